"""Place entities, and make them follow lanes and other tracks."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from cornercase._common.geometry import looks_ahead, within_half_turn
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.simulators.builtin.tracks.lane import LaneTrack
from cornercase.simulators.builtin.tracks.track import FREE, Pose, Track
from cornercase.simulators.builtin.world.state import World
from cornercase.simulators.builtin.world.towing import align_trailers
from cornercase.simulators.builtin.world.whereabouts import lane_of, on_lane

# Tolerance of headings in rad.
_ALIGNED: Final = 1e-3
# Distance in m beyond the end of a road from which a placement is reported as moved.
_BEYOND: Final = 1.0
# Distance in m from a lane's end within which a path sample may belong to either lane.
_SEAM: Final = 0.5


def place_entity(world: World, entity: int, pose: Pose, where: BoolArray) -> None:
    """Place an entity at a pose; from there it follows its lane, or its heading without a lane."""
    lost = ~np.isfinite(pose.x + pose.y + pose.heading)
    if pose.beyond is not None and pose.relative:
        why = f"{world.names[entity]} would be beyond the end of the road, and is placed at that end"
        world.remark(pose.relative, "<Position>", why, where & ~lost & pose.beyond)
    elif pose.beyond is not None:
        lost = lost | pose.beyond
    world.fail(where & lost, f"{world.names[entity]} is placed off the map")
    where = where & world.running
    for state, value in ((world.x, pose.x), (world.y, pose.y), (world.heading, pose.heading)):
        state[entity][where] = value[where]
    # A teleport does not add to the travelled distance.
    world.from_x[entity][where], world.from_y[entity][where] = pose.x[where], pose.y[where]
    world.present[entity] |= where
    world.jumped[entity] |= where
    world.moved[entity] |= where & world.begun
    align_trailers(world, entity, where)
    # An entity on a trajectory stays on it.
    attach_to_lane(world, entity, where & ((world.track[entity] == FREE) | on_lane(world, entity)), pose)


def attach_to_lane(world: World, entity: int, where: BoolArray, pose: Pose | None = None) -> None:
    """Make an entity follow the lane at its position (or `pose`) in the direction of its heading."""
    world.track[entity][where] = FREE
    world.stranded[entity][where] = False
    if world.network is None:
        return
    if pose is None or pose.lane is None or pose.road is None:
        location = world.network.locate(world.x[entity], world.y[entity])
        pose = Pose(world.x[entity], world.y[entity], world.heading[entity], *location)
    assert pose.road is not None
    assert pose.s is not None
    assert pose.lane is not None
    assert pose.offset is not None
    road, section, along = _direction(world, pose, where)
    route = world.route[entity]
    keys = np.stack([road, section, pose.lane, along, route])
    for key, rows in _alike(keys, where):
        first = int(rows.argmax())
        track = lane_track(world, key[0], key[2], float(pose.s[first]), bool(key[3]), key[4])
        if track is None:
            continue
        distance = np.zeros(world.scenarios)
        distance[rows] = track.distance_of(pose.s[rows])
        follow_track(world, entity, track, distance, rows)
        world.offset[entity][rows] = pose.offset[rows] if key[3] else -pose.offset[rows]
        x, y, heading = track.at(distance[rows], world.offset[entity][rows], np.flatnonzero(rows))
        if world.acting is not None:
            is_off = rows.copy()
            is_off[rows] = np.hypot(x - pose.x[rows], y - pose.y[rows]) > _BEYOND
            why = f"{world.names[entity]} lies beyond the end of the nearest road, and is placed at that end"
            world.remark(world.acting, "position", why, is_off)
        turn = within_half_turn(pose.heading[rows] - heading)
        # Headings of sampled lanes are not exact: ignore small differences.
        world.turn[entity][rows] = np.where(np.abs(turn) < _ALIGNED, 0.0, turn)


def _alike(keys: IntArray, where: BoolArray) -> Iterator[tuple[tuple[int, ...], BoolArray]]:
    """Yield the distinct columns of keys in the scenarios of a mask, sorted, and where each occurs, (N,)."""
    for key in sorted({*zip(*keys[:, where].tolist(), strict=True)}):
        yield key, where & (keys == np.array(key)[:, None]).all(axis=0)


def change_lane(world: World, entity: int, lane: IntArray, where: BoolArray) -> BoolArray:
    """Make an entity follow another lane of its road from beside it; return where that lane exists, (N,)."""
    assert world.network is not None
    pose = lane_of(world, entity)
    assert pose.s is not None
    road, section, along = _direction(world, pose, where)
    route = _route_ahead(world, entity, where)
    exists = np.zeros_like(where)
    keys = np.stack([road, section, lane, along, route])
    for key, rows in _alike(keys, where):
        track = lane_track(world, key[0], key[2], float(pose.s[int(rows.argmax())]), bool(key[3]), key[4])
        if track is None:
            continue
        at = np.flatnonzero(rows)
        distance = np.zeros(world.scenarios)
        distance[at] = track.nearest(world.x[entity][at], world.y[entity][at], at)
        x, y, heading = track.at(distance[at], np.zeros(len(at)), at)
        follow_track(world, entity, track, distance, rows)
        dx, dy = world.x[entity][at] - x, world.y[entity][at] - y
        world.offset[entity][at] = dy * np.cos(heading) - dx * np.sin(heading)
        world.turn[entity][at] = 0.0
        world.stranded[entity][at] = False
        world.route[entity][at] = key[4]
        exists |= rows
    return exists


def go_on(world: World, entity: int, number: int) -> None:
    """Make an entity near the end of its lane's cut path (track `track_number`) follow the next part."""
    assert world.network is not None
    track = world.tracks[entity][number]
    assert isinstance(track, LaneTrack)
    distance = world.distance[entity]
    near = (distance < track.span[0]) | (distance > track.span[1])
    at = np.flatnonzero(world.running & (world.track[entity] == number) & near)
    routes, path = _route_ahead(world, entity, near & world.running), track.path
    sample = path.sample_at(distance[at])
    s = path.s_at(distance[at])
    keys = np.stack([path.road[sample], path.lane[sample], path.along[sample], routes[at]])
    for key in np.unique(keys, axis=1).T if at.size else ():
        road, lane, along, route = int(key[0]), int(key[1]), bool(key[2]), int(key[3])
        # Near a lane's end the sample may belong to either lane: wait for the next step.
        seams = world.network.roads[road].seams
        rows = (keys == key[:, None]).all(axis=0) & (np.abs(s[:, None] - seams) > _SEAM).all(axis=1) & (s > _SEAM)
        for section in np.unique(world.network.roads[road].section_at(s[rows])):
            in_section = rows & (world.network.roads[road].section_at(s) == section)
            new = lane_track(world, road, lane, float(s[in_section][0]), along, route)
            if new is not None:
                # On a ring it is the current path, started again.
                new = LaneTrack(new.path) if new is track else new
                _carry_over(world, entity, track, new, at[in_section], s[in_section])
                world.route[entity][at[in_section]] = route


