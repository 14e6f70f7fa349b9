"""Baselines that a reduced set should be better than: random selections, and k-medoids."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from cornercase._common.typing import IntArray
from cornercase.clustering import Distances
from cornercase.reduction.draws import draw_choices, nearest_of
from cornercase.reduction.medoids import choose_medoids

BETTER: Final = 0.95
"""Share of the random selections that a reduced set should be better than."""


class Rivals:
    """Random selections in each clustering, and k-medoids in the critical clusters of the first.

    `labels` are those of the first clustering, `critical_clusters` its critical clusters, `size` the number of selected
    scenarios.
    """

    def __init__(self, distances: Sequence[Distances], labels: IntArray, critical: Sequence[int], size: int) -> None:
        self._distances = distances
        self._size = min(size, len(labels))
        self._random = []
        # These draws influence the selection, so `measure_coverage` evaluates it with others.
        selections = draw_choices(len(labels), self._size, stream="choosing")
        for matrix in distances:
            gaps = nearest_of(matrix, selections)
            self._random.append((gaps.max(axis=1), gaps.mean(axis=1)))
        # If every cluster is critical, none counts more than the others.
        is_critical = np.isin(labels, critical)
        self._members = is_critical if is_critical.any() and (labels[~is_critical] >= 0).any() else None
        if self._members is not None:
            medoid_gaps = distances[0][self._members][:, choose_medoids(distances[0], self._size)].min(axis=1)
            self._middle = float(medoid_gaps.max()), float(medoid_gaps.mean())

    def shortfall(self, kept: list[int]) -> float:
        """Return how far a selection falls short of the baselines; 0 if it is better than all.

        The sum of all shortfalls: of the share of random selections, and of the distances relative to k-medoids.
        """
        total = 0.0
        for matrix, random in zip(self._distances, self._random, strict=True):
            gap = matrix[:, kept].min(axis=1)
            for own, baseline in zip((gap.max(), gap.mean()), random, strict=True):
                total += max(0.0, BETTER - float(np.mean(baseline > own)))
        if self._members is not None:
            gap = self._distances[0][self._members][:, kept].min(axis=1)
            for own, baseline_value in zip((gap.max(), gap.mean()), self._middle, strict=True):
                total += max(0.0, float(own) / max(baseline_value, 1e-300) - 1.0) if own > baseline_value else 0.0
        return total
