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
from cornercase.simulators.builtin.paths._distance_measure import DistanceMeasure, read_distance_measure
from cornercase.simulators.builtin.paths._positions import (
    is_static_position,
    read_entity_index,
    read_entity_refs,
    read_position,
)
from cornercase.simulators.builtin.world._entity_distances import box_lengths_between_references, distance_along_roads
from cornercase.simulators.builtin.world._road_position import (
    has_drivable_lane_in_range,
    is_opposite_direction,
    relative_lane,
    road_heading,
    road_pose,
)
from cornercase.simulators.builtin.world._world import World

EntityTest = Callable[[World, int], BoolArray] | tuple[LeafCondition, ...]
"""A function of the state and an entity's row that returns an array (N,), or leaves any of which has to hold."""


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
    """Return the number of a comparison rule in kernels."""
    return list(_RULES.values()).index(rule)


_COMPONENTS: Final = {
    "": distances.MAGNITUDE,
    "longitudinal": distances.LONGITUDINAL_COMPONENT,
    "lateral": distances.LATERAL_COMPONENT,
}


def _traveled_distance_condition(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    value = scope.read_numbers(element, "value")
    return (LeafCondition(conditions.TRAVELED_DISTANCE_CONDITION, values=(value,)),)


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


def _speed_condition(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    return (_read_velocity_leaf(conditions.SPEED_CONDITION, element, scope),)


def _read_velocity_leaf(kind: int, element: etree._Element, scope: Scope, other: int = -1) -> LeafCondition:
    """Read the rule, value and component of a condition on a velocity or an acceleration."""
    rule, value = read_comparison_rule(element, scope), scope.read_numbers(element, "value")
    option = _COMPONENTS.get(scope.read_text(element, "direction", ""), distances.VERTICAL_COMPONENT)
    return LeafCondition(kind, other, comparison_rule_index(rule), option, (value,))


def _relative_speed_condition(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    other = read_entity_index(element, scope, world)
    return (_read_velocity_leaf(conditions.RELATIVE_SPEED_CONDITION, element, scope, other),)


def _acceleration_condition(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    return (_read_velocity_leaf(conditions.ACCELERATION_CONDITION, element, scope),)


def _stand_still_condition(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    return (LeafCondition(conditions.STAND_STILL_CONDITION, values=(scope.read_numbers(element, "duration"),)),)


def _end_of_road_condition(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    return (LeafCondition(conditions.END_OF_ROAD_CONDITION, values=(scope.read_numbers(element, "duration"),)),)


def _off_road_condition(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    duration = scope.read_numbers(element, "duration")
    world.needs_road_check = True
    return lambda world, e: np.asarray(world.time - world.off_road_since[e] > duration)


def _collision_condition(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    by_type = element.find("ByType")
    if by_type is not None:
        object_type = scope.read_text(by_type, "type")
        others = [k for k, entity in enumerate(world.entities) if _object_type_of_category(entity.kind) == object_type]
    else:
        others = read_entity_refs(element, scope, world)
    if by_type is None and not others:
        raise scope.error_at(element, "<CollisionCondition> names no entity.")

    return tuple(LeafCondition(conditions.COLLISION_CONDITION, other) for other in others)


def _object_type_of_category(category: str) -> str:
    return {"pedestrian": "pedestrian", "misc": "miscellaneous"}.get(category, "vehicle")


def _relative_distance_condition(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    other, gap = read_entity_index(element, scope, world), read_distance_measure(element, scope)
    rule, value = read_comparison_rule(element, scope), scope.read_numbers(element, "value")
    option = _kernel_gap_option(gap, to_entity=True)
    if option is not None:
        index = comparison_rule_index(rule)
        return (LeafCondition(conditions.RELATIVE_DISTANCE_CONDITION, other, index, option, (value,)),)

    def holds(world: World, e: int) -> BoolArray:
        return np.asarray(rule(np.abs(gap.measure_to_entity(world, e, other)), value) & world.present[other])

    return holds


def _distance_condition(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    holder = require_child(element, "Position", scope)
    position, gap = read_position(holder, scope, world), read_distance_measure(element, scope)
    rule, value = read_comparison_rule(element, scope), scope.read_numbers(element, "value")
    option = _kernel_gap_option(gap, to_entity=False)
    fixed_pose = position(world) if is_static_position(holder) else None
    if option is not None and fixed_pose is not None:
        values = (fixed_pose.x, fixed_pose.y, value)
        return (LeafCondition(conditions.DISTANCE_CONDITION, -1, comparison_rule_index(rule), option, values),)

    def holds(world: World, e: int) -> BoolArray:
        pose = position(world) if fixed_pose is None else fixed_pose
        return np.asarray(rule(np.abs(gap.measure_to_point(world, e, pose)), value))

    return holds


def _kernel_gap_option(gap: DistanceMeasure, to_entity: bool) -> int | None:
    """Return the option for which kernels measure a gap; None if kernels cannot measure it."""
    options = {
        "euclidean": distances.EUCLIDEAN_DISTANCE,
        "longitudinal": distances.LONGITUDINAL_DISTANCE,
        "lateral": distances.LATERAL_DISTANCE,
    }
    if (gap.along_road and gap.kind != "euclidean") or (to_entity and gap.is_free_space and gap.kind == "euclidean"):
        return None
    return options[gap.kind] + distances.FREE_SPACE * gap.is_free_space


def _time_headway_condition(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    other, gap = read_entity_index(element, scope, world), read_distance_measure(element, scope)
    rule, value = read_comparison_rule(element, scope), scope.read_numbers(element, "value")
    option = _kernel_gap_option(gap, to_entity=True)
    if option is not None:
        index = comparison_rule_index(rule)
        return (LeafCondition(conditions.TIME_HEADWAY_CONDITION, other, index, option, (value,)),)

    def holds(world: World, e: int) -> BoolArray:
        distance, speed = gap.measure_to_entity(world, e, other), world.speed[e]
        defined = (distance >= 0.0) & (speed >= TOLERANCE) & world.present[other]
        return np.asarray(defined & rule(distance / np.where(defined, speed, 1.0), value))

    return holds


def _time_to_collision_condition(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    gap, rule, value = (
        read_distance_measure(element, scope),
        read_comparison_rule(element, scope),
        scope.read_numbers(element, "value"),
    )
    target = element.find("TimeToCollisionConditionTarget")
    reference = None if target is None else target.find("EntityRef")
    holder = None if target is None else target.find("Position")
    if reference is not None:
        other = read_entity_index(reference, scope, world)
        option = _kernel_gap_option(gap, to_entity=True)
        if option is None:
            return lambda world, e: _time_to_entity_holds(world, e, other, gap, rule, value)
        index = comparison_rule_index(rule)
        return (LeafCondition(conditions.TIME_TO_COLLISION_CONDITION, other, index, option, (value,)),)
    if holder is None:
        raise scope.error_at(
            element, "<TimeToCollisionCondition> names neither an entity nor a position as its target."
        )
    position = read_position(holder, scope, world)

    def holds(world: World, e: int) -> BoolArray:
        return _time_to_close_holds(gap.measure_to_point(world, e, position(world)), world.speed[e], rule, value)

    return holds


def _time_to_entity_holds(
    world: World, e: int, other: int, gap: DistanceMeasure, rule: Callable[[Any, Any], Any], value: Any
) -> BoolArray:
    distance = gap.measure_to_entity(world, e, other)
    # The closing speed is measured along the other's direction of motion.
    x, y = world.step_velocity[0][other], world.step_velocity[1][other]
    pace = np.hypot(x, y)
    stands = (np.abs(x) < TOLERANCE) & (np.abs(y) < TOLERANCE)
    own_speed = (world.step_velocity[0][e] * x + world.step_velocity[1][e] * y) / np.where(stands, 1.0, pace)
    signs = np.where(world.speed[e] < 0.0, -1.0, 1.0) * np.where(own_speed < 0.0, -1.0, 1.0)
    closing = np.where(stands, world.speed[e], signs * (own_speed - np.abs(world.speed[other])))
    return np.asarray(_time_to_close_holds(distance, closing, rule, value) & world.present[other])


def _time_to_close_holds(
    distance: FloatArray, closing: FloatArray, rule: Callable[[Any, Any], Any], value: Any
) -> BoolArray:
    defined = (np.abs(distance) >= TOLERANCE) & (np.abs(closing) >= TOLERANCE)
    time = np.where(defined, distance / np.where(defined, closing, 1.0), -1.0)
    return np.asarray((time >= 0.0) & rule(time, value))


def _relative_clearance_condition(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    forward, backward = (
        scope.read_numbers(element, "distanceForward", 0.0),
        scope.read_numbers(element, "distanceBackward", 0.0),
    )
    free, opposite = (
        scope.read_boolean(element, "freeSpace", False),
        scope.read_boolean(element, "oppositeLanes", False),
    )
    lanes = element.find("RelativeLaneRange")
    first = -100 if lanes is None else scope.read_integer(lanes, "from", -100)
    last = 100 if lanes is None else scope.read_integer(lanes, "to", 100)
    others = read_entity_refs(element, scope, world)

    def holds(world: World, e: int) -> BoolArray:
        own_pose = road_pose(world, e)
        assert own_pose.lane is not None
        occupied = np.zeros(world.scenarios, dtype=np.bool_)
        for other in others or [k for k in range(len(world.entities)) if k != e]:
            pose = road_pose(world, other)
            assert pose.lane is not None
            distance = distance_along_roads(world, e, pose)
            if free:
                overlap_ahead, overlap_behind = box_lengths_between_references(world, e, other)
                distance = np.where(
                    distance > 0, np.maximum(distance - overlap_ahead, 0.0), np.minimum(distance + overlap_behind, 0.0)
                )
            # On a road with opposite direction, lanes have the opposite sign.
            is_opposite = is_opposite_direction(world, e, pose)
            lane = np.where(is_opposite, -own_pose.lane, own_pose.lane)
            lane_difference = relative_lane(world, replace(own_pose, lane=lane), pose) * np.where(is_opposite, -1, 1)
            same_side = np.sign(lane) == np.sign(pose.lane)
            inside = (
                (distance >= -backward) & (distance <= forward) & (lane_difference >= first) & (lane_difference <= last)
            )
            occupied |= inside & (same_side | opposite) & world.present[other]
        return np.asarray(~occupied & has_drivable_lane_in_range(world, own_pose, first, last, opposite))

    return holds


def _angle_condition(element: etree._Element, scope: Scope, world: World) -> EntityTest:
    angle, tolerance = scope.read_numbers(element, "angle"), scope.read_numbers(element, "angleTolerance")
    angle_type, system = (
        scope.read_text(element, "angleType", "heading"),
        scope.read_text(element, "coordinateSystem", "world"),
    )
    other = read_entity_index(element, scope, world) if element.get("entityRef") is not None else None
    network, is_heading = world.network, angle_type == "heading"
    if network is None or other is not None or not is_heading or system not in ("road", "lane"):
        is_relevant = is_heading and (other is not None or system != "entity")
        entity, values = -1 if other is None or not is_heading else other, (angle, tolerance)
        return (LeafCondition(conditions.RELATIVE_ANGLE_CONDITION, entity, option=int(is_relevant), values=values),)

    def holds(world: World, e: int) -> BoolArray:
        pose = road_pose(world, e)
        current = world.heading[e] - road_heading(world, pose)
        if system == "lane" and pose.lane is not None and pose.road is not None and pose.s is not None:
            against = [
                not network.is_traffic_forward(int(r), int(k), float(s))
                for r, k, s in zip(pose.road, pose.lane, pose.s, strict=True)
            ]
            current = current - np.where(against, np.pi, 0.0)
        return np.asarray(np.abs(wrap_angle(current - angle)) < tolerance + TOLERANCE)

    return holds


ENTITY_CONDITION_READERS: Final[dict[str, Callable[[etree._Element, Scope, World], EntityTest]]] = {
    "TraveledDistanceCondition": _traveled_distance_condition,
    "ReachPositionCondition": _reach_position_condition,
    "SpeedCondition": _speed_condition,
    "RelativeSpeedCondition": _relative_speed_condition,
    "AccelerationCondition": _acceleration_condition,
    "StandStillCondition": _stand_still_condition,
    "EndOfRoadCondition": _end_of_road_condition,
    "OffroadCondition": _off_road_condition,
    "CollisionCondition": _collision_condition,
    "RelativeDistanceCondition": _relative_distance_condition,
    "DistanceCondition": _distance_condition,
    "TimeHeadwayCondition": _time_headway_condition,
    "TimeToCollisionCondition": _time_to_collision_condition,
    "RelativeClearanceCondition": _relative_clearance_condition,
    "AngleCondition": _angle_condition,
    "RelativeAngleCondition": _angle_condition,
}
