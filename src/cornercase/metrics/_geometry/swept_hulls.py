"""Compiled overlap tests of the convex hulls that a box sweeps in small steps."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math

import numpy as np

from cornercase._common.geometry.aabb_tree import append_overlap_run, next_overlapping_leaf, node_after_subtree
from cornercase._common.numba.kernel import kernel

_MARGIN = 1e-3  # m by which bounds are wider than a hull


@kernel(error_model="numpy")
def compute_separating_axes(corners, out):
    """Write the candidate separating axes of n hulls to `out`, shape (n, 8, 2).

    `corners`, shape (n, 8, 2), are the corners of a box before and after a step; the hull encloses both boxes. The axes
    are unit vectors along and across both boxes, and perpendicular to the motion of each corner.
    """
    for i in range(len(corners)):
        _write_separating_axes(corners[i], out[i])


@kernel(error_model="numpy")
def _write_separating_axes(corners, out):
    for box in range(2):
        first = 4 * box
        across_x = corners[first + 1, 0] - corners[first, 0]
        across_y = corners[first + 1, 1] - corners[first, 1]
        along_x = corners[first + 1, 0] - corners[first + 2, 0]
        along_y = corners[first + 1, 1] - corners[first + 2, 1]
        if _vector_length(along_x, along_y) >= _vector_length(across_x, across_y):
            x, y = _unit_vector(along_x, along_y)
        else:
            x, y = _unit_vector(across_y, -across_x)
        out[2 * box, 0], out[2 * box, 1] = x, y
        out[2 * box + 1, 0], out[2 * box + 1, 1] = -y, x
    for corner in range(4):
        shift_x = corners[corner + 4, 0] - corners[corner, 0]
        shift_y = corners[corner + 4, 1] - corners[corner, 1]
        out[4 + corner, 0], out[4 + corner, 1] = _unit_vector(-shift_y, shift_x)


@kernel(error_model="numpy")
def _vector_length(x, y):
    return math.sqrt(x * x + y * y)


@kernel(error_model="numpy")
def _unit_vector(x, y):
    norm = _vector_length(x, y)
    return (x / norm, y / norm) if norm > 0.0 else (1.0, 0.0)


@kernel(error_model="numpy")
def find_overlapping_hulls(corners_a, axes_a, center_a, radius_a, corners_b, axes_b, center_b, radius_b, tree):
    """Find which hulls of the swept area a intersect which hulls of the swept area b.

    Return an array with a row of three numbers for each run of consecutive hulls of b that intersect one hull of a: the
    index of the hull of a, and the first and last index of the hulls of b. `center` and `radius` describe a circle
    around each hull. `tree` is a bounding-box tree of the hulls of b.
    """
    leaves, count = len(tree) // 2, 0
    runs = np.empty((64, 3), dtype=np.int64)
    for i in range(len(corners_a)):
        low_x, low_y, high_x, high_y = _bounds_with_margin(corners_a[i])
        last = -2
        node = next_overlapping_leaf(tree, 1, low_x, low_y, high_x, high_y)
        while node > 0:
            j = node - leaves
            distance = math.hypot(center_b[j, 0] - center_a[i, 0], center_b[j, 1] - center_a[i, 1])
            if (
                distance <= radius_a[i] + radius_b[j]
                and _widest_gap_on_axes(corners_a[i], axes_a[i], corners_b[j], axes_b[j], True) <= 0.0
            ):
                if j != last + 1:
                    runs = append_overlap_run(runs, count, i, j)
                    count += 1
                runs[count - 1, 2] = last = j
            node = next_overlapping_leaf(tree, node_after_subtree(node), low_x, low_y, high_x, high_y)
    return runs[:count]


@kernel(error_model="numpy")
def compute_hull_bounds(corners, out):
    """Write the bounds of n hulls, shape (n, 8, 2), to `out`, shape (n, 4): least x and y, greatest x and y.

    The bounds are 1 mm wider than the hulls on each side.
    """
    for i in range(len(corners)):
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = _bounds_with_margin(corners[i])


@kernel(error_model="numpy")
def _bounds_with_margin(corners):
    low_x, high_x = _project_onto_axis(1.0, 0.0, corners)
    low_y, high_y = _project_onto_axis(0.0, 1.0, corners)
    # The margin is far above rounding errors, so no hull that touches along another direction is missed.
    return low_x - _MARGIN, low_y - _MARGIN, high_x + _MARGIN, high_y + _MARGIN


@kernel(error_model="numpy")
def gap_to_nearest_hull(start, motion, fraction, corners, axes):
    """Return the gap between the area that a box sweeps in a `fraction` of a step and the nearest of several hulls.

    `start` and `motion`, shape (4, 2), are the corners of the box and their displacement in the whole step; `corners`
    and `axes` describe the hulls. If the gap is above 0, the distance is at least the gap. If the gap is 0 or below,
    the swept area touches a hull.
    """
    hull, own = np.empty((8, 2)), np.empty((8, 2))
    for corner in range(4):
        for k in range(2):
            hull[corner, k] = start[corner, k]
            hull[corner + 4, k] = start[corner, k] + fraction * motion[corner, k]
    _write_separating_axes(hull, own)
    least = np.inf
    for j in range(len(corners)):
        least = min(least, _widest_gap_on_axes(hull, own, corners[j], axes[j], False))
    return least


@kernel(error_model="numpy")
def _widest_gap_on_axes(a, axes_a, b, axes_b, stop_if_separated):
    """Return the widest gap between two convex shapes along any of their separating axes; negative if they overlap.

    With `stop_if_separated`, return the first gap that is above 0 or NaN.
    """
    widest = -np.inf
    for side in range(2):
        axes = axes_a if side == 0 else axes_b
        for k in range(len(axes)):
            low_a, high_a = _project_onto_axis(axes[k, 0], axes[k, 1], a)
            low_b, high_b = _project_onto_axis(axes[k, 0], axes[k, 1], b)
            gap = max(low_a - high_b, low_b - high_a)
            if stop_if_separated and not gap <= 0.0:
                return gap
            widest = max(widest, gap)
    return widest


@kernel(error_model="numpy")
def _project_onto_axis(x, y, points):
    low = high = x * points[0, 0] + y * points[0, 1]
    for i in range(1, len(points)):
        on_axis = x * points[i, 0] + y * points[i, 1]
        low, high = min(low, on_axis), max(high, on_axis)
    return low, high
