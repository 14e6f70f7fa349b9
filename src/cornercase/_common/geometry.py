"""Angles and oriented boxes in the plane, vectorised over any leading axes."""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt

from cornercase._common.typing import BoolArray, FloatArray

_CONTACT = 1e-9
"""Gap in m at which moving boxes count as touching, so that rounding does not undo a grazing contact."""

_STEADY = 1e-12
"""Acceleration in m/s² that is rounding: it takes two weeks for a metre."""

ACROSS = 1e-7
"""Cosine of an angle that rounding does not tell from a quarter turn."""

_SIGNS_ALONG = np.array([1.0, 1.0, -1.0, -1.0])
_SIGNS_ACROSS = np.array([-1.0, 1.0, 1.0, -1.0])


def within_half_turn(angle: npt.ArrayLike) -> FloatArray:
    """Angles as they are between directions: whole turns apart, and from -π up to π.

    Parameters
    ----------
    angle : array_like of float, shape (...)
        rad.

    Returns
    -------
    ndarray of float64, shape (...)
        rad.
    """
    return np.asarray((np.asarray(angle, dtype=np.float64) + np.pi) % (2 * np.pi) - np.pi)


def looks_ahead(angle: npt.ArrayLike) -> BoolArray:
    """Whether who is turned by an angle still looks ahead rather than back; straight across counts as ahead.

    Parameters
    ----------
    angle : array_like of float, shape (...)
        rad.

    Returns
    -------
    ndarray of bool, shape (...)
    """
    return np.asarray(np.cos(angle) > -ACROSS)


def box_corners(
    x: npt.ArrayLike,
    y: npt.ArrayLike,
    heading: npt.ArrayLike,
    length: npt.ArrayLike,
    width: npt.ArrayLike,
) -> FloatArray:
    """Corners of boxes, counter-clockwise from the front right.

    Parameters
    ----------
    x, y : array_like of float, shape (...)
        Box centres in m.
    heading : array_like of float, shape (...)
        Direction of the boxes' length in rad, counter-clockwise from +x.
    length, width : array_like of float, shape (...)
        Full sizes in m.

    Returns
    -------
    ndarray of float64, shape (..., 4, 2)
    """
    x, y, heading, length, width = np.broadcast_arrays(*map(np.asarray, (x, y, heading, length, width)))
    along = 0.5 * length[..., None] * _SIGNS_ALONG
    across = 0.5 * width[..., None] * _SIGNS_ACROSS
    cos, sin = np.cos(heading)[..., None], np.sin(heading)[..., None]
    corners = np.stack([x[..., None] + cos * along - sin * across, y[..., None] + sin * along + cos * across], -1)
    return np.asarray(corners, dtype=np.float64)


def boxes_overlap(a: FloatArray, b: FloatArray) -> BoolArray:
    """Whether boxes share a point (separating axes).

    Parameters
    ----------
    a, b : ndarray of float64, shape (..., 4, 2)
        Corners as in `box_corners`; leading axes broadcast. A box with a NaN corner overlaps nothing.

    Returns
    -------
    ndarray of bool, shape (...)
    """
    overlap = np.ones(np.broadcast_shapes(a.shape[:-2], b.shape[:-2]), dtype=np.bool_)
    for box in (a, b):
        for first, second in ((0, 1), (1, 2)):
            axis = box[..., second, :] - box[..., first, :]
            on_a = np.einsum("...ck,...k->...c", a, axis)
            on_b = np.einsum("...ck,...k->...c", b, axis)
            overlap &= (on_a.max(-1) >= on_b.min(-1)) & (on_b.max(-1) >= on_a.min(-1))
    return overlap


def box_distance(a: FloatArray, b: FloatArray) -> FloatArray:
    """Gap between boxes, 0 where they overlap.

    Two convex shapes apart are nearest at a corner of one of them, so the gap is the smallest distance of a
    corner to the other box.

    Parameters
    ----------
    a, b : ndarray of float64, shape (..., 4, 2)
        Corners as in `box_corners`; leading axes broadcast.

    Returns
    -------
    ndarray of float64, shape (...)
        m; NaN where a corner is NaN.
    """
    of_a, of_b = box_axes(a), box_axes(b)
    nearest = np.minimum(_corner_distance(a, b, of_b), _corner_distance(b, a, of_a))
    return np.where(separation(a, of_a, b, of_b) <= 0.0, 0.0, nearest)


