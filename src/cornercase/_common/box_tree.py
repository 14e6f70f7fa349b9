"""Which boxes along one way are near a box of another, without a look at each pair.

Boxes that follow each other in time are near each other, so a binary tree over their order packs them as well as one
that sorts them by place first (STR packing), and gives them in order of time.
"""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import numpy as np

from cornercase._common.compiling import kernel
from cornercase._common.typing import FloatArray


def box_tree(bounds: FloatArray) -> FloatArray:
    """Make a tree of boxes along the axes.

    Parameters
    ----------
    bounds : ndarray of float64, shape (m, 4)
        Least x and y, and greatest x and y, of each.

    Returns
    -------
    ndarray of float64, shape (2 k, 4)
        Node 1 holds all boxes, nodes 2 i and 2 i + 1 the first and the second half of what node i holds; those from k
        on are the boxes themselves, where k is the least power of two that is not below m.
    """
    leaves = 1 << max(len(bounds) - 1, 0).bit_length()
    tree = np.empty((2 * leaves, 4))
    tree[:, :2], tree[:, 2:] = np.inf, -np.inf
    tree[leaves : leaves + len(bounds)] = bounds
    fill_tree(tree)
    return tree


@kernel(error_model="numpy", _nrt=False)
def fill_tree(tree):
    """Bounds of the nodes above the boxes."""
    for node in range(len(tree) // 2 - 1, 0, -1):
        for k in range(2):
            tree[node, k] = min(tree[2 * node, k], tree[2 * node + 1, k])
            tree[node, k + 2] = max(tree[2 * node, k + 2], tree[2 * node + 1, k + 2])


@kernel(error_model="numpy", _nrt=False)
def next_near(tree, node, low_x, low_y, high_x, high_y):
    """Node of the next box that shares a point with some bounds, from a node on; 0 where there is none.

    The first is looked for from node 1 on, the one after a box from `node_after` of it.
    """
    leaves = len(tree) // 2
    while node > 0:
        box = tree[node]
        if box[0] <= high_x and low_x <= box[2] and box[1] <= high_y and low_y <= box[3]:
            if node >= leaves:
                return node
            node = 2 * node
        else:
            node = node_after(node)
    return 0


@kernel(error_model="numpy", _nrt=False)
def node_after(node):
    """First node that holds none of what a node holds, but what comes next; 0 where nothing does."""
    while node & 1:
        node >>= 1
    return node + 1 if node > 0 else 0


@kernel(error_model="numpy")
def with_run(runs, count, step, other):
    """Begin one more of the `count` runs, as in `Meetings.runs`; in an array twice as long where it is full."""
    if count == len(runs):
        grown = np.empty((2 * count, 3), dtype=np.int64)
        grown[:count] = runs
        runs = grown
    runs[count, 0], runs[count, 1] = step, other
    return runs
