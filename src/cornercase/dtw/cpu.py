"""Dynamic time warping on the CPU: one series against as many others as a vector has lanes.

The series are sorted by length. Each block of 8 (double) or 16 (single precision) neighbours is interleaved,
so that one vector holds the same instant of all of them; a tile is such a block against a run of single
series. In a pair the recurrence is advanced by four rows at a time: their values stay in registers, and four
independent chains hide the latency of one. Every cell is one rounded sum of its cost and an exact minimum, so
neither the order of the cells, nor the partner in the neighbouring lane, nor the number of threads shows in
the result.
"""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, call-arg, var-annotated, no-any-return"

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from cornercase.dtw import simd
from cornercase.dtw.simd import absolute, add, load, minimum, multiply, root, spread, store, subtract, within
from cornercase.interrupts import noted_interrupts
from cornercase.typing import IntArray

# Cells of one tile: some milliseconds of work, so that threads end together and Ctrl-C is heard soon.
TILE_CELLS = 20_000_000

Floats = npt.NDArray[np.floating[Any]]


@dataclass(frozen=True)
class _Block:
    """Neighbours in the order of length, interleaved: ``values[(instant * dims + dim) * lanes + lane]``."""

    first: int
    lengths: IntArray
    values: Floats


def distance_matrix(
    series: Sequence[Floats],
    *,
    squared: bool,
    window: int | None,
    dtype: npt.DTypeLike,
    n_jobs: int,
    advance: Callable[[int], None],
) -> Floats:
    """Fill the matrix of the public function from checked input.

    Parameters
    ----------
    series : sequence of ndarray, shape (T_i, k)
    squared : bool
        Sum squared distances and take the root at the end.
    window : int or None
    dtype : float64 or float32
        Of the arithmetic and the result.
    n_jobs : int
        Number of threads.
    advance : callable
        Called in this thread with the number of cells done since the last call.

    Returns
    -------
    ndarray of `dtype`, shape (n, n)
    """
    n, dims = len(series), series[0].shape[1]
    dtype = np.dtype(dtype)
    lanes = simd.BYTES // dtype.itemsize
    lengths = np.array([len(one) for one in series], dtype=np.int64)
    order = np.argsort(lengths, kind="stable")
    lengths = lengths[order]
    starts = np.concatenate(([0], np.cumsum(lengths * dims)))
    values = np.concatenate([series[i].ravel() for i in order]).astype(dtype)
    blocks = [_interleave(values, starts, lengths, first, dims, lanes) for first in range(0, n, lanes)]
    out = np.zeros((n, n), dtype=dtype)
    kernel = _kernel(dims, squared, window is not None, lanes)
    band = -1 if window is None else window

    def run(block: _Block, rows: range) -> int:
        kernel(
            values,
            starts,
            lengths,
            block.values,
            block.lengths,
            block.first,
            rows.start,
            rows.stop,
            band,
            order,
            out,
        )
        return int(lengths[rows.start : rows.stop].sum() * block.lengths.sum())

    with noted_interrupts() as check:

        def told(cells: int) -> None:
            advance(cells)
            check()

        _run_all(run, _tiles(blocks, lengths), n_jobs, told)
    return out


def _interleave(values: Floats, starts: IntArray, lengths: IntArray, first: int, dims: int, lanes: int) -> _Block:
    """Interleave up to `lanes` series; padding is finite and never read out."""
    members = range(first, min(first + lanes, len(lengths)))
    block = np.zeros((lengths[members[-1]], dims, lanes), dtype=values.dtype)
    for lane, i in enumerate(members):
        block[: lengths[i], :, lane] = values[starts[i] : starts[i + 1]].reshape(-1, dims)
    return _Block(first, lengths[members.start : members.stop], block.ravel())


def _tiles(blocks: Sequence[_Block], lengths: IntArray) -> Iterator[tuple[_Block, range]]:
    """Blocks against runs of series that stand before their last member, the most expensive first."""
    for block in reversed(blocks):
        end = block.first + len(block.lengths) - 1
        cells = np.cumsum(lengths[:end]) * int(block.lengths[-1]) * len(block.lengths)
        start = 0
        while start < end:
            done = cells[start - 1] if start else 0
            stop = max(start + 1, int(np.searchsorted(cells, done + TILE_CELLS, side="right")))
            yield block, range(start, min(stop, end))
            start = stop


def _run_all(
    run: Callable[[_Block, range], int],
    tiles: Iterator[tuple[_Block, range]],
    n_jobs: int,
    advance: Callable[[int], None],
) -> None:
    """Run tiles on threads; an interrupt drops those not begun and waits for those that are."""
    if n_jobs == 1:
        for tile in tiles:
            advance(run(*tile))
        return
    with ThreadPoolExecutor(n_jobs) as pool:
        waiting: set[Future[int]] = set()
        for tile in tiles:
            waiting.add(pool.submit(run, *tile))
            if len(waiting) > n_jobs:
                done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                advance(sum(future.result() for future in done))
        advance(sum(future.result() for future in waiting))


