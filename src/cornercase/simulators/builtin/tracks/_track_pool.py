"""Tables of all tracks of a batch for compiled code."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from cornercase._common.numba.pointers import memory_address
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.simulators.builtin.track_kernels._track_layout import (
    CLOTHOID_TRACK,
    LANE_TRACK,
    N_COLUMNS,
    POLYLINE_TRACK,
    PYTHON_TRACK,
)
from cornercase.simulators.builtin.tracks._clothoid_spline import ClothoidSpline
from cornercase.simulators.builtin.tracks._lane import LaneTrack
from cornercase.simulators.builtin.tracks._polyline import Polyline
from cornercase.simulators.builtin.tracks._track import ALONG_SEGMENTS, AT_CORNERS, AT_VERTICES, Track

_POLYLINE_ARRAYS: Final = (
    "distance",
    "x",
    "y",
    "heading",
    "directions",
    "vertex_headings",
    "times",
    "speeds",
    "accelerations",
)

HEADING_INTERPOLATIONS: Final = (ALONG_SEGMENTS, AT_CORNERS, AT_VERTICES)
"""Heading interpolations of a polyline, indexed by `TrackTable.heading_interpolation`."""


class TrackTable(NamedTuple):
    """Tables of G tracks of E entities."""

    rows: IntArray  # (E, K): index of each entity's tracks among all tracks; -1 for none
    kind: IntArray  # (G,): `LANE_TRACK`, `POLYLINE_TRACK`, `CLOTHOID_TRACK` or `PYTHON_TRACK`
    addresses: IntArray  # (G, 14): memory addresses of its arrays, see `_track_layout`
    size: IntArray  # (G,): samples of a lane, vertices of a polyline, chord ends of a spline
    n_curvatures: IntArray  # (G,): curvature samples of a lane's reference line; segment ends of a spline
    max_sample_gap: FloatArray  # (G,): largest gap in m between consecutive samples of a lane
    length: FloatArray  # (G,): of a lane in m; NaN for others, which depend on the scenario
    span: FloatArray  # (G, 2): distances in m between which a lane is followed; beyond, another track continues
    is_closed: BoolArray  # (G,): whether a polyline is a loop
    has_times: BoolArray  # (G,): whether a trajectory has times
    heading_interpolation: IntArray  # (G,): index into `HEADING_INTERPOLATIONS`, of a polyline
    is_uniform: BoolArray  # (G,): whether a trajectory is the same in all scenarios, and stored in one row


class TrackPool:
    """Collects the tracks of all entities of a batch for compiled code; `tracks` are the latest tables."""

    def __init__(self) -> None:
        self._counts: list[int] | None = None
        self._rows: dict[int, int] = {}
        # Keeps the arrays alive whose addresses are in the tables.
        self._kept_alive: list[Track] = []
        # By row: trajectories that may change when they are restarted, and their version.
        self._trajectory_versions: dict[int, tuple[Polyline | ClothoidSpline, int]] = {}
        self.tracks = _empty_tables(0)

    def update(self, tracks_by_entity: Sequence[Sequence[Track]]) -> TrackTable:
        """Return the tables of each entity's tracks; rebuilt only if tracks were added or changed.

        `tracks_by_entity` lists the tracks by entity; compared to earlier calls it may only grow.
        """
        counts = [len(tracks) for tracks in tracks_by_entity]
        for g, (trajectory, version) in self._trajectory_versions.items():
            if trajectory.version != version:
                self._add_trajectory(self.tracks, g, g, trajectory)
        if counts == self._counts:
            return self.tracks
        new_tracks = {
            id(track): track for tracks in tracks_by_entity for track in tracks if id(track) not in self._rows
        }
        self._rows.update(zip(new_tracks, range(len(self._rows), len(self._rows) + len(new_tracks)), strict=True))
        tables = _empty_tables(len(new_tracks))
        for g, track in enumerate(new_tracks.values()):
            self._add_track(tables, g, track)
        row = np.full((len(tracks_by_entity), max([*counts, 1])), -1)
        for e, tracks in enumerate(tracks_by_entity):
            row[e, : len(tracks)] = [self._rows[id(track)] for track in tracks]
        columns = (np.concatenate(pair) for pair in zip(self.tracks[1:], tables[1:], strict=True))
        self.tracks, self._counts = TrackTable(row, *columns), counts
        return self.tracks

    def _add_track(self, tables: TrackTable, row: int, track: Track) -> None:
        self._kept_alive.append(track)
        if isinstance(track, LaneTrack):
            path = track.path
            tables.kind[row], tables.size[row], tables.n_curvatures[row] = (
                LANE_TRACK,
                path.x.size,
                path.curvature_distance.size,
            )
            tables.max_sample_gap[row], tables.length[row], tables.span[row] = path.max_chord, track.length, track.span
            tables.addresses[row] = path.array_addresses
        elif isinstance(track, Polyline | ClothoidSpline):
            self._add_trajectory(tables, row, self._rows[id(track)], track)

    def _add_trajectory(self, tables: TrackTable, table_row: int, row: int, track: Polyline | ClothoidSpline) -> None:
        self._trajectory_versions[row] = (track, track.version)
        tables.size[table_row], tables.has_times[table_row], tables.is_uniform[table_row] = (
            track.x.shape[1],
            track.times is not None,
            track.is_uniform,
        )
        if isinstance(track, Polyline):
            tables.kind[table_row], tables.is_closed[table_row] = POLYLINE_TRACK, track.closed
            tables.heading_interpolation[table_row] = HEADING_INTERPOLATIONS.index(track.heading_interpolation)
            arrays = [getattr(track, name) for name in _POLYLINE_ARRAYS]
        else:
            tables.kind[table_row], tables.n_curvatures[table_row] = CLOTHOID_TRACK, track.segment_distances.shape[1]
            arrays = [
                track.segment_distances,
                track.x,
                track.y,
                track.heading,
                track.lengths,
                track.chord_length,
                track.times,
                track.last_chord,
            ]
        for column, array in enumerate(arrays):
            tables.addresses[table_row, column] = 0 if array is None else memory_address(array)


def _empty_tables(count: int) -> TrackTable:
    """Tables of `count` tracks without kernels, for no entities."""
    integers = [np.zeros(count, dtype=np.int64) for _ in range(3)]
    return TrackTable(
        np.full((0, 1), -1),
        np.full(count, PYTHON_TRACK),
        np.zeros((count, N_COLUMNS), dtype=np.int64),
        integers[0],
        integers[1],
        np.full(count, np.nan),
        np.full(count, np.nan),
        np.full((count, 2), np.nan),
        np.zeros(count, dtype=np.bool_),
        np.zeros(count, dtype=np.bool_),
        integers[2],
        np.zeros(count, dtype=np.bool_),
    )
