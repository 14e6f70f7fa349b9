"""OpenSCENARIO positions, resolved for all scenarios of a batch when they are needed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError, suggestion
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.roads import RoadNetwork
from cornercase.scenario import Scope
from cornercase.simulators.builtin.paths.trajectory_shapes import Position, WorldPlace, read_trajectory
from cornercase.simulators.builtin.tracks.track import Pose
from cornercase.simulators.builtin.world.lanes import lane_track
from cornercase.simulators.builtin.world.state import World
from cornercase.simulators.builtin.world.whereabouts import lane_of, looks_along, road_heading

# m; a position this little beyond the end of a road is at the end.
_EDGE: Final = 0.1


def read_position(holder: etree._Element, scope: Scope, world: World) -> Position:
    """Read the position inside `holder`, as a function that resolves it in a world.

    `InputError` if there is none, its kind is not supported, or it refers to something that does not exist.
    """
    element = next(iter(holder.iterchildren("*")), None)
    if element is None:
        raise InputError(f"{scope.source}, line {holder.sourceline}: <{holder.tag}> holds no position.")
    if element.tag not in _READERS:
        raise InputError(
            f"{scope.source}, line {element.sourceline}: <{element.tag}> is not supported by the builtin simulator;"
            f" it reads {', '.join(_READERS)}."
        )
    return _READERS[element.tag](element, scope, world)


def stays_put(holder: etree._Element) -> bool:
    """Whether the position inside `holder` is the same at all times."""
    element = next(iter(holder.iterchildren("*")), None)
    return element is not None and element.tag in ("WorldPosition", "LanePosition", "RoadPosition")


def entity_index(element: etree._Element, scope: Scope, world: World, attribute: str = "entityRef") -> int:
    """Row of the entity that an attribute names."""
    name = scope.text(element, attribute)
    if name not in world.names:
        raise InputError(
            f"{scope.source}, line {element.sourceline}: <{element.tag}> names the entity '{name}', which does not"
            f" exist; {suggestion(name, world.names)}"
        )
    return world.names.index(name)


def entities_in(holder: etree._Element, scope: Scope, world: World) -> list[int]:
    """Rows of the entities that ``EntityRef`` elements name, directly or as members of a selection; no duplicates."""
    rows = []
    for element in holder.iterfind("EntityRef"):
        name = scope.text(element, "entityRef")
        members = world.selections.get(name)
        rows += [entity_index(element, scope, world)] if members is None else members
    return list(dict.fromkeys(rows))


def _world_position(element: etree._Element, scope: Scope, world: World) -> Position:
    return WorldPlace(Pose(scope.number(element, "x"), scope.number(element, "y"), scope.number(element, "h", 0.0)))


def _lane_position(element: etree._Element, scope: Scope, world: World) -> Position:
    network = _network(element, scope, world)
    road = network.index_of(scope.text(element, "roadId"))
    lane = scope.whole_number(element, "laneId")
    s, offset = scope.number(element, "s", 0.0), scope.number(element, "offset", 0.0)
    turn, relative = _orientation(element, scope)
    n = scope.scenarios
    name, length = network.roads[road].name, network.roads[road].length
    missing = ~network.has_lane_at(road, lane, s) & (s >= -_EDGE) & (s <= length + _EDGE)
    for missing_s in np.unique(s[missing]):
        world.fail(
            missing & (s == missing_s),
            f"{scope.source}, line {element.sourceline}: <{element.tag}>: road '{name}' has no lane {lane} at s ="
            f" {missing_s:g} m",
        )

    def resolve(world: World) -> Pose:
        return _on_lane(world, np.full(n, road), np.full(n, lane), s, offset, turn, relative)

    return resolve


def _road_position(element: etree._Element, scope: Scope, world: World) -> Position:
    network = _network(element, scope, world)
    road = network.index_of(scope.text(element, "roadId"))
    s, t = scope.number(element, "s"), scope.number(element, "t")
    turn, relative = _orientation(element, scope)

    def resolve(world: World) -> Pose:
        return _on_road(world, np.full(scope.scenarios, road), s, t, turn, relative)

    return resolve


def _relative_lane_position(element: etree._Element, scope: Scope, world: World) -> Position:
    _network(element, scope, world)
    entity = entity_index(element, scope, world)
    lanes = scope.whole_number(element, "dLane")
    ds, offset = scope.number(element, "ds", 0.0), scope.number(element, "offset", 0.0)
    along_lane = element.get("dsLane") is not None
    ds = scope.number(element, "dsLane") if along_lane else ds
    turn, relative = _orientation(element, scope)

    def resolve(world: World) -> Pose:
        base = lane_of(world, entity)
        # dsLane counts both distances in the entity's direction; ds counts along s and by lane numbers.
        ahead = looks_along(world, base)
        forward = np.where(ahead | (not along_lane), 1, -1)
        base = _moved(world, base, forward * ds)
        road, lane, s = base.road_coordinates()
        lane = shifted_lane(lane, lanes * forward)
        pose = _on_lane(world, road, lane, s, offset * forward, turn, relative)
        pose = _at_the_end(pose, base, element, scope)
        if along_lane or not relative:
            return pose
        return replace(pose, heading=np.where(np.isnan(pose.heading), np.nan, road_heading(world, pose) + turn))

    return resolve


def shifted_lane(lane: IntArray, by: IntArray) -> IntArray:
    """Lane number `n_lanes` lanes to the left seen along s (negative: right), each (N,). There is no lane 0."""
    moved = lane + by
    return np.where((moved == 0) | (np.sign(moved) != np.sign(lane)), moved + np.sign(by), moved)


def _moved(world: World, base: Pose, ds: FloatArray) -> Pose:
    """Move `base` along the roads by `ds` m (negative: against s)."""
    assert world.network is not None
    road, lane, start = base.road_coordinates()
    road, lane, s = road.copy(), lane.copy(), start + ds
    is_too_short = np.zeros(world.scenarios, dtype=np.bool_)
    beyond = np.flatnonzero((s < 0.0) | (s > world.network.lengths[road]))
    for i in beyond[world.running[beyond]]:
        route = 0 if world.actor is None else int(world.route[world.actor, i])
        track = lane_track(world, int(road[i]), int(lane[i]), float(start[i]), bool(ds[i] >= 0.0), route)
        if track is not None:
            distance_to_go, path = np.abs(ds[i : i + 1]), track.path
            distance = path.ahead(track.distance_of(start[i : i + 1]), distance_to_go)
            end_distance = np.interp(distance, path.distance, path.reference)
            start_distance = np.interp(track.distance_of(start[i : i + 1]), path.distance, path.reference)
            is_too_short[i] = bool(end_distance - start_distance < distance_to_go - _EDGE)
            k = int(path.sample_at(distance)[0])
            road[i], lane[i], s[i] = path.road[k], path.lane[k], path.s_at(distance)[0]
    return Pose(base.x, base.y, base.heading, road, lane, s, base.offset, is_too_short)


def _at_the_end(pose: Pose, moved: Pose, element: etree._Element, scope: Scope) -> Pose:
    """Pose with `is_beyond_road` set where the path to it ended with the road."""
    assert pose.beyond is not None
    assert moved.beyond is not None
    location = f"{Path(scope.source).name}, line {element.sourceline}"
    return replace(pose, beyond=pose.beyond | moved.beyond, relative=location)


def _relative_road_position(element: etree._Element, scope: Scope, world: World) -> Position:
    _network(element, scope, world)
    entity = entity_index(element, scope, world)
    ds, dt = scope.number(element, "ds"), scope.number(element, "dt")
    turn, relative = _orientation(element, scope)

    def resolve(world: World) -> Pose:
        base = lane_of(world, entity)
        moved = _moved(world, base, ds)
        road, lane, s = moved.road_coordinates()
        # Beyond a junction, s may run in the opposite direction, which swaps left and right.
        t = _lateral(world, base) * np.sign(lane * base.road_coordinates()[1])
        return _at_the_end(_on_road(world, road, s, t + dt, turn, relative), moved, element, scope)

    return resolve


def _lateral(world: World, pose: Pose) -> FloatArray:
    assert world.network is not None
    roads, _, s = pose.road_coordinates()
    t = np.zeros(world.scenarios)
    for road in np.unique(roads):
        rows = roads == road
        x, y, heading = world.network.roads[int(road)].reference(s[rows])
        t[rows] = (pose.y[rows] - y) * np.cos(heading) - (pose.x[rows] - x) * np.sin(heading)
    return t


def _on_road(world: World, road: IntArray, s: FloatArray, t: FloatArray, turn: FloatArray, relative: bool) -> Pose:
    assert world.network is not None
    x, y, heading = (np.full(len(s), np.nan) for _ in range(3))
    s, beyond = _on_the_road(world, road, s)
    for road_index in np.unique(road):
        rows = (road == road_index) & np.isfinite(s)
        x[rows], y[rows], heading[rows] = world.network.road_world(int(road_index), s[rows], t[rows])
    heading = heading + turn if relative else np.where(np.isnan(heading), np.nan, turn)
    lane, offset = np.zeros(len(s), dtype=np.int64), np.zeros(len(s))
    for road_index in np.unique(road):
        rows = np.flatnonzero((road == road_index) & np.isfinite(x))
        lane[rows], offset[rows] = world.network.lane_at(int(road_index), s[rows], t[rows])
    return Pose(x, y, heading, road, lane, s, offset, beyond)


def _on_the_road(world: World, road: IntArray, s: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Coordinate s clipped to the roads, and whether it was beyond them, each (N,)."""
    assert world.network is not None
    lengths = world.network.lengths[road]
    return np.clip(s, 0.0, lengths), (s < -_EDGE) | (s > lengths + _EDGE)