def available_cpus() -> int:
    """Return the number of CPUs that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


# The kernel is assembled from the functions below; `dims`, `squared`, `banded` and `lanes` are constants in
# each of its versions, so that the compiler drops the branches and unrolls the loops over them.
_inlined = njit(inline="always")


@_inlined
def _cost(x, i, y, j, dims, squared, lanes):
    difference = subtract(spread(x, i * dims), load(y, j * dims * lanes))
    if dims == 1 and not squared:
        return absolute(difference)
    total = multiply(difference, difference)
    for d in range(1, dims):
        difference = subtract(spread(x, i * dims + d), load(y, (j * dims + d) * lanes))
        total = add(total, multiply(difference, difference))
    if squared:
        return total
    return root(total)


# A row is kept behind one column of infinity. The columns `lower` to `upper` are those of the lane with the
# widest band; what a narrower one must not see is masked.
@_inlined
def _one_row(x, i, y, lower, upper, row, below, above, infinity, dims, squared, banded, lanes):
    diagonal = load(row, lower * lanes)
    a = load(infinity, 0)
    for j in range(lower, upper):
        top = load(row, (j + 1) * lanes)
        a = add(_cost(x, i, y, j, dims, squared, lanes), minimum(a, minimum(top, diagonal)))
        if banded:
            a = within(a, j - i, below, above)
        store(row, (j + 1) * lanes, a)
        diagonal = top
    store(row, 0, load(infinity, 0))


@_inlined
def _four_rows(x, i, y, lower, upper, row, below, above, infinity, dims, squared, banded, lanes):
    diagonal = load(row, lower * lanes)
    a = load(infinity, 0)
    b = a
    c = a
    d = a
    for j in range(lower, upper):
        top = load(row, (j + 1) * lanes)
        old_a, old_b, old_c = a, b, c
        a = add(_cost(x, i, y, j, dims, squared, lanes), minimum(a, minimum(top, diagonal)))
        if banded:
            a = within(a, j - i, below, above)
        b = add(_cost(x, i + 1, y, j, dims, squared, lanes), minimum(b, minimum(a, old_a)))
        if banded:
            b = within(b, j - i - 1, below, above)
        c = add(_cost(x, i + 2, y, j, dims, squared, lanes), minimum(c, minimum(b, old_b)))
        if banded:
            c = within(c, j - i - 2, below, above)
        d = add(_cost(x, i + 3, y, j, dims, squared, lanes), minimum(d, minimum(c, old_c)))
        if banded:
            d = within(d, j - i - 3, below, above)
        store(row, (j + 1) * lanes, d)
        diagonal = top
    store(row, 0, load(infinity, 0))


@cache
def _kernel(dims: int, squared: bool, banded: bool, lanes: int) -> Callable[..., None]:
    """Kernel of a tile for one kind of cost; compiled on its first call, then loaded from disk."""

    @njit(cache=True, nogil=True)
    def tile(values, starts, lengths, block, block_lengths, first, begin, end, window, order, out):
        members = len(block_lengths)
        longest = block_lengths[members - 1]
        row = np.empty((longest + 1) * lanes, dtype=values.dtype)
        infinity = np.full(lanes, np.inf, dtype=values.dtype)
        below = np.zeros(lanes, dtype=values.dtype)
        above = np.zeros(lanes, dtype=values.dtype)
        for one in range(begin, end):
            x = values[starts[one] : starts[one + 1]]
            length = lengths[one]
            row[:lanes] = 0.0
            row[lanes:] = np.inf
            reach_below, reach_above = length, longest
            if banded:
                for lane in range(members):
                    below[lane] = max(0, length - block_lengths[lane]) + window - 1
                    above[lane] = max(0, block_lengths[lane] - length) + window - 1
                reach_below, reach_above = int(below.max()), int(above.max())
            low, high = load(below, 0), load(above, 0)
            i = 0
            while i < length:
                lower = max(0, i - reach_below)
                if i + 4 <= length:
                    upper = min(longest, i + 4 + reach_above)
                    _four_rows(x, i, block, lower, upper, row, low, high, infinity, dims, squared, banded, lanes)
                    i += 4
                else:
                    upper = min(longest, i + 1 + reach_above)
                    _one_row(x, i, block, lower, upper, row, low, high, infinity, dims, squared, banded, lanes)
                    i += 1
            for lane in range(members):
                other = first + lane
                if other > one:
                    distance = row[block_lengths[lane] * lanes + lane]
                    if squared:
                        distance = math.sqrt(distance)
                    out[order[one], order[other]] = distance
                    out[order[other], order[one]] = distance

    return tile
