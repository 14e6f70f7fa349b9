"""Positions of entities in road coordinates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cornercase._common.geometry.boxes import is_facing_forward
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.roads._network import RoadNetwork
from cornercase.simulators.builtin.tracks._lane import LaneTrack
from cornercase.simulators.builtin.tracks._track import Pose
from cornercase.simulators.builtin.world._state_layout import MAX_LANE_OFFSET
from cornercase.simulators.builtin.world._world import World


def follows_lane(world: World, entity: int) -> BoolArray:
    """Return a mask (N,) of the scenarios in which the track that an entity follows is a lane, not a trajectory."""
    result = np.zeros(world.scenarios, dtype=np.bool_)
    for k, track in enumerate(world.tracks[entity]):
        if isinstance(track, LaneTrack):
            result |= world.track[entity] == k
    return result


def road_pose(world: World, entity: int) -> Pose:
    """Return the pose of an entity, with its road coordinates if the world has roads."""
    pose = Pose(world.x[entity].copy(), world.y[entity].copy(), world.heading[entity].copy())
    if world.network is None:
        return pose
    # As in esmini, only a lane change leads to another lane, not a large offset.
    near = ~world.changes_lanes[entity] | (np.abs(world.offset[entity]) < MAX_LANE_OFFSET)
    along = follows_lane(world, entity) & near & world.present[entity]
    n = world.scenarios
    road, lane, s, offset = np.full(n, -1), np.zeros(n, dtype=np.int64), np.zeros(n), np.zeros(n)
    free = np.flatnonzero(~along)
    if free.size:
        location = world.network.locate(world.x[entity][free], world.y[entity][free])
        road[free], lane[free], s[free], offset[free] = location
    pose = replace(pose, road=road, lane=lane, s=s, offset=offset)
    for _, track, rows in world.iter_followed_tracks(entity, along):
        if isinstance(track, LaneTrack):
            pose = track.update_road_coordinates(pose, rows, world.distance[entity][rows], world.offset[entity][rows])
    return pose


def is_on_road(world: World, entity: int) -> BoolArray:
    """Return a mask (N,) of the scenarios in which the reference point of an entity is on a lane of a road."""
    assert world.network is not None
    location = world.network.locate(world.x[entity], world.y[entity])
    width = np.zeros(world.scenarios)
    for road, lane in sorted({*zip(location.road.tolist(), location.lane.tolist(), strict=True)}):
        rows = (location.road == road) & (location.lane == lane)
        road_geometry = world.network.roads[road]
        section = road_geometry.section_at(location.s[rows])
        # A lane of type "none" is not part of the road.
        lanes = {int(k): road_geometry.sections[int(k)][1].get(lane) for k in np.unique(section)}
        untyped_sections = {
            k
            for k, lane_geometry in lanes.items()
            if lane_geometry is not None and lane_geometry.lane_type == "none" and lane != 0
        }
        width[rows] = [
            -1.0
            if k in untyped_sections
            else float(road_geometry.lane_width(int(k), lane, location.s[rows][i : i + 1])[0])
            for i, k in enumerate(section.tolist())
        ]
    return np.asarray(np.abs(location.offset) <= 0.5 * width + 1e-6)


def road_heading(world: World, pose: Pose) -> FloatArray:
    """Return the direction in rad in which s increases on the road of a pose, shape (N,)."""
    assert world.network is not None
    road, _, s = pose.road_coordinates()
    return _road_headings(world.network, road, s)


def is_heading_along_road(world: World, pose: Pose) -> BoolArray:
    """Return whether a pose points in the direction of s on its road, shape (N,); True if exactly across the road."""
    return is_facing_forward(pose.heading - road_heading(world, pose))


def locate_on_road(world: World, entity: int, where: BoolArray) -> None:
    """Store road, s and road direction of an entity in the scenarios of a mask, for kernels in the coming frame."""
    if world.network is None:
        return
    follows = follows_lane(world, entity)
    if (where & follows).any():
        pose, at = road_pose(world, entity), np.flatnonzero(where & follows)
        road, _, s = pose.road_coordinates()
        world.last_road[entity][at], world.last_s[entity][at] = road[at], s[at]
        world.road_heading[entity][at] = _road_headings(world.network, road[at], s[at])
    at = np.flatnonzero(~follows & where & world.present[entity])
    x, y, heading = world.x[entity][at], world.y[entity][at], world.heading[entity][at]
    road, s = world.network.track_road(world.last_road[entity][at], world.last_s[entity][at], x, y, heading)
    world.last_road[entity][at], world.last_s[entity][at] = road, s
    world.road_heading[entity][at] = _road_headings(world.network, road, s)


def _road_headings(network: RoadNetwork, road: IntArray, s: FloatArray) -> FloatArray:
    """Return the direction in rad in which s increases at R positions on roads, shape (R,)."""
    heading = np.zeros(len(s))
    for number in np.unique(road):
        rows = road == number
        heading[rows] = network.roads[int(number)].reference_pose(s[rows])[2]
    return heading


def distance_ahead_on_road(world: World, entity: int, target: Pose, default: FloatArray) -> FloatArray:
    """Return the distance in m from an entity to a target along the reference line of their road, shape (N,).

    The distance is positive if the target is ahead. It is `default` if the target is on another road.
    """
    if world.network is None or target.road is None or target.s is None:
        return default
    own_pose = road_pose(world, entity)
    road, _, s = own_pose.road_coordinates()
    forward = np.where(is_heading_along_road(world, own_pose), 1.0, -1.0)
    return np.where(road == target.road, forward * (target.s - s), default)


def relative_lane(world: World, pose: Pose, other: Pose) -> IntArray:
    """Return by how many lanes `other` is to the left of `pose` (negative: right), in driving direction, shape (N,)."""
    lane, other_lane = pose.road_coordinates()[1], other.road_coordinates()[1]
    # Lane 0 is the centre line, not a lane.
    difference = other_lane - lane
    crossing = np.sign(lane) != np.sign(other_lane)
    difference = difference - np.where(crossing, np.sign(difference), 0)
    return np.asarray(difference * np.where(is_heading_along_road(world, pose), 1, -1))


def is_opposite_direction(world: World, entity: int, pose: Pose) -> BoolArray:
    """Return in which scenarios s runs in opposite directions on the roads of an entity and of a pose, shape (N,).

    The directions are compared along the lane path of the entity. False if the path does not use the pose's road.
    """
    assert pose.road is not None
    result = np.zeros(world.scenarios, dtype=np.bool_)
    for _, track, rows in world.iter_followed_tracks(entity, world.present[entity]):
        if not isinstance(track, LaneTrack):
            continue
        path = track.path
        sample = path.sample_index(world.distance[entity][rows])
        for road in np.unique(pose.road[rows]):
            samples = np.flatnonzero(path.road == road)
            on_road_rows = pose.road[rows] == road
            if samples.size:
                near = samples[np.clip(np.searchsorted(samples, sample[on_road_rows]), 0, samples.size - 1)]
                result[rows[on_road_rows]] = path.forward[near] != path.forward[sample[on_road_rows]]
    return result


def has_drivable_lane_in_range(world: World, pose: Pose, first: int, last: int, opposite: bool) -> BoolArray:
    """Return in which scenarios a drivable lane is `first` to `last` lane numbers above the lane of a pose, (N,).

    As in esmini, the driving direction does not matter. Lanes on the other side of the road count only if `opposite`.
    """
    assert world.network is not None
    roads, lanes, s = pose.road_coordinates()
    result = np.zeros(world.scenarios, dtype=np.bool_)
    for road in np.unique(roads):
        rows = np.flatnonzero(roads == road)
        road_geometry = world.network.roads[int(road)]
        for k in np.unique(section := road_geometry.section_at(s[rows])):
            at = rows[section == k]
            lane = lanes[at]
            for number, other in road_geometry.sections[int(k)][1].items():
                in_range = (number >= lane + first) & (number <= lane + last) & other.is_drivable
                result[at] |= in_range & (opposite | (np.sign(number) == np.sign(lane)))
    return result
