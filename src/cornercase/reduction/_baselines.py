"""Baselines for a reduced set: random selections, and k-medoids."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from cornercase._common.typing import IntArray
from cornercase.clustering._embedding import Distances
from cornercase.reduction._medoids import find_k_medoids
from cornercase.reduction._random_selections import distances_to_nearest_per_selection, draw_random_selections

MIN_BETTER_SHARE: Final = 0.95
"""Least share of the random selections that a reduced set should beat."""


class Baselines:
    """Baselines for a selection of scenarios: random selections, and the k-medoids of the first clustering.

    Selections are compared by the largest and the mean distance of scenarios to the nearest selected scenario: with
    random selections in each clustering, with k-medoids only for scenarios in critical clusters of the first
    clustering. `labels` and `critical_clusters` belong to the first clustering. `size` is the number of selected
    scenarios.
    """

    def __init__(
        self, distances: Sequence[Distances], labels: IntArray, critical_clusters: Sequence[int], size: int
    ) -> None:
        self._distances = distances
        self._size = min(size, len(labels))
        self._random_distances = []
        # These draws influence the selection, so `measure_coverage` evaluates it with others.
        selections = draw_random_selections(len(labels), self._size, stream="choosing")
        for matrix in distances:
            gaps = distances_to_nearest_per_selection(matrix, selections)
            self._random_distances.append((gaps.max(axis=1), gaps.mean(axis=1)))
        # If every cluster is critical, none counts more than the others.
        is_critical = np.isin(labels, critical_clusters)
        self._is_critical = is_critical if is_critical.any() and (labels[~is_critical] >= 0).any() else None
        if self._is_critical is not None:
            medoid_gaps = distances[0][self._is_critical][:, find_k_medoids(distances[0], self._size)].min(axis=1)
            self._medoid_distances = float(medoid_gaps.max()), float(medoid_gaps.mean())

    def measure_shortfall(self, selected: list[int]) -> float:
        """Return how far a selection falls short of the baselines; 0 if the selection beats them.

        The selection should beat 95 % of the random selections, in each clustering and by both distances; what is
        missing from 95 % is added. Its distances should also be no larger than those of k-medoids; the relative excess
        is added.
        """
        total = 0.0
        for matrix, random in zip(self._distances, self._random_distances, strict=True):
            gap = matrix[:, selected].min(axis=1)
            for own, baseline in zip((gap.max(), gap.mean()), random, strict=True):
                total += max(0.0, MIN_BETTER_SHARE - float(np.mean(baseline > own)))
        if self._is_critical is not None:
            gap = self._distances[0][self._is_critical][:, selected].min(axis=1)
            for own, baseline_value in zip((gap.max(), gap.mean()), self._medoid_distances, strict=True):
                total += max(0.0, float(own) / max(baseline_value, 1e-300) - 1.0) if own > baseline_value else 0.0
        return total
