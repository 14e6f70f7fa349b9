"""Binary tree of the axis-aligned boxes of a moving object, to find overlaps without testing each pair of boxes.

Boxes of consecutive times are close to each other. So a tree in order of time is about as tight as a tree sorted by
position (STR packing), and a search returns the boxes in order of time.
"""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import numpy as np

from cornercase._common.numba.kernel import kernel


@kernel(error_model="numpy")
def build_aabb_tree(bounds):
    """Build a binary tree, shape (2 k, 4), over m boxes with bounds (min x, min y, max x, max y), shape (m, 4).

    k is the smallest power of two that is at least m. Row i of the tree holds the bounds of node i. Node 1 bounds all
    boxes; nodes 2 i and 2 i + 1 bound the two halves of node i; node k + j is the leaf of box j.
    """
    leaves = 1
    while leaves < len(bounds):
        leaves *= 2
    tree = np.empty((2 * leaves, 4))
    for leaf in range(leaves):
        for k in range(2):
            is_box = leaf < len(bounds)
            tree[leaves + leaf, k] = bounds[leaf, k] if is_box else np.inf
            tree[leaves + leaf, k + 2] = bounds[leaf, k + 2] if is_box else -np.inf
    for node in range(leaves - 1, 0, -1):
        for k in range(2):
            tree[node, k] = min(tree[2 * node, k], tree[2 * node + 1, k])
            tree[node, k + 2] = max(tree[2 * node, k + 2], tree[2 * node + 1, k + 2])
    return tree


@kernel(error_model="numpy", _nrt=False)
def next_overlapping_leaf(tree, node, low_x, low_y, high_x, high_y):
    """Return the number of the next leaf node whose box overlaps the bounds, or 0 if there is none.

    The search begins at `node` and goes on in order of time. To find the first overlapping leaf, pass 1 as `node`; to
    find the next one after `leaf`, pass `node_after_subtree(leaf)`.
    """
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
    """Return the node that a depth-first search visits after the whole subtree of `node`, or 0 at the end."""
    while node & 1:
        node >>= 1
    return node + 1 if node > 0 else 0


@kernel(error_model="numpy")
def append_overlap_run(runs, count, step, other_step):
    """Write `step` and `other_step` into row `count` of `runs`, and return `runs`, or a longer copy if it was full.

    The row begins a run of overlaps: `step` of one path overlaps `other_step` and following steps of another path. The
    caller writes the last of these steps into the third column.
    """
    if count == len(runs):
        grown = np.empty((2 * count, 3), dtype=np.int64)
        for run in range(count):
            for k in range(3):
                grown[run, k] = runs[run, k]
        runs = grown
    runs[count, 0], runs[count, 1] = step, other_step
    return runs
