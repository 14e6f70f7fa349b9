"""Coverage of critical scenarios by a reduced set, for scenarios that were run and for scenarios that were not."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.clustering._embedding import Distances, EmbeddedDistances
from cornercase.evidence import Estimate
from cornercase.evidence._critical_set_estimate import CriticalSet
from cornercase.evidence.gp._gaussian_process import encode_points
from cornercase.reduction._coverage import NearestDistances
from cornercase.reduction._held_out_coverage import (
    HeldOutCriticalCoverage,
    HeldOutDistances,
    summarize_held_out_critical,
)
from cornercase.scenario import ParameterSpace
from cornercase.study._criterion import Criterion

DEFAULT_SIMILARITY: Final = 0.5
"""Default share of the median distance within clusters up to which two scenarios are similar."""
# Number of scenarios at which embedded distances are sampled.
_SAMPLE_SIZE: Final = 1000
# Largest number of distances from which a Gaussian process learns; up to this number the process is exact.
_MAX_DISTANCES: Final = 512


@dataclass(frozen=True)
class CriticalCoverage:
    """Coverage of the critical scenarios by the selected ones, for one aspect (what scenarios are compared by).

    The shares and distances are in-sample: they include critical scenarios that were themselves selected, at distance
    0. `held_out` and `unlike` are about scenarios that were not available for selection.

    Attributes
    ----------
    within : float
        Largest distance of two similar scenarios, in the unit of the distances.
    critical, boundary : float or None
        Share of scenarios that are similar to a selected scenario: among all critical scenarios that were run, and
        among those on the boundary of the critical set. None if there are no such scenarios.
    random, medoids : float or None
        The value of `critical` if scenarios are selected at random (median of 100 selections of the same size), and
        if k-medoids are selected.
    largest, mean : float or None
        Largest and mean distance from critical scenarios that were run to the nearest selected scenario.
    medoids_largest, medoids_mean : float or None
        Largest and mean distance from critical scenarios that were run to the nearest of the k-medoids.
    unlike : Estimate or None
        Probability that a critical scenario drawn at random from the space is similar to no selected scenario. None if
        fewer than 10 critical scenarios were run, if all of these are at the same distance from the nearest selected
        scenario, or if all scenarios have the same score.
    held_out : HeldOutCriticalCoverage or None, default None
        Cross-validated shares; None if not measured.

    Examples
    --------
    >>> import cornercase as cc
    >>> reduced = cc.reduce("study.db", "reduced", by="interaction", size=10)  # doctest: +SKIP
    >>> critical = reduced.critical["interaction"]  # doctest: +SKIP
    >>> critical.critical, round(critical.random, 2), round(critical.unlike.high, 3)  # doctest: +SKIP
    (1.0, 0.71, 0.066)
    """

    within: float
    critical: float | None
    boundary: float | None
    random: float | None
    medoids: float | None
    largest: float | None
    mean: float | None
    medoids_largest: float | None
    medoids_mean: float | None
    unlike: Estimate | None
    held_out: HeldOutCriticalCoverage | None = None


def measure_critical_coverage(
    space: ParameterSpace,
    points: FloatArray,
    scores: FloatArray,
    criterion: Criterion,
    nearest_distances: NearestDistances,
    similar_distance: float,
    *,
    seed: int = 0,
    critical_set: CriticalSet | None = None,
    held_out: HeldOutDistances | None = None,
    random_distances: FloatArray | None = None,
) -> CriticalCoverage:
    """Measure how well selected scenarios represent the critical scenarios, from the distances to the selected ones.

    `points`, shape (n, d), are in the unit cube. `scores` are lower if more critical. A critical scenario is on the
    boundary if at least one of the 2 e scenarios nearest to it is not critical, where e is the number of coordinates of
    the points after `encode_points`.

    For scenarios that were not run, two Gaussian processes over the parameter space make predictions. The first
    predicts the scores, the second the distance from critical scenarios to the nearest selected scenario. Both are
    calibrated by leave-one-out as in `CriticalSet`. The second process learns from at most 512 random scenarios, since
    an exact process is slow with more; so its intervals are wider than they could be.

    `random_distances` are the distances from the critical scenarios to random selections; by default they are taken
    from `nearest_distances`.
    """
    critical = criterion.is_critical(scores)
    distance, medoid_distance = nearest_distances.to_selected, nearest_distances.to_medoids
    if random_distances is None:
        random_distances = nearest_distances.to_random[:, critical]
    random = random_distances <= similar_distance
    any_critical = bool(critical.any())
    is_boundary = critical & _has_neighbour_among(encode_points(space, points), ~critical)
    unlike = None
    # Fewer than ten critical scenarios, or all with the same score or the same distance.
    with suppress(ValueError):
        all_critical = critical_set or CriticalSet(space, points, scores, criterion, seed)
        is_unlike = Criterion(similar_distance, lower_is_critical=False)
        index = np.flatnonzero(critical)
        if len(index) > _MAX_DISTANCES:
            # At random: evenly spaced ones of a Sobol' sequence or a grid may all lie in a part of the space.
            index = np.sort(np.random.default_rng(seed).choice(index, _MAX_DISTANCES, replace=False))
        unlike = all_critical.fraction_inside(
            all_critical.estimate_for_other_scores(points[index], -distance[index], is_unlike)
        )
    return CriticalCoverage(
        within=similar_distance,
        critical=float((distance[critical] <= similar_distance).mean()) if any_critical else None,
        boundary=float((distance[is_boundary] <= similar_distance).mean()) if is_boundary.any() else None,
        random=float(np.median(random.mean(axis=1))) if any_critical else None,
        medoids=float((medoid_distance[critical] <= similar_distance).mean()) if any_critical else None,
        largest=float(distance[critical].max()) if any_critical else None,
        mean=float(distance[critical].mean()) if any_critical else None,
        medoids_largest=float(medoid_distance[critical].max()) if any_critical else None,
        medoids_mean=float(medoid_distance[critical].mean()) if any_critical else None,
        unlike=unlike,
        held_out=summarize_held_out_critical(held_out, critical, is_boundary, similar_distance),
    )


def max_similar_distance(distances: Distances, labels: IntArray, share: float = DEFAULT_SIMILARITY) -> float:
    """Return the distance up to which two scenarios are similar: `share` of the median distance within clusters.

    Without clusters, it is `share` of the median distance of any two scenarios. If `distances` are embedded, the median
    is computed from a sample of 1,000 scenarios.
    """
    check_similarity(share)
    if isinstance(distances, EmbeddedDistances):
        sample = np.linspace(0, len(distances) - 1, min(_SAMPLE_SIZE, len(distances))).astype(np.int64)
        distances, labels = distances[np.ix_(sample, sample)], labels[sample]
    # Row by row, since indices of all pairs would take several times the memory of the distances.
    rows = [row[i + 1 :][labels[i + 1 :] == labels[i]] for i, row in enumerate(distances) if labels[i] >= 0]
    if not any(map(len, rows)):
        rows = [row[i + 1 :] for i, row in enumerate(distances)]
    between = np.concatenate(rows) if rows else np.zeros(0)
    return share * float(np.median(between, overwrite_input=True)) if len(between) else 0.0


def check_similarity(share: float) -> None:
    """Raise `InputError` unless `share` is positive and finite."""
    if not 0.0 < share < float("inf"):
        raise InputError(f"`within` {share:g}: give a number above 0.")


def _has_neighbour_among(points: FloatArray, is_other: BoolArray) -> BoolArray:
    """Mark each point for which `is_other` marks the point itself or at least one of its 2 d nearest neighbours."""
    count = min(2 * points.shape[1], len(points) - 1)
    if count < 1:
        return np.zeros(len(points), dtype=np.bool_)
    neighbours = np.asarray(cKDTree(points).query(points, k=count + 1)[1], dtype=np.int64)
    return np.asarray(is_other[neighbours].any(axis=1))
