"""Dynamic time warping distance between all pairs of series.

The distance of two series is the sum of the local costs along the cheapest path through the table of all pairs of
points. A path leads from the pair of first points to the pair of last points, by steps 1-1, 1-0 and 0-1 (Sakoe and
Chiba, Dynamic programming algorithm optimization for spoken word recognition, 1978, without slope constraint and
weighting).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
import numpy.typing as npt

from cornercase._common.errors import InputError
from cornercase._common.platform import count_available_cpus
from cornercase._common.process.dask import check_client
from cornercase._common.progress import progress_step, show_bars
from cornercase.dtw import _dask_squares as dask_tiles
from cornercase.dtw import _in_memory as pairs
from cornercase.dtw import _matrix_file as disk
from cornercase.dtw._in_memory import DtwSettings

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["distance_matrix", "distances_to", "kernel_matrix"]

MAX_DIMENSIONS = 8


def distance_matrix(
    series: Sequence[npt.ArrayLike],
    *,
    local_cost: Literal["euclidean", "squared"] = "euclidean",
    window: int | None = None,
    dtype: npt.DTypeLike = "float64",
    n_jobs: int | None = None,
    device: Literal["cpu", "cuda"] = "cpu",
    progress: bool = False,
    out: str | os.PathLike[str] | disk.FloatMap | None = None,
    resume: bool = False,
    client: Client | None = None,
) -> npt.NDArray[np.floating[Any]]:
    """Compute the dynamic time warping distance between all pairs of series.

    Parameters
    ----------
    series : sequence of n array_like, shape (T_i,) or (T_i, k)
        Time series or trajectories of any lengths, all with the same number of dimensions k.
    local_cost : {"euclidean", "squared"}
        ``"euclidean"``: the cost of two points is their Euclidean distance, and the result has the unit of the series.
        ``"squared"``: the cost is the squared distance, and the result is the root of the sum, as in tslearn and
        dtaidistance.
    window : int, optional
        Sakoe-Chiba band, at least 1: only points less than `window` instants apart may be matched, so 1 allows no
        warping. For unequal lengths the band surrounds both diagonals, from the first points and from the last points:
        ``-(max(T_i - T_j, 0) + window) < t_j - t_i < max(T_j - T_i, 0) + window``. This is dtaidistance's
        `window`, and tslearn's `sakoe_chiba_radius` plus one.
    dtype : {"float64", "float32"}
        Type of the arithmetic and of the result. In single precision the common mean of all points is subtracted first,
        which changes no distance but keeps digits if coordinates are large.
    n_jobs : int, optional
        Number of threads; by default the number of available CPUs. Does not change the result.
    device : {"cpu", "cuda"}
        Where to compute. ``"cuda"`` needs an NVIDIA GPU and the extra `gpu`; the last digits may differ there.
    progress : bool
        Show a progress bar on standard error after a few seconds.
    out : path or numpy.memmap of `dtype`, shape (n, n), optional
        For a matrix that does not fit in memory: the path of a file to create (NumPy's format, ``numpy.load(path,
        mmap_mode="r")`` reads it), or a memmap of an existing file. A second file, ``.progress``, is created next to
        this file.
    resume : bool
        Continue `out` after an earlier call with the same series and options was interrupted. Finished blocks of the
        matrix in the file are not computed again. If there is no file, the computation starts from the beginning.
    client : distributed.Client, optional
        Dask cluster whose workers compute, on all of their cores; `n_jobs` then has no effect. The result is the same
        to the bit. Needs the extra `cluster`.

    Returns
    -------
    ndarray of `dtype`, shape (n, n)
        Symmetric to the bit, zero on the diagonal. If `out` is given, the memmap.

    Raises
    ------
    InputError
        If a series is empty, not numeric, not finite or has another number of dimensions than the first series (the
        message names its index), an option is invalid, a distance is too large for `dtype`, there is no GPU, or `out`
        has the wrong shape or type or belongs to other series or options.

    Examples
    --------
    >>> distance_matrix([[0.0, 1.0, 1.0], [0.0, 1.0], [2.0, 2.0]]).tolist()
    [[0.0, 0.0, 4.0], [0.0, 0.0, 3.0], [4.0, 3.0, 0.0]]
    """
    settings = _check_settings(local_cost, window, dtype, n_jobs, device, client)
    arrays = _validate_series(series)
    if resume and out is None:
        raise InputError("resume needs a matrix on disk that it can continue; give the path of the matrix as out.")
    if len(arrays) < 2 and out is None:
        return np.zeros((len(arrays), len(arrays)), dtype=settings.dtype)
    arrays = _subtract_common_mean(arrays, settings.dtype, len(arrays))
    with _progress_bar(progress, pairs.count_cells(arrays, None)) as advance:
        if out is None:
            result = _compute_distances(arrays, None, settings, client, advance)
            pairs.require_finite_distances(result)
            return result
        if isinstance(out, np.ndarray) and not isinstance(out, np.memmap):
            raise InputError("out is an array in memory, but has to be a file; give a path or a numpy.memmap.")
        if not arrays:
            raise InputError("There are no series, so out would be empty; give at least one series.")
        return disk.fill_matrix_file(
            arrays, out, resume=resume, settings=settings, report_progress=advance, client=client
        )


def distances_to(
    series: Sequence[npt.ArrayLike],
    landmarks: Sequence[npt.ArrayLike],
    *,
    local_cost: Literal["euclidean", "squared"] = "euclidean",
    window: int | None = None,
    dtype: npt.DTypeLike = "float64",
    n_jobs: int | None = None,
    device: Literal["cpu", "cuda"] = "cpu",
    progress: bool = False,
    client: Client | None = None,
) -> npt.NDArray[np.floating[Any]]:
    """Compute the dynamic time warping distance of each series to each landmark.

    The options are those of `distance_matrix`.

    Parameters
    ----------
    series : sequence of n array_like, shape (T_i,) or (T_i, k)
        Time series or trajectories.
    landmarks : sequence of m array_like, shape (T_j,) or (T_j, k)
        Series from which distances are computed, with the same number of dimensions k as `series`.
    local_cost, window, dtype, n_jobs, device, progress, client : optional
        As in `distance_matrix`.

    Returns
    -------
    ndarray of `dtype`, shape (n, m)
        Distances.

    Raises
    ------
    InputError
        As by `distance_matrix`; the message names the index of the series or of the landmark.

    Examples
    --------
    >>> distances_to([[0.0, 1.0, 1.0], [0.0, 1.0]], [[2.0, 2.0]]).tolist()
    [[4.0], [3.0]]
    """
    settings = _check_settings(local_cost, window, dtype, n_jobs, device, client)
    rows = _validate_series(series)
    columns = _validate_series(landmarks, "Landmark", rows[0].shape[1] if rows else None)
    if not rows or not columns:
        return np.zeros((len(rows), len(columns)), dtype=settings.dtype)
    arrays = _subtract_common_mean([*rows, *columns], settings.dtype, len(rows))
    rows, columns = arrays[: len(rows)], arrays[len(rows) :]
    with _progress_bar(progress, pairs.count_cells(rows, columns)) as advance:
        result = _compute_distances(rows, columns, settings, client, advance)
    pairs.require_finite_distances(result, column_label="landmark ")
    return result


def kernel_matrix(
    series: Sequence[npt.ArrayLike],
    gamma: float,
    *,
    local_cost: Literal["euclidean", "squared"] = "euclidean",
    window: int | None = None,
    dtype: npt.DTypeLike = "float64",
    n_jobs: int | None = None,
    progress: bool = False,
) -> npt.NDArray[np.floating[Any]]:
    """Compute the Gaussian kernel ``exp(-gamma d²)`` of the dynamic time warping distances d between all pairs.

    A distance is not computed if a lower bound proves that its entry in the matrix underflows to zero. So the result is
    the same to the bit as if all distances were computed. The other options are those of `distance_matrix`.

    Parameters
    ----------
    series : sequence of n array_like, shape (T_i,) or (T_i, k)
        Time series or trajectories.
    gamma : float
        Factor of the squared distance, above 0; its unit is one over the squared unit of the distances.
    local_cost, window, dtype, n_jobs, progress : optional
        As in `distance_matrix`.

    Returns
    -------
    ndarray of `dtype`, shape (n, n)
        Symmetric to the bit, one on the diagonal.

    Raises
    ------
    InputError
        As by `distance_matrix`, or if `gamma` is not above 0.

    Examples
    --------
    >>> kernel_matrix([[0.0, 1.0], [0.0, 2.0], [900.0]], 1.0).round(6).tolist()
    [[1.0, 0.367879, 0.0], [0.367879, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    if not 0.0 < gamma < np.inf:
        raise InputError(f"gamma is {gamma!r}; give a finite number above 0.")
    settings = _check_settings(local_cost, window, dtype, n_jobs, "cpu")
    arrays = _validate_series(series)
    if len(arrays) < 2:
        return np.ones((len(arrays), len(arrays)), dtype=settings.dtype)
    arrays = _subtract_common_mean(arrays, settings.dtype, len(arrays))
    # exp underflows to 0 below the logarithm of half the smallest positive number.
    max_exponent = 1.0 + np.log(2.0) - np.log(float(np.finfo(settings.dtype).smallest_subnormal))
    with _progress_bar(progress, pairs.count_cells(arrays, None)) as advance:
        result = pairs.compute_distances(
            arrays, None, settings, advance, max_distance=float(np.sqrt(max_exponent / gamma))
        )
    with np.errstate(over="ignore", under="ignore"):
        kernel: npt.NDArray[np.floating[Any]] = np.exp(-settings.dtype.type(gamma) * result**2)
    return kernel


def _compute_distances(
    rows: list[npt.NDArray[np.float64]],
    columns: list[npt.NDArray[np.float64]] | None,
    settings: DtwSettings,
    client: Client | None,
    report_progress: Callable[[int], None],
) -> npt.NDArray[np.floating[Any]]:
    if client is None:
        return pairs.compute_distances(rows, columns, settings, report_progress)
    return dask_tiles.compute_distances_on_dask(rows, columns, settings, client, report_progress)


def _check_settings(
    local_cost: str,
    window: int | None,
    dtype: npt.DTypeLike,
    n_jobs: int | None,
    device: str,
    client: Client | None = None,
) -> DtwSettings:
    if client is not None:
        check_client(client)
        if device != "cpu":
            raise InputError(
                "`client` computes on the CPUs of its workers, so `device` must be 'cpu'; omit `device` or `client`."
            )
    if local_cost not in ("euclidean", "squared"):
        raise InputError(f"local_cost is {local_cost!r}; choose 'euclidean' or 'squared'.")
    if device not in ("cpu", "cuda"):
        raise InputError(f"device is {device!r}; choose 'cpu' or 'cuda'.")
    if dtype not in ("float64", "float32", np.float64, np.float32, np.dtype("float64"), np.dtype("float32")):
        raise InputError(f"dtype is {dtype!r}; choose 'float64' or 'float32'.")
    # Fits 64 bits, and exceeds any length.
    window = None if window is None else min(_check_positive_int("window", window), 2**40)
    threads = count_available_cpus() if n_jobs is None else _check_positive_int("n_jobs", n_jobs)
    if device == "cuda":
        pairs.require_gpu()
    return DtwSettings(local_cost == "squared", window, np.dtype(dtype), threads, "cuda" if device == "cuda" else "cpu")


def _subtract_common_mean(
    arrays: list[npt.NDArray[np.float64]], dtype: np.dtype[Any], n_series: int
) -> list[npt.NDArray[np.float64]]:
    """Subtract the mean of all points if `dtype` is single precision, so that large coordinates keep their digits.

    If `dtype` is double precision, the arrays stay as they are. The first `n_series` arrays are series, the others are
    landmarks.
    """
    if dtype != np.float32 or not arrays:
        return arrays
    points = np.concatenate(arrays)
    # This must not overflow, so that the message below can name the series.
    mean = (points / len(points)).sum(axis=0)
    points -= mean
    # One pass over all points, since there may be thousands of short arrays.
    ends = np.cumsum([len(array) for array in arrays])
    if np.abs(points).max() > np.finfo(np.float32).max:
        index = int(np.searchsorted(ends, np.abs(points).max(axis=1).argmax(), side="right"))
        name = f"Series {index}" if index < n_series else f"Landmark {index - n_series}"
        raise InputError(f"{name} is too large for float32; choose dtype 'float64'.")
    return [points[end - len(array) : end] for end, array in zip(ends.tolist(), arrays, strict=True)]


def _check_positive_int(name: str, value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 1:
        raise InputError(f"{name} is {value!r}; give a whole number of at least 1.")
    return int(value)


def _validate_series(
    series: Sequence[npt.ArrayLike], name: str = "Series", dims: int | None = None
) -> list[npt.NDArray[np.float64]]:
    """Return the series as finite arrays of shape (T_i, k); raise `InputError` if a series is invalid.

    `dims` is the number of dimensions k if other series are already known; otherwise the first one determines it.
    """
    first = f"{name.lower()} 0" if dims is None else "series 0"
    arrays: list[npt.NDArray[np.float64]] = []
    for index, values in enumerate(series):
        try:
            array = np.asarray(values, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"{name} {index} is not an array of numbers; give shape (T,) or (T, k) for T instants of k values."
            ) from error
        if array.ndim not in (1, 2):
            raise InputError(
                f"{name} {index} has {array.ndim} axes; give shape (T,) or (T, k) for T instants of k values."
            )
        if array.size == 0:
            raise InputError(f"{name} {index} is empty; leave it out.")
        array = array.reshape(len(array), -1)
        dims = array.shape[1] if dims is None else dims
        if array.shape[1] != dims:
            raise InputError(
                f"{name} {index} has {array.shape[1]} dimensions, but {first} has {dims}; use the same number for all."
            )
        if dims > MAX_DIMENSIONS:
            raise InputError(f"{name} {index} has {dims} dimensions; at most {MAX_DIMENSIONS} are supported.")
        arrays.append(array)
    # One pass over all points, since there may be thousands of short series.
    if arrays and not np.isfinite(np.concatenate(arrays)).all():
        index = next(k for k, array in enumerate(arrays) if not np.isfinite(array).all())
        instant = int(np.argmin(np.isfinite(arrays[index]).all(axis=1)))
        raise InputError(
            f"{name} {index} is not finite at instant {instant}; replace the value, or leave the series out."
        )
    return arrays


# Cells per step of the progress bar.
_CELLS_PER_STEP: Final = 1_000_000


@contextmanager
def _progress_bar(progress: bool, cells: int) -> Iterator[Callable[[int], None]]:
    """Show a progress bar; yield a function that advances the bar by a number of finished cells (pairs of points)."""
    total = max(1, round(cells / _CELLS_PER_STEP))
    finished = 0

    with show_bars(progress), progress_step(total, "comparing", "million pairs of points") as show:

        def advance(more: int) -> None:
            nonlocal finished
            finished += more
            show(min(total, round(finished / _CELLS_PER_STEP)))

        yield advance
        show(total)
