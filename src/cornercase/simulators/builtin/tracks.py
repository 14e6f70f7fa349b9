"""What entities move along: lanes through the road network, and trajectories."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Protocol

import numpy as np

from cornercase.scenario.lane_path import LanePath
from cornercase.scenario.opendrive import RoadNetwork
from cornercase.typing import BoolArray, FloatArray, IntArray

FREE: Final = -1

# Half of the stretch over which the heading turns at a corner of a polyline, in m; esmini's figure.
_CORNER: Final = 2.0


@dataclass(frozen=True, eq=False)
class Pose:
    """A place for each scenario.

    Attributes
    ----------
    x, y, heading : ndarray of float64, shape (N,)
    road : ndarray of int64, shape (N,), optional
        Index of the road in the network.
    lane : ndarray of int64, shape (N,), optional
    s, offset : ndarray of float64, shape (N,), optional
        Along the road, and to the left of the lane's centre as seen along the road, in m.
    """

    x: FloatArray
    y: FloatArray
    heading: FloatArray
    road: IntArray | None = None
    lane: IntArray | None = None
    s: FloatArray | None = None
    offset: FloatArray | None = None


class Track(Protocol):
    """A curve that an entity follows, by the distance along it.

    Attributes
    ----------
    ends : bool
        Whether the entity stops at the end; otherwise it goes straight on.
    length : float
        m; the longest one, where it differs between scenarios.
    """

    ends: bool
    length: float

    def at(self, distance: FloatArray, offset: FloatArray, rows: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return x, y and heading at distances, each (R,), for the scenarios `rows`."""
        ...

    def nearest(self, x: FloatArray, y: FloatArray, rows: IntArray) -> FloatArray:
        """Distance along the track of the point of it that is nearest to (x, y), each (R,)."""
        ...


