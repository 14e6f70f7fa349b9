"""Actions on the speed of an entity."""

from __future__ import annotations

from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.scenario import Scope
from cornercase.simulators.builtin.paths.positions import entity_index
from cornercase.simulators.builtin.paths.transitions import Transition
from cornercase.simulators.builtin.world.gaps import distance_ahead, longitudinal_gap, remaining
from cornercase.simulators.builtin.world.state import LONGITUDINAL, World
from cornercase.simulators.builtin.world.whereabouts import lane_of

# A distance that is kept within this, in m, is reached.
_REACHED: Final = 0.1

# Stiffness of the spring that keeps a distance, in 1/m, times the largest acceleration.
_SPRING: Final = 0.4


class SpeedAction:
    """Brings an entity to a speed; where it has a driver, tells the driver which speed to aim for."""

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity, self._id = entity, world.number_action()
        self._transition = Transition(child(element, "SpeedActionDynamics", scope), scope)
        target = child(element, "SpeedActionTarget", scope)
        absolute, relative = target.find("AbsoluteTargetSpeed"), target.find("RelativeTargetSpeed")
        self._reference: int | None = None
        self._continuous = False
        if absolute is not None:
            self._value = scope.number(absolute, "value")
        elif relative is not None:
            self._reference = entity_index(relative, scope, world)
            self._value = scope.number(relative, "value")
            self._factor = scope.text(relative, "speedTargetValueType", "delta") == "factor"
            self._continuous = scope.flag(relative, "continuous", False)
        else:
            raise InputError(f"{scope.source}, line {element.sourceline}: <SpeedActionTarget> holds no target.")
        n = scope.scenarios
        self._from, self._to, self._elapsed, self._duration = (np.zeros(n) for _ in range(4))

    def start(self, world: World, where: BoolArray) -> None:
        e, entity = self._entity, world.entities[self._entity]
        world.claim(LONGITUDINAL, e, self._id, where)
        target, start = self._target(world), world.speed[e]
        limit = np.where(target > start, entity.max_acceleration, entity.max_deceleration)
        duration = self._transition.duration(start, target, limit)
        for state, value in ((self._from, start), (self._to, target), (self._duration, duration)):
            state[where] = value[where]
        self._elapsed[where] = 0.0
        at_once = where & (self._duration <= 1e-9)
        if world.time > 0.0:
            at_once &= ~world.driven[e]
        world.speed[e][at_once] = target[at_once]

    def step(self, world: World, dt: float, where: BoolArray) -> BoolArray:
        e, entity = self._entity, world.entities[self._entity]
        acting = where & world.controls(LONGITUDINAL, e, self._id)
        if self._reference is not None:
            self._to[acting] = self._target(world)[acting]
        settled = self._elapsed >= self._duration - 1e-9
        self._elapsed[acting] += dt
        finished = self._elapsed >= self._duration - 1e-9
        part = self._elapsed / np.where(self._duration > 0, self._duration, 1.0)
        speed = np.where(finished, self._to, self._from + self._transition.at(part) * (self._to - self._from))
        if self._reference is not None and dt > 0:
            # Changes of the other's speed are followed as fast as the vehicle can.
            now = world.speed[e]
            caught = np.clip(speed - now, -entity.max_deceleration * dt, entity.max_acceleration * dt)
            speed = np.where(settled & (self._duration > 0), now + caught, speed)
            # The transition is delayed where it asks for more than the vehicle can.
            ahead = caught != speed - now
            late = ahead & ~settled & (speed != now)
            with np.errstate(divide="ignore", invalid="ignore"):
                share = caught / (speed - now)
            self._elapsed[acting & late] -= (dt * (1.0 - share))[acting & late]
            finished &= ~late
            speed = np.where(late, now + caught, speed)
        world.set_speed(e, acting, speed)
        if world.time == 0.0:
            world.speed[e][acting] = speed[acting]
        reached = finished & (np.abs(speed - self._to) < 1e-6) & (not self._continuous)
        return np.asarray(where & (reached | ~acting))

    def _target(self, world: World) -> FloatArray:
        target = self._value
        if self._reference is not None:
            speed = world.speed[self._reference]
            target = speed * self._value if self._factor else speed + self._value
        limit = world.entities[self._entity].max_speed
        return np.clip(target, -limit, limit)


