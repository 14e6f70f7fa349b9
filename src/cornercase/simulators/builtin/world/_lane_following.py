"""Placement of entities, and changes of the lane or other track that an entity follows."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from cornercase._common.geometry.boxes import is_facing_forward, wrap_angle
from cornercase._common.masks import any_true
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.roads._lane_path import LanePath
from cornercase.roads._network import RoadNetwork
from cornercase.simulators.builtin.tracks._lane import LaneTrack
from cornercase.simulators.builtin.tracks._track import NO_TRACK, Pose, Track, Trajectory
from cornercase.simulators.builtin.world._road_position import follows_lane, road_pose
from cornercase.simulators.builtin.world._trailers import align_trailers
from cornercase.simulators.builtin.world._world import World

# Tolerance of headings in rad.
_ALIGNED: Final = 1e-3
# m; if a placement beyond the end of a road is moved by more than this, it is reported.
_MAX_PLACEMENT_ERROR: Final = 1.0
# m; a steered entity follows another lane once it is beyond the edge of its lane by more than this.
_LANE_HYSTERESIS: Final = 0.1
# Least cosine of the angle between an entity and the traffic on the lane that it begins to follow.
_SAME_DIRECTION: Final = 0.5
# m; within this distance of a lane's end, a sample of the path may belong to this lane or to the next lane.
_SEAM_TOLERANCE: Final = 0.5


def place_entity(world: World, entity: int, pose: Pose, where: BoolArray) -> None:
    """Place an entity at a pose, and make it follow the lane there; without a lane it will go straight on.

    Scenarios in which the pose is not on the map end with an error.
    """
    lost = ~np.isfinite(pose.x + pose.y + pose.heading)
    if pose.is_beyond_road is not None and pose.relative_location:
        why = f"{world.names[entity]} would be beyond the end of the road, and is placed at that end"
        world.add_notice(pose.relative_location, "<Position>", why, where & ~lost & pose.is_beyond_road)
    elif pose.is_beyond_road is not None:
        lost = lost | pose.is_beyond_road
    world.fail(where & lost, f"{world.names[entity]} is placed off the map")
    where = where & world.running
    for state, value in ((world.x, pose.x), (world.y, pose.y), (world.heading, pose.heading)):
        state[entity][where] = value[where]
    # A teleport does not add to the travelled distance.
    world.from_x[entity][where], world.from_y[entity][where] = pose.x[where], pose.y[where]
    world.present[entity] |= where
    world.jumped[entity] |= where
    world.moved[entity] |= where & world.started
    align_trailers(world, entity, where)
    # An entity on a trajectory stays on it.
    attach_to_lane(world, entity, where & ((world.track[entity] == NO_TRACK) | follows_lane(world, entity)), pose)


def attach_to_lane(
    world: World, entity: int, where: BoolArray, pose: Pose | None = None, *, may_move: bool = True
) -> None:
    """Make an entity follow the lane at its position (or at `pose`), in the direction of its heading.

    An entity beyond the end of the road is moved to this end if `may_move`; otherwise it follows no lane.
    """
    world.track[entity][where] = NO_TRACK
    world.stranded[entity][where] = False
    if world.network is None or not any_true(where):
        return
    if pose is None or pose.lane is None or pose.road is None:
        pose = _locate_entity(world, world.network, entity, where)
    assert pose.offset is not None
    _, lane, s = pose.road_coordinates()
    road, section, along = _road_section_direction(world, pose, where)
    keys = np.stack([road, section, lane, along, world.route[entity]])
    for key, rows in _iter_scenarios_by_key(keys, where):
        track = get_lane_track(world, key[0], key[2], float(s[rows.argmax()]), bool(key[3]), key[4])
        if track is None:
            continue
        distance = np.zeros(world.scenarios)
        distance[rows] = track.distance_at_s(s[rows])
        follow_track(world, entity, track, distance, rows)
        world.offset[entity][rows] = pose.offset[rows] if key[3] else -pose.offset[rows]
        x, y, heading = track.pose_at(distance[rows], world.offset[entity][rows], np.flatnonzero(rows))
        is_off = rows.copy()
        is_off[rows] = np.hypot(x - pose.x[rows], y - pose.y[rows]) > _MAX_PLACEMENT_ERROR
        if may_move and world.current_action is not None:
            why = f"{world.names[entity]} lies beyond the end of the nearest road, and is placed at that end"
            world.add_notice(world.current_action, "position", why, is_off)
        turn = wrap_angle(pose.heading[rows] - heading)
        # Headings of sampled lanes are not exact: ignore small differences.
        world.turn[entity][rows] = np.where(np.abs(turn) < _ALIGNED, 0.0, turn)
        if not may_move:
            world.track[entity][is_off] = NO_TRACK
            world.offset[entity][is_off] = world.turn[entity][is_off] = 0.0


def _locate_entity(world: World, network: RoadNetwork, entity: int, where: BoolArray) -> Pose:
    """Return the pose of an entity, with road coordinates in the scenarios of a mask; they are 0 in all others."""
    n = world.scenarios
    road, lane, s, offset = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64), np.zeros(n), np.zeros(n)
    road[where], lane[where], s[where], offset[where] = network.locate(world.x[entity][where], world.y[entity][where])
    return Pose(world.x[entity], world.y[entity], world.heading[entity], road, lane, s, offset)


def follow_lane_at_position(world: World, entity: int, where: BoolArray, *, is_tracked: BoolArray) -> None:
    """Make a steered entity that has left the lane of its track follow the lane at its position.

    The entity keeps its track if it is on no drivable lane, if its heading differs by 60° or more from the direction of
    the traffic there, and while an action makes it change lanes. It also keeps a trajectory in the scenarios
    `is_tracked` (N,), since there the driver steers along the trajectory.
    """
    network = world.network
    if network is None:
        return
    left = np.zeros_like(where)
    for _, track, at in world.iter_followed_tracks(entity, where & ~world.changes_lanes[entity]):
        if isinstance(track, Trajectory):
            at = at[~is_tracked[at]]
        far = at[np.abs(world.offset[entity][at]) > _half_lane_width(world, entity, track, at) + _LANE_HYSTERESIS]
        left[far] = True
    at = np.flatnonzero(left)
    if not at.size:
        return
    road, lane, s, offset = network.locate(world.x[entity][at], world.y[entity][at])
    for k, n in enumerate(at.tolist()):
        current, number, here = network.roads[int(road[k])], int(lane[k]), s[k : k + 1]
        section = int(current.section_at(here)[0])
        candidate = current.sections[section][1].get(number)
        is_inside = abs(offset[k]) <= 0.5 * float(current.lane_width(section, number, here)[0])
        direction = current.reference_pose(here)[2] + np.where(current.is_traffic_forward(number, here), 0.0, np.pi)
        runs_along = bool(np.cos(world.heading[entity][n] - direction[0]) > _SAME_DIRECTION)
        left[n] = is_inside and runs_along and candidate is not None and candidate.is_drivable
    if left.any():
        former = world.track[entity].copy()
        world.route[entity] = _remaining_route(world, entity, left)
        attach_to_lane(world, entity, left)
        lost = left & (world.track[entity] == NO_TRACK)
        world.track[entity][lost] = former[lost]


def _half_lane_width(world: World, entity: int, track: Track, scenarios: IntArray) -> FloatArray:
    """Return half the width in m of the lane at an entity's position on its track, in R scenarios, shape (R,)."""
    network, distance = world.network, world.distance[entity][scenarios]
    assert network is not None
    if isinstance(track, LaneTrack):
        sample = track.path.sample_index(distance)
        road, lane, s = track.path.road[sample], track.path.lane[sample], track.s_at(distance)
    else:
        x, y, _ = track.pose_at(distance, np.zeros(len(scenarios)), scenarios)
        road, lane, s, _ = network.locate(x, y)
    return _half_widths(network, road, lane, s)


