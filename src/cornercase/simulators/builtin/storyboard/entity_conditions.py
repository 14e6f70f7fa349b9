"""Conditions on one entity, evaluated for every scenario of a batch."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError, suggestion
from cornercase._common.geometry import within_half_turn
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.scenario import Scope
from cornercase.simulators.builtin.actions.longitudinal import child
from cornercase.simulators.builtin.frames import gaps, leaves
from cornercase.simulators.builtin.frames.gaps import TOLERANCE
from cornercase.simulators.builtin.frames.leaves import ALIGNED, Leaf
from cornercase.simulators.builtin.paths.distances import Gap, read_gap
from cornercase.simulators.builtin.paths.positions import entities_in, entity_index, read_position, stays_put
from cornercase.simulators.builtin.world.contacts import overlap
from cornercase.simulators.builtin.world.gaps import along_roads, longitudinal_reach
from cornercase.simulators.builtin.world.state import World
from cornercase.simulators.builtin.world.whereabouts import (
    has_lane_between,
    lane_of,
    lanes_between,
    road_heading,
    runs_against,
)

EntityTest = Callable[[World, int], BoolArray]


class Known:
    """A test that kernels can evaluate too: one leaf for each other entity involved."""

    def __init__(self, test: EntityTest, *found: Leaf) -> None:
        self._test, self.leaves = test, found

    def __call__(self, world: World, e: int) -> BoolArray:
        """Evaluate the test for one entity, shape (N,)."""
        return self._test(world, e)


def _equal(a: Any, b: Any) -> Any:
    return np.abs(a - b) <= TOLERANCE


_RULES: Final[dict[str, Callable[[Any, Any], Any]]] = {
    "greaterThan": lambda a, b: a > b + TOLERANCE,
    "lessThan": lambda a, b: a < b - TOLERANCE,
    "equalTo": _equal,
    "greaterOrEqual": lambda a, b: a >= b - TOLERANCE,
    "lessOrEqual": lambda a, b: a <= b + TOLERANCE,
    "notEqualTo": lambda a, b: ~_equal(a, b),
}


def rule_of(
    element: etree._Element, scope: Scope, rules: Mapping[str, Callable[[Any, Any], Any]] = _RULES
) -> Callable[[Any, Any], Any]:
    """Comparison function for an element's ``rule``."""
    rule = scope.text(element, "rule")
    if rule not in rules:
        raise InputError(
            f"{scope.source}, line {element.sourceline}: rule '{rule}' of <{element.tag}>: {suggestion(rule, rules)}"
        )
    return rules[rule]


def number_of_rule(rule: Callable[[Any, Any], Any]) -> int:
    """Index of a comparison in the kernels."""
    return list(_RULES.values()).index(rule)


_COMPONENTS: Final = {"": gaps.ALL_WAYS, "longitudinal": gaps.ALONG, "lateral": gaps.ACROSS}


