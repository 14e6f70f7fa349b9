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
"""Kinds of vehicles; the first one stays on its path."""

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
"""Columns of `Vehicles.parameters`; those of a model's own follow."""

ACCELERATION, STEERING, SPEED, NEWEST, YAW_RATE, SLIP, VELOCITY, LEFT_X, LEFT_Y = range(9)
"""Columns of `Vehicles.state`. The speed is the last one that the model returned; NaN before. `NEWEST` is the index of
the newest request. Yaw rate, slip angle and velocity are those of the centre of gravity, of a model in which tyres
slip. `LEFT_X`, `LEFT_Y` are where the last step left a vehicle that steers."""
N_STATE: Final = 9

# rad; the change of the angle of the wheels for which the time is counted that it takes.
_USUAL_STEERING: Final = 0.1
# A speed in m/s that differs by more from what the model returned was set by something else.
_TOLERANCE: Final = 1e-6
# Share of a time step that a dead time may lack to a multiple.
_ROUNDING: Final = 1e-9


class Vehicles(NamedTuple):
    """Parameters and state of a vehicle in N scenarios, or of several one after another, for kernels."""

    parameters: FloatArray  # (N, P): columns as above, in m, s and rad
    state: FloatArray  # (N, 9): columns as above
    requests: FloatArray  # (N, 2, R): the last requests of acceleration and steering, as rings


def count_requests(delay: FloatArray, time_step: float) -> int:
    """Return how many requests a ring must hold for these dead times in s."""
    return int(np.ceil(delay.max(initial=0.0) / time_step)) + 2


@plain_kernel
def steering_response(parameters):
    """Return the time in s by which the wheels are late, of a row of `Vehicles.parameters`."""
    late = parameters[STEERING_DELAY] + parameters[STEERING_LAG]
    return late + _USUAL_STEERING / parameters[MAX_STEERING_RATE]


@plain_kernel
def begin_step(vehicles, n, speed, acceleration, request, steering):
    """Store the requests of the coming step, with new actuators if something else has changed speed or place."""
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
    """Return the highest acceleration in m/s² that tyres with this grip allow beside the lateral one that is wanted.

    Of the requested and the lateral acceleration, the tyres do the same share.
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
def advance(vehicles, n, which, limit, begin, duration, time_step):
    """Advance an actuator from `begin` s after the start of the step by `duration` s; return the integral of its value.

    `which` is `ACCELERATION` or `STEERING`; the value stays within `limit` of 0.
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
        value, integral = _follow(value, request, lag, max_rate, limit, older)
    if duration > older:
        request = requests[which, _find_request(state, size, steps)]
        value, more = _follow(value, request, lag, max_rate, limit, duration - older)
        integral += more
    state[which] = value
    return integral


@kernel(error_model="numpy", _nrt=False, forceinline=True)
def _find_request(state, size, steps):
    """Return the index of the request `steps` time steps ago, in a ring of `size`."""
    index = int(state[NEWEST]) - steps
    return index if index >= 0 else index + size


@plain_kernel
def _follow(value, request, lag, max_rate, limit, duration):
    """Return the value of an actuator after a duration, and its integral: a ramp, an exponential, then a constant."""
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
    """Return the speed after a step, and the share of the step in which a vehicle that stops in it still moves."""
    if speed + gain < 0.0:
        # One that the scenario has sent backwards stops at once.
        return 0.0, speed / -gain if speed > 0.0 else 0.0
    return min(speed + gain, max_speed), 1.0


@plain_kernel
def change_speed(vehicles, n, speed, acceleration, request, friction, time_step):
    """Return the speed after a time step of a vehicle that stays on its path.

    `acceleration` is that of the last step, `request` the requested one, in m/s².
    """
    begin_step(vehicles, n, speed, acceleration, request, 0.0)
    grip = vehicles.parameters[n, MU] * friction * GRAVITY
    gain = advance(vehicles, n, ACCELERATION, grip, 0.0, time_step, time_step)
    speed, _ = speed_after(speed, gain, vehicles.parameters[n, MAX_SPEED])
    end_step(vehicles, n, speed)
    return speed


@kernel(interpreted_seconds=lambda vehicles, speed, *_: 2e-5 * speed.size, error_model="numpy")
def change_speeds(vehicles, speed, acceleration, request, friction, time_step, active):
    """Change the speeds (N,) of the active vehicles by one time step, and their accelerations to those at its end."""
    _change_all(reference_to(vehicles), speed, acceleration, request, friction, time_step, active)


@plain_kernel
def _change_all(vehicles, speed, acceleration, request, friction, time_step, active):
    for n in range(active.size):
        if active[n]:
            speed[n] = change_speed(vehicles, n, speed[n], acceleration[n], request[n], friction[n], time_step)
            acceleration[n] = vehicles.state[n, ACCELERATION] if speed[n] > 0.0 else 0.0


@plain_kernel
def end_step(vehicles, n, speed):
    """Make room for the next request, and return the acceleration at its end; brakes do nothing at standstill."""
    state, size = vehicles.state[n], vehicles.requests.shape[2]
    state[NEWEST] = state[NEWEST] + 1.0 if state[NEWEST] + 1.0 < size else 0.0
    state[SPEED] = speed
    return state[ACCELERATION] if speed > 0.0 else 0.0