class LaneTrack:
    """The centre line of a lane and of those that follow it, the same for all scenarios."""

    ends = True

    def __init__(self, path: LanePath, key: tuple[object, ...], side: float) -> None:
        self.path = path
        self.key = key
        self.side = side
        self.length = float(path.distance[-1])

    @classmethod
    def of_lane(
        cls, network: RoadNetwork, road: int, lane: int, via: tuple[tuple[int, int, float], ...] = ()
    ) -> LaneTrack | None:
        """Track from the beginning of a lane; None where the lane does not exist."""
        path = network.path_of_lane(road, lane, via)
        if path is None:
            return None
        key = (road, lane, *via)
        return cls(path, key, 1.0 if network.runs_along(road, lane) else -1.0)

    def agrees(self, distance: FloatArray, heading: FloatArray) -> BoolArray:
        """Whether headings point along the track rather than across or against it, shape (R,)."""
        _, _, along = self.at(distance, np.zeros_like(distance), np.arange(len(distance)))
        return np.asarray(np.cos(heading - along) > 0.5)

    def distance_of(self, s: FloatArray) -> FloatArray:
        """Distance along the track of coordinates s on its first road."""
        return np.asarray(self.side * (s - self.path.s[0]))

    def at(self, distance: FloatArray, offset: FloatArray, rows: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        x, y, heading, _ = self.path.at(distance, offset)
        return x, y, heading

    def nearest(self, x: FloatArray, y: FloatArray, rows: IntArray) -> FloatArray:
        return _nearest(
            np.broadcast_to(self.path.x, (len(x), self.path.x.size)),
            np.broadcast_to(self.path.y, (len(x), self.path.y.size)),
            np.broadcast_to(self.path.distance, (len(x), self.path.x.size)),
            x,
            y,
        )

    def lane_pose(self, pose: Pose, rows: IntArray, distance: FloatArray, offset: FloatArray) -> Pose:
        """Return `pose` with the road coordinates of `rows` as they are on this track."""
        assert pose.road is not None
        assert pose.lane is not None
        assert pose.s is not None
        assert pose.offset is not None
        sample = np.clip(np.searchsorted(self.path.distance, distance, "right") - 1, 0, self.path.x.size - 1)
        road, lane, s, t = pose.road.copy(), pose.lane.copy(), pose.s.copy(), pose.offset.copy()
        road[rows], lane[rows] = self.path.road[sample], self.path.lane[sample]
        beyond = distance - self.path.distance[sample]
        along = np.where(self.path.along[sample], 1.0, -1.0)
        s[rows] = self.path.s[sample] + along * beyond
        t[rows] = along * offset
        return replace(pose, road=road, lane=lane, s=s, offset=t)


class Polyline:
    """A trajectory through vertices, which may differ between scenarios.

    Parameters
    ----------
    x, y : ndarray of float64, shape (N, V)
        Vertices in m.
    heading : ndarray of float64, shape (N, V)
        rad; NaN where the file gives none and the heading follows the line.
    time : ndarray of float64, shape (N, V), optional
        s, not decreasing.
    """

    ends = False

    def __init__(self, x: FloatArray, y: FloatArray, heading: FloatArray, time: FloatArray | None) -> None:
        self.x, self.y, self.heading, self.time = x, y, heading, time
        legs = np.hypot(np.diff(x), np.diff(y))
        self.distance = np.concatenate([np.zeros((len(x), 1)), np.cumsum(legs, axis=1)], axis=1)
        self.length = float(self.distance[:, -1].max())
        self.lengths = self.distance[:, -1]
        self._direction = np.unwrap(np.arctan2(np.diff(y), np.diff(x)), axis=1)

    def at(self, distance: FloatArray, offset: FloatArray, rows: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        along, leg, part = self._leg(distance, rows)
        x0, y0 = self.x[rows, leg], self.y[rows, leg]
        x = x0 + part * (self.x[rows, leg + 1] - x0)
        y = y0 + part * (self.y[rows, leg + 1] - y0)
        direction = self._direction[rows, leg]
        beyond = distance - along
        x, y = x + beyond * np.cos(direction), y + beyond * np.sin(direction)
        heading = self._heading(along, leg, part, rows)
        return x - offset * np.sin(direction), y + offset * np.cos(direction), heading

    def nearest(self, x: FloatArray, y: FloatArray, rows: IntArray) -> FloatArray:
        return _nearest(self.x[rows], self.y[rows], self.distance[rows], x, y)

    def distance_at(self, time: FloatArray) -> FloatArray:
        """Distance along the trajectory at times of its own clock, both (N,)."""
        assert self.time is not None
        rows = np.arange(len(time))
        last = self.time.shape[1] - 2
        leg = np.clip((self.time <= time[:, None]).sum(axis=1) - 1, 0, last)
        t0, t1 = self.time[rows, leg], self.time[rows, leg + 1]
        part = np.clip((time - t0) / np.where(t1 > t0, t1 - t0, 1.0), 0.0, 1.0)
        d0 = self.distance[rows, leg]
        return np.asarray(d0 + part * (self.distance[rows, leg + 1] - d0))

    def _leg(self, distance: FloatArray, rows: IntArray) -> tuple[FloatArray, IntArray, FloatArray]:
        table = self.distance[rows]
        along = np.clip(distance, 0.0, table[:, -1])
        leg = np.clip((table <= along[:, None]).sum(axis=1) - 1, 0, table.shape[1] - 2)
        each = np.arange(len(rows))
        span = table[each, leg + 1] - table[each, leg]
        part = (along - table[each, leg]) / np.where(span > 0, span, 1.0)
        return along, leg, part

    def _heading(self, along: FloatArray, leg: IntArray, part: FloatArray, rows: IntArray) -> FloatArray:
        given0, given1 = self.heading[rows, leg], self.heading[rows, leg + 1]
        turn = (given1 - given0 + np.pi) % (2 * np.pi) - np.pi
        heading = self._direction[rows, leg]
        table = self.distance[rows]
        each = np.arange(len(rows))
        for side in (0, 1):
            corner = leg + side
            neighbour = np.clip(leg - 1 if side == 0 else leg + 1, 0, self._direction.shape[1] - 1)
            difference = self._direction[rows, neighbour] - self._direction[rows, leg]
            reach = np.minimum(_CORNER, 0.5 * (table[each, leg + 1] - table[each, leg]))
            away = np.abs(along - table[each, corner])
            close = (away < reach) & (neighbour != leg)
            share = 0.5 * (1.0 - away / np.where(reach > 0, reach, 1.0))
            heading = heading + np.where(close, share * difference, 0.0)
        return np.where(np.isnan(given0 + given1), heading, given0 + part * turn)


def _nearest(px: FloatArray, py: FloatArray, distance: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    dx, dy = np.diff(px), np.diff(py)
    squared = np.maximum(dx * dx + dy * dy, 1e-30)
    part = np.clip(((x[:, None] - px[:, :-1]) * dx + (y[:, None] - py[:, :-1]) * dy) / squared, 0.0, 1.0)
    gap = np.hypot(px[:, :-1] + part * dx - x[:, None], py[:, :-1] + part * dy - y[:, None])
    best = gap.argmin(axis=1)
    rows = np.arange(len(x))
    return np.asarray(distance[rows, best] + part[rows, best] * np.diff(distance)[rows, best])
