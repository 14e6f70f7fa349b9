"""How much of what was run is unlike everything that is kept."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray, IntArray
from cornercase.reduction.hulls import prototype


@dataclass(frozen=True)
class Coverage:
    """Distances from every scenario to the nearest kept one, in the unit of the distance matrix.

    Attributes
    ----------
    kept : int
        Number of scenarios kept.
    largest, mean : float
        Of these distances.
    worst : int
        The scenario at the largest distance: the one that the kept ones represent worst.
    largest_relative, mean_relative : float
        The same as shares of the largest distance of any two scenarios; 0 where all are alike.
    random_largest, random_mean : float
        Medians of the same figures over random subsets of the same size: what a choice without thought would
        reach.
    better_largest, better_mean : float
        Shares of the random subsets that leave a larger gap, and a larger mean, than the kept ones.
    medoids_largest, medoids_mean : float
        The same figures of k-medoids of the same size: the subset that leaves the smallest mean.
    """

    kept: int
    largest: float
    mean: float
    worst: int
    largest_relative: float
    mean_relative: float
    random_largest: float
    random_mean: float
    better_largest: float
    better_mean: float
    medoids_largest: float
    medoids_mean: float


@dataclass(frozen=True)
class Gaps:
    """Distances from every scenario to the nearest one of some subsets.

    Attributes
    ----------
    kept : ndarray of float64, shape (n,)
    medoids : ndarray of float64, shape (n,)
        Of k-medoids of the same size.
    random : ndarray of float64, shape (draws, n)
        Of random subsets of the same size.
    """

    kept: FloatArray
    medoids: FloatArray
    random: FloatArray


def gaps(distances: FloatArray, kept: npt.ArrayLike, *, draws: int = 100, seed: int = 0) -> Gaps:
    """Measure how far every scenario is from the nearest kept one, and from what could have been kept instead.

    Parameters
    ----------
    distances : ndarray of float64, shape (n, n)
    kept : array_like of int, shape (m,)
        At least one.
    draws : int
        Number of random subsets.
    seed : int

    Returns
    -------
    Gaps
    """
    chosen = np.unique(np.asarray(kept, dtype=np.int64))
    return Gaps(
        distances[:, chosen].min(axis=1),
        distances[:, medoids(distances, len(chosen))].min(axis=1),
        random_gaps(distances, len(chosen), draws=draws, seed=seed),
    )


def random_gaps(distances: FloatArray, size: int, *, draws: int = 100, seed: int = 0) -> FloatArray:
    """Distances from every scenario to the nearest one of random subsets of a size, shape (draws, n)."""
    rng = np.random.default_rng(seed)
    chosen = [rng.choice(len(distances), size=size, replace=False) for _ in range(draws)]
    return np.array([distances[:, one].min(axis=1) for one in chosen])


def coverage(distances: npt.ArrayLike, kept: npt.ArrayLike, *, draws: int = 100, seed: int = 0) -> Coverage:
    """Measure how well some scenarios represent all.

    Parameters
    ----------
    distances : array_like, shape (n, n)
        Dynamic time warping distances of all scenarios.
    kept : array_like of int, shape (m,)
        Indices of those kept, at least one; the same index twice counts once.
    draws : int
        Number of random subsets to compare with.
    seed : int
        Of the random subsets.

    Returns
    -------
    Coverage

    Raises
    ------
    InputError
        Nothing is kept, an index is out of range, the matrix is not square, or `draws` is not positive.
    """
    matrix = np.asarray(distances, dtype=np.float64)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
        raise InputError(f"A distance matrix of shape {matrix.shape} is not square; give shape (n, n).")
    chosen = np.unique(np.asarray(kept, dtype=np.int64))
    n = len(matrix)
    if not len(chosen):
        raise InputError("No scenario is kept, so nothing is covered; keep at least one.")
    if chosen[0] < 0 or chosen[-1] >= n:
        raise InputError(f"A kept scenario is not among the {n} of the distance matrix; give indices from 0.")
    if draws < 1:
        raise InputError(f"draws is {draws}; give at least 1.")
    extent = float(matrix.max())
    found = gaps(matrix, chosen, draws=draws, seed=seed)
    left, random, middle = found.kept, found.random, found.medoids
    return Coverage(
        kept=len(chosen),
        largest=float(left.max()),
        mean=float(left.mean()),
        worst=int(left.argmax()),
        largest_relative=float(left.max()) / extent if extent else 0.0,
        mean_relative=float(left.mean()) / extent if extent else 0.0,
        random_largest=float(np.median(random.max(axis=1))),
        random_mean=float(np.median(random.mean(axis=1))),
        better_largest=float(np.mean(random.max(axis=1) > left.max())),
        better_mean=float(np.mean(random.mean(axis=1) > left.mean())),
        medoids_largest=float(middle.max()),
        medoids_mean=float(middle.mean()),
    )


def medoids(distances: FloatArray, k: int, rounds: int = 50) -> IntArray:
    """Choose k scenarios with a small mean distance from all to the nearest one.

    Begins with those that lower it most, one after the other (L. Kaufman, P. J. Rousseeuw, "Finding Groups in Data",
    1990, BUILD); then each takes the middle of those that are nearest to it, until nothing changes (H.-S. Park, C.-H.
    Jun, Expert Systems with Applications 36, 2009).

    Parameters
    ----------
    distances : ndarray of float64, shape (n, n)
    k : int
        1 to n.
    rounds : int, default 50

    Returns
    -------
    ndarray of int64, shape (k,)
        Rising.
    """
    chosen = [int(distances.sum(axis=1).argmin())]
    gap = distances[chosen[0]].copy()
    while len(chosen) < k:
        gain = np.maximum(gap[:, None] - distances, 0.0).sum(axis=0)
        gain[chosen] = -1.0
        chosen.append(int(gain.argmax()))
        gap = np.minimum(gap, distances[chosen[-1]])
    found = np.array(chosen, dtype=np.int64)
    for _ in range(rounds):
        nearest = distances[:, found].argmin(axis=1)
        nearest[found] = np.arange(k)
        middles = [prototype(distances, np.flatnonzero(nearest == j)) for j in range(k)]
        if np.array_equal(middles, found):
            break
        found = np.array(middles, dtype=np.int64)
    return np.sort(found)
