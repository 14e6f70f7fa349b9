"""Copy the state that a driver in Python gets."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from typing import Final

from cornercase._common.numba.kernel import kernel
from cornercase.simulators.builtin.world._state_layout import (
    ACCELERATION,
    DISTANCE,
    HEADING,
    PRESENT,
    SPEED,
    TARGET_SPEED,
    VISIBLE,
    X,
    Y,
)

OWN_ROWS: Final = (DISTANCE, X, Y, HEADING, SPEED, ACCELERATION, TARGET_SPEED)
"""What a driver is given of its own entity, as rows of `World.floats`."""
OTHERS_ROWS: Final = (X, Y, HEADING, SPEED)
"""What a driver is given of the others, as rows of `World.floats`."""


@kernel(interpreted_seconds=lambda floats, *_: 1e-5 * floats.shape[0] * floats.shape[2], error_model="numpy")
def copy_driver_inputs(floats, flags, entity, own, others):
    """Copy the state of an entity to `own` (7, N), and that of A other entities to `others` (4, A, N).

    It is NaN for entities that the driven entity cannot see, since they are absent or hidden by an action.
    """
    for n in range(floats.shape[0]):
        for q in range(len(OWN_ROWS)):
            own[q, n] = floats[n, OWN_ROWS[q], entity]
        for a in range(others.shape[1]):
            other = a if a < entity else a + 1
            is_visible = flags[n, PRESENT, other] and flags[n, VISIBLE, other]
            for q in range(len(OTHERS_ROWS)):
                others[q, a, n] = floats[n, OTHERS_ROWS[q], other] if is_visible else math.nan
