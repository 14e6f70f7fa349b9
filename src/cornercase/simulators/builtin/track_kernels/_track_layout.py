"""Tables of tracks (curves that entities follow) for kernels.

The table `TrackTable.addresses` has a row of memory addresses for each track, one address for each array of the track.
Constants of this module name the columns of the table. The arrays of a lane have an item per sample or curvature; their
order is that of the attributes of the lane path. The arrays of a polyline have a row per scenario, and an item per
vertex or segment.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from cornercase._common.numba.pointers import memory_address
from cornercase._common.typing import BoolArray, FloatArray, IntArray

DISTANCE, X, Y, HEADING = range(4)
"""Columns of all tracks."""

CURVATURE, S, ROAD, LANE_NUMBER, RUNS_ALONG_S = range(4, 9)
REFERENCE_DISTANCE, CENTER_OFFSET, CURVATURE_DISTANCE, REFERENCE_CURVATURE = range(10, 14)
"""Columns of lanes."""

DIRECTION, VERTEX_HEADING, TIME, SPEED, SEGMENT_ACCELERATION = range(4, 9)
"""Columns of polylines. `TIME` is also a column of splines."""

LENGTH, CHORD, LAST_CHORD = 4, 5, 7
"""Columns of splines, whose arrays have a row of chord ends or segment ends per scenario."""

N_COLUMNS: Final = 14
"""Number of columns of `TrackTable.addresses`."""

LANE_TRACK, POLYLINE_TRACK, CLOTHOID_TRACK = range(3)
"""Kinds of tracks: a lane and its successors, a line through vertices, or the chords of a clothoid spline."""

CORNER_HALF_LENGTH: Final = 2.0
"""m; half the length over which the heading turns at a corner of a polyline (esmini's value)."""
VERTEX_TOLERANCE: Final = 1e-6
"""m or s; vertices that differ by less count as the same."""

ALONG_SEGMENTS, AT_CORNERS, AT_VERTICES = range(3)
"""Ways in which the heading changes along a polyline: over whole segments, near corners, or abruptly at vertices."""


class TrackTable(NamedTuple):
    """All tracks of E entities, G in number, as arrays that kernels can read."""

    rows: IntArray  # (E, K): index among all tracks of each track of an entity; -1 for none
    kind: IntArray  # (G,): `LANE_TRACK`, `POLYLINE_TRACK` or `CLOTHOID_TRACK`
    addresses: IntArray  # (G, 14): memory addresses of the arrays of a track
    size: IntArray  # (G,): samples of a lane, vertices of a polyline, chord ends of a spline
    n_curvatures: IntArray  # (G,): curvature samples of a lane's reference line; segment ends of a spline
    max_sample_gap: FloatArray  # (G,): largest gap in m between consecutive samples of a lane
    length: FloatArray  # (G,): length of a lane in m; NaN for trajectories, since their length depends on the scenario
    span: FloatArray  # (G, 2): range of distances in m in which a lane is followed; beyond it, another track continues
    is_closed: BoolArray  # (G,): whether a polyline is a loop
    has_times: BoolArray  # (G,): whether a trajectory has times
    heading_interpolation: IntArray  # (G,): `ALONG_SEGMENTS` and so on, for a polyline
    is_uniform: BoolArray  # (G,): whether a trajectory has the same shape in all scenarios, so that row 0 is read


def alloc_track_table(n_tracks: int) -> TrackTable:
    """Allocate a table for tracks that no entity follows yet."""
    n = n_tracks
    kind, size, n_curvatures, heading_interpolation = (np.zeros(n, dtype=np.int64) for _ in range(4))
    is_closed, has_times, is_uniform = (np.zeros(n, dtype=np.bool_) for _ in range(3))
    max_sample_gap, length = (np.full(n, np.nan) for _ in range(2))
    return TrackTable(
        np.full((0, 1), -1), kind, np.zeros((n, N_COLUMNS), dtype=np.int64), size, n_curvatures,
        max_sample_gap, length, np.full((n, 2), np.nan), is_closed, has_times, heading_interpolation, is_uniform,
    )  # fmt: skip


def make_trajectory_table(kind: int, is_uniform: bool, arrays: Sequence[FloatArray | IntArray | None]) -> TrackTable:
    """Create the table of a single trajectory from its arrays, in the order of the columns of `TrackTable.addresses`.

    Missing times, speeds or accelerations are given as None.
    """
    table = alloc_track_table(1)
    table.kind[0], table.is_uniform[0] = kind, is_uniform
    for column, array in enumerate(arrays):
        table.addresses[0, column] = 0 if array is None else memory_address(array)
    x, times = arrays[X], arrays[TIME]
    assert x is not None
    table.size[0], table.has_times[0] = x.shape[1], times is not None
    return table
