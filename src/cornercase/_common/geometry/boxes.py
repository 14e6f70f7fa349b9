"""Angles and oriented boxes in the plane, vectorized over any leading axes."""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt

from cornercase._common.typing import BoolArray, FloatArray

_CONTACT_TOLERANCE = 1e-9
"""Gap in m up to which moving boxes count as touching, so that rounding does not hide a grazing contact."""

_NEGLIGIBLE_ACCELERATION = 1e-12
"""Acceleration in m/s² below which a value is a rounding error: a box would need two weeks for a metre."""

COS_RIGHT_ANGLE_TOLERANCE = 1e-7
"""Cosine below which rounding errors hide whether an angle is a right angle."""

_SIGNS_ALONG = np.array([1.0, 1.0, -1.0, -1.0])
_SIGNS_ACROSS = np.array([-1.0, 1.0, 1.0, -1.0])


def wrap_angle(angle: npt.ArrayLike) -> FloatArray:
    """Return angles in rad, wrapped to [-π, π)."""
    return np.asarray((np.asarray(angle, dtype=np.float64) + np.pi) % (2 * np.pi) - np.pi)


def is_facing_forward(angle: npt.ArrayLike) -> BoolArray:
    """Return whether a relative heading (rad) points forward, not backward; exactly sideways counts as forward."""
    return np.asarray(np.cos(angle) > -COS_RIGHT_ANGLE_TOLERANCE)


def box_corners(
    x: npt.ArrayLike, y: npt.ArrayLike, heading: npt.ArrayLike, length: npt.ArrayLike, width: npt.ArrayLike
) -> FloatArray:
    """Return the corners of boxes in m, shape (..., 4, 2), counter-clockwise from the front right.

    `x`, `y` are the centre in m; `length`, `width` are full sizes in m. `heading` is the direction of the length axis
    in rad, counter-clockwise from +x.
    """
    x, y, heading, length, width = np.broadcast_arrays(*map(np.asarray, (x, y, heading, length, width)))
    along = 0.5 * length[..., None] * _SIGNS_ALONG
    across = 0.5 * width[..., None] * _SIGNS_ACROSS
    cos, sin = np.cos(heading)[..., None], np.sin(heading)[..., None]
    corners = np.stack([x[..., None] + cos * along - sin * across, y[..., None] + sin * along + cos * across], -1)
    return np.asarray(corners, dtype=np.float64)


def boxes_overlap(a: FloatArray, b: FloatArray) -> BoolArray:
    """Return whether boxes share a point, given their corners in the order of `box_corners`.

    A box with a NaN corner overlaps nothing. Source: separating axis theorem.
    """
    if a.ndim != b.ndim:
        a, b = np.broadcast_arrays(a, b)
    overlap = np.ones(np.broadcast_shapes(a.shape[:-2], b.shape[:-2]), dtype=np.bool_)
    for box in (a, b):
        sides = _side_vectors(box)
        # Corners on the first axis: reducing over a last axis of four is several times slower.
        on_a = np.einsum("...ck,...sk->cs...", a, sides, order="C")
        on_b = np.einsum("...ck,...sk->cs...", b, sides, order="C")
        overlap &= ((on_a.max(0) >= on_b.min(0)) & (on_b.max(0) >= on_a.min(0))).all(0)
    return overlap


def _side_vectors(box: FloatArray) -> FloatArray:
    """Return vectors in the directions of the width and the length of boxes, (..., 2, 2), also if sides are 0 long."""
    sides = box[..., 1:3, :] - box[..., :2, :]
    if (sides[..., 0, 0] * sides[..., 1, 1] - sides[..., 0, 1] * sides[..., 1, 0]).all():
        return sides
    is_zero = ~sides.any(-1, keepdims=True)
    across_other = np.stack([-sides[..., ::-1, 1], sides[..., ::-1, 0]], -1)
    sides = np.where(is_zero, across_other, sides)
    return np.where(is_zero.all(-2, keepdims=True), np.eye(2), sides)