def _route_ahead(world: World, entity: int, where: BoolArray) -> IntArray:
    """Route of an entity without the roads it has passed, to which a new path would lead back, (N,)."""
    result: IntArray = world.route[entity].copy()
    for _, track, at in world.followed(entity, where & (world.route[entity] > 0)):
        if not isinstance(track, LaneTrack):
            continue
        passed = track.path.passed[track.path.sample_at(world.distance[entity][at])]
        for route, count in sorted({*zip(world.route[entity][at].tolist(), passed.tolist(), strict=True)}):
            remaining = world.routes[route][count:]
            if remaining not in world.routes:
                world.routes.append(remaining)
            result[at[(world.route[entity][at] == route) & (passed == count)]] = world.routes.index(remaining)
    return result


def _carry_over(world: World, entity: int, old: LaneTrack, new: LaneTrack, at: IntArray, s: FloatArray) -> None:
    x, y, _ = old.at(world.distance[entity][at], np.zeros(len(at)), at)
    track_distance = new.distance_of(s)
    track_x, track_y, heading = new.at(track_distance, np.zeros(len(at)), at)
    distance, rows = np.zeros(world.scenarios), np.zeros(world.scenarios, dtype=np.bool_)
    distance[at] = track_distance + (x - track_x) * np.cos(heading) + (y - track_y) * np.sin(heading)
    rows[at] = True
    follow_track(world, entity, new, distance, rows)


def assign_route(world: World, entity: int, roads: tuple[int, ...], where: BoolArray) -> None:
    """Make an entity pass roads (by index), and continue as before if it is already on the way."""
    via = tuple((road, 0, 0.0) for road in roads)
    if via not in world.routes:
        world.routes.append(via)
    world.route[entity][where] = world.routes.index(via)
    onward = where & on_lane(world, entity)
    if onward.any():
        pose, turn, offset = lane_of(world, entity), world.turn[entity].copy(), world.offset[entity].copy()
        attach_to_lane(world, entity, onward, pose)
        world.turn[entity][onward], world.offset[entity][onward] = turn[onward], offset[onward]


def follow_track(world: World, entity: int, track: Track, distance: FloatArray, where: BoolArray) -> None:
    """Make an entity follow a track from a distance in m on, (N,)."""
    tracks = world.tracks[entity]
    if track not in tracks:
        tracks.append(track)
    world.track[entity][where] = tracks.index(track)
    world.distance[entity][where] = distance[where]


def lane_track(world: World, road: int, lane: int, s: float, along: bool, route: int) -> LaneTrack | None:
    """Track along a lane and its successors, cached per lane section; None if there is no such lane.

    `s` in m on the road, `along`: in the direction of s; `road` and `route` are indices.
    """
    assert world.network is not None
    section = int(world.network.roads[road].section_at(np.array([s]))[0])
    key = (road, section, lane, along, route)
    if key not in world.lane_tracks:
        world.lane_tracks[key] = LaneTrack.of_lane(world.network, road, lane, s, along, world.routes[route])
    return world.lane_tracks[key]


def _direction(world: World, pose: Pose, where: BoolArray) -> tuple[IntArray, IntArray, BoolArray]:
    """Road, lane section, and whether the heading points along s, each (N,)."""
    assert world.network is not None
    assert pose.road is not None
    assert pose.s is not None
    section = np.zeros(world.scenarios, dtype=np.int64)
    along = np.zeros(world.scenarios, dtype=np.bool_)
    for road in sorted(set(pose.road[where].tolist())):
        rows = where & (pose.road == road)
        road_geometry = world.network.roads[road]
        section[rows] = road_geometry.section_at(pose.s[rows])
        along[rows] = looks_ahead(pose.heading[rows] - road_geometry.reference(pose.s[rows])[2])
    return pose.road, section, along
