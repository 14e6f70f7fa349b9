"""Coverage: how well the selected scenarios represent all scenarios that were run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering._embedding import Distances, EmbeddedDistances
from cornercase.reduction._held_out_coverage import HeldOutCoverage, summarize_distances
from cornercase.reduction._medoids import find_k_medoids
from cornercase.reduction._random_selections import (
    DEFAULT_DRAWS,
    distances_to_nearest,
    distances_to_nearest_per_selection,
    draw_random_selections,
)

# Number of points of a coverage curve.
_N_REACHES: Final = 120


@dataclass(frozen=True)
class Coverage:
    """Coverage by a reduced set: statistics of the distances from every scenario to the nearest selected scenario.

    All values except `held_out` are in-sample: they describe the scenarios from which the set was selected. The
    baselines are random selections and k-medoids, each with as many scenarios as the set.

    Attributes
    ----------
    kept : int
        Number of scenarios selected.
    largest, mean : float
        Largest and mean distance, in the unit of the distances.
    worst : int
        The scenario at the largest distance: its index, or its id if ids were given.
    largest_relative, mean_relative : float
        `largest` and `mean` as shares of the largest distance of any two scenarios; 0 if all are identical.
    random_largest, random_mean : float
        Medians, over the random selections, of the largest and of the mean distance.
    better_largest, better_mean : float
        Shares of the random selections whose largest distance, and whose mean distance, is larger than that of the
        set. NaN if an early version of cornercase reduced the study.
    medoids_largest, medoids_mean : float
        Largest and mean distance if k-medoids are selected, which are chosen for a small mean distance. NaN if an
        early version of cornercase reduced the study.
    held_out : HeldOutCoverage or None, default None
        Cross-validated distances; None if not measured.

    Examples
    --------
    >>> import cornercase as cc
    >>> reduced = cc.reduce("study.db", "reduced", by="interaction", size=10)  # doctest: +SKIP
    >>> coverage = reduced.coverage["interaction"]  # doctest: +SKIP
    >>> round(coverage.mean_relative, 3), coverage.worst, coverage.better_mean  # doctest: +SKIP
    (0.036, 151, 0.98)
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
    held_out: HeldOutCoverage | None = None


@dataclass(frozen=True, eq=False)
class NearestDistances:
    """Distances from every scenario to the nearest selected scenario, for the reduced set and for baselines.

    The distances `to_selected`, shape (n,), end at the reduced set. The distances `to_medoids`, shape (n,), and
    `to_random`, shape (draws, n), end at the baselines: k-medoids, and random selections, one per row. Each baseline
    has as many scenarios as the reduced set.
    """

    to_selected: FloatArray
    to_medoids: FloatArray
    to_random: FloatArray


@dataclass(frozen=True, eq=False)
class CoverageCurves:
    """Coverage curves for the report: share of scenarios that are near a selected one, as a function of the distance.

    `to_selected` and `to_medoids`, shape (n,), are the distances from every scenario to the reduced set and to
    k-medoids. `reach`, shape (m,), has increasing distances from 0 on. For each distance in `reach` and each random
    selection, a percentage of the scenarios is within this distance of the random selection. `random_low` and
    `random_high`, shape (m,), are the 5 % and the 95 % quantile of this percentage over the random selections.
    """

    to_selected: FloatArray
    to_medoids: FloatArray
    reach: FloatArray
    random_low: FloatArray
    random_high: FloatArray

    @classmethod
    def from_nearest_distances(cls, nearest_distances: NearestDistances) -> CoverageCurves:
        """Make coverage curves; the random selections are summarized by two quantiles."""
        to_selected, to_medoids = nearest_distances.to_selected, nearest_distances.to_medoids
        to_random = nearest_distances.to_random
        longest = max(float(to_selected.max()), float(to_medoids.max()), float(np.quantile(to_random, 0.99)), 1e-9)
        reach = np.linspace(0.0, 1.05 * longest, _N_REACHES)
        low, high = np.quantile([percent_within(distances, reach) for distances in to_random], (0.05, 0.95), axis=0)
        return cls(to_selected, to_medoids, reach, low, high)


def percent_within(distances: FloatArray, reach: FloatArray) -> FloatArray:
    """Return, for each value in `reach`, the percentage of `distances` that are at most this value."""
    return np.asarray(100.0 * np.searchsorted(np.sort(distances), reach, side="right") / max(len(distances), 1))


def measure_nearest_distances(
    distances: Distances, selected: npt.ArrayLike, *, draws: int = DEFAULT_DRAWS, seed: int = 0
) -> NearestDistances:
    """Measure the distances from every scenario to the reduced set, to k-medoids and to random selections.

    `selected` are indices; repeated indices count once.
    """
    indices = np.unique(np.asarray(selected, dtype=np.int64))
    return NearestDistances(
        distances_to_nearest(distances, indices),
        distances_to_nearest(distances, find_k_medoids(distances, len(indices))),
        measure_distances_to_random(distances, indices, draws=draws, seed=seed),
    )


def measure_distances_to_random(
    distances: Distances,
    selected: npt.ArrayLike,
    scenarios: IntArray | None = None,
    *,
    draws: int = DEFAULT_DRAWS,
    seed: int = 0,
) -> FloatArray:
    """Measure the distances from m scenarios, by default all, to random selections as large as `selected`.

    The result has shape (draws, m), with a row for each random selection. `reduce` compared the reduced set with other
    random selections to choose the set, so these selections are drawn independently.
    """
    size = len(np.unique(np.asarray(selected, dtype=np.int64)))
    random = draw_random_selections(len(distances), size, stream="grading", draws=draws, seed=seed)
    return distances_to_nearest_per_selection(distances, random, scenarios)


def measure_coverage(
    distances: npt.ArrayLike | EmbeddedDistances,
    selected: npt.ArrayLike,
    *,
    ids: npt.ArrayLike | None = None,
    draws: int = DEFAULT_DRAWS,
    seed: int = 0,
    nearest_distances: NearestDistances | None = None,
) -> Coverage:
    """Measure how well the scenarios with the indices `selected` represent all scenarios.

    `distances` has shape (n, n). If `ids`, shape (n,), are given, the result names the worst scenario by its id. If
    `nearest_distances` are given, the distances to the selected scenarios are not computed again.
    """
    matrix = distances if isinstance(distances, EmbeddedDistances) else np.asarray(distances, dtype=np.float64)
    if len(matrix.shape) != 2 or matrix.shape[0] != matrix.shape[1]:
        raise InputError(f"A distance matrix of shape {matrix.shape} is not square; give shape (n, n).")
    indices = np.unique(np.asarray(selected, dtype=np.int64))
    n = len(matrix)
    if not len(indices):
        raise InputError("No scenario is selected, so nothing is covered; select at least one.")
    if indices[0] < 0 or indices[-1] >= n:
        raise InputError(f"A selected scenario is not in the distance matrix; give indices from 0 to {n - 1}.")
    names = np.arange(n) if ids is None else np.asarray(ids, dtype=np.int64)
    extent = float(matrix.max())
    all_gaps = (
        measure_nearest_distances(matrix, indices, draws=draws, seed=seed)
        if nearest_distances is None
        else nearest_distances
    )
    figures = summarize_distances(all_gaps.to_selected, all_gaps.to_medoids, all_gaps.to_random)
    return Coverage(
        kept=len(indices),
        worst=int(names[all_gaps.to_selected.argmax()]),
        largest_relative=figures["largest"] / extent if extent else 0.0,
        mean_relative=figures["mean"] / extent if extent else 0.0,
        held_out=None,
        **figures,
    )