def box_distance(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the distance in m between boxes, given their corners, shape (..., 4, 2).

    The distance is 0 if the boxes overlap, and NaN if a corner is NaN. Two separate convex shapes are nearest at a
    corner, so the distance is the smallest distance from a corner of one box to the other box.
    """
    of_a, of_b = box_axes(a), box_axes(b)
    nearest = np.minimum(_nearest_corner_distance(a, b, of_b), _nearest_corner_distance(b, a, of_a))
    return np.where(separating_gap(a, of_a, b, of_b) <= 0.0, 0.0, nearest)


def _nearest_corner_distance(a: FloatArray, b: FloatArray, axes: FloatArray) -> FloatArray:
    on_b = project_on_axes(axes, b)
    beyond = np.abs(project_on_axes(axes, a) - _midrange(on_b)[..., None]) - 0.5 * np.ptp(on_b, -1)[..., None]
    outside = np.maximum(beyond, 0.0)
    distance: FloatArray = np.hypot(outside[..., 0, :], outside[..., 1, :]).min(-1)
    return distance


def _midrange(values: FloatArray) -> FloatArray:
    middle: FloatArray = 0.5 * (values.max(-1) + values.min(-1))
    return middle


def box_axes(box: FloatArray) -> FloatArray:
    """Return the unit vectors along the length and the width of boxes, shape (..., 2, 2), given their corners.

    If only the length or the width is 0, both vectors are still correct. If both are 0, the vectors are +x and +y.
    """
    across, along = box[..., 1, :] - box[..., 0, :], box[..., 1, :] - box[..., 2, :]
    turned = np.stack([across[..., 1], -across[..., 0]], -1)
    longer = np.linalg.norm(along, axis=-1) >= np.linalg.norm(across, axis=-1)
    first = _unit_vectors(np.where(longer[..., None], along, turned))
    return np.stack([first, np.stack([-first[..., 1], first[..., 0]], -1)], -2)


def _unit_vectors(vectors: FloatArray) -> FloatArray:
    norm = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(norm > 0.0, vectors / np.where(norm > 0.0, norm, 1.0), np.array([1.0, 0.0]) + 0.0 * norm)


def project_on_axes(axes: FloatArray, points: FloatArray) -> FloatArray:
    """Return coordinates, shape (..., n, m), of m points along n directions."""
    projected: FloatArray = (axes[..., :, None, :] * points[..., None, :, :]).sum(-1)
    return projected


def separating_gap(a: FloatArray, axes_of_a: FloatArray, b: FloatArray, axes_of_b: FloatArray) -> FloatArray:
    """Return the widest gap in m between two convex shapes along any of their axes (separating axis theorem).

    If the gap is positive, the shapes do not touch, and the gap is a lower bound of their distance. The gap is NaN if a
    corner is NaN.
    """
    return np.maximum(_widest_gap(axes_of_a, a, b), _widest_gap(axes_of_b, a, b))


def _widest_gap(axes: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    low, high = _overlapping_shifts(axes, a, b)
    gap: FloatArray = np.maximum(low, -high).max(-1)
    return gap


def _overlapping_shifts(axes: FloatArray, a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return, for each axis, the smallest and largest shift of `b` for which the projections of both boxes overlap."""
    low_a, high_a = _projected_range(axes, a)
    low_b, high_b = _projected_range(axes, b)
    return low_a - high_b, high_a - low_b


def _projected_range(axes: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the smallest and largest coordinate of the points along each axis."""
    x, y = np.ascontiguousarray(axes[..., 0]), np.ascontiguousarray(axes[..., 1])
    # Point by point: reducing over a last axis of four is several times slower.
    low = high = x * points[..., 0, None, 0] + y * points[..., 0, None, 1]
    for i in range(1, points.shape[-2]):
        on_axis = x * points[..., i, None, 0] + y * points[..., i, None, 1]
        low, high = np.minimum(low, on_axis), np.maximum(high, on_axis)
    return low, high


def time_to_contact(
    a: FloatArray,
    b: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray | None = None,
    horizon: npt.ArrayLike = np.inf,
) -> FloatArray:
    """Return the time in s at which two boxes that move without turning first touch.

    `a` and `b` are the corners of the boxes. `velocity` and the constant `acceleration` are those of `b` relative to
    `a`. The time is exact: 0 if the boxes touch now, inf if they do not touch within `horizon` s, NaN for NaN inputs.
    Method: the boxes touch when their projections on all axes overlap. On each axis, the projections overlap in at most
    two time intervals.
    """
    axes = np.concatenate(np.broadcast_arrays(box_axes(a), box_axes(b)), -2)
    low, high = _overlapping_shifts(axes, a, b)
    speed = project_on_axes(axes, velocity[..., None, :])[..., 0]
    low, high, speed = np.broadcast_arrays(low, high, speed)
    if acceleration is None or not np.any(acceleration):
        exact, _ = _overlap_interval_linear(low, high, speed)
        starts, ends = _overlap_interval_linear(low - _CONTACT_TOLERANCE, high + _CONTACT_TOLERANCE, speed)
        exact, starts, ends = exact[..., None], starts[..., None], ends[..., None]
    else:
        relative_acceleration = np.broadcast_to(project_on_axes(axes, acceleration[..., None, :])[..., 0], low.shape)
        relative_acceleration = np.where(
            np.abs(relative_acceleration) <= _NEGLIGIBLE_ACCELERATION, 0.0, relative_acceleration
        )
        exact, _ = _overlap_intervals_quadratic(low, high, speed, relative_acceleration)
        starts, ends = _overlap_intervals_quadratic(
            low - _CONTACT_TOLERANCE, high + _CONTACT_TOLERANCE, speed, relative_acceleration
        )
    # The tolerance only decides whether there is a contact; its time is the exact one if there is one. Along an axis
    # without motion both are infinite.
    with np.errstate(invalid="ignore"):
        starts = np.where((exact >= starts) & (exact - starts <= 1e-3), exact, starts)
    horizon = np.asarray(horizon, dtype=np.float64)
    first = np.full(np.broadcast_shapes(low.shape[:-1], horizon.shape), np.inf)
    for choice in itertools.product(range(starts.shape[-1]), repeat=4):
        index = (..., np.arange(4), np.array(choice))
        begin = np.maximum(starts[index].max(-1), 0.0)
        meets = begin <= np.minimum(ends[index].min(-1), horizon)
        first = np.where(meets & (begin < first), begin, first)
    unknown: BoolArray = np.isnan(low).any(-1) | np.isnan(speed).any(-1) | np.isnan(horizon)
    if acceleration is not None:
        unknown = unknown | np.isnan(acceleration).any(-1)
    return np.where(unknown, np.nan, first)


def _overlap_interval_linear(low: FloatArray, high: FloatArray, speed: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return start and end of the times t with low <= speed t <= high; without such times, start is after end."""
    moves = speed != 0.0
    divisor = np.where(moves, speed, 1.0)
    with np.errstate(over="ignore"):
        at_low, at_high = low / divisor, high / divisor
    always = (low <= 0.0) & (high >= 0.0)
    start = np.where(moves, np.minimum(at_low, at_high), np.where(always, -np.inf, np.inf))
    return start, np.where(moves, np.maximum(at_low, at_high), -start)


def _overlap_intervals_quadratic(
    low: FloatArray, high: FloatArray, speed: FloatArray, acceleration: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return starts and ends of the two intervals of times t with low <= speed t + acceleration t²/2 <= high.

    The last axis of both results has length 2. The start of an empty interval is after its end.
    """
    down = acceleration < 0.0
    low, high = np.where(down, -high, low), np.where(down, -low, high)
    speed, acceleration = np.where(down, -speed, speed), np.abs(acceleration)
    straight = acceleration == 0.0
    start, end = _overlap_interval_linear(low, high, speed)
    acceleration = np.where(straight, 1.0, acceleration)
    enter, leave, below = _quadratic_roots(acceleration, speed, -high)
    below_from, below_to, goes_below = _quadratic_roots(acceleration, speed, -low)
    firsts = [np.where(below, enter, np.inf), np.where(below & goes_below, below_to, np.inf)]
    lasts = [np.where(below, np.where(goes_below, below_from, leave), -np.inf), np.where(below, leave, -np.inf)]
    return (
        np.stack([np.where(straight, start, firsts[0]), np.where(straight, np.inf, firsts[1])], -1),
        np.stack([np.where(straight, end, lasts[0]), np.where(straight, -np.inf, lasts[1])], -1),
    )


def _quadratic_roots(
    acceleration: FloatArray, speed: FloatArray, offset: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return the sorted roots t of acceleration t²/2 + speed t + offset, and whether the roots are real.

    `acceleration` must be positive.
    """
    discriminant = speed * speed - 2.0 * acceleration * offset
    # This sum has no cancellation, so the smaller root keeps its digits when the acceleration is small.
    q = -(speed + np.copysign(np.sqrt(np.maximum(discriminant, 0.0)), speed))
    with np.errstate(over="ignore"):
        first = q / acceleration
        second = np.where(q == 0.0, first, 2.0 * offset / np.where(q == 0.0, 1.0, q))
    # Motion that turns around exactly at the offset has reached it.
    return np.minimum(first, second), np.maximum(first, second), discriminant >= -1e-14 * speed * speed
