"""Cross-validation of the selection: how well a set represents scenarios that were not available for selection.

A set represents the scenarios from which it was selected better than other scenarios. So the scenarios are divided into
five folds. Each fold evaluates a set that was selected in the same way from the other four folds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.clustering._embedding import Distances
from cornercase.reduction._medoids import find_k_medoids
from cornercase.reduction._random_selections import (
    distances_to_nearest_per_selection,
    draw_fold_order,
    draw_random_selections,
    submatrix,
)

N_FOLDS: Final = 5
"""Number of folds of the cross-validation."""

# With fewer scenarios a fold is too small; with more than 600 one fold is enough, since selecting takes long.
_MIN_SCENARIOS: Final = 10
_MAX_ALL_FOLDS: Final = 600


@dataclass(frozen=True, eq=False)
class Fold:
    """One fold of the cross-validation: the held-out scenarios, and the set that was selected from the others.

    `training` are the scenarios from which `selected` were selected. `held_out` are the scenarios that evaluate the
    set. Scenarios are given by index or by id.
    """

    training: IntArray
    selected: IntArray
    held_out: IntArray


@dataclass(frozen=True)
class HeldOutCoverage:
    """Cross-validated distances from held-out scenarios to the nearest scenario of a set selected without them.

    The baselines, random selections and k-medoids, have as many scenarios as the set, and are chosen from the same
    scenarios as the set.

    Attributes
    ----------
    scenarios : int
        Number of scenarios that were held out.
    largest, mean : float
        Largest and mean distance, in the unit of the distances.
    random_largest, random_mean : float
        Medians, over the random selections, of the largest and of the mean distance.
    better_largest, better_mean : float
        Shares of the random selections whose largest distance, and whose mean distance, is larger than that of the
        set.
    medoids_largest, medoids_mean : float
        Largest and mean distance if k-medoids are selected.

    Examples
    --------
    >>> from cornercase.reduction import read_reduction
    >>> held_out = read_reduction("study.db").coverage["interaction"].held_out  # doctest: +SKIP
    >>> held_out.scenarios, round(held_out.mean), round(held_out.random_mean)  # doctest: +SKIP
    (200, 326, 431)
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
class HeldOutCriticalCoverage:
    """Cross-validated shares of held-out critical scenarios that are similar to a selected scenario.

    Attributes
    ----------
    scenarios : int
        Number of critical scenarios that were held out, at least one.
    critical : float
        Share of the held-out critical scenarios that are similar to a selected scenario.
    boundary : float or None
        The same share among the scenarios on the boundary of the critical set; None if there are none.
    random, medoids : float
        The value of `critical` if scenarios are selected at random (median of 100 selections of the same size), and
        if k-medoids are selected.

    Examples
    --------
    >>> from cornercase.reduction import read_reduction
    >>> held_out = read_reduction("study.db").critical["interaction"].held_out  # doctest: +SKIP
    >>> held_out.scenarios, held_out.critical, round(held_out.random, 2)  # doctest: +SKIP
    (24, 0.75, 0.67)
    """

    scenarios: int
    critical: float
    boundary: float | None
    random: float
    medoids: float


@dataclass(frozen=True, eq=False)
class HeldOutDistances:
    """Distances from m held-out scenarios to the nearest selected scenario, to k-medoids, and to random selections.

    `held_out`, shape (m,), are the indices of the scenarios. `to_selected` and `to_medoids` have shape (m,), and
    `to_random` has shape (draws, m).
    """

    held_out: IntArray
    to_selected: FloatArray
    to_medoids: FloatArray
    to_random: FloatArray


def draw_folds(n_scenarios: int) -> list[IntArray]:
    """Divide scenarios into five random folds; return the indices of the held-out scenarios of each fold.

    With more than 600 scenarios only the first fold is returned, since it is large enough and selecting takes long.
    With fewer than 10 scenarios the folds would be too small, so no fold is returned.
    """
    if n_scenarios < _MIN_SCENARIOS:
        return []
    order = draw_fold_order(n_scenarios)
    parts = [np.sort(order[k::N_FOLDS]) for k in range(N_FOLDS)]
    return parts if n_scenarios <= _MAX_ALL_FOLDS else parts[:1]


