"""Compiled perception of a driver: entities in sight, and memory of entities out of sight."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, no-untyped-call, untyped-decorator"

from __future__ import annotations

import math

import numpy as np

from cornercase._common.numba.kernel import kernel
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.drivers._kernels.structs import (
    CENTER_X,
    FIRST_SEEN,
    HALF_LENGTH,
    HALF_WIDTH,
    HEADING,
    KNOWN,
    LAST_SEEN,
    NOTICED,
    SPEED,
    TURN,
    X,
    Y,
    inline_kernel,
    plain_kernel,
)

EYE_AHEAD = 0.25
"""Position of the eye ahead of the box's centre, as a fraction of the box's length."""

# Time constant in s of the perceived turn rate.
TURN_RATE_TIME_CONSTANT = 0.2

# Comparisons with a smaller relative difference are repeated exactly.
_TOLERANCE = 1e-9


def find_visible_others(
    pose: FloatArray,
    box: FloatArray,
    others: FloatArray,
    boxes: FloatArray,
    *,
    field_of_view: float | FloatArray = 2.0 * math.pi,
    sight_range: float | FloatArray = math.inf,
) -> BoolArray:
    """Return which of A other entities a driver sees in each of N scenarios; ndarray of bool, shape (N, A).

    The eye is ahead of the centre of the driver's box, by a quarter of the box's length. An entity is seen if at least
    one of five points of its box (centre and corners) is in range and in the field of view, and no third box blocks the
    line of sight. Boxes have no height, so every entity hides what is behind it.

    `pose` (N, 3): x and y in m and heading in rad of the driver's reference point. `box` (3,): length, width and centre
    of its box in m. `others` (N, 3, A): x, y and heading, NaN if an entity does not exist. `boxes` (3, A): the others'
    boxes, like `box`. `field_of_view` in rad and `sight_range` in m are numbers or of shape (N,).
    """
    half = np.array([0.5, 0.5, 1.0])
    # Contiguous arrays, so that the kernel is compiled only once.
    arrays = np.ascontiguousarray(pose), np.ascontiguousarray(others)
    limits = (np.full(len(pose), limit, dtype=np.float64) for limit in (field_of_view, sight_range))
    seen: BoolArray = _find_visible_in_scenes(*limits, half * box, half[:, None] * boxes, *arrays)
    return seen


@kernel(error_model="numpy")
def _find_visible_in_scenes(field_of_view, sight_range, own, boxes, pose, others):
    scenarios, count = len(pose), others.shape[2]
    seen, placed_boxes = np.empty((scenarios, count), dtype=np.bool_), np.full((count, 5), np.nan)
    for n in range(scenarios):
        eye = eye_pose(own, pose[n, 0], pose[n, 1], math.cos(pose[n, 2]), math.sin(pose[n, 2]))
        update_visible_others(field_of_view[n], sight_range[n], eye, boxes, others[n], placed_boxes, seen[n])
    return seen


@inline_kernel
def eye_pose(own, x, y, cos, sin):
    """Return position and direction (x, y, cosine, sine) of a driver's eye; `own` is its box as in `Fleet`."""
    offset = own[CENTER_X] + EYE_AHEAD * (2.0 * own[HALF_LENGTH])
    return x + offset * cos, y + offset * sin, cos, sin


@inline_kernel
def update_visible_others(field_of_view, sight_range, eye, boxes, others, placed_boxes, seen):
    """Update `seen` (A,), True for each of A other entities that a driver sees in one scenario, and `placed_boxes`.

    `eye` comes from `eye_pose`. `boxes` and `others` are as in `DriverScene`. `placed_boxes` (A, 5) has the boxes of
    the others as in `Workspace.boxes`; the x of a box out of range is NaN. Fill the array with NaN before the first
    step, and then pass it in each step, since it keeps what was computed for unchanged headings.
    """
    eye_x, eye_y, cos, sin = eye
    count = others.shape[1]
    for a in range(count):
        reach = sight_range + abs(boxes[CENTER_X, a]) + boxes[HALF_LENGTH, a] + boxes[HALF_WIDTH, a]
        away_x, away_y = others[X, a] - eye_x, others[Y, a] - eye_y
        if away_x * away_x + away_y * away_y <= reach * reach * (1.0 + _TOLERANCE):
            # Most keep their heading.
            if others[HEADING, a] != placed_boxes[a, 4]:
                placed_boxes[a, 4] = others[HEADING, a]
                placed_boxes[a, 2], placed_boxes[a, 3] = math.cos(others[HEADING, a]), math.sin(others[HEADING, a])
            placed_boxes[a, 0] = others[X, a] + boxes[CENTER_X, a] * placed_boxes[a, 2]
            placed_boxes[a, 1] = others[Y, a] + boxes[CENTER_X, a] * placed_boxes[a, 3]
        else:
            # A box out of range is not seen, and hides nothing within range.
            placed_boxes[a, 0] = math.nan
    half_view = 0.5 * field_of_view
    edge = math.cos(half_view) if half_view < math.pi else -2.0
    for a in range(count):
        seen[a] = False
        if math.isnan(placed_boxes[a, 0]):
            continue
        for point in range(5):
            longitudinal, lateral = 0.0, 0.0
            if point < 4:
                longitudinal = boxes[HALF_LENGTH, a] * (1.0 if point < 2 else -1.0)
                lateral = boxes[HALF_WIDTH, a] * (1.0 if point % 2 == 0 else -1.0)
            to_x = placed_boxes[a, 0] + longitudinal * placed_boxes[a, 2] - lateral * placed_boxes[a, 3] - eye_x
            to_y = placed_boxes[a, 1] + longitudinal * placed_boxes[a, 3] + lateral * placed_boxes[a, 2] - eye_y
            if not _is_in_view(
                cos * to_x + sin * to_y, cos * to_y - sin * to_x, to_x, to_y, sight_range, half_view, edge
            ):
                continue
            hidden = False
            for b in range(count):
                if b != a and _ray_hits_box(
                    eye_x, eye_y, to_x, to_y, placed_boxes, b, boxes[HALF_LENGTH, b], boxes[HALF_WIDTH, b]
                ):
                    hidden = True
                    break
            if not hidden:
                seen[a] = True
                break


