"""Compiled minimum spanning tree of a matrix of distances, by Prim's algorithm."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import numpy as np

from cornercase._common.numba.kernel import kernel


@kernel(error_model="numpy")
def fill_spanning_tree(distances, ends, lengths):
    """Write the edges of a minimum spanning tree to `ends`, shape (2, n - 1), and `lengths`, shape (n - 1,).

    `ends` are the two points of each edge. `distances`, shape (n, n), are symmetric.
    """
    count = len(distances)
    nearest, reach = np.zeros(count, dtype=np.int64), distances[0].copy()
    outside = np.ones(count, dtype=np.bool_)
    outside[0] = False
    for edge in range(count - 1):
        nearest_outside = -1
        for i in range(count):
            if outside[i] and (nearest_outside < 0 or reach[i] < reach[nearest_outside]):
                nearest_outside = i
        ends[0, edge], ends[1, edge], lengths[edge] = nearest[nearest_outside], nearest_outside, reach[nearest_outside]
        outside[nearest_outside] = False
        for i in range(count):
            if outside[i] and distances[nearest_outside, i] < reach[i]:
                nearest[i], reach[i] = nearest_outside, distances[nearest_outside, i]
