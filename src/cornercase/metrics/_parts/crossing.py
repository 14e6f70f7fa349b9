"""Where the tracks of two entities cross, and how far both still have to go there."""

from __future__ import annotations

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics._parts.crossing_kernel import find_crossings
from cornercase.recordings import Recording

_REACH = 1e-6
"""How far in m a track may end short of the other and still meet it: rounding opens no gap at a vertex."""

_STILL = 1e-9
"""Steps in m that are rounding, and have no direction."""

_PARALLEL = 1e-6
"""Sine of the angle below which two pieces of track run beside each other and do not cross."""

_MOST = 256
"""Crossings for which there is room at first."""


def ways_to_crossing(recording: Recording, ego: str, other: str, ahead: float) -> tuple[FloatArray, FloatArray]:
    """How far both still have to go to the crossing of their tracks that lies ahead of both.

    Parameters
    ----------
    recording : Recording
    ego, other : str
    ahead : float
        How far each track goes straight on after the recording, in m.

    Returns
    -------
    ndarray of float64, shape (T,)
        Of the ego, in m; of several crossings the one with the smallest sum of both. NaN where there is none.
    ndarray of float64, shape (T,)
        Of the other.
    """
    tracks = _Track(recording, ego, ahead), _Track(recording, other, ahead)
    crossings = _crossings(*tracks)
    left_mine, left_other = (on[:, None] - track.driven for on, track in zip(crossings, tracks, strict=True))
    open_ = (left_mine >= -_REACH) & (left_other >= -_REACH)
    both = np.where(open_, np.maximum(left_mine, 0.0) + np.maximum(left_other, 0.0), np.inf)
    if not len(both):
        nothing = np.full(len(recording.time), np.nan)
        return nothing, nothing
    nearest = both.argmin(0), np.arange(both.shape[1])
    found = np.isfinite(both[nearest])
    return (
        np.where(found, np.maximum(left_mine[nearest], 0.0), np.nan),
        np.where(found, np.maximum(left_other[nearest], 0.0), np.nan),
    )


class _Track:
    """Polyline of an entity's centre, and how far along it the entity is at each instant."""

    def __init__(self, recording: Recording, name: str, ahead: float) -> None:
        center, heading = recording.center(name), recording.heading[recording.index(name)]
        exists = np.flatnonzero(np.isfinite(center).all(-1))
        points = center[exists]
        along = np.concatenate([np.zeros(min(len(exists), 1)), _lengths(points).cumsum()])
        self.driven = np.full(len(center), np.nan)
        self.driven[exists] = along
        if len(exists):
            last = heading[exists[-1]]
            tip = points[-1] + ahead * np.array([np.cos(last), np.sin(last)])
            points, along = np.vstack([points, tip]), np.append(along, along[-1] + ahead)
        moves = np.flatnonzero(_lengths(points) > _STILL)
        self.start, self.step, self.along = points[moves], points[moves + 1] - points[moves], along[moves]

    def pieces(self) -> FloatArray:
        """Start, direction and length of each piece, and how far along it begins, (n, 6)."""
        length = np.hypot(*self.step.T)
        return np.column_stack([self.start, self.step / length[:, None], length, self.along])


def _lengths(points: FloatArray) -> FloatArray:
    steps = np.diff(points, axis=0)
    return np.hypot(steps[:, 0], steps[:, 1])


def _crossings(a: _Track, b: _Track) -> tuple[FloatArray, FloatArray]:
    """Where the tracks cross, as lengths along each, shape (K,)."""
    pieces = a.pieces(), b.pieces()
    most = _MOST
    while True:
        found = np.empty((2, most))
        count = find_crossings(*pieces, _PARALLEL, _REACH, found)
        if count <= most:
            return found[0, :count], found[1, :count]
        most = count
