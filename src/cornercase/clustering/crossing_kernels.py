"""Compiled overlap tests of boxes along two paths."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math

import numpy as np

from cornercase._common.box_tree import next_near, node_after, with_run
from cornercase._common.compiling import kernel

_MARGIN = 1e-3
"""Margin of the bounding circles in m, far more than rounding."""

_HALVINGS = 20
"""Number of bisections of a step to find the instant of contact, to a millionth of the step."""


@kernel(error_model="numpy")
def find_overlaps(a, size_a, b, size_b, tree):
    """Return which boxes of path a overlap which of path b, as runs for `OverlapRuns`.

    `poses_a`, shape (4, n), and `poses_b`, shape (4, m), have rows x, y, cosine and sine of the heading; sizes are
    length and width; `tree` is the AABB tree of the centres of path b.
    """
    reach = 0.5 * (math.hypot(size_a[0], size_a[1]) + math.hypot(size_b[0], size_b[1]))
    wide = reach + _MARGIN
    leaves, count = len(tree) // 2, 0
    runs = np.empty((64, 3), dtype=np.int64)
    for i in range(a.shape[1]):
        low_x, low_y, high_x, high_y = a[0, i] - wide, a[1, i] - wide, a[0, i] + wide, a[1, i] + wide
        last = -2
        node = next_near(tree, 1, low_x, low_y, high_x, high_y)
        while node > 0:
            j = node - leaves
            x, y = b[0, j] - a[0, i], b[1, j] - a[1, i]
            if x * x + y * y <= reach * reach and _overlap(x, y, a[2, i], a[3, i], size_a, b[2, j], b[3, j], size_b):
                if j != last + 1:
                    runs = with_run(runs, count, i, j)
                    count += 1
                runs[count - 1, 2] = last = j
            node = next_near(tree, node_after(node), low_x, low_y, high_x, high_y)
    return runs[:count]


@kernel(error_model="numpy", _nrt=False)
def touching_share(a, size_a, before, after, b, size_b, meets):
    """Return the fraction of a step of path a at which it first touches a box of path b in `is_touched`."""
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        share = 0.5 * (low + high)
        x = a[0, before] + share * (a[0, after] - a[0, before])
        y = a[1, before] + share * (a[1, after] - a[1, before])
        cos = a[2, before] + share * (a[2, after] - a[2, before])
        sin = a[3, before] + share * (a[3, after] - a[3, before])
        norm = math.hypot(cos, sin)
        touches = False
        for j in range(b.shape[1]):
            if meets[j] and _overlap(
                b[0, j] - x, b[1, j] - y, cos / norm, sin / norm, size_a, b[2, j], b[3, j], size_b
            ):
                touches = True
                break
        if touches:
            high = share
        else:
            low = share
    return high


@kernel(error_model="numpy", _nrt=False)
def _overlap(x, y, cos_a, sin_a, size_a, cos_b, sin_b, size_b):
    """Separating-axis test of two boxes whose centres differ by (x, y)."""
    cos, sin = abs(cos_a * cos_b + sin_a * sin_b), abs(cos_a * sin_b - sin_a * cos_b)
    length_a, width_a, length_b, width_b = 0.5 * size_a[0], 0.5 * size_a[1], 0.5 * size_b[0], 0.5 * size_b[1]
    return (
        abs(cos_a * x + sin_a * y) <= length_a + cos * length_b + sin * width_b
        and abs(cos_a * y - sin_a * x) <= width_a + sin * length_b + cos * width_b
        and abs(cos_b * x + sin_b * y) <= length_b + cos * length_a + sin * width_a
        and abs(cos_b * y - sin_b * x) <= width_b + sin * length_a + cos * width_a
    )
