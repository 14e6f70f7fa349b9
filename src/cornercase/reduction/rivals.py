"""Choices that a reduced set should be better than: random ones, and k-medoids."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from cornercase._common.typing import IntArray
from cornercase.clustering import Distances
from cornercase.reduction.draws import draw_choices, nearest_of
from cornercase.reduction.medoids import choose_medoids

BETTER: Final = 0.95
"""Share of the random choices that a reduced set should be better than."""


class Rivals:
    """Random choices in each clustering, and k-medoids in the critical clusters of the first.

    Parameters
    ----------
    distances : sequence of ndarray of float64, each (n, n), or of PlacedDistances
        Between all scenarios, in any unit.
    labels : ndarray of int64, shape (n,)
        Cluster of each scenario; -1 is noise.
    critical : sequence of int
        Critical clusters.
    size : int
        Number of scenarios in a choice.
    """

    def __init__(self, distances: Sequence[Distances], labels: IntArray, critical: Sequence[int], size: int) -> None:
        self._distances = distances
        self._size = min(size, len(labels))
        self._random = []
        # What is kept is chosen with regard to these draws; `measure_coverage` grades it by others.
        random = draw_choices(len(labels), self._size, stream="choosing")
        for matrix in distances:
            gaps = nearest_of(matrix, random)
            self._random.append((gaps.max(axis=1), gaps.mean(axis=1)))
        # Where every cluster is critical, none counts more than the others.
        members = np.isin(labels, critical)
        self._members = members if members.any() and (labels[~members] >= 0).any() else None
        if self._members is not None:
            middle = distances[0][self._members][:, choose_medoids(distances[0], self._size)].min(axis=1)
            self._middle = float(middle.max()), float(middle.mean())

    def shortfall(self, kept: list[int]) -> float:
        """Return how far a choice falls short of what it should be better than; 0 where it does not.

        Parameters
        ----------
        kept : list of int
            Indices.

        Returns
        -------
        float
            The sum of all shortfalls: of the share of random choices, and of the distances relative to k-medoids.
        """
        short = 0.0
        for matrix, random in zip(self._distances, self._random, strict=True):
            gap = matrix[:, kept].min(axis=1)
            for mine, theirs in zip((gap.max(), gap.mean()), random, strict=True):
                short += max(0.0, BETTER - float(np.mean(theirs > mine)))
        if self._members is not None:
            gap = self._distances[0][self._members][:, kept].min(axis=1)
            for mine, other in zip((gap.max(), gap.mean()), self._middle, strict=True):
                short += max(0.0, float(mine) / max(other, 1e-300) - 1.0) if mine > other else 0.0
        return short
