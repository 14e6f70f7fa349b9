"""OpenSCENARIO positions, resolved for all scenarios of a batch at the instant they are asked for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from lxml import etree

from cornercase.errors import InputError, suggestion
from cornercase.simulators.builtin.scope import Scope
from cornercase.simulators.builtin.tracks import Pose
from cornercase.simulators.builtin.world import World
from cornercase.typing import FloatArray, IntArray

Position = Callable[[World], Pose]


def read_position(holder: etree._Element, scope: Scope, world: World) -> Position:
    """Read the position inside `holder`, a ``Position`` or an element of that type.

    Raises
    ------
    InputError
        There is none, it is of a kind that is not supported, or it names what does not exist.
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


def entity_index(element: etree._Element, scope: Scope, world: World, attribute: str = "entityRef") -> int:
    """Row of the entity that an attribute names."""
    name = scope.text(element, attribute)
    if name not in world.names:
        raise InputError(
            f"{scope.source}, line {element.sourceline}: <{element.tag}> names the entity '{name}', which does not"
            f" exist; {suggestion(name, world.names)}"
        )
    return world.names.index(name)


def _world_position(element: etree._Element, scope: Scope, world: World) -> Position:
    pose = Pose(scope.number(element, "x"), scope.number(element, "y"), scope.number(element, "h", 0.0))

    def resolve(world: World) -> Pose:
        if world.network is None:
            return pose
        place = world.network.locate(pose.x, pose.y)
        return Pose(pose.x, pose.y, pose.heading, place.road, place.lane, place.s, place.offset)

    return resolve


def _lane_position(element: etree._Element, scope: Scope, world: World) -> Position:
    network = _network(element, scope, world)
    road = network.index_of(scope.text(element, "roadId"))
    lane = int(scope.one_number(element, "laneId"))
    s, offset = scope.number(element, "s"), scope.number(element, "offset", 0.0)
    turn, relative = _orientation(element, scope)
    n = scope.scenarios

    def resolve(world: World) -> Pose:
        return _on_lane(world, np.full(n, road), np.full(n, lane), s, offset, turn, relative)

    return resolve


def _road_position(element: etree._Element, scope: Scope, world: World) -> Position:
    network = _network(element, scope, world)
    road = network.index_of(scope.text(element, "roadId"))
    s, t = scope.number(element, "s"), scope.number(element, "t")
    turn, relative = _orientation(element, scope)

    def resolve(world: World) -> Pose:
        assert world.network is not None
        x, y, along = world.network.road_world(road, s, t)
        place = world.network.locate(x, y)
        heading = along + turn if relative else turn
        return Pose(x, y, heading, place.road, place.lane, place.s, place.offset)

    return resolve


def _relative_lane_position(element: etree._Element, scope: Scope, world: World) -> Position:
    _network(element, scope, world)
    entity = entity_index(element, scope, world)
    lanes = int(scope.one_number(element, "dLane"))
    ds, offset = scope.number(element, "ds", 0.0), scope.number(element, "offset", 0.0)
    turn, relative = _orientation(element, scope)

    def resolve(world: World) -> Pose:
        base = world.lane_of(entity)
        assert base.road is not None
        assert base.lane is not None
        assert base.s is not None
        lane = base.lane + lanes
        # There is no lane 0: a step across the centre line skips it.
        lane = np.where((lane == 0) | (np.sign(lane) != np.sign(base.lane)), lane + np.sign(lanes), lane)
        return _on_lane(world, base.road, lane, base.s + ds, offset, turn, relative)

    return resolve


def _relative_object_position(element: etree._Element, scope: Scope, world: World) -> Position:
    entity = entity_index(element, scope, world)
    dx, dy = scope.number(element, "dx"), scope.number(element, "dy")
    turn, relative = _orientation(element, scope)

    def resolve(world: World) -> Pose:
        heading = world.heading[entity]
        cos, sin = np.cos(heading), np.sin(heading)
        x = world.x[entity] + cos * dx - sin * dy
        y = world.y[entity] + sin * dx + cos * dy
        return _located(world, x, y, heading + turn if relative else turn)

    return resolve


def _relative_world_position(element: etree._Element, scope: Scope, world: World) -> Position:
    entity = entity_index(element, scope, world)
    dx, dy = scope.number(element, "dx"), scope.number(element, "dy")
    turn, relative = _orientation(element, scope)

    def resolve(world: World) -> Pose:
        heading = world.heading[entity] + turn if relative else turn
        return _located(world, world.x[entity] + dx, world.y[entity] + dy, heading)

    return resolve


def _located(world: World, x: FloatArray, y: FloatArray, heading: FloatArray) -> Pose:
    if world.network is None:
        return Pose(x, y, heading)
    place = world.network.locate(x, y)
    return Pose(x, y, heading, place.road, place.lane, place.s, place.offset)


def _on_lane(
    world: World,
    road: IntArray,
    lane: IntArray,
    s: FloatArray,
    offset: FloatArray,
    turn: FloatArray,
    relative: bool,
) -> Pose:
    assert world.network is not None
    x, y, heading = (np.full(len(s), np.nan) for _ in range(3))
    for one_road, one_lane in sorted({*zip(road.tolist(), lane.tolist(), strict=True)}):
        rows = (road == one_road) & (lane == one_lane)
        inside = rows & (s >= -1e-6) & (s <= world.network.lengths[one_road] + 1e-6)
        if world.network.has_lane(one_road, one_lane) and inside.any():
            x[inside], y[inside], heading[inside] = world.network.world(one_road, one_lane, s[inside], offset[inside])
    heading = heading + turn if relative else np.where(np.isnan(heading), np.nan, turn)
    return Pose(x, y, heading, road, lane, s, offset)


def _orientation(element: etree._Element, scope: Scope) -> tuple[FloatArray, bool]:
    orientation = element.find("Orientation")
    if orientation is None:
        return np.zeros(scope.scenarios), True
    relative = scope.text(orientation, "type", "absolute") == "relative"
    return scope.number(orientation, "h", 0.0), relative


def _network(element: etree._Element, scope: Scope, world: World):  # type: ignore[no-untyped-def]
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
    "RelativeObjectPosition": _relative_object_position,
    "RelativeWorldPosition": _relative_world_position,
}