def _route_position(element: etree._Element, scope: Scope, world: World) -> Position:
    network = _network(element, scope, world)
    holder = element.find("RouteRef")
    route = None if holder is None else read_route(holder, scope, world)
    in_route = element.find("InRoutePosition")
    inner = None if in_route is None else next(iter(in_route.iterchildren("*")), None)
    if route is None or inner is None or inner.tag not in ("FromLaneCoordinates", "FromRoadCoordinates"):
        raise InputError(
            f"{scope.source}, line {element.sourceline}: <RoutePosition> needs a <RouteRef> and an <InRoutePosition>"
            " from lane or road coordinates."
        )
    on_lane = inner.tag == "FromLaneCoordinates"
    distance = scope.number(inner, "pathS")
    lane = scope.whole_number(inner, "laneId") if on_lane else 0
    lateral = scope.number(inner, "laneOffset", 0.0) if on_lane else scope.number(inner, "t")
    turn, relative = _orientation(element, scope)
    has_orientation = element.find("Orientation") is not None

    def resolve(world: World) -> Pose:
        road, s, along = _along_route(network, route(world), distance)
        if on_lane:
            pose = _on_lane(world, road, np.full(scope.scenarios, lane), s, lateral, turn, relative)
        else:
            pose = _on_road(world, road, s, np.where(along, lateral, -lateral), turn, relative)
        # As in esmini, an orientation against the route is turned around.
        forward = road_heading(world, pose) + np.where(along, 0.0, np.pi)
        against = has_orientation & (np.cos(pose.heading - forward) < 0.0)
        return replace(pose, heading=pose.heading + np.where(against, np.pi, 0.0))

    return resolve


