"""Cross-validation of the selection: how well it represents scenarios that were not available to it.

A set represents the scenarios from which it was selected better than others. So the scenarios are divided in five
folds, and each fold evaluates a set that was selected in the same way from the other four.
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
"""Number of folds of the cross-validation."""

# With fewer scenarios a fold is too small; with more than 600 one fold is enough, since selecting takes long.
_FEWEST: Final = 10
_MOST_FOLDED: Final = 600


@dataclass(frozen=True, eq=False)
class Trial:
    """One fold: a set selected from some scenarios, and the scenarios that evaluate it; by index or by id."""

    chosen_from: IntArray
    kept: IntArray
    judging: IntArray


@dataclass(frozen=True)
class HeldOut:
    """Cross-validated distances from scenarios to the nearest selected one, in the unit of the distances.

    Attributes
    ----------
    scenarios : int
        Number of scenarios that were held out.
    largest, mean : float
        Of these distances.
    random_largest, random_mean : float
        Medians of the same figures over random selections of as many of the same scenarios.
    better_largest, better_mean : float
        Shares of the random selections with a larger maximum, and with a larger mean.
    medoids_largest, medoids_mean : float
        The same figures of k-medoids of the same scenarios.
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
    """Cross-validated shares of critical scenarios that are similar to a selected one.

    Attributes
    ----------
    scenarios : int
        Number of critical scenarios that were held out, at least one.
    critical : float
        Share of them that are similar to a selected one.
    boundary : float or None
        The same for those on the boundary of the critical set; None if there are none.
    random, medoids : float
        `critical` for random selections of as many, the median of 100, and for k-medoids.
    """

    scenarios: int
    critical: float
    boundary: float | None
    random: float
    medoids: float


@dataclass(frozen=True, eq=False)
class HeldOutGaps:
    """Distances from held-out scenarios to the nearest selected one, to k-medoids, and to random selections.

    `held_out`, shape (m,), are the held-out scenarios by index; `to_selected` and `to_medoids` have shape (m,),
    `to_random` (draws, m).
    """

    judging: IntArray
    kept: FloatArray
    medoids: FloatArray
    random: FloatArray


def divide(count: int) -> list[IntArray]:
    """Return the held-out scenarios of each of five random folds, by index.

    With more than 600 scenarios only one fold is returned, with fewer than 10 none.
    """
    if count < _FEWEST:
        return []
    order = draw_order(count)
    parts = [np.sort(order[k::FOLDS]) for k in range(FOLDS)]
    return parts if count <= _MOST_FOLDED else parts[:1]


def measure_held_out_gaps(distances: Distances, trials: Sequence[Trial]) -> HeldOutGaps | None:
    """Measure the distances of held-out scenarios to their fold's set and baselines; None if there are no folds."""
    to_selected, medoids, random = [], [], []
    folds = [fold for fold in trials if len(fold.kept) and len(fold.judging)]
    if not folds:
        return None
    for k, fold in enumerate(folds):
        to_judging = part_of(distances, fold.chosen_from, fold.judging)
        within_training = part_of(distances, fold.chosen_from, fold.chosen_from)
        choices = draw_choices(len(fold.chosen_from), len(fold.kept), stream="grading", seed=k)
        selected = np.flatnonzero(np.isin(fold.chosen_from, fold.kept))
        medoid_indices = choose_medoids(within_training, len(fold.kept))
        to_selected.append(nearest_of(to_judging, selected[None])[0])
        medoids.append(nearest_of(to_judging, medoid_indices[None])[0])
        random.append(nearest_of(to_judging, choices))
    return HeldOutGaps(
        np.concatenate([fold.judging for fold in folds]),
        np.concatenate(to_selected),
        np.concatenate(medoids),
        np.concatenate(random, axis=1),
    )


def summarize(kept: FloatArray, medoids: FloatArray, random: FloatArray) -> dict[str, float]:
    """Return the figures that `HeldOut` and `Coverage` share, from distances of shape (m,), (m,) and (draws, m)."""
    random_largest, random_mean = random.max(axis=1), random.mean(axis=1)
    return {
        "largest": float(kept.max()),
        "mean": float(kept.mean()),
        "random_largest": float(np.median(random_largest)),
        "random_mean": float(np.median(random_mean)),
        "better_largest": float(np.mean(random_largest > kept.max())),
        "better_mean": float(np.mean(random_mean > kept.mean())),
        "medoids_largest": float(medoids.max()),
        "medoids_mean": float(medoids.mean()),
    }


def judge(gaps: HeldOutGaps | None) -> HeldOut | None:
    """Summarize the distances of held-out scenarios; None if there are none."""
    if gaps is None:
        return None
    return HeldOut(scenarios=len(gaps.judging), **summarize(gaps.kept, gaps.medoids, gaps.random))


def judge_critical(
    gaps: HeldOutGaps | None, critical: BoolArray, edge: BoolArray, within: float
) -> HeldOutCritical | None:
    """Return the shares of critical held-out scenarios within a distance of a selected one; None if there are none.

    `critical_mask` and `boundary_mask`, shape (n,), mark the critical scenarios and those on the boundary of the
    critical set.
    """
    if gaps is None or not critical[gaps.judging].any():
        return None
    is_critical, is_boundary = critical[gaps.judging], edge[gaps.judging]
    return HeldOutCritical(
        scenarios=int(is_critical.sum()),
        critical=float((gaps.kept[is_critical] <= within).mean()),
        boundary=float((gaps.kept[is_boundary] <= within).mean()) if is_boundary.any() else None,
        random=float(np.median((gaps.random[:, is_critical] <= within).mean(axis=1))),
        medoids=float((gaps.medoids[is_critical] <= within).mean()),
    )
