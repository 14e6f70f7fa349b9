"""Table of all tracks in a batch of scenarios, for kernels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cornercase.simulators.builtin.track_kernels._track_layout import TrackTable, alloc_track_table
from cornercase.simulators.builtin.tracks._track import Track


class TrackPool:
    """Collector of the tracks of all entities in a batch of scenarios, as one table for kernels."""

    def __init__(self) -> None:
        self._counts: list[int] | None = None
        # Row of each track by its identity, with the track itself, so that it stays alive.
        self._rows: dict[int, tuple[int, Track]] = {}
        # The table from which each row was copied.
        self._copied: list[TrackTable] = []
        self._tracks = alloc_track_table(0)

    def update(self, tracks_by_entity: Sequence[Sequence[Track]]) -> TrackTable:
        """Return the table of all tracks, given the tracks of each entity.

        Since the last call, tracks may have been added, but not removed. The result is a new object only if some were
        added.
        """
        counts = [len(tracks) for tracks in tracks_by_entity]
        for g, track in self._rows.values():
            if track.table is not self._copied[g]:
                self._copied[g] = track.table
                for column, values in zip(self._tracks[1:], track.table[1:], strict=True):
                    column[g] = values[0]
        if counts == self._counts:
            return self._tracks
        for track in (track for tracks in tracks_by_entity for track in tracks):
            if id(track) not in self._rows:
                self._rows[id(track)] = len(self._copied), track
                self._copied.append(track.table)
        rows = np.full((len(tracks_by_entity), max([*counts, 1])), -1)
        for e, tracks in enumerate(tracks_by_entity):
            rows[e, : len(tracks)] = [self._rows[id(track)][0] for track in tracks]
        columns = zip(alloc_track_table(0)[1:], *(table[1:] for table in self._copied), strict=True)
        self._tracks, self._counts = TrackTable(rows, *map(np.concatenate, columns)), counts
        return self._tracks
