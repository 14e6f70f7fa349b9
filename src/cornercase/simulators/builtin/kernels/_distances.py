"""Distances and closing speeds between entities of one scenario."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from typing import Final

from cornercase._common.numba.kernel import kernel
from cornercase.simulators.builtin.kernels._simulation_state import CENTER_X, LENGTH, WIDTH
from cornercase.simulators.builtin.world._state_layout import GONE_X, GONE_Y, HEADING, SPEED, X, Y

MAGNITUDE, LONGITUDINAL_COMPONENT, LATERAL_COMPONENT, VERTICAL_COMPONENT = range(4)
"""Component of a velocity or an acceleration."""

EUCLIDEAN_DISTANCE, LONGITUDINAL_DISTANCE, LATERAL_DISTANCE = range(3)
"""Kind of distance, along the axes of the entity; add `FREE_SPACE` for the distance between bounding boxes."""
FREE_SPACE: Final = 3

TOLERANCE: Final = 1e-6
"""Tolerance of comparisons, in the unit of the values."""

_kernel = kernel(error_model="numpy", _nrt=False)


@_kernel
def vector_component(state, x_row, y_row, e, axes_entity, option):
    """Return a component of a vector of entity `e`, along the axes of the entity `axes_entity`.

    `x_row` and `y_row` are the rows of `state` that hold the vector. `option` is `LONGITUDINAL_COMPONENT`,
    `LATERAL_COMPONENT` or `VERTICAL_COMPONENT`.
    """
    cos, sin = math.cos(state[HEADING, axes_entity]), math.sin(state[HEADING, axes_entity])
    if option == LONGITUDINAL_COMPONENT:
        return state[x_row, e] * cos + state[y_row, e] * sin
    return state[y_row, e] * cos - state[x_row, e] * sin if option == LATERAL_COMPONENT else 0.0


@_kernel
def closing_speed(state, e, other):
    """Return the speed in m/s at which `e` approaches another entity, along that entity's direction of motion.

    If the other entity stands, the result is the speed of `e`.
    """
    x, y = state[GONE_X, other], state[GONE_Y, other]
    if abs(x) < TOLERANCE and abs(y) < TOLERANCE:
        return state[SPEED, e]
    own_speed = (state[GONE_X, e] * x + state[GONE_Y, e] * y) / math.hypot(x, y)
    is_backwards = (state[SPEED, e] < 0.0) != (own_speed < 0.0)
    return (own_speed - abs(state[SPEED, other])) * (-1.0 if is_backwards else 1.0)


@_kernel
def distance_to_entity(scene, n, e, other, distance_kind):
    """Return the signed distance in m from entity `e` to another entity.

    The distance is negative if the other entity is behind, or to the right for a lateral distance. All kinds of
    distances are supported except the Euclidean distance between boxes.
    """
    state = scene.floats[n]
    cos, sin = math.cos(state[HEADING, e]), math.sin(state[HEADING, e])
    dx, dy = state[X, other] - state[X, e], state[Y, other] - state[Y, e]
    if distance_kind == EUCLIDEAN_DISTANCE:
        return math.hypot(dx, dy) if dx * cos + dy * sin > 0.0 else -math.hypot(dx, dy)
    if distance_kind == LONGITUDINAL_DISTANCE:
        return dx * cos + dy * sin
    if distance_kind == LATERAL_DISTANCE:
        return dy * cos - dx * sin
    nearest, farthest = _box_range_seen_from(scene, n, e, other, distance_kind == LATERAL_DISTANCE + FREE_SPACE)
    half = 0.5 * scene.dimensions[e, WIDTH if distance_kind == LATERAL_DISTANCE + FREE_SPACE else LENGTH]
    if nearest > half:
        return nearest - half
    return farthest + half if farthest < -half else 0.0


@_kernel
def _box_range_seen_from(scene, n, e, other, is_lateral):
    """Return the smallest and largest coordinate of the box of another entity, in m from the centre of the box of `e`.

    The coordinate is positive to the left of `e` if `is_lateral`, otherwise positive ahead.
    """
    state, boxes = scene.floats[n], scene.dimensions
    cos, sin = math.cos(state[HEADING, e]), math.sin(state[HEADING, e])
    turned_cos, turned_sin = math.cos(state[HEADING, other]), math.sin(state[HEADING, other])
    x, y = state[X, other] + boxes[other, CENTER_X] * turned_cos, state[Y, other] + boxes[other, CENTER_X] * turned_sin
    own_x, own_y = state[X, e] + boxes[e, CENTER_X] * cos, state[Y, e] + boxes[e, CENTER_X] * sin
    nearest, farthest = math.inf, -math.inf
    for k in range(4):
        along = 0.5 * boxes[other, LENGTH] * (1.0 if k < 2 else -1.0)
        aside = 0.5 * boxes[other, WIDTH] * (1.0 if k == 1 or k == 2 else -1.0)
        dx = x + turned_cos * along - turned_sin * aside - own_x
        dy = y + turned_sin * along + turned_cos * aside - own_y
        coordinate = dy * cos - dx * sin if is_lateral else dx * cos + dy * sin
        nearest, farthest = min(nearest, coordinate), max(farthest, coordinate)
    return nearest, farthest


@_kernel
def distance_to_point(scene, n, e, x, y, distance_kind):
    """Return the signed distance in m from entity `e` to a point.

    The distance is negative if the point is behind, or to the right for a lateral distance.
    """
    state, dimensions, is_free_space = scene.floats[n], scene.dimensions[e], distance_kind >= FREE_SPACE
    dx, dy = x - state[X, e], y - state[Y, e]
    cos, sin = math.cos(state[HEADING, e]), math.sin(state[HEADING, e])
    along, across = dx * cos + dy * sin, dy * cos - dx * sin
    if distance_kind == EUCLIDEAN_DISTANCE:
        return math.hypot(dx, dy) if along > 0.0 else -math.hypot(dx, dy)
    if distance_kind == EUCLIDEAN_DISTANCE + FREE_SPACE:
        along -= dimensions[CENTER_X]
        excess = max(abs(along) - 0.5 * dimensions[LENGTH], 0.0)
        distance = math.hypot(excess, max(abs(across) - 0.5 * dimensions[WIDTH], 0.0))
        return -distance if along < -0.5 * dimensions[LENGTH] else distance
    if distance_kind == LATERAL_DISTANCE or distance_kind == LATERAL_DISTANCE + FREE_SPACE:
        distance = max(abs(across) - (0.5 * dimensions[WIDTH] if is_free_space else 0.0), 0.0)
        return math.copysign(distance, across)
    if not is_free_space:
        return along
    front, rear = 0.5 * dimensions[LENGTH] + dimensions[CENTER_X], 0.5 * dimensions[LENGTH] - dimensions[CENTER_X]
    return max(along - front, 0.0) if along > 0.0 else min(along + rear, 0.0)