def _corner_distance(a: FloatArray, b: FloatArray, axes: FloatArray) -> FloatArray:
    on_b = project(axes, b)
    beyond = np.abs(project(axes, a) - _middle(on_b)[..., None]) - 0.5 * np.ptp(on_b, -1)[..., None]
    outside = np.maximum(beyond, 0.0)
    distance: FloatArray = np.hypot(outside[..., 0, :], outside[..., 1, :]).min(-1)
    return distance


def _middle(values: FloatArray) -> FloatArray:
    middle: FloatArray = 0.5 * (values.max(-1) + values.min(-1))
    return middle


def box_axes(box: FloatArray) -> FloatArray:
    """Directions along and across boxes.

    Parameters
    ----------
    box : ndarray of float64, shape (..., 4, 2)
        Corners as in `box_corners`. Boxes without width or length keep both directions, points get +x and +y.

    Returns
    -------
    ndarray of float64, shape (..., 2, 2)
        Axes, then coordinates.
    """
    across, along = box[..., 1, :] - box[..., 0, :], box[..., 1, :] - box[..., 2, :]
    turned = np.stack([across[..., 1], -across[..., 0]], -1)
    longer = np.linalg.norm(along, axis=-1) >= np.linalg.norm(across, axis=-1)
    first = _unit(np.where(longer[..., None], along, turned))
    return np.stack([first, np.stack([-first[..., 1], first[..., 0]], -1)], -2)


def _unit(vectors: FloatArray) -> FloatArray:
    norm = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(norm > 0.0, vectors / np.where(norm > 0.0, norm, 1.0), np.array([1.0, 0.0]) + 0.0 * norm)


def project(axes: FloatArray, points: FloatArray) -> FloatArray:
    """Coordinates of points along directions.

    Parameters
    ----------
    axes : ndarray of float64, shape (..., n, 2)
    points : ndarray of float64, shape (..., m, 2)

    Returns
    -------
    ndarray of float64, shape (..., n, m)
    """
    projected: FloatArray = (axes[..., :, None, :] * points[..., None, :, :]).sum(-1)
    return projected


def separation(a: FloatArray, axes_of_a: FloatArray, b: FloatArray, axes_of_b: FloatArray) -> FloatArray:
    """Widest gap between two convex shapes along any of their axes (separating axes).

    Parameters
    ----------
    a, b : ndarray of float64, shape (..., n, 2) and (..., m, 2)
        Corners; leading axes broadcast.
    axes_of_a, axes_of_b : ndarray of float64, shape (..., k, 2) and (..., l, 2)
        Unit vectors square to the shapes' edges.

    Returns
    -------
    ndarray of float64, shape (...)
        m; above 0 where the shapes are apart, then a lower bound of their distance; NaN where a corner is
        NaN.
    """
    return np.maximum(_widest_gap(axes_of_a, a, b), _widest_gap(axes_of_b, a, b))


