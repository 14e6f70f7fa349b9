"""A track along a lane and its successors."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray, IntArray
from cornercase.drivers._lanes import driven_path
from cornercase.drivers._path_tracking import locate_on_path
from cornercase.roads._lane_path import LanePath
from cornercase.roads._network import RoadNetwork
from cornercase.simulators.builtin.track_kernels._lane_track import advance_on_lane_path
from cornercase.simulators.builtin.track_kernels._projection import project_on_lane_path
from cornercase.simulators.builtin.track_kernels._track_layout import LANE_TRACK, TrackTable, alloc_track_table
from cornercase.simulators.builtin.tracks._track import Pose, Track

# m; largest distances from the cut ends of a path at which an entity changes to the next path.
_MAX_MARGIN_AHEAD: Final = 1000.0
_MAX_MARGIN_BEHIND: Final = 250.0


class LaneTrack(Track):
    """The centre line of a lane and its successors, the same in all scenarios.

    `span` is the range of distances in m in which entities follow the track. Beyond this range, entities change to
    another track if `is_continued`.
    """

    def __init__(self, path: LanePath) -> None:
        self.path = path
        self.length = float(path.distance[-1])
        begin, end = path.lane_span
        # A path that is cut is left at most halfway between its own lane and the cut.
        self.span = (
            -np.inf if path.has_start else min(_MAX_MARGIN_BEHIND, 0.5 * begin),
            np.inf if path.has_end else self.length - min(_MAX_MARGIN_AHEAD, 0.5 * (self.length - end)),
        )
        self.is_continued = not (path.has_start and path.has_end)

    @classmethod
    def from_lane(
        cls, network: RoadNetwork, road: int, lane: int, s: float, along: bool, via: tuple[tuple[int, int, float], ...]
    ) -> LaneTrack | None:
        """Return the track through a point on a lane, along s or against s; None if the lane does not exist there."""
        path = network.lane_path_from(road, lane, s, along, via)
        return None if path is None else cls(path)

    def _make_table(self) -> TrackTable:
        table, path = alloc_track_table(1), self.path
        table.kind[0], table.addresses[0] = LANE_TRACK, path.array_addresses
        table.size[0], table.n_curvatures[0] = path.x.size, path.curvature_distance.size
        table.max_sample_gap[0], table.length[0], table.span[0] = path.max_chord, self.length, self.span
        return table

    def distance_at_s(self, s: FloatArray) -> FloatArray:
        """Return the distance along the track in m, for a coordinate s of the road for which the track was created."""
        return self.path.distance_of_s(s)

    def s_at(self, distance: FloatArray) -> FloatArray:
        """Return the road coordinate s at distances along the track, in m, shape (R,)."""
        return self.evaluate(distance, np.zeros_like(distance), np.zeros(distance.shape, dtype=np.int64)).s

    def advance(self, distance: FloatArray, offset: FloatArray, step: FloatArray) -> FloatArray:
        """Return the distance along the track in m after entities have moved by `step` m, shape (R,).

        As in esmini, the step is made along the reference line of the road, scaled by a factor, since an entity beside
        this line covers another length in a bend. The factor follows from the curvature at the start of the step. If
        the entity would then cover a length that differs from `step` by more than 0.1 %, the step is made along the
        lane instead. That happens if the curvature changes, or if the lane is not parallel to the reference line. A
        step over a sideways jump of the lane is always made along the reference line.
        """
        path = self.path
        return np.asarray(
            advance_on_lane_path(
                path.array_addresses, path.x.size, path.curvature_distance.size, distance, offset, step
            )
        )

    def nearest_distance(
        self, x: FloatArray, y: FloatArray, rows: IntArray, after: FloatArray | None = None
    ) -> FloatArray:
        path, start = self.path, np.full(len(x), -np.inf) if after is None else after
        return np.asarray(project_on_lane_path(path.array_addresses, path.x.size, path.max_chord, x, y, start))

    def project_moving_point(self, x: FloatArray, y: FloatArray, rows: IntArray, before: FloatArray) -> FloatArray:
        along = locate_on_path(driven_path(self.path), before, x, y, np.zeros_like(x), np.zeros_like(x)).along
        return np.minimum(np.maximum(along, 0.0), self.length)

    def update_road_coordinates(self, pose: Pose, rows: IntArray, distance: FloatArray, offset: FloatArray) -> Pose:
        """Return `pose` with road coordinates from distances and offsets along this track in the scenarios `rows`."""
        assert pose.offset is not None
        sample = self.path.sample_index(distance)
        road, lane, s = pose.road_coordinates()
        road, lane, s, t = road.copy(), lane.copy(), s.copy(), pose.offset.copy()
        road[rows], lane[rows] = self.path.road[sample], self.path.lane[sample]
        s[rows] = self.s_at(distance)
        t[rows] = np.where(self.path.forward[sample], offset, -offset)
        return replace(pose, road=road, lane=lane, s=s, offset=t)
