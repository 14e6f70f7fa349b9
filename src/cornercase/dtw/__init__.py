"""How alike two scenarios are: dynamic time warping between all pairs of series.

The distance of two series is the sum of the local costs along the cheapest path through their table, from
both first to both last points, by steps 1-1, 1-0 and 0-1 (Sakoe and Chiba, Dynamic programming algorithm
optimization for spoken word recognition, 1978, without slope constraint and weighting).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from cornercase.dtw import cpu
from cornercase.errors import InputError

__all__ = ["distance_matrix"]


def distance_matrix(
    series: Sequence[npt.ArrayLike],
    *,
    local_cost: Literal["euclidean", "squared"] = "euclidean",
    window: int | None = None,
    dtype: npt.DTypeLike = "float64",
    n_jobs: int | None = None,
    device: Literal["cpu", "cuda"] = "cpu",
    progress: bool = False,
) -> npt.NDArray[np.floating[Any]]:
    """Dynamic time warping distance between all pairs of series.

    Parameters
    ----------
    series : sequence of n array_like, shape (T_i,) or (T_i, k)
        Courses or trajectories of unequal lengths, all of the same number of dimensions k.
    local_cost : {"euclidean", "squared"}
        ``"euclidean"``: the cost of two points is their Euclidean distance, and the result has its unit.
        ``"squared"``: the cost is the squared distance and the root is taken of the sum, as tslearn and
        dtaidistance do.
    window : int, optional
        Sakoe-Chiba band, at least 1: only points whose instants are less than `window` apart may be matched,
        so 1 allows no warping. For unequal lengths the band reaches around both diagonals, the one from the
        first points and the one from the last: ``-(max(T_i - T_j, 0) + window) < t_j - t_i < max(T_j - T_i,
        0) + window``. This is dtaidistance's `window`, and tslearn's `sakoe_chiba_radius` plus one.
    dtype : {"float64", "float32"}
        Of the arithmetic and of the result. In single precision the common mean of all points is taken off
        first, which changes no distance but keeps digits where coordinates are large.
    n_jobs : int, optional
        Number of threads; as many as the process has CPUs if not given. Does not change the result.
    device : {"cpu", "cuda"}
        Where to compute; this version knows the CPU only.
    progress : bool
        Show a progress bar on standard error.

    Returns
    -------
    ndarray of `dtype`, shape (n, n)
        Symmetric to the bit, zero on the diagonal.

    Raises
    ------
    InputError
        A series is empty, not numeric, not finite or of another number of dimensions than the first (the
        message names its index), an option is not one of those above, or a distance is too large for `dtype`.

    Examples
    --------
    >>> distance_matrix([[0.0, 1.0, 1.0], [0.0, 1.0], [2.0, 2.0]]).tolist()
    [[0.0, 0.0, 4.0], [0.0, 0.0, 3.0], [4.0, 3.0, 0.0]]
    """
    if local_cost not in ("euclidean", "squared"):
        raise InputError(f"local_cost is {local_cost!r}; choose 'euclidean' or 'squared'.")
    if window is not None:
        window = _positive("window", window)
    threads = cpu.available_cpus() if n_jobs is None else _positive("n_jobs", n_jobs)
    if device == "cuda":
        raise InputError(
            "device 'cuda' needs the extra 'gpu', which this version of cornercase does not have yet; choose "
            "device 'cpu'."
        )
    if device != "cpu":
        raise InputError(f"device is {device!r}; choose 'cpu'.")
    if dtype not in ("float64", "float32", np.float64, np.float32, np.dtype("float64"), np.dtype("float32")):
        raise InputError(f"dtype is {dtype!r}; choose 'float64' or 'float32'.")
    number = np.dtype(dtype)

    arrays = _checked(series)
    if len(arrays) < 2:
        return np.zeros((len(arrays), len(arrays)), dtype=number)
    if number == np.float32:
        mean = np.concatenate(arrays).mean(axis=0)
        arrays = [array - mean for array in arrays]
        for index, array in enumerate(arrays):
            if np.abs(array).max() > np.finfo(np.float32).max:
                raise InputError(f"Series {index} is too large for float32; choose dtype 'float64'.")
    points = np.array([len(array) for array in arrays], dtype=np.float64)
    cells = int((points.sum() ** 2 - (points**2).sum()) / 2)
    with _shown(progress, cells) as advance:
        matrix = cpu.distance_matrix(
            arrays,
            squared=local_cost == "squared",
            window=window,
            dtype=number,
            n_jobs=threads,
            advance=advance,
        )
    if not np.isfinite(matrix).all():
        i, j = np.argwhere(~np.isfinite(matrix))[0]
        raise InputError(f"The distance of series {i} and {j} is too large for {number}; scale the values down.")
    return matrix


def _positive(name: str, value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 1:
        raise InputError(f"{name} is {value!r}; give a whole number of at least 1.")
    return int(value)


def _checked(series: Sequence[npt.ArrayLike]) -> list[npt.NDArray[np.float64]]:
    """Return the series as finite arrays of shape (T_i, k)."""
    arrays: list[npt.NDArray[np.float64]] = []
    for index, one in enumerate(series):
        try:
            array = np.asarray(one, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InputError(f"Series {index} is not an array of numbers; give shape (T,) or (T, k).") from error
        if array.ndim not in (1, 2):
            raise InputError(f"Series {index} has {array.ndim} axes; give shape (T,) or (T, k).")
        if array.size == 0:
            raise InputError(f"Series {index} is empty; leave it out.")
        array = array.reshape(len(array), -1)
        if arrays and array.shape[1] != arrays[0].shape[1]:
            raise InputError(
                f"Series {index} has {array.shape[1]} dimensions where series 0 has {arrays[0].shape[1]}; "
                "give all the same."
            )
        if not np.isfinite(array).all():
            instant = int(np.argmin(np.isfinite(array).all(axis=1)))
            raise InputError(
                f"Series {index} is not finite at instant {instant}; fill or cap it, or leave the series out."
            )
        arrays.append(array)
    return arrays


@contextmanager
def _shown(progress: bool, cells: int) -> Iterator[Callable[[int], None]]:
    """Give the function that is told of each finished tile."""
    if not progress:
        yield lambda done: None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True)) as bar:
        task = bar.add_task("DTW distances", total=cells)
        yield lambda done: bar.advance(task, done)
        bar.update(task, completed=cells)
