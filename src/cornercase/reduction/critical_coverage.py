"""How well the kept scenarios represent the critical ones, those that were run and those that were not."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.clustering import Distances, PlacedDistances
from cornercase.evidence import CriticalSet, Estimate, encoded
from cornercase.reduction.coverage import Gaps, measure_gaps
from cornercase.reduction.held_out import HeldOutCritical, HeldOutGaps, judge_critical
from cornercase.scenario import ParameterSpace

WITHIN: Final = 0.5
"""Share of the median distance within clusters up to which two scenarios are alike, unless another one is given."""
# Scenarios whose distances say what is alike, where they are made of places.
_LOOKED_AT: Final = 1000


@dataclass(frozen=True)
class CriticalCoverage:
    """How well kept scenarios represent the critical ones, by one aspect.

    The shares and distances describe the kept scenarios among those that they were chosen from; kept critical ones are
    like themselves. `held_out` and `unlike` speak of others.

    Attributes
    ----------
    within : float
        Distance up to which two scenarios are alike, in the unit of the distances.
    critical, boundary : float or None
        Share of the critical scenarios that were run, and of those of them on the boundary of the critical set, that
        are like a kept one; None where there are none.
    random, medoids : float or None
        `critical` for random choices of as many, the median of 100, and for k-medoids. The random choices are those of
        `cornercase.reduction.coverage.measure_gaps`.
    largest, mean : float or None
        Distance of these critical scenarios to the nearest kept one.
    medoids_largest, medoids_mean : float or None
        The same for k-medoids.
    unlike : Estimate or None
        Probability that a critical scenario drawn at random from the space is unlike every kept one; None where too
        little is known.
    held_out : HeldOutCritical or None, default None
        Shares of critical scenarios that did not choose; None where that was not measured.
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
    held_out: HeldOutCritical | None = None


def measure_critical_coverage(
    space: ParameterSpace,
    points: FloatArray,
    scores: FloatArray,
    threshold: float,
    distances: Distances,
    kept: IntArray,
    within: float,
    *,
    seed: int = 0,
    critical_set: CriticalSet | None = None,
    held_out: HeldOutGaps | None = None,
) -> CriticalCoverage:
    """Measure how well kept scenarios represent the critical ones.

    Parameters
    ----------
    space : ParameterSpace
        That the scenarios are of.
    points : ndarray of float64, shape (n, d)
        Scenarios that were run, in the unit cube.
    scores : ndarray of float64, shape (n,)
        Oriented: lower is more critical.
    threshold : float
        Oriented score up to which a scenario is critical.
    distances : ndarray of float64, shape (n, n), or PlacedDistances
        Between all scenarios, in any unit.
    kept : ndarray of int64, shape (m,)
        Indices of the kept scenarios.
    within : float
        Distance up to which scenarios are alike, as in `distance_alike`.
    seed : int, default 0
        Of the random choices and of the draws of critical sets.
    critical_set : CriticalSet, optional
        Of the same points, scores, threshold and seed, where it is known already.
    held_out : HeldOutGaps, optional
        Of scenarios that did not choose, as `cornercase.reduction.held_out.measure_held_out_gaps` gives it.

    Returns
    -------
    CriticalCoverage
        Figures over the critical scenarios.

    Raises
    ------
    InputError
        Nothing is kept.

    Notes
    -----
    A critical scenario is on the boundary where one of the 2 d scenarios that were run nearest to it is not critical.
    Scenarios that were not run are predicted by two Gaussian processes over the parameter space: one of the scores, and
    one of the distance of the critical scenarios to the nearest kept one. Each is corrected by how well it predicts
    each scenario that was run from all others, as `cornercase.evidence.CriticalSet` says.
    """
    if not len(kept):
        raise InputError("No scenario is kept, so nothing is covered; keep at least one.")
    gaps = measure_gaps(distances, kept, seed=seed)
    return judge_gaps(
        space, points, scores, threshold, gaps, within, seed=seed, critical_set=critical_set, held_out=held_out
    )


