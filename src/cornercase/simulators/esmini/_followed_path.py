"""The path that an entity follows in esmini, as its driver sees it."""

from __future__ import annotations

import ctypes
import math
from typing import Final

import numpy as np

from cornercase._common.geometry.boxes import is_facing_forward
from cornercase.drivers import DrivenPath
from cornercase.drivers._lanes import driven_path
from cornercase.roads._network import RoadNetwork
from cornercase.simulators.builtin.actions._controller import sample_trajectory
from cornercase.simulators.builtin.tracks._lane import LaneTrack
from cornercase.simulators.builtin.tracks._track import Track, Trajectory
from cornercase.simulators.esmini._library import ObjectState, read_road_name, read_route

# Distance in m from the lane's middle up to which another lane id may be due to a seam between lanes.
_SEAM_OFFSET: Final = 0.5
# Distance in m by which the nearest point of the path may move back in a time step.
_MAX_STEP_BACK: Final = 5.0
# Distance in m from the end of a road or a trajectory at which an entity has reached it.
_END_TOLERANCE: Final = 1e-3
# Length in m up to which a trajectory is sampled; no run goes farther.
_REACH: Final = 20_000.0
_ONE_ROW: Final = np.zeros(1, dtype=np.int64)


class FollowedPath:
    """The path that an entity follows: first its initial trajectory, if any, then the lane on which it drives.

    `path` is None if there is no lane. `distance` is the entity's position along the path in m.
    """

    def __init__(self, lib: ctypes.CDLL, network: RoadNetwork, trajectory: Trajectory | None) -> None:
        self._lib, self._network = lib, network
        self._track: Track | None = trajectory
        self._route: tuple[tuple[str, int, float], ...] = ()
        self.path: DrivenPath | None = None if trajectory is None else sample_trajectory(trajectory, _REACH)
        self.distance = 0.0

    @property
    def is_at_road_end(self) -> bool:
        """True if the entity has reached the end of its road."""
        track = self._track
        return isinstance(track, LaneTrack) and track.path.has_end and self.distance >= track.length - _END_TOLERANCE

    def update(self, state: ObjectState) -> None:
        """Locate the entity on its path, or find a new path along its lane if the entity has left its path."""
        track, route = self._track, read_route(self._lib, state.id)
        if isinstance(track, Trajectory):
            self._locate_on_track(track, state)
            if self.distance < track.lengths[0] - _END_TOLERANCE:
                return
        road = self._network.find_road(read_road_name(self._lib, state.road))
        if isinstance(track, LaneTrack) and route == self._route:
            self._locate_on_track(track, state)
            sample = track.path.sample_index(np.array([self.distance]))[0]
            on_lane = (road, state.lane) == (track.path.road[sample], track.path.lane[sample])
            on_lane = on_lane or abs(self._lateral_offset(track, state)) < _SEAM_OFFSET
            if on_lane and track.span[0] <= self.distance <= track.span[1]:
                return
        self._follow_lane(road, state, route)

    def move(self, state: ObjectState, step: float) -> None:
        """Let esmini move the entity by `step` m along its lane; do nothing if the entity follows a trajectory."""
        track = self._track
        if not isinstance(track, LaneTrack):
            return
        offset = self._lateral_offset(track, state)
        self.distance = float(track.advance(np.array([self.distance]), np.array([offset]), np.array([step]))[0])
        at = np.array([self.distance])
        sample = track.path.sample_index(at)[0]
        road = self._network.roads[int(track.path.road[sample])].road_id
        self._lib.SE_ReportObjectRoadPos(
            state.id,
            self._lib.SE_GetRoadIdFromString(road.encode()),
            int(track.path.lane[sample]),
            offset if track.path.forward[sample] else -offset,
            float(track.s_at(at)[0]),
        )

    def _follow_lane(self, road: int | None, state: ObjectState, route: tuple[tuple[str, int, float], ...]) -> None:
        network, s = self._network, np.array([state.s])
        self._track = self.path = None
        if road is None or state.lane == 0 or not network.has_lane_at(road, state.lane, s)[0]:
            return
        # Without the waypoints that it has passed, since a path would lead back to them.
        points = [(index, lane, at) for name, lane, at in route if (index := network.find_road(name)) is not None]
        passed = next((k for k, (index, _, _) in enumerate(points) if index == road), 0)
        along = bool(is_facing_forward(state.h - network.roads[road].reference_pose(s)[2])[0])
        track = LaneTrack.from_lane(network, road, state.lane, state.s, along, tuple(points[passed:]))
        if track is not None:
            self._track, self._route, self.path = track, route, driven_path(track.path)
            self.distance = float(track.distance_at_s(s)[0])

    def _locate_on_track(self, track: Track, state: ObjectState) -> None:
        x, y, after = np.array([state.x]), np.array([state.y]), np.array([self.distance - _MAX_STEP_BACK])
        self.distance = float(track.nearest_distance(x, y, _ONE_ROW, after)[0])

    def _lateral_offset(self, track: Track, state: ObjectState) -> float:
        x, y, heading = track.pose_at(np.array([self.distance]), np.zeros(1), _ONE_ROW)
        return float((state.y - y[0]) * math.cos(heading[0]) - (state.x - x[0]) * math.sin(heading[0]))
