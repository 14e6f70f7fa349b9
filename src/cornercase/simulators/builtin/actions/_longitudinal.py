"""Actions on the speed of an entity."""

from __future__ import annotations

from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.scenario._scope import Scope
from cornercase.simulators.builtin.actions._action import CompiledAction
from cornercase.simulators.builtin.kernels._action_table import DISTANCE_ACTION, SPEED_ACTION
from cornercase.simulators.builtin.kernels._distances import FREE_SPACE, LONGITUDINAL_DISTANCE
from cornercase.simulators.builtin.kernels._synchronize import DISTANCE_TOLERANCE
from cornercase.simulators.builtin.paths._positions import read_entity_index
from cornercase.simulators.builtin.paths._transition_dynamics import TransitionDynamics
from cornercase.simulators.builtin.world._entity_distances import distance_along_roads
from cornercase.simulators.builtin.world._road_position import distance_ahead_on_road, road_pose
from cornercase.simulators.builtin.world._track_motion import shift_along_track
from cornercase.simulators.builtin.world._world import LONGITUDINAL, World

# Tolerance of limits.
_TINY: Final = 1e-6

# Larger than all limits.
_UNLIMITED: Final = 1e10


class SpeedAction(CompiledAction):
    """Action that brings an entity to a speed, or that sets the target speed of the driver who controls the entity."""

    domains = (LONGITUDINAL,)
    memory_attributes = ("_from", "_to", "_parameter", "_span", "_stretch", "_reached", "_value", "_rate")

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity = entity
        self._transition = TransitionDynamics(require_child(element, "SpeedActionDynamics", scope), scope)
        target, self._reference = read_target(element, "SpeedActionTarget", "TargetSpeed", scope, world)
        self._value, is_relative = scope.read_numbers(target, "value"), self._reference is not None
        self._factor = is_relative and scope.read_text(target, "speedTargetValueType", "delta") == "factor"
        self._continuous = is_relative and scope.read_boolean(target, "continuous", False)
        n = scope.n_scenarios
        # The speed changes while the parameter grows from 0 to the span, in s.
        self._from, self._to, self._parameter, self._span = (np.zeros(n) for _ in range(4))
        self._stretch = np.ones(n)
        self._reached, self._rate = np.zeros(n), self._transition.value

    def kernel_options(self) -> tuple[int, ...]:
        reference = -1 if self._reference is None else self._reference
        options = reference, self._factor, self._continuous
        return SPEED_ACTION, self._entity, *self._transition.kernel_options, *options

    def start(self, world: World, where: BoolArray) -> None:
        e, entity = self._entity, world.entities[self._entity]
        start, requested = world.speed[e], self._target_speed(world)
        target = np.clip(requested, -entity.max_speed, entity.max_speed)
        limit = np.where(target > start, entity.max_acceleration, entity.max_deceleration)
        span, stretch = self._transition.speed_change_duration(start, target, requested, limit)
        for state, value in ((self._from, start), (self._to, target), (self._span, span), (self._stretch, stretch)):
            state[where] = value[where]
        self._parameter[where] = 0.0
        self._reached[where] = 0.0
        at_once = where & self._transition.is_immediate(self._span)
        at_once &= ~(world.driven[e] & (world.time > 0.0))
        world.speed[e][at_once] = target[at_once]

    def _target_speed(self, world: World) -> FloatArray:
        target = self._value
        if self._reference is not None:
            speed = world.speed[self._reference]
            target = speed * self._value if self._factor else speed + self._value
        return np.asarray(target)


