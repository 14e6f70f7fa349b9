"""Compiled intersection tests of the hulls that boxes sweep in small steps."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math

import numpy as np

from cornercase._common.box_tree import next_near, node_after, with_run
from cornercase._common.compiling import kernel

_MARGIN = 1e-3  # m by which bounds are wider than a hull


@kernel(error_model="numpy")
def fill_axes(corners, out):
    """Write the possible separating axes, (n, 8, 2), of hulls of a box before and after a step, (n, 8, 2).

    These are unit vectors along and across both boxes, and those perpendicular to the motion of each corner.
    """
    for i in range(len(corners)):
        _put_axes(corners[i], out[i])


@kernel(error_model="numpy")
def _put_axes(corners, out):
    for box in range(2):
        first = 4 * box
        across_x = corners[first + 1, 0] - corners[first, 0]
        across_y = corners[first + 1, 1] - corners[first, 1]
        along_x = corners[first + 1, 0] - corners[first + 2, 0]
        along_y = corners[first + 1, 1] - corners[first + 2, 1]
        if _norm(along_x, along_y) >= _norm(across_x, across_y):
            x, y = _unit(along_x, along_y)
        else:
            x, y = _unit(across_y, -across_x)
        out[2 * box, 0], out[2 * box, 1] = x, y
        out[2 * box + 1, 0], out[2 * box + 1, 1] = -y, x
    for corner in range(4):
        way_x = corners[corner + 4, 0] - corners[corner, 0]
        way_y = corners[corner + 4, 1] - corners[corner, 1]
        out[4 + corner, 0], out[4 + corner, 1] = _unit(-way_y, way_x)


@kernel(error_model="numpy")
def _norm(x, y):
    return math.sqrt(x * x + y * y)


@kernel(error_model="numpy")
def _unit(x, y):
    norm = _norm(x, y)
    return (x / norm, y / norm) if norm > 0.0 else (1.0, 0.0)


@kernel(error_model="numpy")
def find_meetings(corners_a, axes_a, middle_a, reach_a, corners_b, axes_b, middle_b, reach_b, tree):
    """Find which hulls of `a` intersect which of `b`, as overlap runs (start, first, last).

    Each hull lies in the circle given by `middle` and `reach`; `tree` is the `box_tree` of the bounds of those of `b`.
    """
    leaves, count = len(tree) // 2, 0
    runs = np.empty((64, 3), dtype=np.int64)
    for i in range(len(corners_a)):
        low_x, low_y, high_x, high_y = _bounds(corners_a[i])
        last = -2
        node = next_near(tree, 1, low_x, low_y, high_x, high_y)
        while node > 0:
            j = node - leaves
            distance = math.hypot(middle_b[j, 0] - middle_a[i, 0], middle_b[j, 1] - middle_a[i, 1])
            if (
                distance <= reach_a[i] + reach_b[j]
                and _widest_gap(corners_a[i], axes_a[i], corners_b[j], axes_b[j], True) <= 0.0
            ):
                if j != last + 1:
                    runs = with_run(runs, count, i, j)
                    count += 1
                runs[count - 1, 2] = last = j
            node = next_near(tree, node_after(node), low_x, low_y, high_x, high_y)
    return runs[:count]


@kernel(error_model="numpy")
def fill_bounds(corners, out):
    """Write least x and y, and greatest x and y, (n, 4), of hulls, (n, 8, 2)."""
    for i in range(len(corners)):
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = _bounds(corners[i])


@kernel(error_model="numpy")
def _bounds(corners):
    low_x, high_x = _range(1.0, 0.0, corners)
    low_y, high_y = _range(0.0, 1.0, corners)
    # The margin is far above rounding errors, so no hull that touches along another direction is missed.
    return low_x - _MARGIN, low_y - _MARGIN, high_x + _MARGIN, high_y + _MARGIN


@kernel(error_model="numpy")
def least_gap(start, way, share, corners, axes):
    """Gap between a box after a fraction of its motion, (4, 2) both, and the nearest of some hulls.

    Above 0 if it touches none of them; then it is a lower bound of the distance.
    """
    hull, own = np.empty((8, 2)), np.empty((8, 2))
    for corner in range(4):
        for k in range(2):
            hull[corner, k] = start[corner, k]
            hull[corner + 4, k] = start[corner, k] + share * way[corner, k]
    _put_axes(hull, own)
    least = np.inf
    for j in range(len(corners)):
        least = min(least, _widest_gap(hull, own, corners[j], axes[j], False))
    return least


@kernel(error_model="numpy")
def _widest_gap(a, axes_a, b, axes_b, enough):
    """Widest gap along any axis (separating axes); with `stop_if_separated` the first that is above 0, or NaN."""
    widest = -np.inf
    for side in range(2):
        axes = axes_a if side == 0 else axes_b
        for k in range(len(axes)):
            low_a, high_a = _range(axes[k, 0], axes[k, 1], a)
            low_b, high_b = _range(axes[k, 0], axes[k, 1], b)
            gap = max(low_a - high_b, low_b - high_a)
            if enough and not gap <= 0.0:
                return gap
            widest = max(widest, gap)
    return widest


@kernel(error_model="numpy")
def _range(x, y, points):
    low = high = x * points[0, 0] + y * points[0, 1]
    for i in range(1, len(points)):
        on_axis = x * points[i, 0] + y * points[i, 1]
        low, high = min(low, on_axis), max(high, on_axis)
    return low, high
