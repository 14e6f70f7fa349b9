"""Compiled decision of the simple driver, which keeps its speed and its distance."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math

from cornercase.drivers._kernels.structs import (
    AHEAD_FOR,
    CENTER_X,
    HALF_LENGTH,
    HALF_WIDTH,
    HEADING,
    SPEED,
    X,
    Y,
    plain_kernel,
)


@plain_kernel
def follow_with_idm(parameters, scene):
    """Return the acceleration in m/s² of the simple driver, and update its memory.

    The driver brakes only for entities straight ahead, by the Intelligent Driver Model.
    """
    v, target_speed, memory, time_step = scene.driven.speed, scene.driven.target_speed, scene.memory, scene.time_step
    if not math.isfinite(target_speed):
        target_speed = v
    max_acceleration, braking = parameters.acceleration, parameters.comfortable_deceleration
    result = min(max((target_speed - v) / time_step, -braking), max_acceleration)
    count = scene.others.shape[1]
    if count == 0:
        return result
    for a in range(count):
        gap, closing = _gap_and_closing_speed(scene, a, parameters.sight_range)
        if not gap < math.inf:
            memory[AHEAD_FOR, a] = 0.0
            continue
        memory[AHEAD_FOR, a] += time_step
        if memory[AHEAD_FOR, a] > parameters.reaction_time:
            dynamic = v * parameters.time_headway + v * closing / (2.0 * math.sqrt(max_acceleration * braking))
            wanted_gap = parameters.min_gap + max(0.0, dynamic)
            speed_ratio_squared = (v / max(target_speed, 0.1)) ** 2
            result = min(
                result,
                max_acceleration
                * (1.0 - speed_ratio_squared * speed_ratio_squared - (wanted_gap / max(gap, 0.1)) ** 2),
            )
    return min(max(result, -parameters.max_deceleration), max_acceleration)


@plain_kernel
def _gap_and_closing_speed(scene, other, sight_range):
    """Return gap in m and closing speed in m/s to another entity; (inf, 0) if it is not in sight straight ahead."""
    own_box, boxes, others, driven, cos, sin = scene.own, scene.boxes, scene.others, scene.driven, scene.cos, scene.sin
    heading = others[HEADING, other]
    if math.isnan(others[X, other]) or math.isnan(heading):
        return math.inf, 0.0
    x = others[X, other] + boxes[CENTER_X, other] * math.cos(heading) - driven.x - own_box[CENTER_X] * cos
    y = others[Y, other] + boxes[CENTER_X, other] * math.sin(heading) - driven.y - own_box[CENTER_X] * sin
    along, lateral = cos * x + sin * y, abs(cos * y - sin * x)
    turn_cos, turn_sin = math.cos(heading - driven.heading), abs(math.sin(heading - driven.heading))
    reach = boxes[HALF_LENGTH, other] * abs(turn_cos) + boxes[HALF_WIDTH, other] * turn_sin
    half = boxes[HALF_LENGTH, other] * turn_sin + boxes[HALF_WIDTH, other] * abs(turn_cos)
    gap = along - reach - own_box[HALF_LENGTH]
    if lateral < half + own_box[HALF_WIDTH] and along > 0.0 and gap < sight_range:
        return gap, driven.speed - others[SPEED, other] * turn_cos
    return math.inf, 0.0
