"""Prediction of the motion of other entities, as a sequence of straight legs."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from typing import Final

from cornercase.drivers._kernels.structs import HEADING, SPEED, TURN, X, Y, inline_kernel

STANDING_SPEED: Final = 0.2
"""Speed in m/s below which an entity counts as standing."""

TURN_DURATION: Final = 2.0
"""Time in s for which a turning entity is predicted to keep turning."""

TURN_LEGS: Final = 8
"""Number of straight legs for that time."""

MAX_STRAIGHT_TURN_RATE: Final = 0.05
"""Turn rate in rad/s up to which an entity is predicted to go straight."""


@inline_kernel
def predict_legs(memory, other, cos, sin, center_x, horizon, legs):
    """Predict the motion of another entity for `horizon` s; fill `legs`, and return the number of legs.

    The entity is assumed to keep its turn rate for 2 s, and then to go straight. `cos` and `sin` belong to its heading;
    `center_x` is the position of the box's centre ahead of the entity's reference point in m.
    """
    x, y, heading, speed, turn = (
        memory[X, other],
        memory[Y, other],
        memory[HEADING, other],
        memory[SPEED, other],
        memory[TURN, other],
    )
    if not (abs(turn) > MAX_STRAIGHT_TURN_RATE and abs(speed) >= STANDING_SPEED):
        legs[0, 0], legs[0, 1] = x + center_x * cos, y + center_x * sin
        legs[0, 2], legs[0, 3] = cos, sin
        legs[0, 4], legs[0, 5] = 0.0, horizon
        return 1
    for k in range(TURN_LEGS + 1):
        duration = TURN_DURATION / TURN_LEGS
        # The first leg has the current heading of the box.
        if k > 0:
            towards = heading + 0.5 * turn * duration
            if k == TURN_LEGS:
                duration = horizon - k * duration
                towards = heading
            cos, sin = math.cos(towards), math.sin(towards)
        legs[k, 0], legs[k, 1] = x + center_x * cos, y + center_x * sin
        legs[k, 2], legs[k, 3] = cos, sin
        legs[k, 4] = legs[k - 1, 5] if k > 0 else 0.0
        legs[k, 5] = legs[k, 4] + duration
        x, y = x + speed * duration * cos, y + speed * duration * sin
        heading += turn * duration
    return TURN_LEGS + 1
