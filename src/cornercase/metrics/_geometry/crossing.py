"""Crossing of the tracks of two entities, and the distances of both entities to the crossing."""

from __future__ import annotations

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics._geometry.crossing_kernel import find_track_crossings
from cornercase.recordings import Recording

REACH = 1e-6
"""Distance in m by which a track may miss the other track and still cross it.

So rounding errors open no gap at a vertex.
"""

_MIN_STEP = 1e-9
"""Steps in m up to this length are rounding errors without a direction."""

_PARALLEL = 1e-6
"""Sine of the angle up to which two pieces of track are parallel and do not cross."""

_STANDING_SPEED = 0.1
"""Speed in m/s below which an entity does not move forwards or backwards."""

_INITIAL_CAPACITY = 256


def distances_to_crossing(recording: Recording, ego: str, other: str, ahead: float) -> tuple[FloatArray, FloatArray]:
    """Return the distances of ego and other to the crossing of their tracks ahead, in m, shape (T,) each.

    If several crossings lie ahead of both, the crossing with the smallest sum of both distances counts. NaN if no
    crossing lies ahead of both. Each track goes straight on for `ahead` m after the last recorded centre, backwards if
    the entity last moved backwards.
    """
    tracks = _CenterTrack(recording, ego, ahead), _CenterTrack(recording, other, ahead)
    crossings = _crossing_distances(*tracks)
    to_ego, to_other = (along[:, None] - track.distance_at for along, track in zip(crossings, tracks, strict=True))
    is_ahead = (to_ego >= -REACH) & (to_other >= -REACH)
    total = np.where(is_ahead, np.maximum(to_ego, 0.0) + np.maximum(to_other, 0.0), np.inf)
    if not len(total):
        undefined = np.full(len(recording.time), np.nan)
        return undefined, undefined
    nearest = total.argmin(0), np.arange(total.shape[1])
    exists = np.isfinite(total[nearest])
    return (
        np.where(exists, np.maximum(to_ego[nearest], 0.0), np.nan),
        np.where(exists, np.maximum(to_other[nearest], 0.0), np.nan),
    )


class _CenterTrack:
    """Polyline through the recorded centres of an entity's box, and the distance along it at each instant.

    After the last centre, the line goes straight on for `ahead` m, backwards if the entity last moved backwards.
    """

    def __init__(self, recording: Recording, name: str, ahead: float) -> None:
        k, center = recording.entity_index(name), recording.box_center(name)
        heading, speed = recording.heading[k], recording.speed[k]
        exists = np.flatnonzero(np.isfinite(center).all(-1))
        points = center[exists]
        along = np.concatenate([np.zeros(min(len(exists), 1)), _segment_lengths(points).cumsum()])
        self.distance_at = np.full(len(center), np.nan)
        self.distance_at[exists] = along
        if len(exists):
            last = heading[exists[-1]]
            moving_speeds = speed[np.abs(speed) >= _STANDING_SPEED]
            signed_ahead = -ahead if (moving_speeds[-1:] < 0.0).any() else ahead
            tip = points[-1] + signed_ahead * np.array([np.cos(last), np.sin(last)])
            points, along = np.vstack([points, tip]), np.append(along, along[-1] + ahead)
        moves = np.flatnonzero(_segment_lengths(points) > _MIN_STEP)
        self.start, self.step, self.piece_distance = points[moves], points[moves + 1] - points[moves], along[moves]

    def pieces_as_array(self) -> FloatArray:
        """Return the n straight pieces of the polyline, shape (n, 6).

        Columns: x and y of the start, x and y of the unit direction, length, and distance of the start along the track.
        """
        length = np.hypot(*self.step.T)
        return np.column_stack([self.start, self.step / length[:, None], length, self.piece_distance])


def _segment_lengths(points: FloatArray) -> FloatArray:
    steps = np.diff(points, axis=0)
    return np.hypot(steps[:, 0], steps[:, 1])


def _crossing_distances(a: _CenterTrack, b: _CenterTrack) -> tuple[FloatArray, FloatArray]:
    """Return the distances along the tracks `a` and `b` to each of their K crossings in m, shape (K,) each."""
    pieces = a.pieces_as_array(), b.pieces_as_array()
    capacity = _INITIAL_CAPACITY
    while True:
        distances = np.empty((2, capacity))
        count = find_track_crossings(*pieces, _PARALLEL, REACH, distances)
        if count <= capacity:
            return distances[0, :count], distances[1, :count]
        capacity = count
