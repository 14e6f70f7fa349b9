"""Compiled search for the smallest gap between two moving boxes."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math

import numpy as np

from cornercase._common.numba.kernel import kernel

_ROUNDING = 1e-6
"""Largest rounding error of a distance, in m."""


@kernel(error_model="numpy")
def smallest_box_gap(shared, x_a, y_a, cos_a, sin_a, size_a, x_b, y_b, cos_b, sin_b, size_b):
    """Find the smallest gap between two moving boxes over the instants in `shared`.

    Return the smallest gap in m, the first instant with this gap, and the gap at the first instant in `shared`. `x`,
    `y`, `cos` and `sin` are centre and heading of each box at each instant, `size` is length and width.
    """
    # The gap is at least the centre distance less both circumscribed radii, and at most that less both inscribed radii.
    reach = 0.5 * (math.hypot(size_a[0], size_a[1]) + math.hypot(size_b[0], size_b[1]))
    inner = 0.5 * (min(size_a[0], size_a[1]) + min(size_b[0], size_b[1]))
    nearest_centers = math.inf
    for k in range(len(shared)):
        if shared[k]:
            nearest_centers = min(nearest_centers, math.hypot(x_b[k] - x_a[k], y_b[k] - y_a[k]))
    largest = max(nearest_centers - inner, 0.0) + _ROUNDING
    a, b = np.empty((4, 2)), np.empty((4, 2))
    axes = np.empty((4, 2))
    smallest, instant, first, is_first = math.inf, 0, math.nan, True
    for k in range(len(shared)):
        if not shared[k]:
            continue
        if not is_first and math.hypot(x_b[k] - x_a[k], y_b[k] - y_a[k]) - reach > largest:
            continue
        _set_corners(a, x_a[k], y_a[k], cos_a[k], sin_a[k], size_a)
        _set_corners(b, x_b[k], y_b[k], cos_b[k], sin_b[k], size_b)
        gap = _box_distance(a, b, axes)
        if is_first:
            first, is_first = gap, False
        if gap < smallest:
            smallest, instant = gap, k
    return smallest, instant, first


@kernel(error_model="numpy", _nrt=False)
def _set_corners(corners, x, y, cos, sin, size):
    """Write the corners of a box to `corners`, counter-clockwise from the front right."""
    along, across = 0.5 * size[0], 0.5 * size[1]
    for i in range(4):
        ahead = along if i < 2 else -along
        aside = across if i == 1 or i == 2 else -across
        corners[i, 0] = x + cos * ahead - sin * aside
        corners[i, 1] = y + sin * ahead + cos * aside


@kernel(error_model="numpy", _nrt=False)
def _box_distance(a, b, axes):
    """Return the distance of two boxes; 0 if they overlap.

    `axes`, shape (4, 2), is overwritten with the axes of a, then the axes of b.
    """
    _set_axes(axes, 0, a)
    _set_axes(axes, 2, b)
    widest = -math.inf
    for axis in range(4):
        low_a, high_a = _projected_range(axes, axis, a)
        low_b, high_b = _projected_range(axes, axis, b)
        widest = max(widest, low_a - high_b, -(high_a - low_b))
    if widest <= 0.0:
        return 0.0
    return min(_nearest_corner(a, b, axes, 2), _nearest_corner(b, a, axes, 0))


@kernel(error_model="numpy", _nrt=False)
def _set_axes(axes, first, box):
    """Write the unit vectors along and across a box to `axes`, from row `first` on.

    Both vectors are written even for a box of length or width 0. If both are 0, the vectors are +x and +y.
    """
    across_x, across_y = box[1, 0] - box[0, 0], box[1, 1] - box[0, 1]
    along_x, along_y = box[1, 0] - box[2, 0], box[1, 1] - box[2, 1]
    along_norm = math.sqrt(along_x * along_x + along_y * along_y)
    across_norm = math.sqrt(across_x * across_x + across_y * across_y)
    if along_norm < across_norm:
        along_x, along_y = across_y, -across_x
        along_norm = across_norm
    axes[first, 0], axes[first, 1] = (along_x / along_norm, along_y / along_norm) if along_norm > 0.0 else (1.0, 0.0)
    axes[first + 1, 0], axes[first + 1, 1] = -axes[first, 1], axes[first, 0]


@kernel(error_model="numpy", _nrt=False)
def _projected_range(axes, axis, points):
    low, high = math.inf, -math.inf
    for i in range(4):
        on_axis = axes[axis, 0] * points[i, 0] + axes[axis, 1] * points[i, 1]
        low, high = min(low, on_axis), max(high, on_axis)
    return low, high


@kernel(error_model="numpy", _nrt=False)
def _nearest_corner(corners, box, axes, first):
    """Return the smallest distance from the corners of one box, `corners`, to another box, `box`.

    The two rows of `axes` from row `first` on are the axes of `box`.
    """
    nearest = math.inf
    low_u, high_u = _projected_range(axes, first, box)
    low_v, high_v = _projected_range(axes, first + 1, box)
    for i in range(4):
        u = axes[first, 0] * corners[i, 0] + axes[first, 1] * corners[i, 1]
        v = axes[first + 1, 0] * corners[i, 0] + axes[first + 1, 1] * corners[i, 1]
        outside_u = max(abs(u - 0.5 * (high_u + low_u)) - 0.5 * (high_u - low_u), 0.0)
        outside_v = max(abs(v - 0.5 * (high_v + low_v)) - 0.5 * (high_v - low_v), 0.0)
        nearest = min(nearest, math.hypot(outside_u, outside_v))
    return nearest
