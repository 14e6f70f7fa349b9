"""Reader of OpenSCENARIO positions, which are resolved when needed, for all scenarios of a batch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.errors import suggest_name
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.roads._network import RoadNetwork
from cornercase.scenario._scope import Scope
from cornercase.simulators.builtin.paths._trajectory_shapes import PositionResolver, WorldPosition, read_trajectory
from cornercase.simulators.builtin.tracks._track import Pose
from cornercase.simulators.builtin.world._lane_following import get_lane_track
from cornercase.simulators.builtin.world._road_position import is_heading_along_road, road_heading, road_pose
from cornercase.simulators.builtin.world._world import World

# m; a position beyond the end of a road by less than this counts as at the end.
_END_TOLERANCE: Final = 0.1


def read_position(holder: etree._Element, scope: Scope, world: World) -> PositionResolver:
    """Read the position inside an element; return a function that gives its pose in the current state of a world."""
    element = holder.find("*")
    if element is None:
        raise scope.error_at(holder, f"<{holder.tag}> holds no position.")
    if element.tag not in _READERS:
        raise scope.error_at(
            element, f"<{element.tag}> is not supported by the builtin simulator; it reads {', '.join(_READERS)}."
        )
    return _READERS[element.tag](element, scope, world)


def is_static_position(holder: etree._Element) -> bool:
    """Return whether the position inside an element has world, lane or road coordinates, so that it never changes."""
    element = holder.find("*")
    return element is not None and element.tag in ("WorldPosition", "LanePosition", "RoadPosition")


def read_entity_index(element: etree._Element, scope: Scope, world: World, attribute: str = "entityRef") -> int:
    """Return the index of the entity that an attribute of an element names."""
    name = scope.read_text(element, attribute)
    if name not in world.names:
        raise scope.error_at(
            element,
            f"<{element.tag}> names the entity '{name}', which does not exist; {suggest_name(name, world.names)}",
        )
    return world.names.index(name)


def read_entity_refs(holder: etree._Element, scope: Scope, world: World) -> list[int]:
    """Return the indices of the entities that the ``EntityRef`` elements inside an element name.

    A selection stands for its members. Each entity is listed once.
    """
    rows = (row for element in holder.iterfind("EntityRef") for row in read_entity_or_members(element, scope, world))
    return list(dict.fromkeys(rows))


def read_entity_or_members(element: etree._Element, scope: Scope, world: World) -> list[int]:
    """Return the index of the entity that ``entityRef`` names, or the indices of all members of a selection."""
    members = world.selections.get(scope.read_text(element, "entityRef"))
    return [read_entity_index(element, scope, world)] if members is None else members


def _read_world_position(element: etree._Element, scope: Scope, world: World) -> PositionResolver:
    return WorldPosition(
        Pose(scope.read_numbers(element, "x"), scope.read_numbers(element, "y"), scope.read_numbers(element, "h", 0.0))
    )


def _read_lane_position(element: etree._Element, scope: Scope, world: World) -> PositionResolver:
    network = _require_network(element, scope, world)
    road = network.road_index(scope.read_text(element, "roadId"))
    lane = scope.read_integer(element, "laneId")
    s, offset = scope.read_numbers(element, "s", 0.0), scope.read_numbers(element, "offset", 0.0)
    turn, relative = _read_orientation(element, scope)
    n = scope.n_scenarios
    name, length = network.roads[road].road_id, network.roads[road].length
    missing = ~network.has_lane_at(road, lane, s) & (s >= -_END_TOLERANCE) & (s <= length + _END_TOLERANCE)
    for missing_s in np.unique(s[missing]):
        world.fail(
            missing & (s == missing_s),
            f"{scope.file_name}, line {element.sourceline}: <{element.tag}>: road '{name}' has no lane {lane} at s ="
            f" {missing_s:g} m",
        )

    def resolve(world: World) -> Pose:
        return _pose_from_lane_coordinates(world, np.full(n, road), np.full(n, lane), s, offset, turn, relative)

    return resolve


def _read_road_position(element: etree._Element, scope: Scope, world: World) -> PositionResolver:
    network = _require_network(element, scope, world)
    road = network.road_index(scope.read_text(element, "roadId"))
    s, t = scope.read_numbers(element, "s"), scope.read_numbers(element, "t")
    turn, relative = _read_orientation(element, scope)

    def resolve(world: World) -> Pose:
        return _pose_from_road_coordinates(world, np.full(scope.n_scenarios, road), s, t, turn, relative)

    return resolve


def _read_relative_lane_position(element: etree._Element, scope: Scope, world: World) -> PositionResolver:
    _require_network(element, scope, world)
    entity = read_entity_index(element, scope, world)
    lanes = scope.read_integer(element, "dLane")
    ds, offset = scope.read_numbers(element, "ds", 0.0), scope.read_numbers(element, "offset", 0.0)
    along_lane = element.get("dsLane") is not None
    ds = scope.read_numbers(element, "dsLane") if along_lane else ds
    turn, relative = _read_orientation(element, scope)

    def resolve(world: World) -> Pose:
        base = road_pose(world, entity)
        # With dsLane, distances and lanes count in the entity's direction; with ds, along s and by lane numbers.
        ahead = is_heading_along_road(world, base)
        forward = np.where(ahead | (not along_lane), 1, -1)
        base = _move_along_roads(world, base, forward * ds)
        road, lane, s = base.road_coordinates()
        lane = shift_lane(lane, lanes * forward)
        pose = _pose_from_lane_coordinates(world, road, lane, s, offset * forward, turn, relative)
        pose = _mark_end_of_road(pose, base, element, scope)
        if along_lane or not relative:
            return pose
        return replace(pose, heading=np.where(np.isnan(pose.heading), np.nan, road_heading(world, pose) + turn))

    return resolve


def shift_lane(lane: IntArray, n_lanes: IntArray) -> IntArray:
    """Return the lane number `n_lanes` to the left (negative: right), seen along s, shape (N,); lane 0 is skipped."""
    moved = lane + n_lanes
    return np.where((moved == 0) | (np.sign(moved) != np.sign(lane)), moved + np.sign(n_lanes), moved)


def _move_along_roads(world: World, base: Pose, ds: FloatArray) -> Pose:
    """Return a pose whose road, lane and s are moved along the roads by `ds` m (positive: along s).

    x, y and heading stay unchanged.
    """
    assert world.network is not None
    road, lane, start = base.road_coordinates()
    road, lane, s = road.copy(), lane.copy(), start + ds
    is_too_short = np.zeros(world.scenarios, dtype=np.bool_)
    beyond = np.flatnonzero((s < 0.0) | (s > world.network.road_lengths[road]))
    for i in beyond[world.running[beyond]]:
        route = 0 if world.positioned_entity is None else int(world.route[world.positioned_entity, i])
        track = get_lane_track(world, int(road[i]), int(lane[i]), float(start[i]), bool(ds[i] >= 0.0), route)
        if track is not None:
            distance_to_go, path = np.abs(ds[i : i + 1]), track.path
            distance = path.advance_along_reference(track.distance_at_s(start[i : i + 1]), distance_to_go)
            end_distance = np.interp(distance, path.distance, path.reference_distance)
            start_distance = np.interp(track.distance_at_s(start[i : i + 1]), path.distance, path.reference_distance)
            is_too_short[i] = bool(end_distance - start_distance < distance_to_go - _END_TOLERANCE)
            k = int(path.sample_index(distance)[0])
            road[i], lane[i], s[i] = path.road[k], path.lane[k], track.s_at(distance)[0]
    return Pose(base.x, base.y, base.heading, road, lane, s, base.offset, is_too_short)


def _mark_end_of_road(pose: Pose, moved: Pose, element: etree._Element, scope: Scope) -> Pose:
    """Return `pose`, marked as beyond the end of the road in all scenarios in which `moved` has this mark.

    `pose` was computed from `moved`, a pose that was moved along the roads.
    """
    assert pose.is_beyond_road is not None
    assert moved.is_beyond_road is not None
    location = f"{Path(scope.file_name).name}, line {element.sourceline}"
    return replace(pose, is_beyond_road=pose.is_beyond_road | moved.is_beyond_road, relative_location=location)


def _read_relative_road_position(element: etree._Element, scope: Scope, world: World) -> PositionResolver:
    _require_network(element, scope, world)
    entity = read_entity_index(element, scope, world)
    ds, dt = scope.read_numbers(element, "ds"), scope.read_numbers(element, "dt")
    turn, relative = _read_orientation(element, scope)

    def resolve(world: World) -> Pose:
        base = road_pose(world, entity)
        moved = _move_along_roads(world, base, ds)
        road, lane, s = moved.road_coordinates()
        # Beyond a junction, s may run in the opposite direction, which swaps left and right.
        t = _lateral_coordinate(world, base) * np.sign(lane * base.road_coordinates()[1])
        return _mark_end_of_road(
            _pose_from_road_coordinates(world, road, s, t + dt, turn, relative), moved, element, scope
        )

    return resolve


def _lateral_coordinate(world: World, pose: Pose) -> FloatArray:
    assert world.network is not None
    roads, _, s = pose.road_coordinates()
    t = np.zeros(world.scenarios)
    for road in np.unique(roads):
        rows = roads == road
        x, y, heading = world.network.roads[int(road)].reference_pose(s[rows])
        t[rows] = (pose.y[rows] - y) * np.cos(heading) - (pose.x[rows] - x) * np.sin(heading)
    return t


def _pose_from_road_coordinates(
    world: World, road: IntArray, s: FloatArray, t: FloatArray, given_heading: FloatArray, is_relative: bool
) -> Pose:
    assert world.network is not None
    x, y, heading = (np.full(len(s), np.nan) for _ in range(3))
    s, beyond = _clip_to_road(world, road, s)
    for road_index in np.unique(road):
        rows = (road == road_index) & np.isfinite(s)
        x[rows], y[rows], heading[rows] = world.network.road_to_xy_heading(int(road_index), s[rows], t[rows])
    heading = heading + given_heading if is_relative else np.where(np.isnan(heading), np.nan, given_heading)
    lane, offset = np.zeros(len(s), dtype=np.int64), np.zeros(len(s))
    for road_index in np.unique(road):
        rows = np.flatnonzero((road == road_index) & np.isfinite(x))
        lane[rows], offset[rows] = world.network.find_lane(int(road_index), s[rows], t[rows])
    return Pose(x, y, heading, road, lane, s, offset, beyond)


def _clip_to_road(world: World, road: IntArray, s: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return coordinates s in m clipped to the lengths of roads, and a mask of the scenarios that changed, (N,) each.

    Changes up to a small tolerance do not count in the mask.
    """
    assert world.network is not None
    lengths = world.network.road_lengths[road]
    return np.clip(s, 0.0, lengths), (s < -_END_TOLERANCE) | (s > lengths + _END_TOLERANCE)


