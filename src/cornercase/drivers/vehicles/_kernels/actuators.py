"""Compiled actuators of a vehicle: dead time, lag, highest rate and friction limit, integrated exactly."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, no-untyped-call, untyped-decorator, call-arg"

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from cornercase._common.numba.kernel import kernel
from cornercase._common.numba.tuple_pointers import reference_to
from cornercase._common.typing import FloatArray

plain_kernel = kernel(error_model="numpy", _nrt=False)

GRAVITY: Final = 9.81
"""In m/s²."""

ACTUATORS, KINEMATIC, SINGLE_TRACK = range(3)
"""Kinds of vehicle models; a vehicle of the first kind stays on its path."""

(
    DELAY,
    LAG,
    MAX_JERK,
    MU,
    STEERING_DELAY,
    STEERING_LAG,
    MAX_STEERING_RATE,
    MAX_SPEED,
    MAX_STEERING,
    WHEELBASE,
) = range(10)
"""Columns of `Vehicles.parameters`; columns that only one model has follow."""

ACCELERATION, STEERING, SPEED, NEWEST, YAW_RATE, SLIP, VELOCITY, LEFT_X, LEFT_Y = range(9)
"""Columns of `Vehicles.state`. `SPEED` is the last speed that the model returned; NaN before. `NEWEST` is the index of
the newest request. Yaw rate, slip angle and velocity are for the centre of gravity, in a model whose tyres slip.
`LEFT_X` and `LEFT_Y` are the position of a vehicle that steers after its last step."""
N_STATE: Final = 9

# rad; change of the wheels' angle whose duration counts as part of the steering response.
_USUAL_STEERING: Final = 0.1
# m/s; a speed that differs by more from the one that the model returned was set by something else.
_TOLERANCE: Final = 1e-6
# Share of a time step by which a dead time may be less than a multiple of the step.
_ROUNDING: Final = 1e-9


class Vehicles(NamedTuple):
    """Parameters and state of vehicles of one model, for compiled functions; one row per vehicle and scenario."""

    parameters: FloatArray  # (N, P): columns as above, in m, s and rad
    state: FloatArray  # (N, 9): columns as above
    requests: FloatArray  # (N, 2, R): the last requests of acceleration and steering, as ring buffers


def count_requests(delay: FloatArray, time_step: float) -> int:
    """Return how many requests a ring buffer must hold for the longest of these dead times in s."""
    return int(np.ceil(delay.max(initial=0.0) / time_step)) + 2


@plain_kernel
def steering_response(parameters):
    """Return the time in s by which the wheels lag behind a request, from a row of `Vehicles.parameters`."""
    late = parameters[STEERING_DELAY] + parameters[STEERING_LAG]
    return late + _USUAL_STEERING / parameters[MAX_STEERING_RATE]


@plain_kernel
def begin_step(vehicles, n, speed, acceleration, request, steering):
    """Store the requests for a time step; reset the actuators if something else has changed the vehicle's motion."""
    state, requests = vehicles.state[n], vehicles.requests[n]
    if not abs(speed - state[SPEED]) <= _TOLERANCE:
        state[ACCELERATION] = acceleration if math.isfinite(acceleration) and speed > 0.0 else 0.0
        state[STEERING] = state[NEWEST] = state[YAW_RATE] = state[SLIP] = 0.0
        state[VELOCITY] = speed
        for k in range(requests.shape[1]):
            requests[0, k], requests[1, k] = state[ACCELERATION], 0.0
    newest = int(state[NEWEST])
    requests[0, newest], requests[1, newest] = request, steering


@plain_kernel
def longitudinal_grip(vehicles, n, grip, lateral, time_step):
    """Return the highest longitudinal acceleration in m/s² that the tyres allow next to a lateral acceleration.

    `grip` is the highest total acceleration of the tyres. If the requested and the `lateral` acceleration, each limited
    to `grip`, exceed it together, both are reduced by the same factor.
    """
    requests = vehicles.requests[n]
    steps = int(vehicles.parameters[n, DELAY] / time_step + _ROUNDING)
    request = requests[0, _find_request(vehicles.state[n], requests.shape[1], steps)]
    request, lateral = min(abs(request), grip), min(abs(lateral), grip)
    if request + lateral <= grip:
        return grip
    wanted = math.hypot(request, lateral)
    return grip if wanted <= grip else grip * request / wanted


