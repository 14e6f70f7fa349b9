"""Medoids: the prototype (most central scenario) of a cluster, and k-medoids of all scenarios."""

from __future__ import annotations

import heapq

import numpy as np
import numpy.typing as npt

from cornercase._common.errors import InputError
from cornercase._common.typing import IntArray
from cornercase.clustering._embedding import Distances, EmbeddedDistances


def find_prototype(distances: Distances, members: npt.ArrayLike) -> int:
    """Return the medoid of a cluster: the member with the smallest sum of distances to all members, the first if tied.

    `members` and the result are indices of scenarios.
    """
    indices = np.asarray(members, dtype=np.int64)
    if not len(indices):
        raise InputError("A cluster without scenarios has no prototype; leave it out.")
    indices = np.sort(indices)
    if isinstance(distances, EmbeddedDistances):
        return distances.medoid(indices)
    return int(indices[distances[np.ix_(indices, indices)].sum(axis=1).argmin()])


def find_k_medoids(distances: Distances, k: int, max_iterations: int = 50) -> IntArray:
    """Choose `k` scenarios such that the mean distance from all scenarios to the nearest of them is small.

    Returns their indices in ascending order. First, scenarios are added one after the other, each time the scenario
    that lowers this mean most (BUILD: L. Kaufman, P. J. Rousseeuw, "Finding Groups in Data", 1990). Then each scenario
    is assigned to its nearest medoid, and each medoid is replaced by the medoid of the scenarios assigned to it, until
    nothing changes (H.-S. Park, C.-H. Jun, "A simple and fast algorithm for K-medoids clustering", 2009). Both steps
    need all distances. If `distances` are `EmbeddedDistances` (distances of points that represent the scenarios),
    k-means groups these points instead, and the scenario nearest to the mean of each group is chosen.
    """
    if isinstance(distances, EmbeddedDistances):
        return distances.medoids(k)
    selected = [int(distances.sum(axis=1).argmin())]
    gap = distances[selected[0]].copy()
    # Gains can only fall as others are chosen, so only the largest one is computed again.
    gains = ((float(np.maximum(gap - row, 0.0).sum()), j) for j, row in enumerate(distances) if j != selected[0])
    queue = [(-gain, j) for gain, j in gains]
    heapq.heapify(queue)
    while len(selected) < k:
        _, best = heapq.heappop(queue)
        gain = float(np.maximum(gap - distances[best], 0.0).sum())
        if queue and (-gain, best) > queue[0]:
            heapq.heappush(queue, (-gain, best))
            continue
        selected.append(best)
        gap = np.minimum(gap, distances[best])
    medoids = np.array(selected, dtype=np.int64)
    for _ in range(max_iterations):
        nearest = distances[medoids].argmin(axis=0)
        nearest[medoids] = np.arange(k)
        moved = [find_prototype(distances, np.flatnonzero(nearest == j)) for j in range(k)]
        if np.array_equal(moved, medoids):
            break
        medoids = np.array(moved, dtype=np.int64)
    return np.sort(medoids)
