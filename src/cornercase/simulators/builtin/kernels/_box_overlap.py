"""Overlap of the bounding boxes of two entities in a scenario."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math

from cornercase._common.numba.kernel import kernel
from cornercase.simulators.builtin.kernels._simulation_state import CENTER_X, LENGTH, MAX_EXTENT, WIDTH
from cornercase.simulators.builtin.world._state_layout import HEADING, PRESENT, X, Y

_kernel = kernel(error_model="numpy", _nrt=False)


@kernel(error_model="numpy", _nrt=False, forceinline=True)
def entities_overlap(scene, n, a, b):
    """Return whether the bounding boxes of two entities of a scenario overlap; False if an entity is absent."""
    state, boxes = scene.floats[n], scene.dimensions
    if not (scene.flags[n, PRESENT, a] and scene.flags[n, PRESENT, b]):
        return False
    # Boxes cannot overlap if their reference points are farther apart than this.
    dx, dy, max_distance = (
        state[X, a] - state[X, b],
        state[Y, a] - state[Y, b],
        boxes[a, MAX_EXTENT] + boxes[b, MAX_EXTENT],
    )
    return dx * dx + dy * dy <= max_distance * max_distance and _boxes_overlap(state, boxes, a, b)


@_kernel
def _boxes_overlap(state, boxes, a, b):
    cos_a, sin_a = math.cos(state[HEADING, a]), math.sin(state[HEADING, a])
    cos_b, sin_b = math.cos(state[HEADING, b]), math.sin(state[HEADING, b])
    x_a, y_a = state[X, a] + boxes[a, CENTER_X] * cos_a, state[Y, a] + boxes[a, CENTER_X] * sin_a
    x_b, y_b = state[X, b] + boxes[b, CENTER_X] * cos_b, state[Y, b] + boxes[b, CENTER_X] * sin_b
    size_sum = math.hypot(boxes[a, LENGTH], boxes[a, WIDTH]) + math.hypot(boxes[b, LENGTH], boxes[b, WIDTH])
    if not math.hypot(x_a - x_b, y_a - y_b) <= 0.5 * size_sum:
        return False
    box_a = (x_a, y_a, cos_a, sin_a, 0.5 * boxes[a, LENGTH], 0.5 * boxes[a, WIDTH])
    box_b = (x_b, y_b, cos_b, sin_b, 0.5 * boxes[b, LENGTH], 0.5 * boxes[b, WIDTH])
    return not (_is_separated_along(box_a, box_b) or _is_separated_along(box_b, box_a))


@_kernel
def _is_separated_along(box, other):
    """Return whether the direction of an edge of the first box separates the two boxes (separating axis theorem)."""
    for side in range(2):
        # Corners in order: front right, front left, rear left, rear right.
        begin, end = _corner(box, side), _corner(box, side + 1)
        axis_x, axis_y = end[0] - begin[0], end[1] - begin[1]
        low, high = _project_box(box, axis_x, axis_y)
        other_low, other_high = _project_box(other, axis_x, axis_y)
        if not (high >= other_low and other_high >= low):
            return True
    return False


@_kernel
def _project_box(box, axis_x, axis_y):
    low, high = math.inf, -math.inf
    for k in range(4):
        x, y = _corner(box, k)
        along = x * axis_x + y * axis_y
        low, high = min(low, along), max(high, along)
    return low, high


@_kernel
def _corner(box, k):
    x, y, cos, sin, half_length, half_width = box
    along = half_length if k < 2 else -half_length
    across = half_width if k == 1 or k == 2 else -half_width
    return x + cos * along - sin * across, y + sin * along + cos * across