def _along_route(
    network: RoadNetwork, waypoints: list[Pose], way: FloatArray
) -> tuple[IntArray, FloatArray, BoolArray]:
    """Road, s, and whether the route runs along s, `distance` m after the first waypoint, each (N,)."""
    roads = np.stack([pose.road_coordinates()[0] for pose in waypoints])
    _, first_lane, first_s = waypoints[0].road_coordinates()
    section = np.zeros(len(way), dtype=np.int64)
    for index in np.unique(roads[0]):
        rows = roads[0] == index
        section[rows] = network.roads[int(index)].section_at(first_s[rows])
    road, s, along = roads[0].copy(), first_s.copy(), np.zeros(len(way), dtype=np.bool_)
    keys = np.concatenate([roads, first_lane[None], section[None]])
    for key in np.unique(keys, axis=1).T:
        rows = (keys == key[:, None]).all(axis=0)
        *road_indices, lane, k = (int(index) for index in key)
        start, end = network.roads[road_indices[0]].section_span(k)
        # Start at the section's entry, so that all positions in it share one walk.
        forward = network.runs_along(road_indices[0], lane, 0.5 * (start + end))
        section_start = start if forward else end - 1e-9
        extra = (first_s[rows] - section_start) * (1.0 if forward else -1.0)
        walk = [(road_indices[0], lane, section_start), *((index, 0, 0.0) for index in road_indices[1:])]
        road[rows], s[rows], along[rows] = network.along_route(walk, way[rows] + extra)
    return road, s, along


Route = Callable[[World], list[Pose]]


