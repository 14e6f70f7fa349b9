"""Tables of all tracks of a batch for compiled code."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from cornercase._common.addresses import address_of
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.simulators.builtin.tracks.clothoids import ClothoidSpline
from cornercase.simulators.builtin.tracks.columns import COLUMNS
from cornercase.simulators.builtin.tracks.lane import LaneTrack
from cornercase.simulators.builtin.tracks.polyline import Polyline
from cornercase.simulators.builtin.tracks.track import ALONG_LEGS, AT_CORNERS, AT_VERTICES, Track

LANE: Final = 0
"""Kind of a track along lanes."""
LINE: Final = 1
"""Kind of a track through vertices."""
CHORDS: Final = 2
"""Kind of a track along the chords of a clothoid spline."""
OTHER: Final = 3
"""Kind of a track without kernels."""

_LINE_ARRAYS: Final = ("distance", "x", "y", "heading", "directions", "facing", "time", "speeds", "rates")

TURNINGS: Final = (ALONG_LEGS, AT_CORNERS, AT_VERTICES)
"""Heading interpolations of a polyline, indexed by `TrackTable.heading_interpolation`."""


class Tracks(NamedTuple):
    """Tables of G tracks of E entities."""

    row: IntArray  # (E, K): index of each entity's tracks among all tracks; -1 for none
    kind: IntArray  # (G,): `LANE_TRACK`, `POLYLINE_TRACK`, `CLOTHOID_TRACK` or `PYTHON_TRACK`
    address: IntArray  # (G, 14): memory addresses of its arrays, see `_track_layout`
    size: IntArray  # (G,): samples of a lane, vertices of a polyline, chord ends of a spline
    bends: IntArray  # (G,): curvature samples of a lane's reference line; segment ends of a spline
    chord: FloatArray  # (G,): largest gap in m between consecutive samples of a lane
    length: FloatArray  # (G,): of a lane in m; NaN for others, which depend on the scenario
    span: FloatArray  # (G, 2): distances in m between which a lane is followed; beyond, another track continues
    closed: BoolArray  # (G,): whether a polyline is a loop
    timed: BoolArray  # (G,): whether a trajectory has times
    turning: IntArray  # (G,): index into `HEADING_INTERPOLATIONS`, of a polyline
    alike: BoolArray  # (G,): whether a trajectory is the same in all scenarios, and stored in one row


class TrackPool:
    """Collects the tracks of all entities of a batch for compiled code; `tracks` are the latest tables."""

    def __init__(self) -> None:
        self._counts: list[int] | None = None
        self._rows: dict[int, int] = {}
        # Keeps the arrays alive whose addresses are in the tables.
        self._held: list[Track] = []
        # By row: trajectories that may change when they are restarted, and their version.
        self._drawn: dict[int, tuple[Polyline | ClothoidSpline, int]] = {}
        self.tracks = _tables(0)

    def gather(self, followed: Sequence[Sequence[Track]]) -> Tracks:
        """Return the tables of each entity's tracks; rebuilt only if tracks were added or changed.

        `tracks_by_entity` lists the tracks by entity; compared to earlier calls it may only grow.
        """
        counts = [len(tracks) for tracks in followed]
        for g, (trajectory, version) in self._drawn.items():
            if trajectory.version != version:
                self._enter_drawn(self.tracks, g, g, trajectory)
        if counts == self._counts:
            return self.tracks
        new_tracks = {id(track): track for tracks in followed for track in tracks if id(track) not in self._rows}
        self._rows.update(zip(new_tracks, range(len(self._rows), len(self._rows) + len(new_tracks)), strict=True))
        tables = _tables(len(new_tracks))
        for g, track in enumerate(new_tracks.values()):
            self._enter(tables, g, track)
        row = np.full((len(followed), max([*counts, 1])), -1)
        for e, tracks in enumerate(followed):
            row[e, : len(tracks)] = [self._rows[id(track)] for track in tracks]
        columns = (np.concatenate(pair) for pair in zip(self.tracks[1:], tables[1:], strict=True))
        self.tracks, self._counts = Tracks(row, *columns), counts
        return self.tracks

    def _enter(self, tables: Tracks, g: int, track: Track) -> None:
        self._held.append(track)
        if isinstance(track, LaneTrack):
            path = track.path
            tables.kind[g], tables.size[g], tables.bends[g] = LANE, path.x.size, path.bend_at.size
            tables.chord[g], tables.length[g], tables.span[g] = path.chord, track.length, track.span
            tables.address[g] = path.addresses
        elif isinstance(track, Polyline | ClothoidSpline):
            self._enter_drawn(tables, g, self._rows[id(track)], track)

    def _enter_drawn(self, tables: Tracks, g: int, row: int, track: Polyline | ClothoidSpline) -> None:
        self._drawn[row] = (track, track.version)
        tables.size[g], tables.timed[g], tables.alike[g] = track.x.shape[1], track.time is not None, track.alike
        if isinstance(track, Polyline):
            tables.kind[g], tables.closed[g] = LINE, track.closed
            tables.turning[g] = TURNINGS.index(track.turning)
            arrays = [getattr(track, name) for name in _LINE_ARRAYS]
        else:
            tables.kind[g], tables.bends[g] = CHORDS, track.begin.shape[1]
            arrays = [track.begin, track.x, track.y, track.heading, track.lengths, track.chord, track.time, track.last]
        for column, array in enumerate(arrays):
            tables.address[g, column] = 0 if array is None else address_of(array)


def _tables(count: int) -> Tracks:
    """Tables of `count` tracks without kernels, for no entities."""
    integers = [np.zeros(count, dtype=np.int64) for _ in range(3)]
    return Tracks(
        np.full((0, 1), -1),
        np.full(count, OTHER),
        np.zeros((count, COLUMNS), dtype=np.int64),
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
