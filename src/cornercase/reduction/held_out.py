"""What sets leave out of scenarios that did not choose them.

A set that is chosen for some scenarios leaves less of these than of others. So the scenarios are divided in five, and
each fifth judges a set that was chosen in the same way from the other four.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.clustering import Distances
from cornercase.reduction.draws import draw_choices, draw_order, nearest_of, part_of
from cornercase.reduction.medoids import choose_medoids

FOLDS: Final = 5
"""Number of parts of which each judges a set that the others choose."""

# With fewer scenarios a part says nothing; with more than so many the first part is enough, and choosing takes long.
_FEWEST: Final = 10
_MOST_FOLDED: Final = 600


@dataclass(frozen=True, eq=False)
class Trial:
    """A set that some scenarios chose, for others to judge.

    Attributes
    ----------
    chosen_from : ndarray of int64
        Scenarios that it was chosen from, by index or by id.
    kept : ndarray of int64
        Those of them that are kept.
    judging : ndarray of int64
        The others.
    """

    chosen_from: IntArray
    kept: IntArray
    judging: IntArray


@dataclass(frozen=True)
class HeldOut:
    """Distances from scenarios to the nearest one of a set that they did not choose, in the unit of the distances.

    Attributes
    ----------
    scenarios : int
        Number of scenarios that judge.
    largest, mean : float
        Of these distances.
    random_largest, random_mean : float
        Medians of the same figures over random choices of as many of the same scenarios.
    better_largest, better_mean : float
        Shares of the random choices that leave a larger gap, and a larger mean.
    medoids_largest, medoids_mean : float
        The same figures of k-medoids, found of the same scenarios.
    """

    scenarios: int
    largest: float
    mean: float
    random_largest: float
    random_mean: float
    better_largest: float
    better_mean: float
    medoids_largest: float
    medoids_mean: float


@dataclass(frozen=True)
class HeldOutCritical:
    """Shares of critical scenarios that are like one of a set that they did not choose.

    Attributes
    ----------
    scenarios : int
        Number of critical scenarios that judge, at least one.
    critical : float
        Share of them that are like a kept one.
    boundary : float or None
        The same of those of them on the boundary of the critical set; None where there are none.
    random, medoids : float
        `critical` for random choices of as many, the median of 100, and for k-medoids.
    """

    scenarios: int
    critical: float
    boundary: float | None
    random: float
    medoids: float


@dataclass(frozen=True, eq=False)
class HeldOutGaps:
    """Distances from scenarios to the nearest one of some choices that they had no part in.

    Attributes
    ----------
    judging : ndarray of int64, shape (m,)
        Which scenarios, by index.
    kept, medoids : ndarray of float64, shape (m,)
        To the nearest kept one, and to the nearest one of k-medoids of the same number.
    random : ndarray of float64, shape (draws, m)
        To the nearest one of random choices of the same number.
    """

    judging: IntArray
    kept: FloatArray
    medoids: FloatArray
    random: FloatArray


def divide(count: int) -> list[IntArray]:
    """Divide scenarios into those that choose and those that judge.

    Parameters
    ----------
    count : int
        Number of scenarios.

    Returns
    -------
    list of ndarray of int64
        Indices of those that judge, by part: each scenario is in one of five parts, drawn at random. Of more than 600
        scenarios only one part is given, of fewer than 10 none.
    """
    if count < _FEWEST:
        return []
    order = draw_order(count)
    parts = [np.sort(order[k::FOLDS]) for k in range(FOLDS)]
    return parts if count <= _MOST_FOLDED else parts[:1]


def measure_held_out_gaps(distances: Distances, trials: Sequence[Trial]) -> HeldOutGaps | None:
    """Measure how far scenarios are from sets that they did not choose, and from other choices.

    Parameters
    ----------
    distances : ndarray of float64, shape (n, n), or PlacedDistances
        Between all scenarios, in any unit.
    trials : sequence of Trial
        By index.

    Returns
    -------
    HeldOutGaps or None
        Of all that judge; None where nobody does.
    """
    kept, medoids, random = [], [], []
    known = [one for one in trials if len(one.kept) and len(one.judging)]
    if not known:
        return None
    for k, one in enumerate(known):
        to_judging = part_of(distances, one.chosen_from, one.judging)
        between = part_of(distances, one.chosen_from, one.chosen_from)
        choices = draw_choices(len(one.chosen_from), len(one.kept), stream="grading", seed=k)
        mine, middles = np.flatnonzero(np.isin(one.chosen_from, one.kept)), choose_medoids(between, len(one.kept))
        kept.append(nearest_of(to_judging, mine[None])[0])
        medoids.append(nearest_of(to_judging, middles[None])[0])
        random.append(nearest_of(to_judging, choices))
    return HeldOutGaps(
        np.concatenate([one.judging for one in known]),
        np.concatenate(kept),
        np.concatenate(medoids),
        np.concatenate(random, axis=1),
    )


def judge(gaps: HeldOutGaps | None) -> HeldOut | None:
    """Say what sets leave out of all scenarios that did not choose them.

    Parameters
    ----------
    gaps : HeldOutGaps or None
        Of all that judge.

    Returns
    -------
    HeldOut or None
        None where nobody judges.
    """
    if gaps is None:
        return None
    largest, mean = gaps.random.max(axis=1), gaps.random.mean(axis=1)
    return HeldOut(
        scenarios=len(gaps.judging),
        largest=float(gaps.kept.max()),
        mean=float(gaps.kept.mean()),
        random_largest=float(np.median(largest)),
        random_mean=float(np.median(mean)),
        better_largest=float(np.mean(largest > gaps.kept.max())),
        better_mean=float(np.mean(mean > gaps.kept.mean())),
        medoids_largest=float(gaps.medoids.max()),
        medoids_mean=float(gaps.medoids.mean()),
    )


def judge_critical(
    gaps: HeldOutGaps | None, critical: BoolArray, edge: BoolArray, within: float
) -> HeldOutCritical | None:
    """Say how many critical scenarios are like one of a set that they did not choose.

    Parameters
    ----------
    gaps : HeldOutGaps or None
        Of all that judge.
    critical, edge : ndarray of bool, shape (n,)
        Critical scenarios, and those of them on the boundary of the critical set.
    within : float
        Distance up to which two scenarios are alike.

    Returns
    -------
    HeldOutCritical or None
        None where no critical scenario judges.
    """
    if gaps is None or not critical[gaps.judging].any():
        return None
    there, border = critical[gaps.judging], edge[gaps.judging]
    return HeldOutCritical(
        scenarios=int(there.sum()),
        critical=float((gaps.kept[there] <= within).mean()),
        boundary=float((gaps.kept[border] <= within).mean()) if border.any() else None,
        random=float(np.median((gaps.random[:, there] <= within).mean(axis=1))),
        medoids=float((gaps.medoids[there] <= within).mean()),
    )