def _read_route_position(element: etree._Element, scope: Scope, world: World) -> PositionResolver:
    network = _require_network(element, scope, world)
    holder = element.find("RouteRef")
    route = None if holder is None else read_route(holder, scope, world)
    in_route = element.find("InRoutePosition")
    inner = None if in_route is None else in_route.find("*")
    if route is None or inner is None or inner.tag not in ("FromLaneCoordinates", "FromRoadCoordinates"):
        raise scope.error_at(
            element, "<RoutePosition> needs a <RouteRef> and an <InRoutePosition> from lane or road coordinates."
        )
    on_lane = inner.tag == "FromLaneCoordinates"
    distance = scope.read_numbers(inner, "pathS")
    lane = scope.read_integer(inner, "laneId") if on_lane else 0
    lateral = scope.read_numbers(inner, "laneOffset", 0.0) if on_lane else scope.read_numbers(inner, "t")
    turn, relative = _read_orientation(element, scope)
    has_orientation = element.find("Orientation") is not None

    def resolve(world: World) -> Pose:
        road, s, along = _locate_distances_on_route(network, route(world), distance)
        if on_lane:
            pose = _pose_from_lane_coordinates(
                world, road, np.full(scope.n_scenarios, lane), s, lateral, turn, relative
            )
        else:
            pose = _pose_from_road_coordinates(world, road, s, np.where(along, lateral, -lateral), turn, relative)
        # As in esmini, a heading against the route is turned around.
        forward = road_heading(world, pose) + np.where(along, 0.0, np.pi)
        against = has_orientation & (np.cos(pose.heading - forward) < 0.0)
        return replace(pose, heading=pose.heading + np.where(against, np.pi, 0.0))

    return resolve


