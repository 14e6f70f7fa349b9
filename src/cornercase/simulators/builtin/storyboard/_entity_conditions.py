"""Conditions on a single entity, evaluated for all scenarios of a batch."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np
from lxml import etree

from cornercase._common.errors import suggest_name
from cornercase._common.geometry.boxes import wrap_angle
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.scenario._scope import Scope
from cornercase.simulators.builtin.actions._longitudinal import require_child
from cornercase.simulators.builtin.kernels import _conditions as conditions
from cornercase.simulators.builtin.kernels import _distances as distances
from cornercase.simulators.builtin.kernels._conditions import MAX_HEADING_DIFFERENCE, LeafCondition
from cornercase.simulators.builtin.kernels._distances import TOLERANCE
from cornercase.simulators.builtin.paths._distance_measure import read_distance_measure
from cornercase.simulators.builtin.paths._positions import (
    is_static_position,
    read_entity_index,
    read_entity_refs,
    read_position,
)
from cornercase.simulators.builtin.world._entity_distances import distance_along_roads, free_space_to_entity
from cornercase.simulators.builtin.world._road_position import (
    has_drivable_lane_in_range,
    is_opposite_direction,
    relative_lane,
    road_heading,
    road_pose,
)
from cornercase.simulators.builtin.world._world import World

EntityTest = Callable[[World, int], BoolArray] | tuple[LeafCondition, ...]
"""A function of the world and an entity's index that returns a mask, or conditions for compiled code, joined by or."""

ConditionReader = Callable[[etree._Element, Scope, World], EntityTest]


def _is_equal(a: Any, b: Any) -> Any:
    return np.abs(a - b) <= TOLERANCE


_RULES: Final[dict[str, Callable[[Any, Any], Any]]] = {
    "greaterThan": lambda a, b: a > b + TOLERANCE,
    "lessThan": lambda a, b: a < b - TOLERANCE,
    "equalTo": _is_equal,
    "greaterOrEqual": lambda a, b: a >= b - TOLERANCE,
    "lessOrEqual": lambda a, b: a <= b + TOLERANCE,
    "notEqualTo": lambda a, b: ~_is_equal(a, b),
}


def read_comparison_rule(
    element: etree._Element, scope: Scope, rules: Mapping[str, Callable[[Any, Any], Any]] = _RULES
) -> Callable[[Any, Any], Any]:
    """Return the comparison function for the ``rule`` of an element."""
    rule = scope.read_text(element, "rule")
    if rule not in rules:
        raise scope.error_at(element, f"rule '{rule}' of <{element.tag}>: {suggest_name(rule, rules)}")
    return rules[rule]


def comparison_rule_index(rule: Callable[[Any, Any], Any]) -> int:
    """Return the index by which compiled code selects a comparison rule."""
    return list(_RULES.values()).index(rule)


_COMPONENTS: Final = {
    "": distances.MAGNITUDE,
    "longitudinal": distances.LONGITUDINAL_COMPONENT,
    "lateral": distances.LATERAL_COMPONENT,
}


def _make_threshold_reader(kind: int, attribute: str) -> ConditionReader:
    """Return a function that reads a condition, which holds if a property of the entity reaches a number in the file.

    `attribute` is the XML attribute with this number. A duration of standstill must exceed it.
    """
    return lambda element, scope, world: (LeafCondition(kind, values=(scope.read_numbers(element, attribute),)),)