@plain_kernel
def advance_actuator(vehicles, n, which, limit, begin, duration, time_step):
    """Advance an actuator from `begin` s after the start of the step by `duration` s; return the integral of its value.

    `which` is `ACCELERATION` or `STEERING`. The value stays between ``-limit`` and `limit`.
    """
    parameters, state, requests = vehicles.parameters[n], vehicles.state[n], vehicles.requests[n]
    first = DELAY if which == ACCELERATION else STEERING_DELAY
    delay, lag, max_rate = parameters[first], parameters[first + 1], parameters[first + 2]
    steps, size = int(delay / time_step + _ROUNDING), requests.shape[1]
    # An older request is still in effect in the first part of the step.
    older = min(max(delay - steps * time_step - begin, 0.0), duration)
    value, integral = state[which], 0.0
    if older > 0.0:
        request = requests[which, _find_request(state, size, steps + 1)]
        value, integral = _approach_request(value, request, lag, max_rate, limit, older)
    if duration > older:
        request = requests[which, _find_request(state, size, steps)]
        value, more = _approach_request(value, request, lag, max_rate, limit, duration - older)
        integral += more
    state[which] = value
    return integral


@kernel(error_model="numpy", _nrt=False, forceinline=True)
def _find_request(state, size, steps):
    """Return the index of the request `steps` time steps ago, in a ring buffer of `size` requests."""
    index = int(state[NEWEST]) - steps
    return index if index >= 0 else index + size


@plain_kernel
def _approach_request(value, request, lag, max_rate, limit, duration):
    """Return the value of an actuator after a duration, and the integral of the value over the duration.

    The value first changes at `max_rate`, then approaches the request exponentially, and at last stays constant.
    """
    value, target = min(max(value, -limit), limit), min(max(request, -limit), limit)
    left, integral = duration, 0.0
    if value != target and max_rate < math.inf:
        gap = request - value
        # The lag alone is slower near the request.
        ramp = min(left, max(abs(gap) / max_rate - lag, 0.0), abs(target - value) / max_rate)
        end = value + math.copysign(max_rate * ramp, gap)
        integral, value, left = 0.5 * (value + end) * ramp, end, left - ramp
    if value != target and left > 0.0:
        if lag > 0.0:
            gap = request - value
            until = left if target == request else min(left, max(lag * math.log(gap / (request - target)), 0.0))
            decayed = gap * math.exp(-until / lag)
            integral += request * until - lag * (gap - decayed)
            value, left = request - decayed, left - until
        if left > 0.0:
            value = target
    return value, integral + value * left


@plain_kernel
def speed_after(speed, gain, max_speed):
    """Return the speed after a step, and the share of the step in which the vehicle moves: below 1 if it stops."""
    if speed + gain < 0.0:
        # A vehicle that the scenario has sent backwards stops at once.
        return 0.0, speed / -gain if speed > 0.0 else 0.0
    return min(speed + gain, max_speed), 1.0


@plain_kernel
def change_speed(vehicles, n, speed, acceleration, request, friction, time_step):
    """Return the speed after a time step of a vehicle that stays on its path.

    `acceleration` is the acceleration of the last step, and `request` the requested acceleration, in m/s².
    """
    begin_step(vehicles, n, speed, acceleration, request, 0.0)
    grip = vehicles.parameters[n, MU] * friction * GRAVITY
    gain = advance_actuator(vehicles, n, ACCELERATION, grip, 0.0, time_step, time_step)
    speed, _ = speed_after(speed, gain, vehicles.parameters[n, MAX_SPEED])
    end_step(vehicles, n, speed)
    return speed


@kernel(interpreted_seconds=lambda vehicles, speed, *_: 2e-5 * speed.size, error_model="numpy")
def change_speeds(vehicles, speed, acceleration, request, friction, time_step, active):
    """Change `speed` and `acceleration` (N,) of the active vehicles to the values at the end of a time step."""
    _change_all(reference_to(vehicles), speed, acceleration, request, friction, time_step, active)


@plain_kernel
def _change_all(vehicles, speed, acceleration, request, friction, time_step, active):
    for n in range(active.size):
        if active[n]:
            speed[n] = change_speed(vehicles, n, speed[n], acceleration[n], request[n], friction[n], time_step)
            acceleration[n] = vehicles.state[n, ACCELERATION] if speed[n] > 0.0 else 0.0


@plain_kernel
def end_step(vehicles, n, speed):
    """Make room for the next request; return the acceleration at the end of the step, 0 if the vehicle stands."""
    state, size = vehicles.state[n], vehicles.requests.shape[2]
    state[NEWEST] = state[NEWEST] + 1.0 if state[NEWEST] + 1.0 < size else 0.0
    state[SPEED] = speed
    return state[ACCELERATION] if speed > 0.0 else 0.0
