"""Actions on the speed of an entity."""

from __future__ import annotations

from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.scenario._scope import Scope
from cornercase.simulators.builtin.actions._action import Action
from cornercase.simulators.builtin.kernels._action_table import (
    DISTANCE_ACTION,
    DYNAMICS_DIMENSIONS,
    DYNAMICS_SHAPES,
    SPEED_ACTION,
)
from cornercase.simulators.builtin.kernels._synchronize import DISTANCE_TOLERANCE, SPRING_STIFFNESS
from cornercase.simulators.builtin.paths._dynamics import TransitionDynamics
from cornercase.simulators.builtin.paths._positions import read_entity_index
from cornercase.simulators.builtin.world._entity_distances import distance_ahead, distance_along_roads, longitudinal_gap
from cornercase.simulators.builtin.world._road_position import distance_ahead_on_road, road_pose
from cornercase.simulators.builtin.world._track_motion import shift_along_track
from cornercase.simulators.builtin.world._world import LONGITUDINAL, World

# Tolerance of speeds and times in m/s and s.
_TINY: Final = 1e-6

# Larger than all limits.
_UNLIMITED: Final = 1e10


class SpeedAction(Action):
    """Brings an entity to a speed; if it has a driver, sets the driver's target speed."""

    domains = (LONGITUDINAL,)
    memory_attributes = ("_from", "_to", "_parameter", "_span", "_stretch", "_reached", "_value", "_rate")

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity = entity
        self._transition = TransitionDynamics(require_child(element, "SpeedActionDynamics", scope), scope)
        target = require_child(element, "SpeedActionTarget", scope)
        absolute, relative = target.find("AbsoluteTargetSpeed"), target.find("RelativeTargetSpeed")
        self._reference: int | None = None
        self._continuous = self._factor = False
        if absolute is not None:
            self._value = scope.read_numbers(absolute, "value")
        elif relative is not None:
            self._reference = read_entity_index(relative, scope, world)
            self._value = scope.read_numbers(relative, "value")
            self._factor = scope.read_text(relative, "speedTargetValueType", "delta") == "factor"
            self._continuous = scope.read_boolean(relative, "continuous", False)
        else:
            raise InputError(f"{scope.file_name}, line {element.sourceline}: <SpeedActionTarget> holds no target.")
        n = scope.n_scenarios
        # The speed changes while the parameter grows from 0 to the span, in s.
        self._from, self._to, self._parameter, self._span = (np.zeros(n) for _ in range(4))
        self._stretch = np.ones(n)
        self._reached, self._rate = np.zeros(n), self._transition.value

    def kernel_options(self) -> tuple[int, ...]:
        shape, dimension = (
            DYNAMICS_SHAPES.index(self._transition.shape),
            DYNAMICS_DIMENSIONS.index(self._transition.dimension),
        )
        reference = -1 if self._reference is None else self._reference
        return SPEED_ACTION, self._entity, shape, dimension, reference, self._factor, self._continuous

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

    def step(self, world: World, dt: float, where: BoolArray) -> BoolArray:
        e, entity = self._entity, world.entities[self._entity]
        if self._reference is not None:
            self._to[where] = np.clip(self._target_speed(world), -entity.max_speed, entity.max_speed)[where]
            if self._transition.dimension == "rate":
                self._span[where] = self._transition.duration_at_rate(self._to - self._from)[where]
        current, driven = world.speed[e], world.driven[e]
        highest, lowest = current + entity.max_acceleration * dt, current - entity.max_deceleration * dt
        # If the change exceeds the vehicle's limits, it takes longer: the parameter lags behind the time.
        settled = (self._span > 0.0) & (self._parameter > self._span - _TINY)
        parameter = np.clip(self._parameter + dt / self._stretch, 0.0, self._span)
        planned = self._transition.value_at(self._from, self._to, parameter, self._span)
        requested = np.where(settled, self._to, planned)
        speed = np.clip(requested, lowest, highest) if dt > 0 else np.where(settled, current, planned)
        speed = np.where(driven, requested, speed)
        late = (np.abs(speed - requested) > _TINY * dt) & ~settled & (dt > 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(late, (speed - current) / (planned - current), 1.0)
        behind = np.clip(parameter - dt * (1.0 - share) / self._stretch, 0.0, self._span)
        speed = np.where(late | settled, speed, requested)
        parameter = np.where(settled, self._parameter, np.where(late, behind, parameter))
        self._parameter[where] = parameter[where]
        arrived = (parameter > self._span - _TINY) & (np.abs(speed - self._to) < _TINY)
        self._reached[where & arrived] = 1.0
        speed = np.where(arrived, self._to, speed)
        world.set_speed(e, where, speed)
        begins = where & (world.time == 0.0)
        world.speed[e][begins] = speed[begins]
        return np.asarray(where & (self._reached > 0.0) & (not self._continuous))

    def _target_speed(self, world: World) -> FloatArray:
        target = self._value
        if self._reference is not None:
            speed = world.speed[self._reference]
            target = speed * self._value if self._factor else speed + self._value
        return np.asarray(target)


class LongitudinalDistanceAction(Action):
    """Keeps a distance or a time gap to another entity, like a critically damped spring.

    Missing limits are the vehicle's own; without any constraints the entity jumps to its position.
    """

    domains = (LONGITUDINAL,)
    # The kernels use the same order.
    memory_attributes = ("_acceleration", "_behind", "_wanted", "_up", "_down", "_fastest", "_jerk_up", "_jerk_down")

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

    def kernel_options(self) -> tuple[int, ...]:
        if self._rigid or self._on_roads:
            return super().kernel_options()
        return DISTANCE_ACTION, self._entity, self._other, self._continuous, self._free, self._timed

    def start(self, world: World, where: BoolArray) -> None:
        new = where & self._undecided
        if new.any():
            measure = longitudinal_gap if self._free else distance_ahead
            self._behind[new] = np.where(measure(world, self._entity, self._other) >= 0.0, 1.0, 0.0)[new]
            self._undecided[new] = False

    def step(self, world: World, dt: float, where: BoolArray) -> BoolArray:
        e, o = self._entity, self._other
        speed, other = world.speed[e], world.speed[o]
        target = np.abs(np.abs(other) * self._wanted if self._timed else self._wanted)
        distance = self._signed_distance(world)
        # Without a connecting road there is no distance: keep the speed.
        where = where & np.isfinite(distance)
        error = np.where(np.isfinite(distance), distance, 0.0) - np.where(self._behind > 0.0, target, -target)
        if self._rigid:
            shift_along_track(world, e, where, error)
            world.set_speed(e, where, other)
        else:
            a = self._spring_acceleration(error, speed - other, dt)
            self._acceleration[where] = a[where]
            world.set_speed(e, where, np.clip(speed + a * dt, -self._fastest, self._fastest))
        reached = (np.abs(error) < DISTANCE_TOLERANCE) & (not self._continuous)
        return np.asarray(where & reached)

    def _spring_acceleration(self, error: FloatArray, closing: FloatArray, dt: float) -> FloatArray:
        """Acceleration within the limits in m/s², shape (N,)."""
        stiffness = SPRING_STIFFNESS * np.where(error < 0, self._up, self._down)
        a = np.clip(error * stiffness - 2.0 * np.sqrt(stiffness) * closing, -self._down, self._up)
        before = self._acceleration
        sinks, rises = (a < 0) & (a < before), (a >= 0) & (a > before)
        lowest, highest = before - self._jerk_down * dt, before + self._jerk_up * dt
        return np.where(sinks, np.maximum(a, lowest), np.where(rises, np.minimum(a, highest), a))

    def _signed_distance(self, world: World) -> FloatArray:
        """Signed distance ahead to the other entity, shape (N,)."""
        if self._free:
            return longitudinal_gap(world, self._entity, self._other)
        if self._on_roads:
            other_pose = road_pose(world, self._other)
            return distance_ahead_on_road(
                world, self._entity, other_pose, distance_along_roads(world, self._entity, other_pose)
            )
        return distance_ahead(world, self._entity, self._other)


def _read_limit(
    limits: etree._Element | None, name: str, vehicle_limit: float, default: float, scope: Scope
) -> FloatArray:
    """Limit of dynamic constraints, shape (N,); the vehicle's own if missing or too large, a usual one if 0."""
    vehicle_limit = min(vehicle_limit, _UNLIMITED)
    limit = (
        np.full(scope.n_scenarios, vehicle_limit) if limits is None else scope.read_numbers(limits, name, vehicle_limit)
    )
    return np.where(limit < _TINY, min(vehicle_limit, default), np.minimum(limit, vehicle_limit))


def require_child(element: etree._Element, tag: str, scope: Scope) -> etree._Element:
    """Return the child element with a tag; raise `InputError` if there is none."""
    result = element.find(tag)
    if result is None:
        raise InputError(f"{scope.file_name}, line {element.sourceline}: <{element.tag}> has no <{tag}>.")
    return result
