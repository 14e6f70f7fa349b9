"""Acceleration that the throttle and brake pedals of a vehicle ask for."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.drivers._driving_function import Body

# m/s²; limits of a vehicle for which the scenario file has none.
_MAX_ACCELERATION: Final = 3.0
_MAX_DECELERATION: Final = 8.0


def pedals_to_acceleration(throttle: FloatArray, brake: FloatArray, body: Body) -> FloatArray:
    """Return the accelerations (N,) in m/s² that pedals ask for; NaN where both pedals are NaN.

    Pedals are from 0 to 1; NaN counts as 0 if the other pedal has a value. The acceleration is linear in each pedal.
    Full throttle gives the highest acceleration in the scenario file, and full brake the highest deceleration there. If
    the file has no such limit, they give 3 m/s² and 8 m/s².
    """
    highest = body.max_acceleration if np.isfinite(body.max_acceleration) else _MAX_ACCELERATION
    lowest = -(body.max_deceleration if np.isfinite(body.max_deceleration) else _MAX_DECELERATION)
    has_throttle, has_brake = ~np.isnan(throttle), ~np.isnan(brake)
    acceleration = np.where(has_throttle, throttle, 0.0) * highest + np.where(has_brake, brake, 0.0) * lowest
    return np.where(has_throttle | has_brake, acceleration, np.nan)