def judge_gaps(
    space: ParameterSpace,
    points: FloatArray,
    scores: FloatArray,
    threshold: float,
    gaps: Gaps,
    within: float,
    *,
    seed: int = 0,
    critical_set: CriticalSet | None = None,
    held_out: HeldOutGaps | None = None,
) -> CriticalCoverage:
    """Say how well kept scenarios represent the critical ones, where the distances to them are known.

    Parameters
    ----------
    space : ParameterSpace
        That the scenarios are of.
    points : ndarray of float64, shape (n, d)
        Scenarios that were run, in the unit cube.
    scores : ndarray of float64, shape (n,)
        Oriented: lower is more critical.
    threshold : float
        Oriented score up to which a scenario is critical.
    gaps : Gaps
        As `cornercase.reduction.coverage.measure_gaps` gives it with the seed.
    within : float
        Distance up to which scenarios are alike, as in `distance_alike`.
    seed : int, default 0
        Of the draws of critical sets.
    critical_set : CriticalSet, optional
        As in `measure_critical_coverage`.
    held_out : HeldOutGaps, optional
        As in `measure_critical_coverage`.

    Returns
    -------
    CriticalCoverage
        As `measure_critical_coverage`.
    """
    critical = scores <= threshold
    gap, middle = gaps.kept, gaps.medoids
    random = gaps.random[:, critical] <= within
    there = bool(critical.any())
    edge = critical & _beside(encoded(space, points), ~critical)
    unlike = None
    # Fewer than ten critical scenarios, or all as critical or as far from a kept one as each other.
    with suppress(ValueError):
        whole = critical_set or CriticalSet(space, points, scores, threshold, seed)
        unlike = whole.share_in(CriticalSet(space, points[critical], -gap[critical], -within, seed))
    return CriticalCoverage(
        within=within,
        critical=float((gap[critical] <= within).mean()) if there else None,
        boundary=float((gap[edge] <= within).mean()) if edge.any() else None,
        random=float(np.median(random.mean(axis=1))) if there else None,
        medoids=float((middle[critical] <= within).mean()) if there else None,
        largest=float(gap[critical].max()) if there else None,
        mean=float(gap[critical].mean()) if there else None,
        medoids_largest=float(middle[critical].max()) if there else None,
        medoids_mean=float(middle[critical].mean()) if there else None,
        unlike=unlike,
        held_out=judge_critical(held_out, critical, edge, within),
    )


def distance_alike(distances: Distances, labels: IntArray, share: float = WITHIN) -> float:
    """Give the distance up to which two scenarios count as alike.

    Parameters
    ----------
    distances : ndarray of float64, shape (n, n), or PlacedDistances
        Between all scenarios, in any unit; of places those of 1,000 scenarios are looked at.
    labels : ndarray of int64, shape (n,)
        -1 is noise.
    share : float, default 0.5
        Of the median distance between two scenarios of one cluster; of any two where there are no clusters.

    Returns
    -------
    float
        In the unit of the distances.

    Raises
    ------
    InputError
        `share` is not positive.
    """
    require_within(share)
    if isinstance(distances, PlacedDistances):
        some = np.linspace(0, len(distances) - 1, min(_LOOKED_AT, len(distances))).astype(np.int64)
        distances, labels = distances[np.ix_(some, some)], labels[some]
    # Row by row: all pairs and their indices would be several times as large as the distances.
    within = [row[i + 1 :][labels[i + 1 :] == labels[i]] for i, row in enumerate(distances) if labels[i] >= 0]
    if not any(map(len, within)):
        within = [row[i + 1 :] for i, row in enumerate(distances)]
    between = np.concatenate(within) if within else np.zeros(0)
    return share * float(np.median(between, overwrite_input=True)) if len(between) else 0.0


def require_within(share: float) -> None:
    """Refuse a share of the distance within clusters that cannot be.

    Parameters
    ----------
    share : float
        Of the median distance between two scenarios of one cluster.

    Raises
    ------
    InputError
        It is not positive, or not finite.
    """
    if not 0.0 < share < float("inf"):
        raise InputError(f"`within` {share:g}: give a number above 0.")


def _beside(points: FloatArray, others: BoolArray) -> BoolArray:
    """Whether one of the `others` is among the 2 d scenarios nearest to each point, shape (n,)."""
    count = min(2 * points.shape[1], len(points) - 1)
    if count < 1:
        return np.zeros(len(points), dtype=np.bool_)
    nearest = np.asarray(cKDTree(points).query(points, k=count + 1)[1], dtype=np.int64)
    return np.asarray(others[nearest].any(axis=1))
