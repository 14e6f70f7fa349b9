"""Compiled overlap tests of boxes along two paths."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math

import numpy as np

from cornercase._common.geometry.aabb_tree import append_run, next_overlapping_leaf, node_after_subtree
from cornercase._common.numba.kernel import kernel

_MARGIN = 1e-3
"""Margin of the bounding circles in m, far more than rounding."""

_N_BISECTIONS = 20
"""Number of bisections of a step to find the instant of contact, to a millionth of the step."""


@kernel(error_model="numpy")
def find_overlap_runs(poses_a, size_a, poses_b, size_b, tree):
    """Return which boxes of path a overlap which of path b, as runs for `OverlapRuns`.

    `poses_a`, shape (4, n), and `poses_b`, shape (4, m), have rows x, y, cosine and sine of the heading; sizes are
    length and width; `tree` is the AABB tree of the centres of path b.
    """
    reach = 0.5 * (math.hypot(size_a[0], size_a[1]) + math.hypot(size_b[0], size_b[1]))
    wide = reach + _MARGIN
    leaves, count = len(tree) // 2, 0
    runs = np.empty((64, 3), dtype=np.int64)
    for i in range(poses_a.shape[1]):
        low_x, low_y, high_x, high_y = (
            poses_a[0, i] - wide,
            poses_a[1, i] - wide,
            poses_a[0, i] + wide,
            poses_a[1, i] + wide,
        )
        last = -2
        node = next_overlapping_leaf(tree, 1, low_x, low_y, high_x, high_y)
        while node > 0:
            j = node - leaves
            x, y = poses_b[0, j] - poses_a[0, i], poses_b[1, j] - poses_a[1, i]
            if x * x + y * y <= reach * reach and _boxes_overlap(
                x, y, poses_a[2, i], poses_a[3, i], size_a, poses_b[2, j], poses_b[3, j], size_b
            ):
                if j != last + 1:
                    runs = append_run(runs, count, i, j)
                    count += 1
                runs[count - 1, 2] = last = j
            node = next_overlapping_leaf(tree, node_after_subtree(node), low_x, low_y, high_x, high_y)
    return runs[:count]


@kernel(error_model="numpy", _nrt=False)
def contact_fraction(poses_a, size_a, before, after, poses_b, size_b, is_touched):
    """Return the fraction of a step of path a at which it first touches a box of path b in `is_touched`."""
    low, high = 0.0, 1.0
    for _ in range(_N_BISECTIONS):
        share = 0.5 * (low + high)
        x = poses_a[0, before] + share * (poses_a[0, after] - poses_a[0, before])
        y = poses_a[1, before] + share * (poses_a[1, after] - poses_a[1, before])
        cos = poses_a[2, before] + share * (poses_a[2, after] - poses_a[2, before])
        sin = poses_a[3, before] + share * (poses_a[3, after] - poses_a[3, before])
        norm = math.hypot(cos, sin)
        touches = False
        for j in range(poses_b.shape[1]):
            if is_touched[j] and _boxes_overlap(
                poses_b[0, j] - x,
                poses_b[1, j] - y,
                cos / norm,
                sin / norm,
                size_a,
                poses_b[2, j],
                poses_b[3, j],
                size_b,
            ):
                touches = True
                break
        if touches:
            high = share
        else:
            low = share
    return high


@kernel(error_model="numpy", _nrt=False)
def _boxes_overlap(x, y, cos_a, sin_a, size_a, cos_b, sin_b, size_b):
    """Separating-axis test of two boxes whose centres differ by (x, y)."""
    cos, sin = abs(cos_a * cos_b + sin_a * sin_b), abs(cos_a * sin_b - sin_a * cos_b)
    length_a, width_a, length_b, width_b = 0.5 * size_a[0], 0.5 * size_a[1], 0.5 * size_b[0], 0.5 * size_b[1]
    return (
        abs(cos_a * x + sin_a * y) <= length_a + cos * length_b + sin * width_b
        and abs(cos_a * y - sin_a * x) <= width_a + sin * length_b + cos * width_b
        and abs(cos_b * x + sin_b * y) <= length_b + cos * length_a + sin * width_a
        and abs(cos_b * y - sin_b * x) <= width_b + sin * length_a + cos * width_a
    )
