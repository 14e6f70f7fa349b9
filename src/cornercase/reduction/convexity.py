"""Convexity of clusters, and near-convex parts of clusters that are not convex."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from cornercase._common.typing import BoolArray, FloatArray, IntArray

CONVEX: Final = 0.8
"""Convexity from which a cluster counts as convex."""

# Largest number of pairs: all pairs of 200 scenarios.
_PAIRS: Final = 20_000
_ALONG: Final = (0.25, 0.5, 0.75)
_REACH: Final = 0.95
_MOST_PARTS: Final = 6


def measure_convexity(points: FloatArray, members: BoolArray) -> float:
    """Measure how much of the space between the members of a cluster belongs to it, 0 to 1.

    Three points are sampled on the line between any two members, evenly spaced. A point belongs to the cluster if the
    nearest of all scenarios is a member, and is no farther away than 95 % of the members are from their 2 d-th
    neighbour in the cluster. About 1 for a ball and a cube, 0.6 for a thin horseshoe; 1 for up to d + 1 members, which
    say too little.
    """
    cluster_points = points[members]
    count, dimensions = cluster_points.shape
    if count <= dimensions + 1:
        return 1.0
    to_others = np.asarray(cKDTree(cluster_points).query(cluster_points, k=min(2 * dimensions, count - 1) + 1)[0])
    reach = float(np.quantile(to_others[:, -1], _REACH))
    first, second = _spread_pairs(count)
    tree = cKDTree(points)
    n_inside = 0
    for share in _ALONG:
        distance, nearest = tree.query((1.0 - share) * cluster_points[first] + share * cluster_points[second])
        n_inside += int((members[nearest] & (distance <= reach)).sum())
    return n_inside / (len(_ALONG) * len(first))


def _spread_pairs(count: int) -> tuple[IntArray, IntArray]:
    """Evenly spaced pairs out of all pairs of `n_points` scenarios; all if there are few."""
    pairs = count * (count - 1) // 2
    sample = np.linspace(0, pairs - 1, min(pairs, _PAIRS)).astype(np.int64)
    rows = np.arange(count)
    # Number of pairs before those of each scenario with later ones.
    before = rows * (2 * count - rows - 1) // 2
    first = np.searchsorted(before, sample, side="right") - 1
    return first, sample - before[first] + first + 1


def find_convex_parts(points: FloatArray, members: BoolArray) -> list[IntArray]:
    """Divide a cluster into the smallest number of convex parts that k-means finds, as indices, the largest part first.

    One part if the cluster is convex; none if six parts are not enough.
    """
    indices = np.flatnonzero(members)
    if measure_convexity(points, members) >= CONVEX:
        return [indices]
    from sklearn.cluster import KMeans

    for count in range(2, min(_MOST_PARTS, len(indices)) + 1):
        with threadpool_limits(limits=1):
            labels = KMeans(count, n_init=10, random_state=0).fit_predict(points[indices])
        parts = [indices[labels == k] for k in range(count)]
        if all(_alone(points, members, part) >= CONVEX for part in parts):
            return sorted(parts, key=lambda part: (-len(part), int(part[0])))
    return []


def _alone(points: FloatArray, members: BoolArray, part: IntArray) -> float:
    """Convexity of a part, ignoring the other parts of its cluster."""
    is_visible = ~members
    is_visible[part] = True
    is_part = np.zeros(len(points), dtype=np.bool_)
    is_part[part] = True
    return measure_convexity(points[is_visible], is_part[is_visible])