def half_lane_widths(network: RoadNetwork, path: LanePath) -> FloatArray:
    """Return half the width of the lane at each of P samples of a lane path, in m, shape (P,); results are cached."""
    if "half widths" not in path.cache:
        path.cache["half widths"] = _half_widths(network, path.road, path.lane, path.s)
    widths: FloatArray = path.cache["half widths"]
    return widths


def _half_widths(network: RoadNetwork, road: IntArray, lane: IntArray, s: FloatArray) -> FloatArray:
    """Return half the widths in m of lanes at R points, given by road index, lane number and s, shape (R,)."""
    width = np.empty(len(s))
    for number, which in sorted({*zip(road.tolist(), lane.tolist(), strict=True)}):
        current, rows = network.roads[number], np.flatnonzero((road == number) & (lane == which))
        section = current.section_at(s[rows])
        for k in sorted(set(section.tolist())):
            inside = rows[section == k]
            width[inside] = current.lane_width(k, which, s[inside])
    return 0.5 * width


def _iter_scenarios_by_key(keys: IntArray, where: BoolArray) -> Iterator[tuple[tuple[int, ...], BoolArray]]:
    """Group the scenarios of a mask that have the same column in `keys`, shape (K, N).

    Yields the column of each group, in ascending order, and a mask of the scenarios in the group.
    """
    for key in sorted({*zip(*keys[:, where].tolist(), strict=True)}):
        yield key, where & (keys == np.array(key)[:, None]).all(axis=0)