def _reach_position_condition(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    holder = require_child(element, "Position", scope)
    position, tolerance = read_position(holder, scope, world), scope.read_numbers(element, "tolerance")
    oriented = holder.find("*/Orientation") is not None
    if is_static_position(holder):
        # A fixed position is looked up once.
        pose = position(world)
        values = (pose.x, pose.y, pose.heading, tolerance)
        return (LeafCondition(conditions.REACH_POSITION_CONDITION, option=int(oriented), values=values),)

    def reached(world: World, e: int) -> BoolArray:
        pose = position(world)
        near = np.hypot(pose.x - world.x[e], pose.y - world.y[e]) < tolerance
        turn = wrap_angle(pose.heading - world.heading[e])
        return np.asarray(near & (np.abs(turn) < MAX_HEADING_DIFFERENCE) if oriented else near)

    return reached


def _make_velocity_reader(kind: int) -> ConditionReader:
    """Return a function that reads a condition on the size or a component of a velocity or an acceleration."""

    def read(element: etree._Element, scope: Scope, world: World) -> EntityTest:
        other = read_entity_index(element, scope, world) if kind == conditions.RELATIVE_SPEED_CONDITION else -1
        rule, value = read_comparison_rule(element, scope), scope.read_numbers(element, "value")
        option = _COMPONENTS.get(scope.read_text(element, "direction", ""), distances.VERTICAL_COMPONENT)
        return (LeafCondition(kind, other, comparison_rule_index(rule), option, (value,)),)

    return read


def _off_road_condition(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    duration = scope.read_numbers(element, "duration")
    world.needs_road_check = True
    return lambda world, e: np.asarray(world.time - world.off_road_since[e] > duration)


def _collision_condition(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    by_type = element.find("ByType")
    if by_type is not None:
        others = world.entities_of_type(scope.read_text(by_type, "type"))
    elif not (others := read_entity_refs(element, scope, world)):
        raise scope.error_at(element, "<CollisionCondition> names no entity.")
    return tuple(LeafCondition(conditions.COLLISION_CONDITION, other) for other in others)


Comparison = Callable[[FloatArray], Any]
"""Compares numbers with the value in the file, by the rule in the file."""

GapTest = Callable[[World, int, int, FloatArray, Comparison], Any]
"""Decides by the world, the indices of two entities, their distance in m in each scenario, and a comparison."""


def _read_gap_condition(kind: int, holds: GapTest, element: etree._Element, other: int, scope: Scope) -> EntityTest:
    """Read a condition on the distance to the entity `other`.

    `holds` is the test in Python, which is used if compiled code cannot measure the distance.
    """
    gap, rule = read_distance_measure(element, scope), read_comparison_rule(element, scope)
    value, kernel_kind = scope.read_numbers(element, "value"), gap.kernel_kind(to_entity=True)
    if kernel_kind is not None:
        return (LeafCondition(kind, other, comparison_rule_index(rule), kernel_kind, (value,)),)

    def test(world: World, e: int) -> BoolArray:
        distance = gap.measure_to_entity(world, e, other)
        return np.asarray(holds(world, e, other, distance, lambda number: rule(number, value)) & world.present[other])

    return test


def _make_gap_reader(kind: int, holds: GapTest) -> ConditionReader:
    """Return a function that reads a condition on the distance to the entity that its XML element names."""
    return lambda element, scope, world: _read_gap_condition(
        kind, holds, element, read_entity_index(element, scope, world), scope
    )


def _relative_distance_holds(world: World, e: int, other: int, distance: FloatArray, compare: Comparison) -> Any:
    return compare(np.abs(distance))


def _time_headway_holds(world: World, e: int, other: int, distance: FloatArray, compare: Comparison) -> Any:
    defined = (distance >= 0.0) & (world.speed[e] >= TOLERANCE)
    return defined & compare(distance / np.where(defined, world.speed[e], 1.0))


def _distance_condition(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    holder = require_child(element, "Position", scope)
    position, gap = read_position(holder, scope, world), read_distance_measure(element, scope)
    rule, value = read_comparison_rule(element, scope), scope.read_numbers(element, "value")
    kernel_kind = gap.kernel_kind(to_entity=False)
    fixed_pose = position(world) if is_static_position(holder) else None
    if kernel_kind is not None and fixed_pose is not None:
        values = (fixed_pose.x, fixed_pose.y, value)
        return (LeafCondition(conditions.DISTANCE_CONDITION, -1, comparison_rule_index(rule), kernel_kind, values),)

    def holds(world: World, e: int) -> BoolArray:
        pose = position(world) if fixed_pose is None else fixed_pose
        return np.asarray(rule(np.abs(gap.measure_to_point(world, e, pose)), value))

    return holds


def _time_to_collision_condition(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    target = element.find("TimeToCollisionConditionTarget")
    reference = None if target is None else target.find("EntityRef")
    holder = None if target is None else target.find("Position")
    if reference is not None:
        other = read_entity_index(reference, scope, world)
        kind = conditions.TIME_TO_COLLISION_CONDITION
        return _read_gap_condition(kind, _ttc_to_entity_holds, element, other, scope)
    if holder is None:
        raise scope.error_at(
            element, "<TimeToCollisionCondition> names neither an entity nor a position as its target."
        )
    position, gap = read_position(holder, scope, world), read_distance_measure(element, scope)
    rule, value = read_comparison_rule(element, scope), scope.read_numbers(element, "value")

    def holds(world: World, e: int) -> BoolArray:
        distance = gap.measure_to_point(world, e, position(world))
        return np.asarray(_ttc_holds(distance, world.speed[e], lambda number: rule(number, value)))

    return holds


def _ttc_to_entity_holds(world: World, e: int, other: int, distance: FloatArray, compare: Comparison) -> Any:
    # The closing speed is measured along the other's direction of motion.
    x, y = world.step_velocity[0][other], world.step_velocity[1][other]
    pace = np.hypot(x, y)
    stands = (np.abs(x) < TOLERANCE) & (np.abs(y) < TOLERANCE)
    own_speed = (world.step_velocity[0][e] * x + world.step_velocity[1][e] * y) / np.where(stands, 1.0, pace)
    signs = np.where(world.speed[e] < 0.0, -1.0, 1.0) * np.where(own_speed < 0.0, -1.0, 1.0)
    closing = np.where(stands, world.speed[e], signs * (own_speed - np.abs(world.speed[other])))
    return _ttc_holds(distance, closing, compare)


def _ttc_holds(distance: FloatArray, closing: FloatArray, compare: Comparison) -> Any:
    defined = (np.abs(distance) >= TOLERANCE) & (np.abs(closing) >= TOLERANCE)
    time = np.where(defined, distance / np.where(defined, closing, 1.0), -1.0)
    return (time >= 0.0) & compare(time)


def _relative_clearance_condition(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    forward = scope.read_numbers(element, "distanceForward", 0.0)
    backward = scope.read_numbers(element, "distanceBackward", 0.0)
    free = scope.read_boolean(element, "freeSpace", False)
    opposite = scope.read_boolean(element, "oppositeLanes", False)
    lanes = element.find("RelativeLaneRange")
    first = -100 if lanes is None else scope.read_integer(lanes, "from", -100)
    last = 100 if lanes is None else scope.read_integer(lanes, "to", 100)
    others = read_entity_refs(element, scope, world)

    def holds(world: World, e: int) -> BoolArray:
        own_pose = road_pose(world, e)
        own_lane = own_pose.road_coordinates()[1]
        occupied = np.zeros(world.scenarios, dtype=np.bool_)
        for other in others or [k for k in range(len(world.entities)) if k != e]:
            pose = road_pose(world, other)
            distance = distance_along_roads(world, e, pose)
            if free:
                distance = free_space_to_entity(world, e, other, distance)
            # On a road with opposite direction, lanes have the opposite sign.
            is_opposite = is_opposite_direction(world, e, pose)
            lane = np.where(is_opposite, -own_lane, own_lane)
            lane_difference = relative_lane(world, replace(own_pose, lane=lane), pose) * np.where(is_opposite, -1, 1)
            same_side = np.sign(lane) == np.sign(pose.road_coordinates()[1])
            inside = (
                (distance >= -backward) & (distance <= forward) & (lane_difference >= first) & (lane_difference <= last)
            )
            occupied |= inside & (same_side | opposite) & world.present[other]
        return np.asarray(~occupied & has_drivable_lane_in_range(world, own_pose, first, last, opposite))

    return holds


def _angle_condition(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    angle, tolerance = scope.read_numbers(element, "angle"), scope.read_numbers(element, "angleTolerance")
    is_heading = scope.read_text(element, "angleType", "heading") == "heading"
    system, network = scope.read_text(element, "coordinateSystem", "world"), world.network
    other = read_entity_index(element, scope, world) if element.get("entityRef") is not None else None
    if network is None or other is not None or not is_heading or system not in ("road", "lane"):
        is_relevant = is_heading and (other is not None or system != "entity")
        entity, values = -1 if other is None or not is_heading else other, (angle, tolerance)
        return (LeafCondition(conditions.RELATIVE_ANGLE_CONDITION, entity, option=int(is_relevant), values=values),)

    def holds(world: World, e: int) -> BoolArray:
        pose = road_pose(world, e)
        current = world.heading[e] - road_heading(world, pose)
        if system == "lane":
            against = [
                not network.is_traffic_forward(int(road), int(lane), float(s))
                for road, lane, s in zip(*pose.road_coordinates(), strict=True)
            ]
            current = current - np.where(against, np.pi, 0.0)
        return np.asarray(np.abs(wrap_angle(current - angle)) < tolerance + TOLERANCE)

    return holds


ENTITY_CONDITION_READERS: Final[dict[str, ConditionReader]] = {
    "TraveledDistanceCondition": _make_threshold_reader(conditions.TRAVELED_DISTANCE_CONDITION, "value"),
    "ReachPositionCondition": _reach_position_condition,
    "SpeedCondition": _make_velocity_reader(conditions.SPEED_CONDITION),
    "RelativeSpeedCondition": _make_velocity_reader(conditions.RELATIVE_SPEED_CONDITION),
    "AccelerationCondition": _make_velocity_reader(conditions.ACCELERATION_CONDITION),
    "StandStillCondition": _make_threshold_reader(conditions.STAND_STILL_CONDITION, "duration"),
    "EndOfRoadCondition": _make_threshold_reader(conditions.END_OF_ROAD_CONDITION, "duration"),
    "OffroadCondition": _off_road_condition,
    "CollisionCondition": _collision_condition,
    "RelativeDistanceCondition": _make_gap_reader(conditions.RELATIVE_DISTANCE_CONDITION, _relative_distance_holds),
    "DistanceCondition": _distance_condition,
    "TimeHeadwayCondition": _make_gap_reader(conditions.TIME_HEADWAY_CONDITION, _time_headway_holds),
    "TimeToCollisionCondition": _time_to_collision_condition,
    "RelativeClearanceCondition": _relative_clearance_condition,
    "AngleCondition": _angle_condition,
    "RelativeAngleCondition": _angle_condition,
}
