"""Dynamic time warping on an NVIDIA GPU: one pair of series per thread, four rows of the cost table at a time.

Neighbouring threads have the same row series and neighbouring column series. The column series are interleaved, so a
warp reads and writes consecutive numbers. The four rows are computed in registers; only the last of them is written to
global memory, for the next four rows. The compiler contracts products and sums, so the last digits may differ from the
CPU's digits.
"""

# Compiled functions have no static types.
# mypy: disable-error-code="attr-defined, no-untyped-def, untyped-decorator, no-any-return, no-untyped-call"

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import cuda

from cornercase._common.typing import IntArray

# Threads of a block: column series side by side.
THREADS = 128
# Memory for the rows of all pairs of one launch.
ROW_BYTES = 1 << 30
# Largest CUDA grid along the second axis.
MAX_GRID_ROWS = 65_535

Floats = npt.NDArray[np.floating[Any]]


def compute_distances_on_gpu(
    rows: Sequence[Floats],
    columns: Sequence[Floats] | None,
    *,
    squared: bool,
    window: int | None,
    dtype: npt.DTypeLike,
    report_progress: Callable[[int], None],
) -> Floats:
    """Compute the distances of validated series; parameters and result are as in `compute_distances_on_cpu`."""
    dtype = np.dtype(dtype)
    symmetric = columns is None
    partners = rows if columns is None else columns
    dims = rows[0].shape[1]
    # Longest first, so that the threads of a warp finish together and the last launch is short.
    row_order, row_lengths = _order_and_lengths_decreasing(rows)
    column_order, column_lengths = _order_and_lengths_decreasing(partners)
    longest, width = int(column_lengths[0]), len(partners)
    interleaved = np.zeros((longest, dims, width), dtype=dtype)
    for position, j in enumerate(column_order):
        interleaved[: len(partners[j]), :, position] = partners[j]
    starts = np.concatenate(([0], np.cumsum(row_lengths * dims)))
    values = cuda.to_device(np.concatenate([rows[i].ravel() for i in row_order]).astype(dtype))
    starts_on_device, lengths_on_device = cuda.to_device(starts), cuda.to_device(row_lengths)
    columns_on_device, column_lengths_on_device = cuda.to_device(interleaved), cuda.to_device(column_lengths)

    blocks = -(-width // THREADS)
    together = max(1, min(len(rows), MAX_GRID_ROWS, ROW_BYTES // ((longest + 1) * blocks * THREADS * dtype.itemsize)))
    rows_on_device = cuda.device_array((together, longest + 1, width), dtype=dtype)
    result_on_device = cuda.device_array((together, width), dtype=dtype)
    kernel = _cuda_kernel(dims, squared, dtype)
    out = np.zeros((len(rows), width), dtype=dtype)
    for first in range(0, len(rows), together):
        stop = min(first + together, len(rows))
        kernel[(blocks, stop - first), (THREADS, 1)](
            values,
            starts_on_device,
            lengths_on_device,
            columns_on_device,
            column_lengths_on_device,
            first,
            -1 if window is None else window,
            symmetric,
            rows_on_device,
            result_on_device,
        )
        result = result_on_device.copy_to_host()[: stop - first]
        for i, line in zip(range(first, stop), result, strict=True):
            if symmetric:
                later = column_order[i + 1 :]
                out[row_order[i], later] = line[i + 1 :]
                out[later, row_order[i]] = line[i + 1 :]
            else:
                out[row_order[i], column_order] = line
        report_progress(_count_cells(row_lengths, column_lengths, range(first, stop), symmetric))
    return out


def _order_and_lengths_decreasing(series: Sequence[Floats]) -> tuple[IntArray, IntArray]:
    lengths = np.array([len(values) for values in series], dtype=np.int64)
    order = np.argsort(-lengths, kind="stable")
    return order, lengths[order]


def _count_cells(row_lengths: IntArray, column_lengths: IntArray, rows: range, symmetric: bool) -> int:
    return sum(int(row_lengths[i] * column_lengths[i + 1 if symmetric else 0 :].sum()) for i in rows)


@cache
def _cuda_kernel(dims: int, squared: bool, dtype: np.dtype[Any]) -> Any:
    real = dtype.type

    @cuda.jit(device=True)
    def cost(x, at, columns, j, column):
        difference = x[at] - columns[j, 0, column]
        if dims == 1 and not squared:
            return abs(difference)
        total = difference * difference
        for d in range(1, dims):
            difference = x[at + d] - columns[j, d, column]
            total += difference * difference
        if squared:
            return total
        return real(math.sqrt(total))

    @cuda.jit
    def kernel(x, starts, lengths, columns, column_lengths, first, window, symmetric, rows, out):
        column = cuda.blockIdx.x * cuda.blockDim.x + cuda.threadIdx.x
        line = cuda.blockIdx.y
        index = first + line
        if column >= len(column_lengths) or (symmetric and column <= index):
            return
        length, width = lengths[index], column_lengths[column]
        start = starts[index]
        infinity = real(np.inf)
        below, above = length, width
        if window > 0:
            below = max(0, length - width) + window - 1
            above = max(0, width - length) + window - 1
        rows[line, 0, column] = real(0.0)
        for j in range(width):
            rows[line, j + 1, column] = infinity
        for i in range(0, length, 4):
            at = start + i * dims
            lower = max(0, i - below)
            upper = min(width, i + 4 + above)
            diagonal = rows[line, lower, column]
            a = b = c = d = infinity
            for j in range(lower, upper):
                top = rows[line, j + 1, column]
                shift = j - i
                last_a, last_b, last_c = a, b, c
                a = infinity
                if -below <= shift <= above:
                    a = cost(x, at, columns, j, column) + min(last_a, min(top, diagonal))
                bottom = a
                if i + 1 < length:
                    b = infinity
                    if -below <= shift - 1 <= above:
                        b = cost(x, at + dims, columns, j, column) + min(last_b, min(a, last_a))
                    bottom = b
                if i + 2 < length:
                    c = infinity
                    if -below <= shift - 2 <= above:
                        c = cost(x, at + 2 * dims, columns, j, column) + min(last_c, min(b, last_b))
                    bottom = c
                if i + 3 < length:
                    last_d = d
                    d = infinity
                    if -below <= shift - 3 <= above:
                        d = cost(x, at + 3 * dims, columns, j, column) + min(last_d, min(c, last_c))
                    bottom = d
                rows[line, j + 1, column] = bottom
                diagonal = top
            rows[line, 0, column] = infinity
        distance = rows[line, width, column]
        if squared:
            distance = real(math.sqrt(distance))
        out[line, column] = distance

    return kernel
