"""Dynamic time warping on the CPU: one series against as many others as a vector register has lanes.

Series are sorted by length. Each block of 8 (double precision) or 16 (single precision) neighbours is interleaved, so
that one vector holds the same instant of all of them. A tile is the comparison of such a block with several single
series. The recurrence advances four rows at a time: the values of the rows stay in registers, and while one row waits
for a result, the processor works on the other rows. The value of a cell is the cost of the cell plus the minimum of
three neighbours. The minimum is exact, and the sum is rounded once. So the result does not depend on the order of the
cells, the neighbouring lanes, or the number of threads.
"""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, call-arg, var-annotated, no-any-return"

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from cornercase._common.numba import kernel as kernel_module
from cornercase._common.process.signals import collect_interrupts
from cornercase._common.typing import BoolArray, IntArray
from cornercase.dtw import _simd as simd
from cornercase.dtw._simd import (
    absolute,
    add,
    broadcast_point,
    load_vector,
    mask_outside_band,
    minimum,
    nonnegative_minimum,
    root,
    store_vector,
    subtract,
    sum_of_squares,
)

# Cells of a tile: a few ms of work, so that threads finish together and Ctrl-C takes effect soon.
TILE_CELLS = 20_000_000

Floats = npt.NDArray[np.floating[Any]]


@dataclass(frozen=True)
class _SortedSeries:
    """Concatenated series, sorted by length: series ``order[i]`` begins at index ``starts[i]`` of `values`."""

    order: IntArray
    lengths: IntArray
    starts: IntArray
    values: Floats


@dataclass(frozen=True)
class _InterleavedBlock:
    """Series of similar length, interleaved: ``values[(instant * dims + dim) * lanes + lane]``.

    `first` is the index of the first of these series in the order by length.
    """

    first: int
    lengths: IntArray
    values: Floats


def compute_distances_on_cpu(
    rows: Sequence[Floats],
    columns: Sequence[Floats] | None,
    *,
    squared: bool,
    window: int | None,
    dtype: npt.DTypeLike,
    n_jobs: int,
    report_progress: Callable[[int], None],
    needed: BoolArray | None = None,
) -> Floats:
    """Compute the distances of validated series, shape (len(rows), len(columns)).

    Without `columns`, the rows are compared with each other, and only one half is computed. `report_progress` gets the
    number of cells (pairs of instants) done since its last call, in the thread of the caller. `needed` marks the pairs
    that are wanted; the distances of all other pairs may be infinite.
    """
    if columns is not None and len(columns) < len(rows):
        # The longer side fills the lanes better; the distance is the same from either side.
        transposed = None if needed is None else needed.T
        return compute_distances_on_cpu(
            columns,
            rows,
            squared=squared,
            window=window,
            dtype=dtype,
            n_jobs=n_jobs,
            report_progress=report_progress,
            needed=transposed,
        ).T.copy()
    symmetric = columns is None
    dims = rows[0].shape[1]
    dtype = np.dtype(dtype)
    lanes = simd.VECTOR_BYTES // dtype.itemsize
    singles = _sort_by_length(rows, dtype)
    partners = singles if columns is None else _sort_by_length(columns, dtype)
    blocks = [_interleave_block(partners, first, dims, lanes) for first in range(0, len(partners.order), lanes)]
    out = np.full((len(singles.order), len(partners.order)), 0.0 if needed is None else np.inf, dtype=dtype)
    kernel = compile_dtw_kernel(dims, squared, window is not None, dtype)
    band = -1 if window is None else window

    def compute_tile(block: _InterleavedBlock, tile: range) -> int:
        selected = np.arange(tile.start, tile.stop)
        j = partners.order[block.first : block.first + len(block.lengths)]
        if needed is not None:
            selected = selected[needed[singles.order[selected][:, None], j].any(axis=1)]
        result = np.empty((len(selected), lanes), dtype=dtype)
        kernel(singles.values, singles.starts, singles.lengths, block.values, block.lengths, selected, band, result)
        i = singles.order[selected]
        result = result[:, : len(j)]
        out[i[:, None], j] = result
        if symmetric:
            # A block against itself has both halves, equal to the bit.
            out[j[:, None], i] = result.T
        return int(singles.lengths[tile.start : tile.stop].sum() * block.lengths.sum())

    with collect_interrupts() as check:

        def finished(cells: int) -> None:
            report_progress(cells)
            check()

        _run_tiles(compute_tile, _iter_tiles(blocks, singles.lengths, symmetric, n_jobs), n_jobs, finished)
    return out


