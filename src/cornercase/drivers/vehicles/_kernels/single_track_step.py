"""Compiled step of the dynamic single-track model."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, no-untyped-call, untyped-decorator, call-arg"

from __future__ import annotations

import math
from typing import Final

from cornercase.drivers.vehicles._kernels.actuators import (
    ACCELERATION,
    GRAVITY,
    MAX_SPEED,
    MAX_STEERING,
    MU,
    SLIP,
    STEERING,
    VELOCITY,
    WHEELBASE,
    YAW_RATE,
    advance_actuator,
    begin_step,
    end_step,
    longitudinal_grip,
    plain_kernel,
    speed_after,
)
from cornercase.drivers.vehicles._kernels.kinematic_step import (
    HEADING,
    LAST_ACCELERATION,
    SPEED,
    X,
    Y,
    move_without_slip,
)

MASS, INERTIA, FRONT_AXLE, REAR_AXLE, FRONT_STIFFNESS, REAR_STIFFNESS, HEIGHT = range(WHEELBASE + 1, WHEELBASE + 8)
"""Columns of `Vehicles.parameters`."""

# m/s; a slower vehicle rolls without slip, as in CommonRoad's model.
_ROLLING_SPEED: Final = 0.1
# s; the longest part of a step in which the inputs count as constant, and the same while the wheels hardly turn.
_PART: Final = 0.025
_STEADY_PART: Final = 0.05
# rad; change of the angle of the wheels in a step up to which they hardly turn.
_SMALL_TURN: Final = 5e-3
_SHORTEST_PART: Final = 1e-5
# Slip decays at most by e to this power in a part: the error of the Runge-Kutta method is then 2 % of the slip (5 % at
# 1.5).
_MAX_DECAY: Final = 1.25
# Share of a step that rounding may leave.
_ROUNDING: Final = 1e-9


@plain_kernel
def move_single_track_vehicle(vehicles, n, motion, acceleration, steering, friction, time_step):
    """Move a vehicle whose tyres slip by one time step, and return its speed.

    `motion` (x, y, heading, speed, acceleration) is changed in place.
    """
    parameters, state, begin = vehicles.parameters[n], vehicles.state[n], 0.0
    begin_step(vehicles, n, motion[SPEED], motion[LAST_ACCELERATION], acceleration, steering)
    grip = parameters[MU] * friction * GRAVITY
    # How fast slip decays at 1 m/s, in 1/s.
    stiffness = max(parameters[FRONT_STIFFNESS], parameters[REAR_STIFFNESS])
    leverage = parameters[MASS] * parameters[FRONT_AXLE] * parameters[REAR_AXLE] / parameters[INERTIA]
    rate = grip * stiffness * max(leverage, 1.0)
    longest = _STEADY_PART if abs(steering - state[STEERING]) < _SMALL_TURN else _PART
    is_centered = False
    while begin < (1.0 - _ROUNDING) * time_step:
        duration = min(longest, time_step - begin)
        is_rolling = state[VELOCITY] < _ROLLING_SPEED
        if is_rolling == is_centered:
            _move_reference_point(motion, -parameters[REAR_AXLE] if is_centered else parameters[REAR_AXLE])
            is_centered = not is_centered
        if is_rolling:
            motion[SPEED] = max(motion[SPEED], 0.0)
            move_without_slip(vehicles, n, motion, grip, begin, duration, time_step)
            curvature = math.tan(state[STEERING]) / parameters[WHEELBASE]
            state[SLIP], state[YAW_RATE] = math.atan(parameters[REAR_AXLE] * curvature), motion[SPEED] * curvature
            state[VELOCITY] = motion[SPEED] / math.cos(state[SLIP])
        else:
            duration = min(duration, max(_MAX_DECAY * state[VELOCITY] / rate, _SHORTEST_PART))
            _move_with_slip(vehicles, n, motion, grip, begin, duration, time_step)
        begin += duration
    if is_centered:
        _move_reference_point(motion, -parameters[REAR_AXLE])
    motion[LAST_ACCELERATION] = end_step(vehicles, n, motion[SPEED])
    return motion[SPEED]


@plain_kernel
def _move_reference_point(motion, ahead):
    """Move the reference point by `ahead` m: from the rear axle to the centre of gravity, or back if negative."""
    motion[X] += ahead * math.cos(motion[HEADING])
    motion[Y] += ahead * math.sin(motion[HEADING])


@plain_kernel
def _move_with_slip(vehicles, n, motion, grip, begin, duration, time_step):
    """Move the centre of gravity of a vehicle whose tyres slip by a part of a time step, by the Runge-Kutta method."""
    parameters, state = vehicles.parameters[n], vehicles.state[n]
    speed, slip, yaw_rate = state[VELOCITY], state[SLIP], state[YAW_RATE]
    lateral = speed * speed * math.tan(state[STEERING]) / parameters[WHEELBASE]
    limit = longitudinal_grip(vehicles, n, grip, lateral, time_step)
    gain = advance_actuator(vehicles, n, ACCELERATION, limit, begin, duration, time_step)
    steering = advance_actuator(vehicles, n, STEERING, parameters[MAX_STEERING], begin, duration, time_step) / duration
    end, moving = speed_after(speed, gain, parameters[MAX_SPEED])
    h, course = moving * duration, motion[HEADING] + slip
    axles = _axle_force_limits(parameters, grip, gain / duration)
    # Velocity at the start, and the sums over the stages of the changes of heading, slip and yaw rate.
    x, y, turn, d_slip, d_yaw = speed * math.cos(course), speed * math.sin(course), 0.0, 0.0, 0.0
    stage_turn, stage_slip, stage_yaw, per_speed = 0.0, slip, yaw_rate, 0.0
    for stage in range(4):
        stage_speed = speed + (0.0, 0.5, 0.5, 1.0)[stage] * (end - speed)
        if stage != 2:
            per_speed = 1.0 / max(stage_speed, 0.5 * _ROLLING_SPEED)
        slip_rate, yaw_acceleration = _slip_and_yaw_rates(axles, parameters, steering, per_speed, stage_slip, stage_yaw)
        if stage >= 2:
            # The position is the integral by Simpson's rule.
            course = motion[HEADING] + stage_turn + stage_slip
            weight = 4.0 if stage == 2 else 1.0
            x += weight * stage_speed * math.cos(course)
            y += weight * stage_speed * math.sin(course)
        weight = (1.0, 2.0, 2.0, 1.0)[stage]
        turn, d_slip, d_yaw = turn + weight * stage_yaw, d_slip + weight * slip_rate, d_yaw + weight * yaw_acceleration
        ahead = (0.5, 0.5, 1.0, 0.0)[stage] * h
        stage_turn, stage_slip = ahead * stage_yaw, slip + ahead * slip_rate
        stage_yaw = yaw_rate + ahead * yaw_acceleration
    sixth = h / 6.0
    motion[X] += x * sixth
    motion[Y] += y * sixth
    motion[HEADING] += turn * sixth
    state[SLIP], state[YAW_RATE] = slip + d_slip * sixth, yaw_rate + d_yaw * sixth
    state[VELOCITY], motion[SPEED] = end, end * math.cos(state[SLIP])


@plain_kernel
def _axle_force_limits(parameters, grip, acceleration):
    """Return the lateral stiffness and the highest lateral force of each axle, and the mass over the inertia.

    The five numbers are the stiffness of the front and of the rear axle, over the mass of the vehicle, in m/s² per rad,
    the highest force of the front and of the rear axle, over the mass, in m/s², and the last ratio in 1/m².
    """
    front, rear = parameters[FRONT_AXLE], parameters[REAR_AXLE]
    # Loads of the axles as shares of the weight; an axle that lifts off has no force.
    transfer = acceleration * parameters[HEIGHT] / GRAVITY
    front_load = min(max((rear - transfer) / (front + rear), 0.0), 1.0)
    # The share of the friction that the acceleration leaves.
    left = math.sqrt(max(1.0 - (acceleration / grip) ** 2, 0.0)) if grip > 0.0 else 0.0
    front_grip, rear_grip = grip * front_load, grip * (1.0 - front_load)
    return (
        front_grip * parameters[FRONT_STIFFNESS],
        rear_grip * parameters[REAR_STIFFNESS],
        front_grip * left,
        rear_grip * left,
        parameters[MASS] / parameters[INERTIA],
    )


@plain_kernel
def _slip_and_yaw_rates(axles, parameters, steering, per_speed, slip, yaw_rate):
    """Return slip angle rate and yaw acceleration from the lateral forces; `per_speed` is 1 / speed in s/m."""
    front_stiffness, rear_stiffness, front_limit, rear_limit, per_inertia = axles
    front, rear = parameters[FRONT_AXLE], parameters[REAR_AXLE]
    front_slip, rear_slip = steering - slip - front * yaw_rate * per_speed, rear * yaw_rate * per_speed - slip
    # Forces per mass.
    front_force = min(max(front_stiffness * front_slip, -front_limit), front_limit)
    rear_force = min(max(rear_stiffness * rear_slip, -rear_limit), rear_limit)
    slip_rate = (front_force + rear_force) * per_speed - yaw_rate
    return slip_rate, (front * front_force - rear * rear_force) * per_inertia
