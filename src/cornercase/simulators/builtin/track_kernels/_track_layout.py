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
LANE_NUMBER: Final = 7
RUNS_ALONG_S: Final = 8
REFERENCE_DISTANCE: Final = 10
CENTER_OFFSET: Final = 11
CURVATURE_DISTANCE: Final = 12
REFERENCE_CURVATURE: Final = 13
"""Columns of lanes."""

DIRECTION: Final = 4
VERTEX_HEADING: Final = 5
TIME: Final = 6
SPEED: Final = 7
SEGMENT_ACCELERATION: Final = 8
"""Columns of polylines; splines have their times in the same column."""

LENGTH: Final = 4
CHORD: Final = 5
LAST_CHORD: Final = 7
"""Columns of splines, with a row of chord or segment ends per scenario."""

N_COLUMNS: Final = 14
"""Number of columns."""

LANE_TRACK: Final = 0
"""Kind of a track along lanes."""
POLYLINE_TRACK: Final = 1
"""Kind of a track through vertices."""
CLOTHOID_TRACK: Final = 2
"""Kind of a track along the chords of a clothoid spline."""
PYTHON_TRACK: Final = 3
"""Kind of a track without kernels."""

CORNER_HALF_LENGTH: Final = 2.0
"""m; half the length over which the heading turns at a corner of a polyline (esmini's value)."""
VERTEX_TOLERANCE: Final = 1e-6
"""m or s; closer vertices coincide."""
