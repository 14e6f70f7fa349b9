"""How well the kept scenarios represent all that were run."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering import Distances, PlacedDistances
from cornercase.reduction.draws import DRAWS, draw_choices, nearest, nearest_of
from cornercase.reduction.held_out import HeldOut
from cornercase.reduction.medoids import choose_medoids


@dataclass(frozen=True)
class Coverage:
    """Distances from every scenario to the nearest kept one, in the unit of the distances.

    All but `held_out` describe the kept scenarios among those that they were chosen from, so they say nothing of
    others; `held_out` does.

    Attributes
    ----------
    kept : int
        Number of scenarios kept.
    largest, mean : float
        Of these distances.
    worst : int
        The scenario at the largest distance: the one that the kept ones represent worst. By index, or by id where
        ids were given.
    largest_relative, mean_relative : float
        The same as shares of the largest distance of any two scenarios; 0 where all are alike.
    random_largest, random_mean : float
        Medians of the same figures over random choices of as many.
    better_largest, better_mean : float
        Shares of the random choices that leave a larger gap, and a larger mean, than the kept ones.
    medoids_largest, medoids_mean : float
        The same figures of k-medoids of the same number: the choice that leaves the smallest mean. These and the two
        before are NaN in a study that an early version reduced.
    held_out : HeldOut or None, default None
        Of scenarios that did not choose; None where that was not measured.
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
    held_out: HeldOut | None = None


@dataclass(frozen=True, eq=False)
class Gaps:
    """Distances from every scenario to the nearest one of some choices.

    Attributes
    ----------
    kept : ndarray of float64, shape (n,)
    medoids : ndarray of float64, shape (n,)
        Of k-medoids of the same number.
    random : ndarray of float64, shape (draws, n)
        Of random choices of the same number.
    """

    kept: FloatArray
    medoids: FloatArray
    random: FloatArray


def measure_gaps(distances: Distances, kept: npt.ArrayLike, *, draws: int = DRAWS, seed: int = 0) -> Gaps:
    """Measure how far every scenario is from the nearest kept one, and from those of other choices.

    Parameters
    ----------
    distances : ndarray of float64, shape (n, n), or PlacedDistances
        Between all scenarios, in any unit.
    kept : array_like of int, shape (m,)
        Indices of the kept scenarios, at least one; the same index twice counts once.
    draws : int, default 100
        Number of random choices to compare with. They are drawn for this: `choose_scenarios` knows others.
    seed : int, default 0
        Of the random choices.

    Returns
    -------
    Gaps
        Distances by scenario.
    """
    chosen = np.unique(np.asarray(kept, dtype=np.int64))
    random = draw_choices(len(distances), len(chosen), stream="grading", draws=draws, seed=seed)
    return Gaps(
        nearest(distances, chosen),
        nearest(distances, choose_medoids(distances, len(chosen))),
        nearest_of(distances, random),
    )


def redrawn(gaps: Gaps, distances: Distances, kept: IntArray, seed: int) -> Gaps:
    """Compare kept scenarios with random choices of another seed than 0.

    Parameters
    ----------
    gaps : Gaps
        As `measure_gaps` gives it with the seed 0.
    distances : ndarray of float64, shape (n, n), or PlacedDistances
        Between all scenarios.
    kept : ndarray of int64, shape (m,)
        Indices of the kept scenarios.
    seed : int
        Of the random choices.

    Returns
    -------
    Gaps
        As `measure_gaps` gives it with the seed.
    """
    if not seed:
        return gaps
    random = draw_choices(len(distances), len(np.unique(kept)), stream="grading", seed=seed)
    return replace(gaps, random=nearest_of(distances, random))


def measure_coverage(
    distances: npt.ArrayLike | PlacedDistances,
    kept: npt.ArrayLike,
    *,
    ids: npt.ArrayLike | None = None,
    draws: int = DRAWS,
    seed: int = 0,
    gaps: Gaps | None = None,
) -> Coverage:
    """Measure how well some scenarios represent all.

    Parameters
    ----------
    distances : array_like, shape (n, n), or PlacedDistances
        Between all scenarios.
    kept : array_like of int, shape (m,)
        Indices of the kept scenarios, at least one; the same index twice counts once.
    ids : array_like of int, shape (n,), optional
        Names of the scenarios; indices by default.
    draws : int, default 100
        Number of random choices to compare with, as in `measure_gaps`.
    seed : int, default 0
        Of the random choices.
    gaps : Gaps, optional
        What `measure_gaps` gives for them, where it is known.

    Returns
    -------
    Coverage
        Figures over all scenarios.

    Raises
    ------
    InputError
        Nothing is kept, an index is out of range, the matrix is not square, or `draws` is not positive.
    """
    matrix = distances if isinstance(distances, PlacedDistances) else np.asarray(distances, dtype=np.float64)
    if len(matrix.shape) != 2 or matrix.shape[0] != matrix.shape[1]:
        raise InputError(f"A distance matrix of shape {matrix.shape} is not square; give shape (n, n).")
    chosen = np.unique(np.asarray(kept, dtype=np.int64))
    n = len(matrix)
    if not len(chosen):
        raise InputError("No scenario is kept, so nothing is covered; keep at least one.")
    if chosen[0] < 0 or chosen[-1] >= n:
        raise InputError(f"A kept scenario is not among the {n} of the distance matrix; give indices from 0.")
    names = np.arange(n) if ids is None else np.asarray(ids, dtype=np.int64)
    extent = float(matrix.max())
    found = measure_gaps(matrix, chosen, draws=draws, seed=seed) if gaps is None else gaps
    left, random, middle = found.kept, found.random, found.medoids
    return Coverage(
        kept=len(chosen),
        largest=float(left.max()),
        mean=float(left.mean()),
        worst=int(names[left.argmax()]),
        largest_relative=float(left.max()) / extent if extent else 0.0,
        mean_relative=float(left.mean()) / extent if extent else 0.0,
        random_largest=float(np.median(random.max(axis=1))),
        random_mean=float(np.median(random.mean(axis=1))),
        better_largest=float(np.mean(random.max(axis=1) > left.max())),
        better_mean=float(np.mean(random.mean(axis=1) > left.mean())),
        medoids_largest=float(middle.max()),
        medoids_mean=float(middle.mean()),
    )
