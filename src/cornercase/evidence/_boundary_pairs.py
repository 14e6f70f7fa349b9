"""Pairs of scenarios that are near each other but end differently: the boundary between outcomes separates them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.spatial import KDTree

from cornercase._common.typing import FloatArray

# Weight of a parameter without influence. It is so small that the parameter only decides between equally near pairs.
_MIN_WEIGHT: Final = 1e-3


def find_boundary_pairs(
    points: FloatArray, outcomes: Sequence[str], weights: FloatArray | None = None, count: int = 5
) -> list[tuple[int, int, float]]:
    """Return up to `count` pairs of a scenario and its nearest one with another outcome, nearest first.

    No scenario is in two pairs. `points`, shape (n, d), are in the unit cube, and `outcomes` has a label for each
    point. Distances are Euclidean. `weights`, shape (d,), multiply the coordinates of the points, for example by each
    parameter's share of the variance of the score; weights below 0.001 count as 0.001, and by default all are 1. Each
    pair is given by two indices and the distance.
    """
    scaled = points if weights is None else points * np.maximum(weights, _MIN_WEIGHT)
    labels = np.array(outcomes)
    candidates: list[tuple[float, int, int]] = []
    for label in np.unique(labels):
        members, others = np.flatnonzero(labels == label), np.flatnonzero(labels != label)
        if len(others):
            distances, nearest = KDTree(scaled[others]).query(scaled[members])
            columns = np.asarray(distances), members, others[nearest]
            candidates += zip(*(column.tolist() for column in columns), strict=True)
    pairs: list[tuple[int, int, float]] = []
    taken: set[int] = set()
    for distance, first, second in sorted((d, min(i, j), max(i, j)) for d, i, j in candidates):
        if len(pairs) < count and taken.isdisjoint((first, second)):
            pairs.append((first, second, distance))
            taken |= {first, second}
    return pairs
