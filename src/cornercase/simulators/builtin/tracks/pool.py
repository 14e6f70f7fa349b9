"""All tracks of a batch, as kernels read them."""

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
"""Kind of a track along the chords of a spline."""
OTHER: Final = 3
"""Kind of a track that kernels do not know."""

_LINE_ARRAYS: Final = ("distance", "x", "y", "heading", "directions", "facing", "time", "speeds", "rates")

TURNINGS: Final = (ALONG_LEGS, AT_CORNERS, AT_VERTICES)
"""Where the heading turns along a line, in the order of `Tracks.turning`."""


class Tracks(NamedTuple):
    """Tables of G tracks of E entities, as these are until one is started again.

    Attributes
    ----------
    row : ndarray of int64, shape (E, K)
        Which of the tracks each track of each entity is; -1 where it has fewer.
    kind : ndarray of int64, shape (G,)
        `LANE`, `LINE`, `CHORDS` or `OTHER`.
    address : ndarray of int64, shape (G, 14)
        Where its arrays lie.
    size : ndarray of int64, shape (G,)
        Samples of a lane, vertices of a line, ends of a spline's chords.
    bends : ndarray of int64, shape (G,)
        Places along a lane at which the bend of the reference line is known; ends of a spline's segments.
    chord : ndarray of float64, shape (G,)
        Largest gap between two samples of a lane that follow each other, in m.
    length : ndarray of float64, shape (G,)
        Length of a lane in m; NaN for others, which differ from scenario to scenario.
    span : ndarray of float64, shape (G, 2)
        Distances in m between which a lane is followed; beyond them another one leads on.
    closed, timed : ndarray of bool, shape (G,)
        Whether a line goes on from its end to its start, and whether a line or spline has a clock.
    turning : ndarray of int64, shape (G,)
        Where the heading turns along a line, as place in `TURNINGS`.
    alike : ndarray of bool, shape (G,)
        Whether a line or the chords of a spline are the same in all scenarios, so that one row stands for all.
    """

    row: IntArray
    kind: IntArray
    address: IntArray
    size: IntArray
    bends: IntArray
    chord: FloatArray
    length: FloatArray
    span: FloatArray
    closed: BoolArray
    timed: BoolArray
    turning: IntArray
    alike: BoolArray


class TrackPool:
    """Keeps the tracks of all entities of a batch together for kernels.

    Attributes
    ----------
    tracks : Tracks
        As of the last `gather`.
    """

    def __init__(self) -> None:
        self._counts: list[int] | None = None
        self._rows: dict[int, int] = {}
        # The tables hold addresses of what these hold.
        self._held: list[Track] = []
        # What is started again can run otherwise then: by row, and as of which version.
        self._drawn: dict[int, tuple[Polyline | ClothoidSpline, int]] = {}
        self.tracks = _tables(0)

    def gather(self, followed: Sequence[Sequence[Track]]) -> Tracks:
        """Return tables of the tracks of each entity: the same as before where none has come.

        Parameters
        ----------
        followed : sequence of sequence of Track
            By entity; of a pool asked before, only longer than then.

        Returns
        -------
        Tracks
        """
        counts = [len(tracks) for tracks in followed]
        for g, (drawn, version) in self._drawn.items():
            if drawn.version != version:
                self._enter_drawn(self.tracks, g, g, drawn)
        if counts == self._counts:
            return self.tracks
        new = {id(track): track for tracks in followed for track in tracks if id(track) not in self._rows}
        self._rows.update(zip(new, range(len(self._rows), len(self._rows) + len(new)), strict=True))
        tables = _tables(len(new))
        for g, track in enumerate(new.values()):
            self._enter(tables, g, track)
        row = np.full((len(followed), max([*counts, 1])), -1)
        for e, tracks in enumerate(followed):
            row[e, : len(tracks)] = [self._rows[id(track)] for track in tracks]
        joined = (np.concatenate(pair) for pair in zip(self.tracks[1:], tables[1:], strict=True))
        self.tracks, self._counts = Tracks(row, *joined), counts
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
    """Tables of so many tracks that kernels do not know, of no entity."""
    whole = [np.zeros(count, dtype=np.int64) for _ in range(3)]
    return Tracks(
        np.full((0, 1), -1),
        np.full(count, OTHER),
        np.zeros((count, COLUMNS), dtype=np.int64),
        whole[0],
        whole[1],
        np.full(count, np.nan),
        np.full(count, np.nan),
        np.full((count, 2), np.nan),
        np.zeros(count, dtype=np.bool_),
        np.zeros(count, dtype=np.bool_),
        whole[2],
        np.zeros(count, dtype=np.bool_),
    )