@inline_kernel
def _is_in_view(along, across, to_x, to_y, sight_range, half_view, edge):
    """Check whether a point is in range and in the field of view; square root and angle only in borderline cases."""
    squared = to_x * to_x + to_y * to_y
    if squared > sight_range * sight_range * (1.0 + _TOLERANCE):
        return False
    if squared > sight_range * sight_range * (1.0 - _TOLERANCE) and math.hypot(to_x, to_y) > sight_range:
        return False
    away = math.sqrt(squared)
    inner = along - away * edge
    if abs(inner) > _TOLERANCE * away:
        return inner > 0.0
    return abs(math.atan2(across, along)) <= half_view


@plain_kernel
def _ray_hits_box(eye_x, eye_y, to_x, to_y, placed_boxes, box, half_length, half_width):
    """Check whether the line of sight from the eye hits a box (slab method).

    A box that contains the eye hides nothing.
    """
    if math.isnan(placed_boxes[box, 0]):
        return False
    from_x, from_y = eye_x - placed_boxes[box, 0], eye_y - placed_boxes[box, 1]
    enters, leaves = 0.0, 1.0
    inside = True
    for axis in range(2):
        if axis == 0:
            start, step, half = (
                from_x * placed_boxes[box, 2] + from_y * placed_boxes[box, 3],
                to_x * placed_boxes[box, 2] + to_y * placed_boxes[box, 3],
                half_length,
            )
        else:
            start, step, half = (
                from_y * placed_boxes[box, 2] - from_x * placed_boxes[box, 3],
                to_y * placed_boxes[box, 2] - to_x * placed_boxes[box, 3],
                half_width,
            )
        # Nearly all boxes are on one side of the line.
        if min(start, start + step) > half + _TOLERANCE or max(start, start + step) < -half - _TOLERANCE:
            return False
        if step == 0.0 and abs(start) > half:
            return False
        inside = inside and abs(start) <= half
        if step != 0.0:
            first, last = (-half - start) / step, (half - start) / step
            enters, leaves = max(enters, min(first, last)), min(leaves, max(first, last))
    return enters < leaves and not inside


@inline_kernel
def update_perception(behaviour, scene, seen):
    """Update the memory and the awareness of a driver in one scenario, from the entities in sight.

    The driver knows an entity once it has seen the entity for the reaction time. The driver assumes that an entity out
    of sight goes straight on at its last speed, and forgets the entity after the memory time. If the entity comes into
    sight again before that, the reaction time does not start again.
    """
    time, time_step, others, memory, awareness = (
        scene.time, scene.time_step, scene.others, scene.memory, scene.awareness,
    )  # fmt: skip
    # The tolerance absorbs rounding errors in the sums of time steps.
    memorable = behaviour.memory + 1e-9
    for a in range(others.shape[1]):
        if seen[a]:
            if not time - memory[LAST_SEEN, a] <= memorable:
                memory[FIRST_SEEN, a] = time
                memory[TURN, a] = 0.0
            else:
                since = max(time - memory[LAST_SEEN, a], time_step)
                change = others[HEADING, a] - memory[HEADING, a] + math.pi
                # Skip the slow remainder if it changes nothing.
                if not 0.0 <= change < 2.0 * math.pi:
                    change %= 2.0 * math.pi
                change -= math.pi
                memory[TURN, a] += (change / since - memory[TURN, a]) * min(since / TURN_RATE_TIME_CONSTANT, 1.0)
            memory[LAST_SEEN, a] = time
            memory[X, a], memory[Y, a] = others[X, a], others[Y, a]
            memory[HEADING, a], memory[SPEED, a] = others[HEADING, a], others[SPEED, a]
        elif time - memory[LAST_SEEN, a] <= memorable:
            step = memory[SPEED, a] * time_step
            memory[X, a] += step * math.cos(memory[HEADING, a])
            memory[Y, a] += step * math.sin(memory[HEADING, a])
        noticed = time - memory[LAST_SEEN, a] <= memorable and not math.isnan(others[X, a])
        awareness[NOTICED, a] = noticed
        awareness[KNOWN, a] = noticed and memory[LAST_SEEN, a] - memory[FIRST_SEEN, a] >= behaviour.reaction_time - 1e-9
