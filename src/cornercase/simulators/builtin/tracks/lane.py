"""The way along a lane and those that follow it."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray, IntArray
from cornercase.roads import LanePath, RoadNetwork
from cornercase.simulators.builtin.tracks.lane_kernels import advance_on_path
from cornercase.simulators.builtin.tracks.nearest_kernels import nearest_on_path
from cornercase.simulators.builtin.tracks.track import Pose, Track

# So far before the place where a path is cut, in m, an entity goes over to one that leads on.
_AHEAD: Final = 1000.0
_BACK: Final = 250.0


class LaneTrack(Track):
    """The centre line of a lane and of those that follow it, the same for all scenarios.

    Attributes
    ----------
    path : LanePath
    length : float
        m.
    span : tuple of (float, float)
        Distances in m between which it is followed; beyond them another one leads on.
    goes_over : bool
        Whether another one leads on at all.
    """

    def __init__(self, path: LanePath) -> None:
        self.path = path
        self.length = float(path.distance[-1])
        begin, end = path.lane_span
        # Where the path is cut at an end, it is left between its own lane and that end.
        self.span = (
            -np.inf if path.begins else min(_BACK, 0.5 * begin),
            np.inf if path.ends else self.length - min(_AHEAD, 0.5 * (self.length - end)),
        )
        self.goes_over = not (path.begins and path.ends)

    @classmethod
    def of_lane(
        cls, network: RoadNetwork, road: int, lane: int, s: float, along: bool, via: tuple[tuple[int, int, float], ...]
    ) -> LaneTrack | None:
        """Track that passes a place on a lane, in the direction of s or against it; None where there is no lane."""
        path = network.path_of_lane(road, lane, s, along, via)
        return None if path is None else cls(path)

    def distance_of(self, s: FloatArray) -> FloatArray:
        """Distance along the track of coordinates s on the road that it was made for."""
        return self.path.distance_at(s)

    def at(self, distance: FloatArray, offset: FloatArray, rows: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        x, y, heading, _ = self.path.at(distance, offset)
        return x, y, heading

    def curvature(self, distance: FloatArray, rows: IntArray) -> FloatArray:
        return self.path.at(distance, np.zeros_like(distance))[3]

    def advance(self, distance: FloatArray, offset: FloatArray, way: FloatArray) -> FloatArray:
        """Distance along the track after a step, each (R,) in m.

        As in esmini, a step is a step along the reference line of the road, which lengthens or shortens it as the bend
        at its begin does. Where the bend changes, and where the lane runs aslant, the way that is driven is another: if
        it is so by more than 0.1 %, the step is one along the lane.
        """
        path = self.path
        return np.asarray(advance_on_path(path.addresses, path.x.size, path.bend_at.size, distance, offset, way))

    def nearest(self, x: FloatArray, y: FloatArray, rows: IntArray, after: FloatArray | None = None) -> FloatArray:
        path, first = self.path, np.full(len(x), -np.inf) if after is None else after
        return np.asarray(nearest_on_path(path.addresses, path.x.size, path.chord, x, y, first))

    def lane_pose(self, pose: Pose, rows: IntArray, distance: FloatArray, offset: FloatArray) -> Pose:
        """Return `pose` with the road coordinates of `rows` as they are on this track."""
        assert pose.road is not None
        assert pose.lane is not None
        assert pose.s is not None
        assert pose.offset is not None
        sample = self.path.sample_at(distance)
        road, lane, s, t = pose.road.copy(), pose.lane.copy(), pose.s.copy(), pose.offset.copy()
        road[rows], lane[rows] = self.path.road[sample], self.path.lane[sample]
        s[rows] = self.path.s_at(distance)
        t[rows] = np.where(self.path.along[sample], offset, -offset)
        return replace(pose, road=road, lane=lane, s=s, offset=t)
