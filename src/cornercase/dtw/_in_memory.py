"""DTW distances of series, computed in memory on the CPU or the GPU; identical series are computed only once."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from cornercase._common.errors import InputError
from cornercase._common.optional_packages import describe_install
from cornercase._common.typing import IntArray
from cornercase.dtw import _cpu as cpu

Floats = npt.NDArray[np.floating[Any]]


@dataclass(frozen=True)
class DtwSettings:
    """Settings for the computation of distances.

    `squared` selects the squared Euclidean distance as local cost, instead of the Euclidean distance. `window` is the
    Sakoe-Chiba band in instants; None for no band.
    """

    squared: bool
    window: int | None
    dtype: np.dtype[Any]
    n_jobs: int
    device: Literal["cpu", "cuda"]


def compute_distances(
    rows: Sequence[Floats],
    columns: Sequence[Floats] | None,
    settings: DtwSettings,
    report_progress: Callable[[int], None],
    max_distance: float | None = None,
) -> Floats:
    """Compute the distances of validated series, shape (len(rows), len(columns)).

    Without `columns`, the rows are compared with each other. `report_progress` gets the number of cells (pairs of
    instants) done since its last call. Distances that surely exceed `max_distance` are skipped if the rows are compared
    with each other on the CPU. Skipped distances, and distances that overflow, are infinite.
    """
    total = count_cells(rows, columns)
    distinct_rows, row_of = remove_duplicates(rows)
    distinct_columns, column_of = (None, row_of) if columns is None else remove_duplicates(columns)
    if settings.window is None:
        distinct_rows, distinct_columns = trim_common_constant_parts(distinct_rows, distinct_columns)
    needed = None
    if max_distance is not None:
        from cornercase.dtw._lower_bounds import find_pairs_within_distance

        needed = find_pairs_within_distance(distinct_rows, max_distance, settings.squared)
    computed = count_cells(distinct_rows, distinct_columns)
    share = total / computed if computed else 0.0

    def report_done(done: int) -> None:
        report_progress(round(done * share))

    if settings.device == "cuda":
        from cornercase.dtw import _cuda as cuda_module

        result = cuda_module.compute_distances_on_gpu(
            distinct_rows,
            distinct_columns,
            squared=settings.squared,
            window=settings.window,
            dtype=settings.dtype,
            report_progress=report_done,
        )
    else:
        result = cpu.compute_distances_on_cpu(
            distinct_rows,
            distinct_columns,
            squared=settings.squared,
            window=settings.window,
            dtype=settings.dtype,
            n_jobs=settings.n_jobs,
            report_progress=report_done,
            needed=needed,
        )
    if len(distinct_rows) < len(rows) or (distinct_columns and columns and len(distinct_columns) < len(columns)):
        result = result[row_of[:, None], column_of]
    return result


def require_finite_distances(
    distances: Floats, first_row: int = 0, first_column: int = 0, column_label: str = ""
) -> None:
    """Raise `InputError` for the first pair whose distance has overflowed.

    The message names the pair by the numbers of its row and its column. The first row has the number `first_row`, the
    first column has `first_column`. `column_label` is the text before the column's number, with a trailing space.
    """
    if not np.isfinite(distances).all():
        i, j = np.argwhere(~np.isfinite(distances))[0] + (first_row, first_column)
        raise InputError(
            f"The distance of series {i} and {column_label}{j} is too large for {distances.dtype};"
            f" scale the values down."
        )


def require_gpu() -> None:
    """Raise `InputError` if there is no usable GPU; the simulator of numba counts as a GPU."""
    if os.environ.get("NUMBA_ENABLE_CUDASIM") == "1":
        return
    if find_spec("numba_cuda") is None:
        raise InputError(f"device 'cuda' needs the extra 'gpu'; {describe_install('gpu')}, or choose device 'cpu'.")
    from numba import cuda

    if not cuda.is_available():
        raise InputError("device 'cuda' needs an NVIDIA GPU and its driver, but none was found; choose device 'cpu'.")


def count_cells(rows: Sequence[Floats], columns: Sequence[Floats] | None) -> int:
    """Return the number of cells (pairs of instants) in the cost tables of all pairs of series."""
    lengths = np.array([len(values) for values in rows], dtype=np.float64)
    if columns is None:
        return int((lengths.sum() ** 2 - (lengths**2).sum()) / 2)
    return int(lengths.sum() * sum(len(values) for values in columns))


def remove_duplicates(series: Sequence[Floats]) -> tuple[Sequence[Floats], IntArray]:
    """Return the distinct series, and the index of each given series among the distinct series.

    Only series that are equal to the bit are duplicates.
    """
    positions: dict[bytes, int] = {}
    index = np.array([positions.setdefault(values.tobytes(), len(positions)) for values in series], dtype=np.int64)
    _, first = np.unique(index, return_index=True)
    return [series[i] for i in first], index


def trim_common_constant_parts(
    rows: Sequence[Floats], columns: Sequence[Floats] | None
) -> tuple[Sequence[Floats], Sequence[Floats] | None]:
    """Reduce a constant start or end to a single point if all series have the same one; this changes no distance.

    An example is a metric that stays at its cap. The function is for distances without a window, which stay the same
    to the bit.

    Proof: let x begin with p points that equal c, and y with q points that equal c. In the cost table of x (rows) and y
    (columns), the first p rows and q columns form a rectangle whose cells all cost 0. Path A leaves the rectangle
    early: it goes on to later columns while it is still in a row ``i < p - 1``. Until it reaches row ``p - 1``, it
    compares c with each of these columns at least once. Path B goes to the corner ``(p - 1, q - 1)`` at no cost, and
    then passes the same columns in row ``p - 1``. So B adds a part of the costs of A, in the same order. As costs are
    not negative, the rounded sum of B is not greater. The same holds for a path that goes on to later rows first. So
    there is a cheapest path through the corner, and its part before the corner can be cut off. For a constant end,
    reverse the series. A common start that is not constant cannot be cut off. For example, both series may begin with
    0, 3. If zeros follow in one of them, the cheapest path may match these zeros with the first 0 of the other series.
    """
    series = [*rows, *(columns or ())]
    starts = np.array([values[0] for values in series])
    ends = np.array([values[-1] for values in series])
    at_begin, at_end = bool((starts == starts[0]).all()), bool((ends == ends[0]).all())
    if not at_begin and not at_end:
        return rows, columns

    def shorten(values: Floats) -> Floats:
        if at_begin:
            moving = np.flatnonzero((values != values[0]).any(axis=1))
            values = values[moving[0] - 1 :] if len(moving) else values[:1]
        if at_end:
            moving = np.flatnonzero((values != values[-1]).any(axis=1))
            values = values[: moving[-1] + 2] if len(moving) else values[:1]
        return values

    return [shorten(values) for values in rows], None if columns is None else [shorten(values) for values in columns]
