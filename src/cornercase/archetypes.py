"""The few scenarios of each cluster that stand for it: archetypes on its hull, a prototype in its middle.

As in the paper, the archetypes are vertices of the convex hull of a cluster in the parameter space, the
scenarios between which all others lie; Cutler and Breiman (Archetypal analysis, 1994) show that archetypes
are to be found there. The prototype is the scenario that is most like all others of its cluster.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull, QhullError

from cornercase.errors import InputError
from cornercase.typing import FloatArray, IntArray

# As many as the paper keeps on each hull; of all scenarios about a tenth is kept.
MOST_ARCHETYPES = 15
KEPT_SHARE = 10
# The number of facets grows so fast with the dimensions that hulls beyond these are of no use.
MOST_HULL_DIMENSIONS = 6
_FLAT = 1e-9


@dataclass(frozen=True)
class Hull:
    """Convex hull of some points.

    Attributes
    ----------
    vertices : ndarray of int64, shape (v,)
        Indices of the points at its corners, rising.
    simplices : ndarray of int64, shape (m, r)
        Facets, each by the indices of r points; r is the number of dimensions that the points fill: triangles
        in space, edges in a plane (also one that lies in space), the two ends of a line. Shape (0, 0) for one
        point.
    """

    vertices: IntArray
    simplices: IntArray


@dataclass(frozen=True)
class Kept:
    """A scenario of the reduced set.

    Attributes
    ----------
    index : int
        Which scenario.
    cluster : int
        Which cluster it stands for; -1 for noise.
    role : {"archetype", "prototype", "gap"}
        Why it is kept; a gap is a scenario that was unlike all that were kept before it.
    """

    index: int
    cluster: int
    role: Literal["archetype", "prototype", "gap"]


def convex_hull(points: npt.ArrayLike) -> Hull:
    """Convex hull, also of points that lie in a plane, on a line or upon each other.

    Parameters
    ----------
    points : array_like, shape (n, d)
        At least one, finite. Of points that are the same the first is taken.

    Returns
    -------
    Hull
        Points that do not fill all dimensions have the hull in the flat that they fill. Beyond 6 dimensions
        it is the hull in the 6 directions of largest variance.

    Raises
    ------
    InputError
        No points, not of one shape, or not finite.
    """
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or not array.size:
        raise InputError(f"Points of shape {array.shape} have no hull; give shape (n, d) with n and d at least 1.")
    if not np.isfinite(array).all():
        raise InputError(f"Point {int(np.argmin(np.isfinite(array).all(axis=1)))} is not finite; leave it out.")
    _, first = np.unique(array, axis=0, return_index=True)
    first = np.sort(first).astype(np.int64)
    centred = array[first] - array[first].mean(axis=0)
    _, extents, directions = np.linalg.svd(centred, full_matrices=False)
    filled = int((extents > _FLAT * max(1.0, float(np.abs(array).max()))).sum())
    flat = centred @ directions.T
    for dimensions in range(min(filled, MOST_HULL_DIMENSIONS), 1, -1):
        # Qhull cannot start on what is nearly flat; then the thinnest direction is left out.
        try:
            hull = ConvexHull(flat[:, :dimensions])
        except QhullError:
            continue
        return Hull(np.sort(first[hull.vertices]), first[hull.simplices])
    if filled == 0:
        return Hull(first[:1], np.empty((0, 0), dtype=np.int64))
    ends = np.sort(first[[int(flat[:, 0].argmin()), int(flat[:, 0].argmax())]])
    return Hull(ends, ends[:, None])


def hull_archetypes(points: npt.ArrayLike, k: int | None = None) -> IntArray:
    """Points at the corners of the convex hull, the most different ones if there are more than wanted.

    Parameters
    ----------
    points : array_like, shape (n, d)
        Parameters in the unit cube.
    k : int, optional
        How many at most; all vertices if not given.

    Returns
    -------
    ndarray of int64, shape (m,)
        Indices, rising. Of more than `k` vertices those are taken that farthest-first traversal (Gonzalez,
        Clustering to minimize the maximum intercluster distance, 1985) meets: first the one farthest from the
        mean of the points, then always the one farthest from all taken; at a tie the first.

    Raises
    ------
    InputError
        As `convex_hull`, or `k` is not positive.
    """
    if k is not None and k < 1:
        raise InputError(f"k is {k}; keep at least 1 archetype.")
    array = np.asarray(points, dtype=np.float64)
    vertices = convex_hull(array).vertices
    if k is None or len(vertices) <= k:
        return vertices
    corners = array[vertices]
    nearest = np.linalg.norm(corners - array.mean(axis=0), axis=1)
    taken: list[int] = []
    for _ in range(k):
        taken.append(int(nearest.argmax()))
        away = np.linalg.norm(corners - corners[taken[-1]], axis=1)
        nearest = away if len(taken) == 1 else np.minimum(nearest, away)
    return np.sort(vertices[taken])


def prototype(distances: FloatArray, members: npt.ArrayLike) -> int:
    """Medoid: the member with the smallest sum of distances to the others, at a tie the first.

    Parameters
    ----------
    distances : ndarray of float64, shape (n, n)
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
    return int(indices[distances[np.ix_(indices, indices)].sum(axis=1).argmin()])