def measure_held_out_distances(all_distances: Distances, all_folds: Sequence[Fold]) -> HeldOutDistances | None:
    """Measure distances of held-out scenarios to sets selected without them, and to baselines; None without folds."""
    to_selected, medoids, random = [], [], []
    folds = [fold for fold in all_folds if len(fold.selected) and len(fold.held_out)]
    if not folds:
        return None
    for k, fold in enumerate(folds):
        to_held_out = submatrix(all_distances, fold.training, fold.held_out)
        within_training = submatrix(all_distances, fold.training, fold.training)
        choices = draw_random_selections(len(fold.training), len(fold.selected), stream="grading", seed=k)
        selected = np.flatnonzero(np.isin(fold.training, fold.selected))
        medoid_indices = find_k_medoids(within_training, len(fold.selected))
        to_selected.append(distances_to_nearest_per_selection(to_held_out, selected[None])[0])
        medoids.append(distances_to_nearest_per_selection(to_held_out, medoid_indices[None])[0])
        random.append(distances_to_nearest_per_selection(to_held_out, choices))
    return HeldOutDistances(
        np.concatenate([fold.held_out for fold in folds]),
        np.concatenate(to_selected),
        np.concatenate(medoids),
        np.concatenate(random, axis=1),
    )


def summarize_distances(to_selected: FloatArray, to_medoids: FloatArray, to_random: FloatArray) -> dict[str, float]:
    """Return the attributes that `HeldOutCoverage` and `Coverage` have in common, by name.

    They are computed from distances to the nearest selected scenario. The distances have shape (m,) for the reduced set
    and for k-medoids, and (draws, m) for random selections.
    """
    random_largest, random_mean = to_random.max(axis=1), to_random.mean(axis=1)
    return {
        "largest": float(to_selected.max()),
        "mean": float(to_selected.mean()),
        "random_largest": float(np.median(random_largest)),
        "random_mean": float(np.median(random_mean)),
        "better_largest": float(np.mean(random_largest > to_selected.max())),
        "better_mean": float(np.mean(random_mean > to_selected.mean())),
        "medoids_largest": float(to_medoids.max()),
        "medoids_mean": float(to_medoids.mean()),
    }


def summarize_held_out(held_out_distances: HeldOutDistances | None) -> HeldOutCoverage | None:
    """Summarize the distances of held-out scenarios; None if there are none."""
    if held_out_distances is None:
        return None
    return HeldOutCoverage(
        scenarios=len(held_out_distances.held_out),
        **summarize_distances(
            held_out_distances.to_selected, held_out_distances.to_medoids, held_out_distances.to_random
        ),
    )


def summarize_held_out_critical(
    held_out_distances: HeldOutDistances | None,
    critical_mask: BoolArray,
    boundary_mask: BoolArray,
    similar_distance: float,
) -> HeldOutCriticalCoverage | None:
    """Return the shares of critical held-out scenarios that are similar to a selected one; None if none are critical.

    Two scenarios are similar if their distance is at most `similar_distance`. Of all n scenarios, `critical_mask` marks
    the critical ones, and `boundary_mask` the critical ones on the boundary of the critical set.
    """
    if held_out_distances is None or not critical_mask[held_out_distances.held_out].any():
        return None
    is_critical, is_boundary = critical_mask[held_out_distances.held_out], boundary_mask[held_out_distances.held_out]
    return HeldOutCriticalCoverage(
        scenarios=int(is_critical.sum()),
        critical=float((held_out_distances.to_selected[is_critical] <= similar_distance).mean()),
        boundary=float((held_out_distances.to_selected[is_boundary] <= similar_distance).mean())
        if is_boundary.any()
        else None,
        random=float(np.median((held_out_distances.to_random[:, is_critical] <= similar_distance).mean(axis=1))),
        medoids=float((held_out_distances.to_medoids[is_critical] <= similar_distance).mean()),
    )
