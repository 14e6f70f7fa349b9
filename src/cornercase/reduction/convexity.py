"""Whether a cluster is convex, and near-convex parts of one that is not."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.spatial import cKDTree
from sklearn.cluster import KMeans
from threadpoolctl import threadpool_limits

from cornercase._common.typing import BoolArray, FloatArray, IntArray

CONVEX: Final = 0.8
"""Convexity from which a cluster counts as convex."""

# All pairs of 200 scenarios.
_PAIRS: Final = 20_000
_ALONG: Final = (0.25, 0.5, 0.75)
_REACH: Final = 0.95
_MOST_PARTS: Final = 6


def convexity(points: FloatArray, members: BoolArray) -> float:
    """How much of what lies between the scenarios of a cluster is the cluster's.

    On the line between any two members three places are looked at, evenly spread. A place is the cluster's where the
    nearest scenario of all is a member, and is no farther than members are from each other: than their 2 d-th
    neighbours among themselves, for 95 % of them.

    Parameters
    ----------
    points : ndarray of float64, shape (n, d)
        All scenarios.
    members : ndarray of bool, shape (n,)
        Those of the cluster.

    Returns
    -------
    float
        0 to 1; 1 for up to d + 1 members, between which too little is known. About 1 for a ball and a cube, 0.6 for a
        thin horseshoe.
    """
    own = points[members]
    count, dimensions = own.shape
    if count <= dimensions + 1:
        return 1.0
    to_others = np.asarray(cKDTree(own).query(own, k=min(2 * dimensions, count - 1) + 1)[0])
    reach = float(np.quantile(to_others[:, -1], _REACH))
    one, two = np.triu_indices(count, 1)
    if len(one) > _PAIRS:
        some = np.linspace(0, len(one) - 1, _PAIRS).astype(np.int64)
        one, two = one[some], two[some]
    tree = cKDTree(points)
    inside = 0
    for share in _ALONG:
        away, nearest = tree.query((1.0 - share) * own[one] + share * own[two])
        inside += int((members[nearest] & (away <= reach)).sum())
    return inside / (len(_ALONG) * len(one))


def near_convex_parts(points: FloatArray, members: BoolArray) -> list[IntArray]:
    """Divide a cluster into as few parts as are all convex, by k-means.

    Parameters
    ----------
    points : ndarray of float64, shape (n, d)
    members : ndarray of bool, shape (n,)

    Returns
    -------
    list of ndarray of int64
        Indices of each part's scenarios, the largest part first: one part where the cluster is convex, and none where
        not even six parts are enough.
    """
    own = np.flatnonzero(members)
    if convexity(points, members) >= CONVEX:
        return [own]
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
    return convexity(points[seen], mine[seen])