def reduce_clusters(
    points: npt.ArrayLike,
    distances: npt.ArrayLike,
    labels: npt.ArrayLike,
    *,
    archetypes: int | Literal["auto"] = "auto",
) -> tuple[Kept, ...]:
    """Choose the scenarios that stand for the clusters.

    Parameters
    ----------
    points : array_like, shape (n, d)
        Parameters of the scenarios in the unit cube.
    distances : array_like, shape (n, n)
        Distances by which the scenarios were clustered.
    labels : array_like of int, shape (n,)
        Cluster of each scenario; -1 is noise, of which none is kept.
    archetypes : int or "auto"
        How many for each cluster at most. ``"auto"`` keeps about a tenth of all scenarios, prototypes
        included, so ``n // (10 * clusters) - 1``, but at least d + 1, without which a hull is flat, and at
        most 15, as the paper.

    Returns
    -------
    tuple of Kept
        By cluster, the prototype first, then the archetypes by index. No scenario is there twice: a prototype
        that is also a corner of the hull stands as the prototype, and the hull of the others gives the
        archetypes.

    Raises
    ------
    InputError
        The numbers of scenarios differ, or `archetypes` is not positive.
    """
    points = np.asarray(points, dtype=np.float64)
    distances = np.asarray(distances, dtype=np.float64)
    names = np.asarray(labels, dtype=np.int64)
    n = len(names)
    if points.ndim != 2 or len(points) != n or distances.shape != (n, n):
        raise InputError(
            f"There are {n} labels, points of shape {points.shape} and distances of shape {distances.shape}; "
            "give all for the same scenarios."
        )
    found = [int(name) for name in np.unique(names) if name >= 0]
    if archetypes == "auto":
        lowest = min(points.shape[1] + 1, MOST_ARCHETYPES)
        most = int(np.clip(n // (KEPT_SHARE * max(1, len(found))) - 1, lowest, MOST_ARCHETYPES))
    elif isinstance(archetypes, (int, np.integer)) and archetypes >= 1:
        most = int(archetypes)
    else:
        raise InputError(f"archetypes is {archetypes!r}; give a whole number of at least 1, or 'auto'.")

    kept: list[Kept] = []
    for name in found:
        members = np.flatnonzero(names == name)
        middle = prototype(distances, members)
        kept.append(Kept(middle, name, "prototype"))
        # A scenario with the same parameters as the prototype would add nothing to it.
        others = members[(points[members] != points[middle]).any(axis=1)]
        if len(others):
            corners = others[hull_archetypes(points[others], most)]
            kept.extend(Kept(int(index), name, "archetype") for index in corners)
    return tuple(kept)