def read_route(holder: etree._Element, scope: Scope, world: World) -> Route:
    """Read the ``Route`` or ``CatalogReference`` in `holder`, as a function that resolves its waypoints in a world.

    `InputError` if there is none, or it has fewer than two waypoints.
    """
    element, scope = scope.referred(holder, "Route")
    waypoints = [
        read_position(position, scope, world)
        for position in (waypoint.find("Position") for waypoint in element.iterfind("Waypoint"))
        if position is not None
    ]
    if len(waypoints) < 2:
        raise InputError(f"{scope.source}, line {element.sourceline}: a <Route> needs at least two waypoints.")

    _network(element, scope, world)
    return lambda world: [waypoint(world) for waypoint in waypoints]


def _trajectory_position(element: etree._Element, scope: Scope, world: World) -> Position:
    holder = element.find("TrajectoryRef")
    if holder is None:
        raise InputError(f"{scope.source}, line {element.sourceline}: <TrajectoryPosition> has no <TrajectoryRef>.")
    shape = read_trajectory(holder, scope, world, read_position)
    s, t = scope.number(element, "s"), scope.number(element, "t", 0.0)
    turn, relative = _orientation(element, scope)
    rows = np.arange(scope.scenarios)

    def resolve(world: World) -> Pose:
        x, y, heading = shape(world).at(s, t, rows)
        return _located(world, x, y, heading + turn if relative else turn)

    return resolve


def _relative_position(element: etree._Element, scope: Scope, world: World) -> Position:
    """Read a ``RelativeObjectPosition`` (in the entity's axes) or a ``RelativeWorldPosition``."""
    entity = entity_index(element, scope, world)
    dx, dy = scope.number(element, "dx"), scope.number(element, "dy")
    turn, relative = _orientation(element, scope)
    in_entity_axes = element.tag == "RelativeObjectPosition"

    def resolve(world: World) -> Pose:
        heading = world.heading[entity]
        x, y = world.x[entity] + dx, world.y[entity] + dy
        if in_entity_axes:
            cos, sin = np.cos(heading), np.sin(heading)
            x = world.x[entity] + cos * dx - sin * dy
            y = world.y[entity] + sin * dx + cos * dy
        return _located(world, x, y, heading + turn if relative else turn)

    return resolve


def _located(world: World, x: FloatArray, y: FloatArray, heading: FloatArray) -> Pose:
    if world.network is None:
        return Pose(x, y, heading)
    position = world.network.locate(x, y)
    return Pose(x, y, heading, position.road, position.lane, position.s, position.offset)


def _on_lane(
    world: World, road: IntArray, lane: IntArray, s: FloatArray, offset: FloatArray, turn: FloatArray, relative: bool
) -> Pose:
    assert world.network is not None
    x, y, heading = (np.full(len(s), np.nan) for _ in range(3))
    s, beyond = _on_the_road(world, road, s)
    for one_road, one_lane in sorted({*zip(road.tolist(), lane.tolist(), strict=True)}):
        inside = (road == one_road) & (lane == one_lane) & world.network.has_lane_at(one_road, one_lane, s)
        if inside.any():
            pose = world.network.world(one_road, one_lane, s[inside], offset[inside])
            x[inside], y[inside], heading[inside] = pose
    heading = heading + turn if relative else np.where(np.isnan(heading), np.nan, turn)
    return Pose(x, y, heading, road, lane, s, offset, beyond)


def _orientation(element: etree._Element, scope: Scope) -> tuple[FloatArray, bool]:
    orientation = element.find("Orientation")
    if orientation is None:
        return np.zeros(scope.scenarios), True
    relative = scope.text(orientation, "type", "absolute") == "relative"
    return scope.number(orientation, "h", 0.0), relative


def _network(element: etree._Element, scope: Scope, world: World) -> RoadNetwork:
    if world.network is None:
        raise InputError(
            f"{scope.source}, line {element.sourceline}: <{element.tag}> needs a road file, but"
            " <RoadNetwork> names none."
        )
    return world.network


_READERS: Final[dict[str, Callable[[etree._Element, Scope, World], Position]]] = {
    "WorldPosition": _world_position,
    "LanePosition": _lane_position,
    "RoadPosition": _road_position,
    "RelativeLanePosition": _relative_lane_position,
    "RelativeRoadPosition": _relative_road_position,
    "RoutePosition": _route_position,
    "TrajectoryPosition": _trajectory_position,
    "RelativeObjectPosition": _relative_position,
    "RelativeWorldPosition": _relative_position,
}
