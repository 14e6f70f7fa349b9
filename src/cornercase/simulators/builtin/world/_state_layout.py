"""Layout of the tables that hold the state of a batch of scenarios.

The constants are row numbers in tables indexed (scenario, row, entity). So all values of a scenario are in one block of
memory, which makes kernels fast.
"""

from __future__ import annotations

from typing import Final

(
    X, Y, HEADING, SPEED, ACCELERATION, ODOMETER, STANDING_SINCE, DISTANCE, OFFSET, TURN, SIDEWAYS, PACE, VELOCITY,
    LAST_S, AT_END_SINCE, OFF_ROAD_SINCE, TARGET_SPEED, FROM_X, FROM_Y, FROM_HEADING, GONE_X, GONE_Y, PULL_X, PULL_Y,
    BEFORE, ROAD_HEADING,
) = range(26)  # fmt: skip
"""Rows of `World.floats`."""

N_FLOAT_ROWS: Final = 26
"""Number of rows of `World.floats`."""

(
    PRESENT, CHANGES_LANES, STRANDED, MOVED, DECIDED, ACTIVATED, DRIVEN, VISIBLE, JUMPED, STEERED,
) = range(10)  # fmt: skip
"""Rows of `World.flags`."""

TRACK, ROUTE, LAST_ROAD, DRIVER, PULLED_BY = range(5)
"""Rows of `World.numbers`."""

_NAN, _INF = float("nan"), float("inf")

FLOAT_ROWS: Final = {
    "x": (X, _NAN), "y": (Y, _NAN), "heading": (HEADING, _NAN), "speed": (SPEED, 0.0),
    "acceleration": (ACCELERATION, 0.0), "odometer": (ODOMETER, 0.0), "standing_since": (STANDING_SINCE, _INF),
    "distance": (DISTANCE, 0.0), "offset": (OFFSET, 0.0), "turn": (TURN, 0.0), "sideways": (SIDEWAYS, 0.0),
    "pace": (PACE, _NAN), "velocity": (VELOCITY, 0.0), "last_s": (LAST_S, 0.0), "at_end_since": (AT_END_SINCE, _INF),
    "off_road_since": (OFF_ROAD_SINCE, _INF), "target_speed": (TARGET_SPEED, _INF), "from_x": (FROM_X, _NAN),
    "from_y": (FROM_Y, _NAN), "from_heading": (FROM_HEADING, _NAN), "before": (BEFORE, 0.0),
    "road_heading": (ROAD_HEADING, _NAN),
}  # fmt: skip
"""Row and initial value of each array of floats in `World`, by name; vectors have two rows and are not listed."""

FLAG_ROWS: Final = {
    "present": (PRESENT, False), "changes_lanes": (CHANGES_LANES, False), "stranded": (STRANDED, False),
    "moved": (MOVED, False), "decided": (DECIDED, False), "activated": (ACTIVATED, False), "driven": (DRIVEN, False),
    "visible": (VISIBLE, True), "jumped": (JUMPED, False),
    "steered": (STEERED, False),
}  # fmt: skip
"""Row and initial value of each array of flags in `World`, by name."""

INTEGER_ROWS: Final = {
    "track": (TRACK, -1), "route": (ROUTE, 0), "last_road": (LAST_ROAD, -1), "driver": (DRIVER, -1),
    "pulled_by": (PULLED_BY, -1),
}  # fmt: skip
"""Row and initial value of each array of integers in `World`, by name."""

MAX_LANE_OFFSET: Final = 1.0
"""m; an entity that changes lanes counts as on the new lane if its offset from this lane is smaller.

Otherwise the lane is looked up from the position."""
