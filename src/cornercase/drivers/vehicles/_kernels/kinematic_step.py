"""Compiled step of the kinematic single-track model."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, no-untyped-call, untyped-decorator, call-arg"

from __future__ import annotations

import math
from typing import Final

from cornercase.drivers.vehicles._kernels.actuators import (
    ACCELERATION,
    DELAY,
    GRAVITY,
    LAG,
    MAX_JERK,
    MAX_SPEED,
    MAX_STEERING,
    MAX_STEERING_RATE,
    MU,
    STEERING,
    STEERING_DELAY,
    STEERING_LAG,
    WHEELBASE,
    advance_actuator,
    begin_step,
    end_step,
    longitudinal_grip,
    plain_kernel,
    speed_after,
)

X, Y, HEADING, SPEED, LAST_ACCELERATION = range(5)
"""Columns of the motion of a vehicle."""

# s; the longest part of a step in which speed and curvature count as linear.
_PART: Final = 0.01
# Share of the grip that lateral acceleration may use if the rest of the grip is to hardly change in a step.
_MAX_SHARE: Final = 0.5


@plain_kernel
def move_kinematic_vehicle(vehicles, n, motion, acceleration, steering, friction, time_step):
    """Move a vehicle without tyre slip by one time step, and return its speed.

    `motion` (x, y, heading, speed, acceleration) is changed in place.
    """
    begin_step(vehicles, n, motion[SPEED], motion[LAST_ACCELERATION], acceleration, steering)
    grip = vehicles.parameters[n, MU] * friction * GRAVITY
    # A circle without slip needs no parts.
    parts = (
        1 if _is_exact_circle(vehicles.parameters[n], motion[SPEED], steering, grip) else math.ceil(time_step / _PART)
    )
    for part in range(parts):
        move_without_slip(vehicles, n, motion, grip, part * time_step / parts, time_step / parts, time_step)
    motion[LAST_ACCELERATION] = end_step(vehicles, n, motion[SPEED])
    return motion[SPEED]


@plain_kernel
def _is_exact_circle(parameters, speed, steering, grip):
    """Return whether a vehicle moves exactly along a circle in this step.

    This holds without delays, lags and rate limits, if the tyres are far from their friction limit.
    """
    is_late = max(parameters[DELAY], parameters[LAG], parameters[STEERING_DELAY], parameters[STEERING_LAG]) > 0.0
    is_slow = min(parameters[MAX_JERK], parameters[MAX_STEERING_RATE]) < math.inf
    lateral = speed * speed * math.tan(min(abs(steering), parameters[MAX_STEERING])) / parameters[WHEELBASE]
    return not (is_late or is_slow) and lateral < _MAX_SHARE * grip


@plain_kernel
def move_without_slip(vehicles, n, motion, grip, begin, duration, time_step):
    """Move a vehicle without tyre slip by a part of a time step; `grip` is its highest acceleration in m/s²."""
    parameters, state = vehicles.parameters[n], vehicles.state[n]
    wheelbase = parameters[WHEELBASE]
    speed = motion[SPEED]
    lateral = speed * speed * math.tan(state[STEERING]) / wheelbase
    limit = longitudinal_grip(vehicles, n, grip, lateral, time_step)
    gain = advance_actuator(vehicles, n, ACCELERATION, limit, begin, duration, time_step)
    steering = advance_actuator(vehicles, n, STEERING, parameters[MAX_STEERING], begin, duration, time_step) / duration
    motion[SPEED], moving = speed_after(speed, gain, parameters[MAX_SPEED])
    mean = 0.5 * (speed + motion[SPEED])
    curvature = math.tan(steering) / wheelbase
    # The front wheels slide if the curve asks for more than the tyres can do next to the acceleration.
    lateral_grip = math.sqrt(max(grip * grip - (gain / duration) ** 2, 0.0))
    if mean * mean * abs(curvature) > lateral_grip:
        curvature = math.copysign(lateral_grip / (mean * mean), curvature)
    length = mean * moving * duration
    turn = curvature * length
    chord = length if turn == 0.0 else length * math.sin(0.5 * turn) / (0.5 * turn)
    motion[X] += chord * math.cos(motion[HEADING] + 0.5 * turn)
    motion[Y] += chord * math.sin(motion[HEADING] + 0.5 * turn)
    motion[HEADING] += turn