def _traveled(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    value = scope.number(element, "value")
    return Known(lambda world, e: np.asarray(world.odometer[e] >= value), Leaf(leaves.TRAVELED, values=(value,)))


def _reach_position(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    holder = child(element, "Position", scope)
    position, tolerance = read_position(holder, scope, world), scope.number(element, "tolerance")
    oriented = holder.find("*/Orientation") is not None

    # A fixed position is looked up once.
    fixed_pose = position(world) if stays_put(holder) else None

    def reached(world: World, e: int) -> BoolArray:
        pose = position(world) if fixed_pose is None else fixed_pose
        near = np.hypot(pose.x - world.x[e], pose.y - world.y[e]) < tolerance
        turn = within_half_turn(pose.heading - world.heading[e])
        return np.asarray(near & (np.abs(turn) < ALIGNED) if oriented else near)

    if fixed_pose is None:
        return reached
    values = (fixed_pose.x, fixed_pose.y, fixed_pose.heading, tolerance)
    return Known(reached, Leaf(leaves.REACHES, option=int(oriented), values=values))


def _along(world: World, vector: tuple[FloatArray, FloatArray], e: int, axes: int, direction: str) -> FloatArray:
    """Component of a vector of an entity along or across the heading of `axes`, or 0 upwards, (N,)."""
    x, y, cos, sin = vector[0][e], vector[1][e], np.cos(world.heading[axes]), np.sin(world.heading[axes])
    if direction == "longitudinal":
        return np.asarray(x * cos + y * sin)
    return np.asarray(y * cos - x * sin) if direction == "lateral" else np.zeros(world.scenarios)


def _speed(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    rule, value = rule_of(element, scope), scope.number(element, "value")
    direction = scope.text(element, "direction", "")
    option = _COMPONENTS.get(direction, gaps.UPWARDS)
    leaf = Leaf(leaves.SPEED_IS, rule=number_of_rule(rule), option=option, values=(value,))
    if not direction:
        return Known(lambda world, e: np.asarray(rule(world.speed[e], value)), leaf)
    return Known(lambda world, e: np.asarray(rule(_along(world, world.gone, e, e, direction), value)), leaf)


def _relative_speed(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    rule, value = rule_of(element, scope), scope.number(element, "value")
    other, direction = entity_index(element, scope, world), scope.text(element, "direction", "")

    def holds(world: World, e: int) -> BoolArray:
        if not direction:
            difference = world.speed[e] - world.speed[other]
        else:
            own_component, other_component = (
                _along(world, world.gone, entity, other, direction) for entity in (e, other)
            )
            difference = own_component - other_component
        return np.asarray(rule(difference, value) & world.present[other])

    option = _COMPONENTS.get(direction, gaps.UPWARDS)
    return Known(holds, Leaf(leaves.RELATIVE_SPEED, other, number_of_rule(rule), option, (value,)))


def _acceleration(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    rule, value = rule_of(element, scope), scope.number(element, "value")
    direction = scope.text(element, "direction", "")

    def holds(world: World, e: int) -> BoolArray:
        if direction:
            return np.asarray(rule(_along(world, world.pull, e, e, direction), value))
        # Negative against the heading.
        size = np.hypot(world.pull[0][e], world.pull[1][e])
        return np.asarray(rule(np.where(_along(world, world.pull, e, e, "longitudinal") < 0.0, -size, size), value))

    option = _COMPONENTS.get(direction, gaps.UPWARDS)
    return Known(holds, Leaf(leaves.ACCELERATION_IS, rule=number_of_rule(rule), option=option, values=(value,)))


def _stand_still(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    duration = scope.number(element, "duration")
    leaf = Leaf(leaves.STANDS, values=(duration,))
    return Known(lambda world, e: np.asarray(world.time - world.standing_since[e] > duration), leaf)


def _end_of_road(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    duration = scope.number(element, "duration")
    leaf = Leaf(leaves.AT_END, values=(duration,))
    return Known(lambda world, e: np.asarray(world.time - world.at_end_since[e] > duration - TOLERANCE), leaf)


def _off_road(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    duration = scope.number(element, "duration")
    world.watches_roads = True
    return lambda world, e: np.asarray(world.time - world.off_road_since[e] > duration)


def _collision(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    by_type = element.find("ByType")
    if by_type is not None:
        object_type = scope.text(by_type, "type")
        others = [k for k, entity in enumerate(world.entities) if _type_of(entity.kind) == object_type]
    else:
        others = entities_in(element, scope, world)
    if by_type is None and not others:
        raise InputError(f"{scope.source}, line {element.sourceline}: <CollisionCondition> names no entity.")

    def holds(world: World, e: int) -> BoolArray:
        result = np.zeros(world.scenarios, dtype=np.bool_)
        for other in others:
            result |= overlap(world, e, other)
        return result

    return Known(holds, *(Leaf(leaves.COLLIDES, other) for other in others))


def _type_of(kind: str) -> str:
    return {"pedestrian": "pedestrian", "misc": "miscellaneous"}.get(kind, "vehicle")


def _relative_distance(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    other, gap = entity_index(element, scope, world), read_gap(element, scope)
    rule, value = rule_of(element, scope), scope.number(element, "value")

    def holds(world: World, e: int) -> BoolArray:
        return np.asarray(rule(np.abs(gap.to_entity(world, e, other)), value) & world.present[other])

    option = _measured(gap, to_entity=True)
    return holds if option is None else Known(holds, Leaf(leaves.APART, other, number_of_rule(rule), option, (value,)))


def _distance(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    holder = child(element, "Position", scope)
    position, gap = read_position(holder, scope, world), read_gap(element, scope)
    rule, value = rule_of(element, scope), scope.number(element, "value")
    fixed_pose = position(world) if stays_put(holder) else None

    def holds(world: World, e: int) -> BoolArray:
        pose = position(world) if fixed_pose is None else fixed_pose
        return np.asarray(rule(np.abs(gap.to_place(world, e, pose)), value))

    option = _measured(gap, to_entity=False)
    if option is None or fixed_pose is None:
        return holds
    leaf = Leaf(leaves.APART_FROM_PLACE, -1, number_of_rule(rule), option, (fixed_pose.x, fixed_pose.y, value))
    return Known(holds, leaf)


def _measured(gap: Gap, to_entity: bool) -> int | None:
    """Option by which kernels measure a gap; None if they cannot."""
    options = {"euclidean": gaps.EUCLIDEAN, "longitudinal": gaps.LONGITUDINAL, "lateral": gaps.LATERAL}
    if (gap.along_road and gap.kind != "euclidean") or (to_entity and gap.free and gap.kind == "euclidean"):
        return None
    return options[gap.kind] + gaps.FREE * gap.free


def _time_headway(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    other, gap = entity_index(element, scope, world), read_gap(element, scope)
    rule, value = rule_of(element, scope), scope.number(element, "value")

    def holds(world: World, e: int) -> BoolArray:
        distance, speed = gap.to_entity(world, e, other), world.speed[e]
        defined = (distance >= 0.0) & (speed >= TOLERANCE) & world.present[other]
        return np.asarray(defined & rule(distance / np.where(defined, speed, 1.0), value))

    option = _measured(gap, to_entity=True)
    return (
        holds if option is None else Known(holds, Leaf(leaves.HEADWAY, other, number_of_rule(rule), option, (value,)))
    )


def _time_to_collision(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    gap, rule, value = read_gap(element, scope), rule_of(element, scope), scope.number(element, "value")
    target = element.find("TimeToCollisionConditionTarget")
    reference = None if target is None else target.find("EntityRef")
    holder = None if target is None else target.find("Position")
    if reference is not None:
        other = entity_index(reference, scope, world)
        option = _measured(gap, to_entity=True)

        def collides(world: World, e: int) -> BoolArray:
            return _collides(world, e, other, gap, rule, value)

        if option is None:
            return collides
        return Known(collides, Leaf(leaves.TIME_TO_COLLISION, other, number_of_rule(rule), option, (value,)))
    if holder is None:
        raise InputError(
            f"{scope.source}, line {element.sourceline}: <TimeToCollisionCondition> names neither an entity nor a"
            " position as its target."
        )
    position = read_position(holder, scope, world)

    def holds(world: World, e: int) -> BoolArray:
        return _in_time(gap.to_place(world, e, position(world)), world.speed[e], rule, value)

    return holds


def _collides(world: World, e: int, other: int, gap: Gap, rule: Callable[[Any, Any], Any], value: Any) -> BoolArray:
    distance = gap.to_entity(world, e, other)
    # The closing speed is measured along the other's direction of motion.
    x, y = world.gone[0][other], world.gone[1][other]
    pace = np.hypot(x, y)
    stands = (np.abs(x) < TOLERANCE) & (np.abs(y) < TOLERANCE)
    own_speed = (world.gone[0][e] * x + world.gone[1][e] * y) / np.where(stands, 1.0, pace)
    signs = np.where(world.speed[e] < 0.0, -1.0, 1.0) * np.where(own_speed < 0.0, -1.0, 1.0)
    closing = np.where(stands, world.speed[e], signs * (own_speed - np.abs(world.speed[other])))
    return np.asarray(_in_time(distance, closing, rule, value) & world.present[other])


def _in_time(distance: FloatArray, closing: FloatArray, rule: Callable[[Any, Any], Any], value: Any) -> BoolArray:
    defined = (np.abs(distance) >= TOLERANCE) & (np.abs(closing) >= TOLERANCE)
    time = np.where(defined, distance / np.where(defined, closing, 1.0), -1.0)
    return np.asarray((time >= 0.0) & rule(time, value))


def _relative_clearance(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    forward, backward = scope.number(element, "distanceForward", 0.0), scope.number(element, "distanceBackward", 0.0)
    free, opposite = scope.flag(element, "freeSpace", False), scope.flag(element, "oppositeLanes", False)
    lanes = element.find("RelativeLaneRange")
    first = -100 if lanes is None else scope.whole_number(lanes, "from", -100)
    last = 100 if lanes is None else scope.whole_number(lanes, "to", 100)
    others = entities_in(element, scope, world)

    def holds(world: World, e: int) -> BoolArray:
        own_pose = lane_of(world, e)
        assert own_pose.lane is not None
        occupied = np.zeros(world.scenarios, dtype=np.bool_)
        for other in others or [k for k in range(len(world.entities)) if k != e]:
            pose = lane_of(world, other)
            assert pose.lane is not None
            distance = along_roads(world, e, pose)
            if free:
                overlap_ahead, overlap_behind = longitudinal_reach(world, e, other)
                distance = np.where(
                    distance > 0, np.maximum(distance - overlap_ahead, 0.0), np.minimum(distance + overlap_behind, 0.0)
                )
            # On a road with opposite direction, lanes have the opposite sign.
            is_opposite = runs_against(world, e, pose)
            lane = np.where(is_opposite, -own_pose.lane, own_pose.lane)
            lane_difference = lanes_between(world, replace(own_pose, lane=lane), pose) * np.where(is_opposite, -1, 1)
            same_side = np.sign(lane) == np.sign(pose.lane)
            inside = (
                (distance >= -backward) & (distance <= forward) & (lane_difference >= first) & (lane_difference <= last)
            )
            occupied |= inside & (same_side | opposite) & world.present[other]
        return np.asarray(~occupied & has_lane_between(world, own_pose, first, last, opposite))

    return holds


def _angle(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    angle, tolerance = scope.number(element, "angle"), scope.number(element, "angleTolerance")
    angle_type, system = scope.text(element, "angleType", "heading"), scope.text(element, "coordinateSystem", "world")
    other = entity_index(element, scope, world) if element.get("entityRef") is not None else None

    def holds(world: World, e: int) -> BoolArray:
        current = world.heading[e]
        if angle_type != "heading":
            current = np.zeros(world.scenarios)
        elif other is not None:
            current = current - world.heading[other]
        elif system == "entity":
            current = np.zeros(world.scenarios)
        elif system in ("road", "lane") and world.network is not None:
            pose = lane_of(world, e)
            current = current - road_heading(world, pose)
            if system == "lane" and pose.lane is not None and pose.road is not None and pose.s is not None:
                against = [
                    not world.network.runs_along(int(r), int(k), float(s))
                    for r, k, s in zip(pose.road, pose.lane, pose.s, strict=True)
                ]
                current = current - np.where(against, np.pi, 0.0)
        difference = np.abs(within_half_turn(current - angle))
        return np.asarray(difference < tolerance + TOLERANCE)

    if angle_type == "heading" and other is None and system in ("road", "lane") and world.network is not None:
        return holds
    if angle_type != "heading" or (other is None and system == "entity"):
        return Known(holds, Leaf(leaves.TURNED, values=(angle, tolerance)))
    return Known(holds, Leaf(leaves.TURNED, -1 if other is None else other, option=1, values=(angle, tolerance)))


BY_ENTITY: Final[dict[str, Callable[[etree._Element, Scope, World], EntityTest]]] = {
    "TraveledDistanceCondition": _traveled,
    "ReachPositionCondition": _reach_position,
    "SpeedCondition": _speed,
    "RelativeSpeedCondition": _relative_speed,
    "AccelerationCondition": _acceleration,
    "StandStillCondition": _stand_still,
    "EndOfRoadCondition": _end_of_road,
    "OffroadCondition": _off_road,
    "CollisionCondition": _collision,
    "RelativeDistanceCondition": _relative_distance,
    "DistanceCondition": _distance,
    "TimeHeadwayCondition": _time_headway,
    "TimeToCollisionCondition": _time_to_collision,
    "RelativeClearanceCondition": _relative_clearance,
    "AngleCondition": _angle,
    "RelativeAngleCondition": _angle,
}
