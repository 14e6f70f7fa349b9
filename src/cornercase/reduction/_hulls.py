"""Convex hulls of clusters in the parameter space, and the archetypes (extreme scenarios) at their corners.

As in the paper that cornercase follows, the archetypes of a cluster are vertices of its convex hull; all other
scenarios of the cluster lie between them. A. Cutler and L. Breiman, "Archetypal analysis", 1994, show that archetypes
lie on the hull.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull, QhullError

from cornercase._common.errors import InputError
from cornercase._common.typing import IntArray

# The number of facets grows so fast with the number of dimensions that hulls of more dimensions are useless.
MAX_HULL_DIMENSIONS = 6
_RANK_TOLERANCE = 1e-9


@dataclass(frozen=True)
class Hull:
    """Convex hull of some points: ascending indices of its vertices, and facets, shape (m, r), as indices.

    r is the number of dimensions that the points span, at most 6. In three dimensions facets are triangles, in a plane
    edges, and on a line the two ends. A single point has facets of shape (0, 0).
    """

    vertices: IntArray
    simplices: IntArray


def find_convex_hull(points: npt.ArrayLike) -> Hull:
    """Find the convex hull of at least one point; the points may lie in a plane, on a line or at the same position.

    If points do not span all dimensions, the result is the hull in the subspace that they span. With more than 6
    dimensions it is the hull in the 6 directions of largest variance. Of identical points, only the first is used.
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
    rank = int((extents > _RANK_TOLERANCE * max(1.0, float(np.abs(array).max()))).sum())
    projected = centred @ directions.T
    for dimensions in range(min(rank, MAX_HULL_DIMENSIONS), 1, -1):
        # Qhull fails on nearly flat points; then the direction of smallest variance is left out.
        try:
            hull = ConvexHull(projected[:, :dimensions])
        except QhullError:
            continue
        return Hull(np.sort(first[hull.vertices]), first[hull.simplices])
    if rank == 0:
        return Hull(first[:1], np.empty((0, 0), dtype=np.int64))
    ends = np.sort(first[[int(projected[:, 0].argmin()), int(projected[:, 0].argmax())]])
    return Hull(ends, ends[:, None])


def find_hull_edges(facets: Iterable[Sequence[int]]) -> list[tuple[int, int]]:
    """Return the edges of hulls, in ascending order; a hull on a line has two facets in a row, which are its ends."""
    facets = list(facets)
    ends = [facet[0] for facet in facets if len(facet) == 1]
    pairs = [pair for facet in facets for pair in combinations(facet, 2)]
    return sorted({(min(pair), max(pair)) for pair in (*pairs, *zip(ends[::2], ends[1::2], strict=False))})


def find_hull_archetypes(points: npt.ArrayLike, k: int | None = None) -> IntArray:
    """Return the indices, in ascending order, of at most `k` vertices of the convex hull; by default all vertices.

    If the hull has more than `k` vertices, vertices far from each other are selected by farthest-first traversal
    (Gonzalez, "Clustering to minimize the maximum intercluster distance", 1985). The first vertex is the one farthest
    from the mean of the points. Each further vertex is the one farthest from the vertices selected before. If vertices
    are tied, the first of them is selected.
    """
    if k is not None and k < 1:
        raise InputError(f"`k` {k}: give at least 1.")
    array = np.asarray(points, dtype=np.float64)
    vertices = find_convex_hull(array).vertices
    if k is None or len(vertices) <= k:
        return vertices
    corners = array[vertices]
    nearest = np.linalg.norm(corners - array.mean(axis=0), axis=1)
    selected: list[int] = []
    for _ in range(k):
        selected.append(int(nearest.argmax()))
        distance = np.linalg.norm(corners - corners[selected[-1]], axis=1)
        nearest = distance if len(selected) == 1 else np.minimum(nearest, distance)
    return np.sort(vertices[selected])