def switch_to_lane_track(world: World, entity: int, lane: IntArray, where: BoolArray) -> BoolArray:
    """Make an entity follow another lane of its road, without moving the entity itself.

    Returns a mask (N,) of the scenarios in which this lane exists.
    """
    assert world.network is not None
    pose = road_pose(world, entity)
    _, _, s = pose.road_coordinates()
    road, section, along = _road_section_direction(world, pose, where)
    exists = np.zeros_like(where)
    keys = np.stack([road, section, lane, along, _remaining_route(world, entity, where)])
    for key, rows in _iter_scenarios_by_key(keys, where):
        track = get_lane_track(world, key[0], key[2], float(s[rows.argmax()]), bool(key[3]), key[4])
        if track is None:
            continue
        at = np.flatnonzero(rows)
        distance = np.zeros(world.scenarios)
        distance[at] = track.nearest_distance(world.x[entity][at], world.y[entity][at], at)
        x, y, heading = track.pose_at(distance[at], np.zeros(len(at)), at)
        follow_track(world, entity, track, distance, rows)
        dx, dy = world.x[entity][at] - x, world.y[entity][at] - y
        world.offset[entity][at] = dy * np.cos(heading) - dx * np.sin(heading)
        world.turn[entity][at] = 0.0
        world.stranded[entity][at] = False
        world.route[entity][at] = key[4]
        exists |= rows
    return exists


def extend_lane_path(world: World, entity: int, track_number: int) -> None:
    """Make an entity follow the next part of its lane path, if it follows a certain part and is near an end of it.

    `track_number` is the number of this part among the tracks of the entity.
    """
    assert world.network is not None
    track = world.tracks[entity][track_number]
    assert isinstance(track, LaneTrack)
    distance = world.distance[entity]
    near = (distance < track.span[0]) | (distance > track.span[1])
    at = np.flatnonzero(world.running & (world.track[entity] == track_number) & near)
    routes, path = _remaining_route(world, entity, near & world.running), track.path
    sample = path.sample_index(distance[at])
    s = track.s_at(distance[at])
    keys = np.stack([path.road[sample], path.lane[sample], path.forward[sample], routes[at]])
    for key in np.unique(keys, axis=1).T if at.size else ():
        road, lane, along, route = int(key[0]), int(key[1]), bool(key[2]), int(key[3])
        # Near a lane's end the sample may belong to either lane: wait for the next step.
        seams = world.network.roads[road].section_bounds
        rows = (
            (keys == key[:, None]).all(axis=0)
            & (np.abs(s[:, None] - seams) > _SEAM_TOLERANCE).all(axis=1)
            & (s > _SEAM_TOLERANCE)
        )
        for section in np.unique(world.network.roads[road].section_at(s[rows])):
            in_section = rows & (world.network.roads[road].section_at(s) == section)
            new = get_lane_track(world, road, lane, float(s[in_section][0]), along, route)
            if new is not None:
                # On a ring, the next part is the present path again.
                new = LaneTrack(new.path) if new is track else new
                _move_to_new_path(world, entity, track, new, at[in_section], s[in_section])
                world.route[entity][at[in_section]] = route