class LongitudinalDistanceAction(CompiledAction):
    """Action that keeps a distance or a time gap to another entity, like a critically damped spring.

    Limits that the file does not set are taken from the vehicle. If the file has no ``DynamicConstraints``, the entity
    jumps to the wanted distance.
    """

    domains = (LONGITUDINAL,)
    # The kernels use the same order.
    memory_attributes = (
        "_acceleration", "_behind", "_wanted", "_up", "_down", "_fastest", "_jerk_up", "_jerk_down", "_located",
    )  # fmt: skip

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity = entity
        self._other = read_entity_index(element, scope, world)
        self._continuous = scope.read_boolean(element, "continuous", False)
        self._free = scope.read_boolean(element, "freespace", False)
        system = scope.read_text(element, "coordinateSystem", "entity")
        self._on_roads = system in ("lane", "road", "trajectory") and not self._free
        side = scope.read_text(element, "displacement", "trailingReferencedEntity")
        distance, self._timed = scope.read_numbers(element, "distance", 0.0), element.get("timeGap") is not None
        # A time in s, or a distance in m.
        self._wanted = scope.read_numbers(element, "timeGap") if self._timed else distance
        n, vehicle = scope.n_scenarios, world.entities[entity]
        limits = element.find("DynamicConstraints")
        self._rigid = limits is None
        self._up = _read_limit(limits, "maxAcceleration", vehicle.max_acceleration, 5.0, scope)
        self._down = _read_limit(limits, "maxDeceleration", vehicle.max_deceleration, 10.0, scope)
        self._fastest = _read_limit(limits, "maxSpeed", vehicle.max_speed, 250.0 / 3.6, scope)
        self._jerk_up = _read_limit(limits, "maxAccelerationRate", np.inf, _UNLIMITED, scope)
        self._jerk_down = _read_limit(limits, "maxDecelerationRate", np.inf, _UNLIMITED, scope)
        self._behind = np.full(n, 1.0 if side != "leadingReferencedEntity" else 0.0)
        # With "any", the entity stays on the side where it starts.
        self._undecided = np.full(n, side == "any")
        self._acceleration = np.zeros(n)
        # Distance along roads, measured in each frame.
        self._located = np.full(n, np.nan)

    def kernel_options(self) -> tuple[int, ...]:
        if self._rigid:
            return super().kernel_options()
        options = self._continuous, self._free, self._timed, self._on_roads
        return DISTANCE_ACTION, self._entity, self._other, *options

    def start(self, world: World, where: BoolArray) -> None:
        new = where & self._undecided
        if new.any():
            self._behind[new] = np.where(self._distance_along_heading(world) >= 0.0, 1.0, 0.0)[new]
            self._undecided[new] = False

    def step(self, world: World, dt: float, where: BoolArray) -> BoolArray:
        if not self._rigid:
            return super().step(world, dt, where)
        e, other = self._entity, world.speed[self._other]
        target = np.abs(np.abs(other) * self._wanted if self._timed else self._wanted)
        distance = self._signed_distance(world)
        # Without a connecting road there is no distance: keep the speed.
        where = where & np.isfinite(distance)
        error = np.where(np.isfinite(distance), distance, 0.0) - np.where(self._behind > 0.0, target, -target)
        shift_along_track(world, e, where, error)
        world.set_speed(e, where, other)
        reached = (np.abs(error) < DISTANCE_TOLERANCE) & (not self._continuous)
        return np.asarray(where & reached)

    def look_up_positions_now(self, world: World, where: BoolArray) -> None:
        if self._on_roads:
            self._located[where] = self._signed_distance(world)[where]

    def _signed_distance(self, world: World) -> FloatArray:
        """Return the distance to the other entity in m for each scenario, negative if the other entity is behind."""
        if self._on_roads:
            other_pose = road_pose(world, self._other)
            along_roads = distance_along_roads(world, self._entity, other_pose)
            return distance_ahead_on_road(world, self._entity, other_pose, along_roads)
        return self._distance_along_heading(world)

    def _distance_along_heading(self, world: World) -> FloatArray:
        kind = LONGITUDINAL_DISTANCE + FREE_SPACE * self._free
        return world.compiled.measure_to_entity(self._entity, self._other, kind)


def _read_limit(
    limits: etree._Element | None, name: str, vehicle_limit: float, default: float, scope: Scope
) -> FloatArray:
    """Read a limit on the motion for each scenario; no limit exceeds `vehicle_limit`.

    A missing limit means `vehicle_limit`. A limit of 0 means `default`, or `vehicle_limit` if that is smaller.
    """
    vehicle_limit = min(vehicle_limit, _UNLIMITED)
    limit = read_dynamic_limit(limits, name, vehicle_limit, scope)
    return np.where(limit < _TINY, min(vehicle_limit, default), np.minimum(limit, vehicle_limit))


def read_dynamic_limit(limits: etree._Element | None, name: str, default: float, scope: Scope) -> FloatArray:
    """Read an attribute of ``DynamicConstraints`` for each scenario; a missing one is `default`."""
    if limits is None:
        return np.full(scope.n_scenarios, default)
    limit = scope.read_numbers(limits, name, default)
    scope.mark_invalid(limits, name, "is below 0", limit < 0.0)
    return limit


def require_child(element: etree._Element, tag: str, scope: Scope) -> etree._Element:
    """Return the child element with a tag; raise `InputError` if there is none."""
    result = element.find(tag)
    if result is None:
        raise scope.error_at(element, f"<{element.tag}> has no <{tag}>.")
    return result


def read_target(
    element: etree._Element, tag: str, quantity: str, scope: Scope, world: World
) -> tuple[etree._Element, int | None]:
    """Return the target of an action, and the index of the entity to which it is relative (or None)."""
    holder = require_child(element, tag, scope)
    if (absolute := holder.find(f"Absolute{quantity}")) is not None:
        return absolute, None
    if (relative := holder.find(f"Relative{quantity}")) is not None:
        return relative, read_entity_index(relative, scope, world)
    raise scope.error_at(element, f"<{tag}> holds no target.")
