"""Whether a cluster is convex, and near-convex parts of one that is not."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from cornercase._common.typing import BoolArray, FloatArray, IntArray

CONVEX: Final = 0.8
"""Convexity from which a cluster counts as convex."""

# All pairs of 200 scenarios.
_PAIRS: Final = 20_000
_ALONG: Final = (0.25, 0.5, 0.75)
_REACH: Final = 0.95
_MOST_PARTS: Final = 6


def measure_convexity(points: FloatArray, members: BoolArray) -> float:
    """Measure how much of the space between the scenarios of a cluster belongs to the cluster.

    Three places are taken on the line between any two members, evenly spread. A place belongs to the cluster where the
    nearest of all scenarios is a member, and is no farther than 95 % of the members are from their 2 d-th neighbour
    among the members.

    Parameters
    ----------
    points : ndarray of float64, shape (n, d)
        All scenarios.
    members : ndarray of bool, shape (n,)
        Those of the cluster.

    Returns
    -------
    float
        0 to 1; 1 for up to d + 1 members, which say too little of the space between them. About 1 for a ball and a
        cube, 0.6 for a thin horseshoe.
    """
    own = points[members]
    count, dimensions = own.shape
    if count <= dimensions + 1:
        return 1.0
    to_others = np.asarray(cKDTree(own).query(own, k=min(2 * dimensions, count - 1) + 1)[0])
    reach = float(np.quantile(to_others[:, -1], _REACH))
    one, two = _spread_pairs(count)
    tree = cKDTree(points)
    inside = 0
    for share in _ALONG:
        away, nearest = tree.query((1.0 - share) * own[one] + share * own[two])
        inside += int((members[nearest] & (away <= reach)).sum())
    return inside / (len(_ALONG) * len(one))


def _spread_pairs(count: int) -> tuple[IntArray, IntArray]:
    """Pairs of so many scenarios, evenly spread over all pairs in their order; all where there are few."""
    pairs = count * (count - 1) // 2
    some = np.linspace(0, pairs - 1, min(pairs, _PAIRS)).astype(np.int64)
    rows = np.arange(count)
    # How many pairs come before those of each scenario with later ones.
    before = rows * (2 * count - rows - 1) // 2
    one = np.searchsorted(before, some, side="right") - 1
    return one, some - before[one] + one + 1


def find_convex_parts(points: FloatArray, members: BoolArray) -> list[IntArray]:
    """Divide a cluster into the smallest number of convex parts that k-means finds.

    Parameters
    ----------
    points : ndarray of float64, shape (n, d)
        Parameters in the unit cube.
    members : ndarray of bool, shape (n,)
        Mask of the scenarios of the cluster.

    Returns
    -------
    list of ndarray of int64
        Indices of each part's scenarios, the largest part first: one part where the cluster is convex, none where six
        parts are not enough.
    """
    own = np.flatnonzero(members)
    if measure_convexity(points, members) >= CONVEX:
        return [own]
    from sklearn.cluster import KMeans

    for count in range(2, min(_MOST_PARTS, len(own)) + 1):
        with threadpool_limits(limits=1):
            found = KMeans(count, n_init=10, random_state=0).fit_predict(points[own])
        parts = [own[found == k] for k in range(count)]
        if all(_alone(points, members, part) >= CONVEX for part in parts):
            return sorted(parts, key=lambda part: (-len(part), int(part[0])))
    return []


def _alone(points: FloatArray, members: BoolArray, part: IntArray) -> float:
    """Convexity of a part, to which the other parts of its cluster are not foreign."""
    seen = ~members
    seen[part] = True
    mine = np.zeros(len(points), dtype=np.bool_)
    mine[part] = True
    return measure_convexity(points[seen], mine[seen])