def _locate_distances_on_route(
    network: RoadNetwork, waypoints: list[Pose], distance: FloatArray
) -> tuple[IntArray, FloatArray, BoolArray]:
    """Return where a point at a distance in m along a route is: road index, s in m, and if the route runs along s.

    Each result has one value per scenario, shape (N,).
    """
    roads = np.stack([pose.road_coordinates()[0] for pose in waypoints])
    _, first_lane, first_s = waypoints[0].road_coordinates()
    section = np.zeros(len(distance), dtype=np.int64)
    for index in np.unique(roads[0]):
        rows = roads[0] == index
        section[rows] = network.roads[int(index)].section_at(first_s[rows])
    road, s, along = roads[0].copy(), first_s.copy(), np.zeros(len(distance), dtype=np.bool_)
    keys = np.concatenate([roads, first_lane[None], section[None]])
    for key in np.unique(keys, axis=1).T:
        rows = (keys == key[:, None]).all(axis=0)
        *road_indices, lane, k = (int(index) for index in key)
        start, end = network.roads[road_indices[0]].section_interval(k)
        # Start at the entry of the lane section, so that one walk serves all positions in this section.
        forward = network.is_traffic_forward(road_indices[0], lane, 0.5 * (start + end))
        section_start = start if forward else end - 1e-9
        extra = (first_s[rows] - section_start) * (1.0 if forward else -1.0)
        walk = [(road_indices[0], lane, section_start), *((index, 0, 0.0) for index in road_indices[1:])]
        road[rows], s[rows], along[rows] = network.locate_on_route(walk, distance[rows] + extra)
    return road, s, along


