"""Columns of `TrackTable.addresses`: arrays of a track.

Arrays of a lane, in the order of its path's arrays, have an element per sample or curvature; arrays of a polyline have
a row of vertices or segments per scenario.
"""

from __future__ import annotations

from typing import Final

DISTANCE: Final = 0
X: Final = 1
Y: Final = 2
HEADING: Final = 3
"""Columns of all tracks."""

CURVATURE: Final = 4
S: Final = 5
ROAD: Final = 6
NUMBER: Final = 7
ALONG: Final = 8
REFERENCE: Final = 10
CENTER: Final = 11
BEND_AT: Final = 12
BEND: Final = 13
"""Columns of lanes."""

DIRECTION: Final = 4
FACING: Final = 5
TIME: Final = 6
SPEED: Final = 7
RATE: Final = 8
"""Columns of polylines; splines have their times in the same column."""

LENGTH: Final = 4
CHORD: Final = 5
LAST: Final = 7
"""Columns of splines, with a row of chord or segment ends per scenario."""

COLUMNS: Final = 14
"""Number of columns."""