class LongitudinalDistanceAction:
    """Keeps a distance or a time gap to another entity, like a critically damped spring."""

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity, self._id = entity, world.number_action()
        self._other = entity_index(element, scope, world)
        self._continuous = scope.flag(element, "continuous", False)
        self._free = scope.flag(element, "freespace", False)
        self._system = scope.text(element, "coordinateSystem", "entity")
        self._side = scope.text(element, "displacement", "any")
        gap, self._distance = element.get("timeGap"), scope.number(element, "distance", 0.0)
        self._gap = None if gap is None else scope.number(element, "timeGap")
        limits = element.find("DynamicConstraints")
        names = ("maxAcceleration", "maxDeceleration", "maxSpeed", "maxAccelerationRate", "maxDecelerationRate")
        n = scope.scenarios
        bounds = [np.full(n, np.inf) if limits is None else scope.number(limits, name, np.inf) for name in names]
        self._up, self._down, self._fastest, self._jerk_up, self._jerk_down = bounds
        self._behind = np.ones(n, dtype=np.bool_)
        self._acceleration = np.zeros(n)

    def start(self, world: World, where: BoolArray) -> None:
        world.claim(LONGITUDINAL, self._entity, self._id, where)
        behind = self._measure(world) >= 0.0
        if self._side != "any":
            behind = np.full(world.scenarios, self._side == "trailingReferencedEntity")
        self._behind[where] = behind[where]
        self._acceleration[where] = 0.0

    def step(self, world: World, dt: float, where: BoolArray) -> BoolArray:
        e, o = self._entity, self._other
        acting = where & world.controls(LONGITUDINAL, e, self._id)
        speed, other = world.speed[e], world.speed[o]
        wanted = np.abs(self._distance if self._gap is None else np.abs(other) * self._gap)
        error = self._measure(world) - np.where(self._behind, wanted, -wanted)
        rigid = np.isinf(self._up) & np.isinf(self._down)
        at_once = acting & rigid
        world.distance[e][at_once] += error[at_once]
        stiffness = _SPRING * np.where(error < 0, self._up, self._down)
        with np.errstate(invalid="ignore"):
            a = error * stiffness - 2.0 * np.sqrt(stiffness) * (speed - other)
        a = np.clip(a, -self._down, self._up)
        before = self._acceleration
        down = np.where(np.isfinite(self._jerk_down), before - self._jerk_down * dt, -np.inf) if dt > 0 else before
        up = np.where(np.isfinite(self._jerk_up), before + self._jerk_up * dt, np.inf) if dt > 0 else before
        a = np.where(
            (a < 0) & (a < before), np.maximum(a, down), np.where((a > 0) & (a > before), np.minimum(a, up), a)
        )
        with np.errstate(invalid="ignore"):
            following = np.clip(speed + a * dt, -self._fastest, self._fastest)
        self._acceleration[acting & ~rigid] = a[acting & ~rigid]
        result = np.where(rigid, other, following)
        world.set_speed(e, acting, result)
        reached = (np.abs(error) < _REACHED) & (not self._continuous)
        return np.asarray(where & (reached | ~acting))

    def _measure(self, world: World) -> FloatArray:
        """Signed distance ahead to the other, shape (N,)."""
        if self._free:
            return longitudinal_gap(world, self._entity, self._other)
        if self._system in ("lane", "road", "trajectory"):
            return remaining(world, self._entity, lane_of(world, self._other))
        return distance_ahead(world, self._entity, self._other)


def child(element: etree._Element, tag: str, scope: Scope) -> etree._Element:
    """Child element of a name; raises an `InputError` where there is none.

    Parameters
    ----------
    element : lxml element
    tag : str
    scope : Scope
        Values of the parameters there.

    Returns
    -------
    lxml element
    """
    found = element.find(tag)
    if found is None:
        raise InputError(f"{scope.source}, line {element.sourceline}: <{element.tag}> has no <{tag}>.")
    return found
