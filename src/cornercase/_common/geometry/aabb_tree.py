"""Binary tree of axis-aligned boxes along a path, to find overlaps without testing each pair.

Boxes that follow each other in time are close to each other. A tree over their order is therefore packed as well as
one sorted by position (STR packing), and it returns boxes in order of time.
"""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import numpy as np

from cornercase._common.numba.kernel import kernel
from cornercase._common.typing import FloatArray


def build_aabb_tree(bounds: FloatArray) -> FloatArray:
    """Build the tree, shape (2 k, 4), of boxes with bounds (min x, min y, max x, max y), shape (m, 4).

    Node 1 holds all boxes, nodes 2 i and 2 i + 1 the two halves of node i. The nodes from k on are the boxes
    themselves; k is the smallest power of two that is at least m.
    """
    leaves = 1 << max(len(bounds) - 1, 0).bit_length()
    tree = np.empty((2 * leaves, 4))
    tree[:, :2], tree[:, 2:] = np.inf, -np.inf
    tree[leaves : leaves + len(bounds)] = bounds
    fill_inner_nodes(tree)
    return tree


@kernel(error_model="numpy", _nrt=False)
def fill_inner_nodes(tree):
    """Compute the bounds of the inner nodes from those of the leaves."""
    for node in range(len(tree) // 2 - 1, 0, -1):
        for k in range(2):
            tree[node, k] = min(tree[2 * node, k], tree[2 * node + 1, k])
            tree[node, k + 2] = max(tree[2 * node, k + 2], tree[2 * node + 1, k + 2])


@kernel(error_model="numpy", _nrt=False)
def next_overlapping_leaf(tree, node, low_x, low_y, high_x, high_y):
    """Return the first leaf at or after `node` that overlaps the bounds, or 0. Start at node 1."""
    leaves = len(tree) // 2
    while node > 0:
        box = tree[node]
        if box[0] <= high_x and low_x <= box[2] and box[1] <= high_y and low_y <= box[3]:
            if node >= leaves:
                return node
            node = 2 * node
        else:
            node = node_after_subtree(node)
    return 0


@kernel(error_model="numpy", _nrt=False)
def node_after_subtree(node):
    """Return the node that follows a node's whole subtree, or 0 after the last one."""
    while node & 1:
        node >>= 1
    return node + 1 if node > 0 else 0


@kernel(error_model="numpy")
def append_run(runs, count, step, other_step):
    """Append a run to the first `count` rows of `runs` (see `OverlapRuns.runs`); double the array if it is full."""
    if count == len(runs):
        grown = np.empty((2 * count, 3), dtype=np.int64)
        grown[:count] = runs
        runs = grown
    runs[count, 0], runs[count, 1] = step, other_step
    return runs
