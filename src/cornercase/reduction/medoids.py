"""Scenarios in the middle of others: the medoid of a cluster, and k medoids of all."""

from __future__ import annotations

import heapq

import numpy as np
import numpy.typing as npt

from cornercase._common.errors import InputError
from cornercase._common.typing import IntArray
from cornercase.clustering import Distances, PlacedDistances


def find_prototype(distances: Distances, members: npt.ArrayLike) -> int:
    """Find the medoid: the member with the smallest sum of distances to the others, at a tie the first.

    Parameters
    ----------
    distances : ndarray of float64, shape (n, n), or PlacedDistances
        Between all scenarios, in any unit.
    members : array_like of int, shape (m,)
        Indices of the scenarios of one cluster, at least one.

    Returns
    -------
    int
        Index of the scenario, one of `members`.

    Raises
    ------
    InputError
        There are no members.
    """
    indices = np.asarray(members, dtype=np.int64)
    if not len(indices):
        raise InputError("A cluster without scenarios has no prototype; leave it out.")
    indices = np.sort(indices)
    if isinstance(distances, PlacedDistances):
        return distances.middle(indices)
    return int(indices[distances[np.ix_(indices, indices)].sum(axis=1).argmin()])


def choose_medoids(distances: Distances, k: int, rounds: int = 50) -> IntArray:
    """Choose k scenarios with a small mean distance from all to the nearest one.

    Starts with the scenarios that lower it most, one after the other [1]_. Then each medoid moves to the middle of the
    scenarios that are nearest to it, until nothing changes [2]_. Where distances are made of places, k-means
    gives them, as in `PlacedDistances.medoids`.

    Parameters
    ----------
    distances : ndarray of float64, shape (n, n), or PlacedDistances
        Between all scenarios, symmetric, in any unit.
    k : int
        1 to n.
    rounds : int, default 50
        At most.

    Returns
    -------
    ndarray of int64, shape (k,)
        Indices, rising.

    References
    ----------
    .. [1] L. Kaufman, P. J. Rousseeuw, "Finding Groups in Data", 1990: the algorithm BUILD.
    .. [2] H.-S. Park, C.-H. Jun, "A simple and fast algorithm for K-medoids clustering", Expert Systems with
       Applications 36, 2009.
    """
    if isinstance(distances, PlacedDistances):
        return distances.medoids(k)
    chosen = [int(distances.sum(axis=1).argmin())]
    gap = distances[chosen[0]].copy()
    # What a scenario gains can only fall as others are chosen, so it is computed again only for the largest of before.
    gains = ((float(np.maximum(gap - row, 0.0).sum()), j) for j, row in enumerate(distances) if j != chosen[0])
    queue = [(-gain, j) for gain, j in gains]
    heapq.heapify(queue)
    while len(chosen) < k:
        _, best = heapq.heappop(queue)
        gain = float(np.maximum(gap - distances[best], 0.0).sum())
        if queue and (-gain, best) > queue[0]:
            heapq.heappush(queue, (-gain, best))
            continue
        chosen.append(best)
        gap = np.minimum(gap, distances[best])
    found = np.array(chosen, dtype=np.int64)
    for _ in range(rounds):
        nearest = distances[found].argmin(axis=0)
        nearest[found] = np.arange(k)
        middles = [find_prototype(distances, np.flatnonzero(nearest == j)) for j in range(k)]
        if np.array_equal(middles, found):
            break
        found = np.array(middles, dtype=np.int64)
    return np.sort(found)