def _widest_gap(axes: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    low, high = _free_shift(axes, a, b)
    gap: FloatArray = np.maximum(low, -high).max(-1)
    return gap


def _free_shift(axes: FloatArray, a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Range of shifts of `b` along each axis under which the two projections share a point."""
    low_a, high_a = _range(axes, a)
    low_b, high_b = _range(axes, b)
    return low_a - high_b, high_a - low_b


def _range(axes: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least and greatest coordinate of the points along each axis."""
    x, y = np.ascontiguousarray(axes[..., 0]), np.ascontiguousarray(axes[..., 1])
    # One point after the other: reducing over a last axis of four takes several times as long.
    low = high = x * points[..., 0, None, 0] + y * points[..., 0, None, 1]
    for i in range(1, points.shape[-2]):
        on_axis = x * points[..., i, None, 0] + y * points[..., i, None, 1]
        low, high = np.minimum(low, on_axis), np.maximum(high, on_axis)
    return low, high


def first_contact(
    a: FloatArray,
    b: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray | None = None,
    horizon: npt.ArrayLike = np.inf,
) -> FloatArray:
    """When a box that moves without turning first shares a point with a box at rest, exactly.

    Along each separating axis the projections overlap while low <= v t + a t²/2 <= high, which holds in at
    most two intervals of time; the boxes touch when one interval of every axis is open.

    Parameters
    ----------
    a, b : ndarray of float64, shape (..., 4, 2)
        Corners at time 0 as in `box_corners`; leading axes broadcast.
    velocity : ndarray of float64, shape (..., 2)
        Of `b` relative to `a` at time 0, in m/s.
    acceleration : ndarray of float64, shape (..., 2), optional
        Of `b` relative to `a`, in m/s²; none by default.
    horizon : array_like of float, shape (...), optional
        Last time of interest in s.

    Returns
    -------
    ndarray of float64, shape (...)
        s; 0 where they touch now, inf where never up to the horizon, NaN where an input is.
    """
    axes = np.concatenate(np.broadcast_arrays(box_axes(a), box_axes(b)), -2)
    low, high = _free_shift(axes, a, b)
    speed = project(axes, velocity[..., None, :])[..., 0]
    low, high, speed = np.broadcast_arrays(low, high, speed)
    if acceleration is None or not np.any(acceleration):
        exact, _ = _open_linear(low, high, speed)
        starts, ends = _open_linear(low - _CONTACT, high + _CONTACT, speed)
        exact, starts, ends = exact[..., None], starts[..., None], ends[..., None]
    else:
        gain = np.broadcast_to(project(axes, acceleration[..., None, :])[..., 0], low.shape)
        gain = np.where(np.abs(gain) <= _STEADY, 0.0, gain)
        exact, _ = _open_quadratic(low, high, speed, gain)
        starts, ends = _open_quadratic(low - _CONTACT, high + _CONTACT, speed, gain)
    # The tolerance only decides whether there is a contact, not when: where there is an exact time, that one is taken.
    # Along an axis without motion both times are infinite.
    with np.errstate(invalid="ignore"):
        starts = np.where((exact >= starts) & (exact - starts <= 1e-3), exact, starts)
    horizon = np.asarray(horizon, dtype=np.float64)
    first = np.full(np.broadcast_shapes(low.shape[:-1], horizon.shape), np.inf)
    for choice in itertools.product(range(starts.shape[-1]), repeat=4):
        picked = (..., np.arange(4), np.array(choice))
        begin = np.maximum(starts[picked].max(-1), 0.0)
        meets = begin <= np.minimum(ends[picked].min(-1), horizon)
        first = np.where(meets & (begin < first), begin, first)
    unknown: BoolArray = np.isnan(low).any(-1) | np.isnan(speed).any(-1) | np.isnan(horizon)
    if acceleration is not None:
        unknown = unknown | np.isnan(acceleration).any(-1)
    return np.where(unknown, np.nan, first)


def _open_linear(low: FloatArray, high: FloatArray, speed: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Interval of time in which low <= speed t <= high; where there is none it begins after it ends."""
    moves = speed != 0.0
    divisor = np.where(moves, speed, 1.0)
    with np.errstate(over="ignore"):
        at_low, at_high = low / divisor, high / divisor
    always = (low <= 0.0) & (high >= 0.0)
    start = np.where(moves, np.minimum(at_low, at_high), np.where(always, -np.inf, np.inf))
    return start, np.where(moves, np.maximum(at_low, at_high), -start)


def _open_quadratic(
    low: FloatArray, high: FloatArray, speed: FloatArray, gain: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Both intervals of time, on a new last axis, in which low <= speed t + gain t²/2 <= high."""
    down = gain < 0.0
    low, high = np.where(down, -high, low), np.where(down, -low, high)
    speed, gain = np.where(down, -speed, speed), np.abs(gain)
    straight = gain == 0.0
    start, end = _open_linear(low, high, speed)
    gain = np.where(straight, 1.0, gain)
    enter, leave, below = _roots(gain, speed, -high)
    dip_from, dip_to, dips = _roots(gain, speed, -low)
    firsts = [np.where(below, enter, np.inf), np.where(below & dips, dip_to, np.inf)]
    lasts = [np.where(below, np.where(dips, dip_from, leave), -np.inf), np.where(below, leave, -np.inf)]
    return (
        np.stack([np.where(straight, start, firsts[0]), np.where(straight, np.inf, firsts[1])], -1),
        np.stack([np.where(straight, end, lasts[0]), np.where(straight, -np.inf, lasts[1])], -1),
    )


def _roots(gain: FloatArray, speed: FloatArray, offset: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Ordered roots of gain t²/2 + speed t + offset for gain > 0, and whether there are any."""
    discriminant = speed * speed - 2.0 * gain * offset
    # The sum has no cancellation, so the smaller root keeps its digits when the acceleration is small.
    q = -(speed + np.copysign(np.sqrt(np.maximum(discriminant, 0.0)), speed))
    with np.errstate(over="ignore"):
        one = q / gain
        two = np.where(q == 0.0, one, 2.0 * offset / np.where(q == 0.0, 1.0, q))
    # Motion that turns back exactly at a place has reached it.
    return np.minimum(one, two), np.maximum(one, two), discriminant >= -1e-14 * speed * speed