RouteResolver = Callable[[World], list[Pose]]
"""Function that returns the poses of the waypoints of a route in the current state of a world."""


def read_route(holder: etree._Element, scope: Scope, world: World) -> RouteResolver:
    """Read the ``Route`` or ``CatalogReference`` in an element; return a function that gives the waypoints' poses."""
    element, scope = scope.resolve_element_or_reference(holder, "Route")
    waypoints = [
        read_position(position, scope, world)
        for position in (waypoint.find("Position") for waypoint in element.iterfind("Waypoint"))
        if position is not None
    ]
    if len(waypoints) < 2:
        raise scope.error_at(element, "a <Route> needs at least two waypoints.")

    _require_network(element, scope, world)
    return lambda world: [waypoint(world) for waypoint in waypoints]


def _read_trajectory_position(element: etree._Element, scope: Scope, world: World) -> PositionResolver:
    holder = element.find("TrajectoryRef")
    if holder is None:
        raise scope.error_at(element, "<TrajectoryPosition> has no <TrajectoryRef>.")
    shape = read_trajectory(holder, scope, world, read_position)
    s, t = scope.read_numbers(element, "s"), scope.read_numbers(element, "t", 0.0)
    turn, relative = _read_orientation(element, scope)
    rows = np.arange(scope.n_scenarios)

    def resolve(world: World) -> Pose:
        x, y, heading = shape(world, False, None, None).pose_at(s, t, rows)
        return _locate_pose(world, x, y, heading + turn if relative else turn)

    return resolve


def _read_relative_xy_position(element: etree._Element, scope: Scope, world: World) -> PositionResolver:
    """Read a ``RelativeObjectPosition`` (along the axes of an entity) or ``RelativeWorldPosition`` (along x and y)."""
    entity = read_entity_index(element, scope, world)
    dx, dy = scope.read_numbers(element, "dx"), scope.read_numbers(element, "dy")
    turn, relative = _read_orientation(element, scope)
    in_entity_axes = element.tag == "RelativeObjectPosition"

    def resolve(world: World) -> Pose:
        heading = world.heading[entity]
        x, y = world.x[entity] + dx, world.y[entity] + dy
        if in_entity_axes:
            cos, sin = np.cos(heading), np.sin(heading)
            x = world.x[entity] + cos * dx - sin * dy
            y = world.y[entity] + sin * dx + cos * dy
        return _locate_pose(world, x, y, heading + turn if relative else turn)

    return resolve


def _locate_pose(world: World, x: FloatArray, y: FloatArray, heading: FloatArray) -> Pose:
    if world.network is None:
        return Pose(x, y, heading)
    position = world.network.locate(x, y)
    return Pose(x, y, heading, position.road, position.lane, position.s, position.offset)


def _pose_from_lane_coordinates(
    world: World,
    road: IntArray,
    lane: IntArray,
    s: FloatArray,
    offset: FloatArray,
    given_heading: FloatArray,
    is_relative: bool,
) -> Pose:
    assert world.network is not None
    x, y, heading = (np.full(len(s), np.nan) for _ in range(3))
    s, beyond = _clip_to_road(world, road, s)
    for one_road, one_lane in sorted({*zip(road.tolist(), lane.tolist(), strict=True)}):
        inside = (road == one_road) & (lane == one_lane) & world.network.has_lane_at(one_road, one_lane, s)
        if inside.any():
            pose = world.network.lane_to_xy_heading(one_road, one_lane, s[inside], offset[inside])
            x[inside], y[inside], heading[inside] = pose
    heading = heading + given_heading if is_relative else np.where(np.isnan(heading), np.nan, given_heading)
    return Pose(x, y, heading, road, lane, s, offset, beyond)


def _read_orientation(element: etree._Element, scope: Scope) -> tuple[FloatArray, bool]:
    orientation = element.find("Orientation")
    if orientation is None:
        return np.zeros(scope.n_scenarios), True
    relative = scope.read_text(orientation, "type", "absolute") == "relative"
    return scope.read_numbers(orientation, "h", 0.0), relative


def _require_network(element: etree._Element, scope: Scope, world: World) -> RoadNetwork:
    if world.network is None:
        raise scope.error_at(element, f"<{element.tag}> needs a road file, but <RoadNetwork> names none.")
    return world.network


_READERS: Final[dict[str, Callable[[etree._Element, Scope, World], PositionResolver]]] = {
    "WorldPosition": _read_world_position,
    "LanePosition": _read_lane_position,
    "RoadPosition": _read_road_position,
    "RelativeLanePosition": _read_relative_lane_position,
    "RelativeRoadPosition": _read_relative_road_position,
    "RoutePosition": _read_route_position,
    "TrajectoryPosition": _read_trajectory_position,
    "RelativeObjectPosition": _read_relative_xy_position,
    "RelativeWorldPosition": _read_relative_xy_position,
}