def _sort_by_length(series: Sequence[Floats], dtype: np.dtype[Any]) -> _SortedSeries:
    lengths = np.array([len(values) for values in series], dtype=np.int64)
    order = np.argsort(lengths, kind="stable")
    starts = np.concatenate(([0], np.cumsum(lengths[order] * series[0].shape[1])))
    return _SortedSeries(
        order, lengths[order], starts, np.concatenate([series[i].ravel() for i in order]).astype(dtype)
    )


def _interleave_block(series: _SortedSeries, first: int, dims: int, lanes: int) -> _InterleavedBlock:
    """Interleave up to `lanes` series. Unused lanes get finite numbers, and their results are dropped."""
    members = range(first, min(first + lanes, len(series.order)))
    block = np.zeros((series.lengths[members[-1]], dims, lanes), dtype=series.values.dtype)
    for lane, i in enumerate(members):
        values = series.values[series.starts[i] : series.starts[i + 1]]
        block[: series.lengths[i], :, lane] = values.reshape(-1, dims)
    return _InterleavedBlock(first, series.lengths[members.start : members.stop], block.ravel())


def _iter_tiles(
    blocks: Sequence[_InterleavedBlock], lengths: IntArray, symmetric: bool, n_jobs: int
) -> Iterator[tuple[_InterleavedBlock, range]]:
    """Yield tiles (a block and a range of single series), the most expensive first.

    If the comparison is `symmetric` (series with each other), the range ends with the last series of the block.
    """
    total = int(lengths.sum()) * sum(int(block.lengths.sum()) for block in blocks) // (2 if symmetric else 1)
    share = min(max(total // (16 * n_jobs), TILE_CELLS // 10), TILE_CELLS)
    for block in reversed(blocks):
        end = block.first + len(block.lengths) if symmetric else len(lengths)
        cells = np.cumsum(lengths[:end]) * int(block.lengths[-1]) * len(block.lengths)
        start = 0
        while start < end:
            finished = cells[start - 1] if start else 0
            stop = max(start + 1, int(np.searchsorted(cells, finished + share, side="right")))
            yield block, range(start, min(stop, end))
            start = stop


def _run_tiles(
    run: Callable[[_InterleavedBlock, range], int],
    tiles: Iterator[tuple[_InterleavedBlock, range]],
    n_jobs: int,
    report_progress: Callable[[int], None],
) -> None:
    """Run tiles on threads. After an interrupt, waiting tiles are dropped and running tiles are finished."""
    if n_jobs == 1:
        for tile in tiles:
            report_progress(run(*tile))
        return
    with ThreadPoolExecutor(n_jobs) as pool:
        waiting: set[Future[int]] = set()
        for tile in tiles:
            waiting.add(pool.submit(run, *tile))
            if len(waiting) > n_jobs:
                finished, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                report_progress(sum(future.result() for future in finished))
        report_progress(sum(future.result() for future in waiting))


# The kernel is assembled from the functions below; `dims`, `squared`, `banded` and `lanes` are constants in
# each of its versions, so that the compiler drops the branches and unrolls the loops over them.
_inline_kernel = njit(inline="always")


@_inline_kernel
def _local_cost(x, y, j, dims, squared, lanes):
    if dims == 1 and not squared:
        return absolute(subtract(x[0], load_vector(y, j * lanes)))
    total = sum_of_squares(x, y, j * dims * lanes)
    if squared:
        return total
    return root(total)


# A row of the cost table is stored after one column of infinity. Columns `lower` to `upper` are in the band of the lane
# with the widest band; narrower bands are masked.
@_inline_kernel
def _advance_one_row(x, i, y, lower, upper, row, below, above, infinity, dims, squared, banded, lanes):
    x_a = broadcast_point(x, i * dims, dims)
    diagonal = load_vector(row, lower * lanes)
    a = load_vector(infinity, 0)
    for j in range(lower, upper):
        top = load_vector(row, (j + 1) * lanes)
        a = add(_local_cost(x_a, y, j, dims, squared, lanes), minimum(a, nonnegative_minimum(top, diagonal)))
        if banded:
            a = mask_outside_band(a, j - i, below, above)
        store_vector(row, (j + 1) * lanes, a)
        diagonal = top
    store_vector(row, 0, load_vector(infinity, 0))


@_inline_kernel
def _advance_four_rows(x, i, y, lower, upper, row, below, above, infinity, dims, squared, banded, lanes):
    x_a = broadcast_point(x, i * dims, dims)
    x_b = broadcast_point(x, (i + 1) * dims, dims)
    x_c = broadcast_point(x, (i + 2) * dims, dims)
    x_d = broadcast_point(x, (i + 3) * dims, dims)
    diagonal = load_vector(row, lower * lanes)
    a = load_vector(infinity, 0)
    b = a
    c = a
    d = a
    for j in range(lower, upper):
        top = load_vector(row, (j + 1) * lanes)
        old_a, old_b, old_c = a, b, c
        a = add(_local_cost(x_a, y, j, dims, squared, lanes), minimum(a, nonnegative_minimum(top, diagonal)))
        if banded:
            a = mask_outside_band(a, j - i, below, above)
        b = add(_local_cost(x_b, y, j, dims, squared, lanes), minimum(b, nonnegative_minimum(a, old_a)))
        if banded:
            b = mask_outside_band(b, j - i - 1, below, above)
        c = add(_local_cost(x_c, y, j, dims, squared, lanes), minimum(c, nonnegative_minimum(b, old_b)))
        if banded:
            c = mask_outside_band(c, j - i - 2, below, above)
        d = add(_local_cost(x_d, y, j, dims, squared, lanes), minimum(d, nonnegative_minimum(c, old_c)))
        if banded:
            d = mask_outside_band(d, j - i - 3, below, above)
        store_vector(row, (j + 1) * lanes, d)
        diagonal = top
    store_vector(row, 0, load_vector(infinity, 0))


@cache
def _tile_kernel(dims: int, squared: bool, banded: bool, lanes: int) -> Callable[..., None]:
    """Make the compiled function for one number of dimensions and lanes, one local cost, and a band or none.

    The function computes the distances of some single series to one interleaved block of series.
    """

    def tile(values, starts, lengths, block, block_lengths, selected, window, out):
        members = len(block_lengths)
        longest = block_lengths[members - 1]
        row = np.empty((longest + 1) * lanes, dtype=values.dtype)
        infinity = np.full(lanes, np.inf, dtype=values.dtype)
        below = np.zeros(lanes, dtype=values.dtype)
        above = np.zeros(lanes, dtype=values.dtype)
        for out_row, index in enumerate(selected):
            x = values[starts[index] : starts[index + 1]]
            length = lengths[index]
            row[:lanes] = 0.0
            row[lanes:] = np.inf
            reach_below, reach_above = length, longest
            if banded:
                for lane in range(members):
                    below[lane] = max(0, length - block_lengths[lane]) + window - 1
                    above[lane] = max(0, block_lengths[lane] - length) + window - 1
                reach_below, reach_above = int(below.max()), int(above.max())
            low, high = load_vector(below, 0), load_vector(above, 0)
            i = 0
            while i < length:
                lower = max(0, i - reach_below)
                if i + 4 <= length:
                    upper = min(longest, i + 4 + reach_above)
                    _advance_four_rows(
                        x, i, block, lower, upper, row, low, high, infinity, dims, squared, banded, lanes
                    )
                    i += 4
                else:
                    upper = min(longest, i + 1 + reach_above)
                    _advance_one_row(x, i, block, lower, upper, row, low, high, infinity, dims, squared, banded, lanes)
                    i += 1
            for lane in range(members):
                distance = row[block_lengths[lane] * lanes + lane]
                if squared:
                    distance = math.sqrt(distance)
                out[out_row, lane] = distance

    return kernel_module.kernel()(tile)


def compile_dtw_kernel(dims: int, squared: bool, banded: bool, dtype: npt.DTypeLike) -> Callable[..., None]:
    """Return the compiled function for one number of dimensions, one local cost, one type, and a band or none."""
    dtype = np.dtype(dtype)
    kernel = _tile_kernel(dims, squared, banded, simd.VECTOR_BYTES // dtype.itemsize)
    floats, integers = np.zeros(dims, dtype=dtype), np.zeros(1, dtype=np.int64)
    kernel(floats, integers, integers, floats, integers, integers[:0], 1, np.empty((0, 1), dtype=dtype))
    return kernel
