"""Compiled steering along a path."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, no-untyped-call, untyped-decorator"

from __future__ import annotations

import math
from typing import Final

import numpy as np

from cornercase._common.numba.kernel import kernel
from cornercase.drivers._kernels.structs import plain_kernel

# A deviation decays to 1/e within this distance in m, or this time in s if that is longer; wheels that lag
# behind add to the time.
_DECAY_DISTANCE: Final = 2.0
_DECAY_TIME: Final = 0.4
_DECAY_PER_RESPONSE: Final = 2.0
# rad; steepest approach to the path.
_MAX_APPROACH: Final = 0.5
# Nearest approach to the centre of a bend, as a part of its radius.
_MIN_RADIUS_SHARE: Final = 0.1


@plain_kernel
def steering_angle(offset, turn, curvature, speed, wheelbase, response):
    """Return the angle of the front wheels in rad, as `steer_along_path` does, for one pose relative to a path."""
    decay = max(_DECAY_DISTANCE, (_DECAY_TIME + _DECAY_PER_RESPONSE * response) * abs(speed))
    # With the heading at its limit, the offset shrinks along a straight line.
    limit = 2.0 * decay * _MAX_APPROACH
    sinc = 1.0 if turn == 0.0 else math.sin(turn) / turn
    share = max(1.0 - curvature * offset, _MIN_RADIUS_SHARE)
    bend = (
        curvature * math.cos(turn) / share
        - 2.0 * turn / decay
        - sinc * min(max(offset, -limit), limit) / (decay * decay)
    )
    return math.atan(wheelbase * bend)


@kernel(interpreted_seconds=lambda offset, *_: 5e-6 * offset.size, error_model="numpy")
def steering_angles(offset, turn, curvature, speed, wheelbase, response):
    """Return the angles of the front wheels in rad for N poses relative to a path; all arguments have shape (N,)."""
    result = np.empty(offset.size)
    for n in range(offset.size):
        result[n] = steering_angle(offset[n], turn[n], curvature[n], speed[n], wheelbase[n], response[n])
    return result
