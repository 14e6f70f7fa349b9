"""Convex hulls of clusters in the parameter space, and the archetypes at their corners.

As in the paper, the archetypes of a cluster are vertices of its convex hull: all its other scenarios lie between them.
A. Cutler and L. Breiman, "Archetypal analysis", 1994, show that archetypes are to be found there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull, QhullError

from cornercase._common.errors import InputError
from cornercase._common.typing import IntArray

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


def find_hull(points: npt.ArrayLike) -> Hull:
    """Find the convex hull, also of points that lie in a plane, on a line or upon each other.

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


def find_hull_archetypes(points: npt.ArrayLike, k: int | None = None) -> IntArray:
    """Find points at the corners of the convex hull, the most different ones if there are more than wanted.

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
        As `find_hull`, or `k` is not positive.
    """
    if k is not None and k < 1:
        raise InputError(f"`k` {k}: keep at least 1 archetype.")
    array = np.asarray(points, dtype=np.float64)
    vertices = find_hull(array).vertices
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
