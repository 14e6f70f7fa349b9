"""Copy the state of entities for a driver that runs in Python."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from typing import Final

from cornercase._common.numba.kernel import kernel
from cornercase.simulators.builtin.world._state_layout import (
    ACCELERATION,
    BEFORE,
    DISTANCE,
    FROM_HEADING,
    FROM_X,
    FROM_Y,
    HEADING,
    JUMPED,
    PRESENT,
    SPEED,
    TARGET_SPEED,
    VISIBLE,
    X,
    Y,
)

OWN_ROWS: Final = (DISTANCE, X, Y, HEADING, SPEED, ACCELERATION, TARGET_SPEED)
"""Rows of `World.floats` that a driver receives for its own entity."""
OTHERS_ROWS: Final = (X, Y, HEADING, SPEED)
"""Rows of `World.floats` that a driver receives for all other entities."""
# Rows with the values of `OTHERS_ROWS` at the start of the step, for an entity that has not jumped. Not used for the
# speed of the own entity, since actions change it only after the driver was asked.
_STARTS: Final = (FROM_X, FROM_Y, FROM_HEADING, BEFORE)


@kernel(interpreted_seconds=lambda floats, *_: 1e-5 * floats.shape[0] * floats.shape[2], error_model="numpy")
def copy_driver_inputs(floats, flags, entity, is_at_start, begin, own, others):
    """Copy the state of an entity to `own` (7, N), and the state of the A other entities to `others` (4, A, N).

    Actions may have moved entities in this time step already. If `is_at_start`, the poses of all entities and the
    speeds of the other entities are nevertheless those at the start of the time step. `begin` (3, N) always receives
    the entity's own pose at the start. After a jump, such as a teleport, the new pose counts as the pose at the start.
    Other entities that are absent or hidden by an action get NaN.
    """
    for n in range(floats.shape[0]):
        for q in range(len(OWN_ROWS)):
            own[q, n] = floats[n, OWN_ROWS[q], entity]
        for q in range(3):
            begin[q, n] = floats[n, OTHERS_ROWS[q] if flags[n, JUMPED, entity] else _STARTS[q], entity]
            if is_at_start:
                own[q + 1, n] = begin[q, n]
        for a in range(others.shape[1]):
            other = a if a < entity else a + 1
            is_visible = flags[n, PRESENT, other] and flags[n, VISIBLE, other]
            for q in range(len(OTHERS_ROWS)):
                row = OTHERS_ROWS[q]
                if is_at_start and (q == 3 or not flags[n, JUMPED, other]):
                    row = _STARTS[q]
                others[q, a, n] = floats[n, row, other] if is_visible else math.nan
