"""Convexity of clusters, and near-convex parts of clusters that are not convex."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from cornercase._common.numba.blas import single_threaded_blas
from cornercase._common.typing import BoolArray, FloatArray, IntArray

MIN_CONVEXITY: Final = 0.8
"""Convexity from which a cluster counts as convex."""

# Largest number of pairs between which points are sampled: about all pairs of 200 scenarios.
_MAX_PAIRS: Final = 20_000
_SAMPLE_POSITIONS: Final = (0.25, 0.5, 0.75)
_NEIGHBOUR_QUANTILE: Final = 0.95
_MAX_PARTS: Final = 6


def measure_convexity(points: FloatArray, is_member: BoolArray) -> float:
    """Measure how much of the space between the members of a cluster belongs to the cluster, 0 to 1.

    Three evenly spaced points are sampled on the line between each two members; of very many pairs, 20,000 are used.
    The result is the share of these points that belong to the cluster. It is about 1 for a ball and a cube, and 0.3 to
    0.7 for a horseshoe; a thinner horseshoe has a lower value.

    A sampled point belongs to the cluster if the scenario nearest to it is a member, and is not too far away. The limit
    is the usual distance between neighbours in the cluster: the 95 % quantile of the distances from each member to its
    2 d-th nearest member, where d is the number of dimensions. Up to d + 1 members are too few to judge: the result is
    1.
    """
    cluster_points = points[is_member]
    count, dimensions = cluster_points.shape
    if count <= dimensions + 1:
        return 1.0
    to_others = np.asarray(cKDTree(cluster_points).query(cluster_points, k=min(2 * dimensions, count - 1) + 1)[0])
    reach = float(np.quantile(to_others[:, -1], _NEIGHBOUR_QUANTILE))
    first, second = _evenly_spaced_pairs(count)
    tree = cKDTree(points)
    n_inside = 0
    for share in _SAMPLE_POSITIONS:
        distance, nearest = tree.query((1.0 - share) * cluster_points[first] + share * cluster_points[second])
        n_inside += int((is_member[nearest] & (distance <= reach)).sum())
    return n_inside / (len(_SAMPLE_POSITIONS) * len(first))


def _evenly_spaced_pairs(n_points: int) -> tuple[IntArray, IntArray]:
    """Return evenly spaced pairs of indices out of all pairs of `n_points` points; all pairs if there are few."""
    pairs = n_points * (n_points - 1) // 2
    sample = np.linspace(0, pairs - 1, min(pairs, _MAX_PAIRS)).astype(np.int64)
    rows = np.arange(n_points)
    # Number of pairs that precede the pairs of each scenario with later scenarios.
    before = rows * (2 * n_points - rows - 1) // 2
    first = np.searchsorted(before, sample, side="right") - 1
    return first, sample - before[first] + first + 1


def split_into_convex_parts(points: FloatArray, is_member: BoolArray) -> list[IntArray]:
    """Divide a cluster into the smallest number of convex parts that k-means finds; return the indices of each part.

    The largest part is first. There is one part if the cluster is convex, and none if six parts are not enough.
    """
    indices = np.flatnonzero(is_member)
    if measure_convexity(points, is_member) >= MIN_CONVEXITY:
        return [indices]
    from sklearn.cluster import KMeans

    for count in range(2, min(_MAX_PARTS, len(indices)) + 1):
        with single_threaded_blas():
            labels = KMeans(count, n_init=10, random_state=0).fit_predict(points[indices])
        parts = [indices[labels == k] for k in range(count)]
        if all(_convexity_of_part(points, is_member, part) >= MIN_CONVEXITY for part in parts):
            return sorted(parts, key=lambda part: (-len(part), int(part[0])))
    return []


def _convexity_of_part(points: FloatArray, is_member: BoolArray, part: IntArray) -> float:
    """Measure the convexity of a part of a cluster, ignoring the other parts."""
    is_visible = ~is_member
    is_visible[part] = True
    is_part = np.zeros(len(points), dtype=np.bool_)
    is_part[part] = True
    return measure_convexity(points[is_visible], is_part[is_visible])