def _remaining_route(world: World, entity: int, where: BoolArray) -> IntArray:
    """Return the index in `world.routes` of what remains of an entity's route in each scenario, shape (N,).

    Roads that the entity has passed are left out of the route, since a new path would lead back to them.
    """
    result: IntArray = world.route[entity].copy()
    for _, track, at in world.iter_followed_tracks(entity, where & (world.route[entity] > 0)):
        if not isinstance(track, LaneTrack):
            continue
        passed = track.path.goals_passed[track.path.sample_index(world.distance[entity][at])]
        for route, count in sorted({*zip(world.route[entity][at].tolist(), passed.tolist(), strict=True)}):
            remaining = world.routes[route][count:]
            if remaining not in world.routes:
                world.routes.append(remaining)
            result[at[(world.route[entity][at] == route) & (passed == count)]] = world.routes.index(remaining)
    return result


def _move_to_new_path(
    world: World, entity: int, old: LaneTrack, new: LaneTrack, scenarios: IntArray, s: FloatArray
) -> None:
    x, y, _ = old.pose_at(world.distance[entity][scenarios], np.zeros(len(scenarios)), scenarios)
    track_distance = new.distance_at_s(s)
    track_x, track_y, heading = new.pose_at(track_distance, np.zeros(len(scenarios)), scenarios)
    distance, rows = np.zeros(world.scenarios), np.zeros(world.scenarios, dtype=np.bool_)
    distance[scenarios] = track_distance + (x - track_x) * np.cos(heading) + (y - track_y) * np.sin(heading)
    rows[scenarios] = True
    follow_track(world, entity, new, distance, rows)


def assign_route(world: World, entity: int, roads: tuple[int, ...], where: BoolArray) -> None:
    """Assign a route along roads (indices) to an entity, in the scenarios of a mask.

    An entity that follows a lane takes the route from its present position on.
    """
    via = tuple((road, 0, 0.0) for road in roads)
    if via not in world.routes:
        world.routes.append(via)
    world.route[entity][where] = world.routes.index(via)
    onward = where & follows_lane(world, entity)
    if onward.any():
        pose, turn, offset = road_pose(world, entity), world.turn[entity].copy(), world.offset[entity].copy()
        attach_to_lane(world, entity, onward, pose)
        world.turn[entity][onward], world.offset[entity][onward] = turn[onward], offset[onward]


def follow_track(world: World, entity: int, track: Track, distance: FloatArray, where: BoolArray) -> None:
    """Make an entity follow a track, starting at a distance along the track in m, shape (N,)."""
    tracks = world.tracks[entity]
    if track not in tracks:
        tracks.append(track)
    world.track[entity][where] = tracks.index(track)
    world.distance[entity][where] = distance[where]


def get_lane_track(world: World, road: int, lane: int, s: float, along: bool, route: int) -> LaneTrack | None:
    """Return the cached track along the lane at `s` m and its successors; None if the lane does not exist there."""
    assert world.network is not None
    section = int(world.network.roads[road].section_at(np.array([s]))[0])
    key = (road, section, lane, along, route)
    if key not in world.lane_tracks:
        world.lane_tracks[key] = LaneTrack.from_lane(world.network, road, lane, s, along, world.routes[route])
    return world.lane_tracks[key]


def _road_section_direction(world: World, pose: Pose, where: BoolArray) -> tuple[IntArray, IntArray, BoolArray]:
    """Return road index, index of the lane section, and whether the heading of a pose is along s, shape (N,) each."""
    assert world.network is not None
    roads, _, s = pose.road_coordinates()
    section = np.zeros(world.scenarios, dtype=np.int64)
    along = np.zeros(world.scenarios, dtype=np.bool_)
    for road in sorted(set(roads[where].tolist())):
        rows = where & (roads == road)
        road_geometry = world.network.roads[road]
        section[rows] = road_geometry.section_at(s[rows])
        along[rows] = is_facing_forward(pose.heading[rows] - road_geometry.reference_pose(s[rows])[2])
    return roads, section, along
