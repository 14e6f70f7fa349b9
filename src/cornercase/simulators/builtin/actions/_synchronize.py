"""The action that makes an entity arrive at its target when a master arrives at its own."""

from __future__ import annotations

from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.scenario._scope import Scope
from cornercase.simulators.builtin.actions._action import Action
from cornercase.simulators.builtin.actions._longitudinal import require_child
from cornercase.simulators.builtin.kernels._action_table import SYNCHRONIZE_ACTION
from cornercase.simulators.builtin.kernels._synchronize import (
    ABSOLUTE_FINAL_SPEED,
    AT_FINAL_SPEED,
    FINAL_SPEED_DIFFERENCE,
    FINAL_SPEED_FACTOR,
    FIRST_PHASE,
    HARD_BRAKING,
    LAST_PHASE,
    MAX_BRAKING,
    NEVER_ARRIVES,
    NO_FINAL_SPEED,
    NOT_STARTED,
    PASSED_TOLERANCE,
    PHASE_SPEED_TOLERANCE,
    STANDING_STILL,
    WAITING_FOR_MASTER,
)
from cornercase.simulators.builtin.paths._positions import read_entity_index, read_position
from cornercase.simulators.builtin.tracks._track import Pose
from cornercase.simulators.builtin.world._entity_distances import TargetCache, remaining_distance
from cornercase.simulators.builtin.world._road_position import distance_ahead_on_road, follows_lane, speed_along_road
from cornercase.simulators.builtin.world._world import LONGITUDINAL, World

_TINY: Final = 1e-6


class SynchronizeAction(Action):
    """Controls an entity's speed so that it reaches its target when the master reaches its own.

    With a final speed, two phases of constant acceleration end at the target with that speed; the entity stops in
    between rather than driving backwards. With a steady state it reaches the final speed a distance or a time before
    the target. Without a final speed its acceleration is constant.
    """

    domains = (LONGITUDINAL,)
    # The kernels use the same order.
    memory_attributes = (
        "_mode", "_convex", "_last", "_last_master",
        "_x", "_y", "_road", "_s", "_track", "_place", "_tolerance",
        "_x_master", "_y_master", "_road_master", "_s_master", "_track_master", "_place_master", "_tolerance_master",
        "_steady_distance", "_steady_time", "_final",
    )  # fmt: skip

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity = entity
        self._master = read_entity_index(element, scope, world, "masterEntityRef")
        self._read_target_master = read_position(require_child(element, "TargetPositionMaster", scope), scope, world)
        self._read_target = read_position(require_child(element, "TargetPosition", scope), scope, world)
        self._tolerance = scope.read_numbers(element, "targetTolerance", 0.0)
        self._tolerance_master = scope.read_numbers(element, "targetToleranceMaster", 0.0)
        n = scope.n_scenarios
        self._final, self._final_speed_kind = np.zeros(n), NO_FINAL_SPEED
        self._steady_distance, self._steady_time = np.zeros(n), np.zeros(n)
        final = element.find("FinalSpeed")
        inner = None if final is None else next(iter(final.iterchildren("*")), None)
        if inner is not None:
            self._read_final(inner, scope)
        self._mode, self._convex = np.full(n, float(NOT_STARTED)), np.zeros(n)
        self._last, self._last_master = np.full(n, np.inf), np.full(n, np.inf)
        self._x, self._y, self._road, self._s = (np.full(n, np.nan) for _ in range(4))
        self._x_master, self._y_master, self._road_master, self._s_master = (np.full(n, np.nan) for _ in range(4))
        self._track, self._place, self._track_master, self._place_master = (np.full(n, np.nan) for _ in range(4))

    def kernel_options(self) -> tuple[int, ...]:
        return SYNCHRONIZE_ACTION, self._entity, self._master, self._final_speed_kind

    def _read_final(self, element: etree._Element, scope: Scope) -> None:
        if element.tag == "AbsoluteSpeed":
            self._final, self._final_speed_kind = scope.read_numbers(element, "value"), ABSOLUTE_FINAL_SPEED
        elif element.tag == "RelativeSpeedToMaster":
            self._final = scope.read_numbers(element, "value")
            factor = scope.read_text(element, "speedTargetValueType", "delta") == "factor"
            self._final_speed_kind = FINAL_SPEED_FACTOR if factor else FINAL_SPEED_DIFFERENCE
        else:
            raise InputError(
                f"{scope.file_name}, line {element.sourceline}: <FinalSpeed> holds neither an <AbsoluteSpeed> nor a"
                " <RelativeSpeedToMaster>."
            )
        distance, time = element.find("TargetDistanceSteadyState"), element.find("TargetTimeSteadyState")
        if distance is not None:
            self._steady_distance = scope.read_numbers(distance, "distance")
        if time is not None:
            name = "time_gap" if time.get("time_gap") is not None else "time"
            self._steady_time = scope.read_numbers(time, name)

    def start(self, world: World, where: BoolArray) -> None:
        target, master = self._read_target(world), self._read_target_master(world)
        self._x[where], self._y[where] = target.x[where], target.y[where]
        self._x_master[where], self._y_master[where] = master.x[where], master.y[where]
        if world.network is not None:
            self._road[where], _, self._s[where], _ = world.network.locate(target.x[where], target.y[where])
            self._road_master[where], _, self._s_master[where], _ = world.network.locate(
                master.x[where], master.y[where]
            )
        self._place[where] = self._place_master[where] = np.nan
        self._mode[where] = NOT_STARTED
        self._last[where] = self._last_master[where] = np.inf

    def look_up_positions(self, world: World, where: BoolArray) -> None:
        self._remaining_distances(world, where)
        world.road_speed[self._master][where] = speed_along_road(world, self._master, where)[where]
        if self._final_speed_kind != NO_FINAL_SPEED:
            world.road_speed[self._entity][where] = speed_along_road(world, self._entity, where)[where]

    def _remaining_distances(self, world: World, where: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Distances of the entity and its master to their targets in m, negative once passed, each (N,)."""
        target = Pose(self._x, self._y, np.zeros(world.scenarios), road=self._road, s=self._s)
        master = Pose(self._x_master, self._y_master, target.heading, road=self._road_master, s=self._s_master)
        signed = _remaining_distance(
            world, self._master, master, TargetCache(self._track_master, self._place_master), where
        )
        return _remaining_distance(world, self._entity, target, TargetCache(self._track, self._place), where), signed

    def step(self, world: World, dt: float, where: BoolArray) -> BoolArray:
        e, m = self._entity, self._master
        distance, signed = self._remaining_distances(world, where)
        distance = np.abs(distance)
        master_distance = np.abs(signed)
        is_done = (distance < self._tolerance + _TINY) | (master_distance < self._tolerance_master + _TINY)
        is_done |= (distance > self._last + PASSED_TOLERANCE) | (master_distance > self._last_master + PASSED_TOLERANCE)
        self._last[where], self._last_master[where] = distance[where], master_distance[where]
        distance = np.maximum(distance - self._tolerance, _TINY)
        master_distance = np.maximum(master_distance - self._tolerance_master, _TINY)
        # Component of the master's speed along its road towards its target.
        direction = _driving_direction(world.speed[m]) * np.sign(signed * np.cos(world.turn[m]))
        speed_master = direction * speed_along_road(world, m, where)
        approaches = (speed_master > _TINY) & (dt > 0)
        time = np.where(approaches, master_distance / np.where(approaches, speed_master, 1.0), NEVER_ARRIVES)
        is_done |= approaches & (time < dt)

        final, waited = self._final_speed(world), self._mode == WAITING_FOR_MASTER
        if self._final_speed_kind == NO_FINAL_SPEED:
            target = self._speed_without_final_speed(world, dt, distance, time, approaches, where)
        else:
            target = self._speed_with_final_speed(world, dt, distance, time, final, approaches, where & ~is_done)
            target = np.where(is_done, final, target)
        # A driver's target speed must be reachable.
        speed = np.clip(target, 0.0, world.entities[e].max_speed)
        # Without a final speed, an arriving entity keeps its speed, unless its master has just stopped approaching.
        change = where & ~(is_done & (approaches | waited)) if self._final_speed_kind == NO_FINAL_SPEED else where
        own_speed = np.where(np.isfinite(target), target, world.speed[e])
        world.set_speed(e, change, np.where(world.driven[e], speed, own_speed))
        return where & is_done

    def _final_speed(self, world: World) -> FloatArray:
        master = world.speed[self._master]
        if self._final_speed_kind == FINAL_SPEED_FACTOR:
            return np.asarray(master * self._final)
        return np.asarray(master + self._final) if self._final_speed_kind == FINAL_SPEED_DIFFERENCE else self._final

    def _speed_without_final_speed(
        self, world: World, dt: float, distance: FloatArray, time: FloatArray, approaches: BoolArray, where: BoolArray
    ) -> FloatArray:
        """Speed at the end of the step without a final speed: one constant acceleration."""
        speed, mean, driven = world.speed[self._entity], distance / time, world.driven[self._entity]
        linear = speed + 2.0 * (mean - speed) / time * dt
        waits = ~approaches & (self._mode != WAITING_FOR_MASTER)
        free = where & ~driven
        self._mode[free] = np.where(approaches, LAST_PHASE, WAITING_FOR_MASTER)[free]
        return np.where(driven, mean, np.where(approaches, linear, np.where(waits, 0.0, speed)))

    def _speed_with_final_speed(
        self,
        world: World,
        dt: float,
        distance: FloatArray,
        time: FloatArray,
        final: FloatArray,
        approaches: BoolArray,
        active: BoolArray,
    ) -> FloatArray:
        """Speed at the end of the step with a final speed."""
        v0, mode = world.speed[self._entity], self._mode.copy()
        road_speed = _driving_direction(v0) * speed_along_road(world, self._entity, active)
        safe = np.maximum(np.abs(final), 1e-9)
        steady_way = np.where(self._steady_time > 0, self._steady_time * final, self._steady_distance)
        steady_time = steady_way / safe
        begins = (steady_way > 0) & (mode != AT_FINAL_SPEED)
        reached = begins & ((distance - steady_way < _TINY) | (time - steady_time < _TINY))
        mode[reached] = AT_FINAL_SPEED
        shorter = begins & ~reached
        distance, time = np.where(shorter, distance - steady_way, distance), np.where(shorter, time - steady_time, time)

        result = v0.copy()
        pending = active.copy()

        def assign_speed(where: BoolArray, speed: FloatArray | float) -> None:
            nonlocal pending
            where = where & pending
            result[where] = np.broadcast_to(speed, v0.shape)[where]
            pending = pending & ~where

        assign_speed(mode == AT_FINAL_SPEED, final)
        stands = ~approaches & pending
        result[stands & (mode != WAITING_FOR_MASTER)] = 0.0
        mode[stands] = WAITING_FOR_MASTER
        pending &= ~stands
        # An entity that waited starts again; with a steady state the last phase comes next, as in esmini.
        released = pending & (mode == WAITING_FOR_MASTER)
        mode[released] = np.where((v0 > 0) | (steady_way <= 0), NOT_STARTED, LAST_PHASE)[released]
        assign_speed(released & (mode == LAST_PHASE), 0.0)
        braking = mode == HARD_BRAKING
        stopped = braking & (v0 - MAX_BRAKING * dt < 0)
        mode[stopped & pending] = NOT_STARTED
        assign_speed(braking, np.maximum(v0 - MAX_BRAKING * dt, 0.0))
        standing = (mode == STANDING_STILL) & pending
        mode[standing & (time < 2.0 * distance / safe)] = LAST_PHASE
        assign_speed((mode == STANDING_STILL), 0.0)
        line = 2.0 * distance / time - np.maximum(final, 0.0)
        assign_speed(mode == LAST_PHASE, np.where((time < 1e-3) | (distance < 1e-3), 0.0, np.maximum(line, 0.0)))
        passed = (
            (mode == FIRST_PHASE) & pending & (np.abs(v0 - (2.0 * distance / time - final)) < PHASE_SPEED_TOLERANCE)
        )
        mode[passed] = LAST_PHASE
        assign_speed(passed, v0)
        new = (mode == NOT_STARTED) & pending
        mode[new] = FIRST_PHASE
        self._convex[new] = ((final + v0) / 2.0 < distance / time)[new]

        rate, apex = _first_phase_acceleration(road_speed, final, distance, time)
        has_wrong_sign = pending & (mode == FIRST_PHASE) & np.where(self._convex > 0.0, rate < 0, rate > 0)
        mode[has_wrong_sign] = LAST_PHASE
        rate = np.where(has_wrong_sign, 0.0, rate)
        # Instead of driving backwards it stops, waits, and continues in time.
        would_reverse = pending & (mode == FIRST_PHASE) & (apex < 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            stop_time = 2.0 * road_speed * distance / (road_speed**2 + final**2)
            gentle = np.where(stop_time > _TINY, -road_speed / stop_time, 0.0)
        hard = would_reverse & (stop_time * road_speed / 2.0 > distance / 2.0)
        rate = np.where(would_reverse, np.where(hard, -MAX_BRAKING, gentle), rate)
        mode[hard] = HARD_BRAKING
        stopped = would_reverse & (road_speed + rate * dt < 0)
        mode[stopped] = STANDING_STILL
        assign_speed(stopped, 0.0)
        assign_speed(pending, v0 + rate * dt)
        self._mode[active] = mode[active]
        return np.asarray(result)


def _remaining_distance(world: World, entity: int, target: Pose, cache: TargetCache, where: BoolArray) -> FloatArray:
    """Distance to a target along the trajectory, else along the road's reference line, in m, shape (N,)."""
    distance = remaining_distance(world, entity, target, cache, where)
    follows = follows_lane(world, entity)
    return (
        np.where(follows, distance_ahead_on_road(world, entity, target, distance), distance)
        if follows.any()
        else distance
    )


def _driving_direction(speed: FloatArray) -> FloatArray:
    """-1 for driving backwards, otherwise 1, also at rest, shape (N,)."""
    return np.where(speed < 0.0, -1.0, 1.0)


def _first_phase_acceleration(
    v0: FloatArray, v1: FloatArray, distance: FloatArray, time: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Acceleration of the first of two phases, and the speed at its end, each (N,).

    The phases have accelerations a and -a, cover `distance` in `time`, begin with v0 and end with v1. With vx between
    them after the time x: way = x (v0 + vx) / 2 + (time - x) (v1 + vx) / 2 and (vx - v0) / x = (vx - v1) / (time - x).
    """
    mean = distance / time
    root = np.sqrt(np.maximum(2.0 * (2.0 * mean**2 - 2.0 * (v0 + v1) * mean + v0**2 + v1**2), 0.0))
    rate, apex = np.zeros_like(v0), np.zeros_like(v0)
    is_equal = np.abs(v1 - v0) < _TINY
    open_ = ~is_equal
    with np.errstate(divide="ignore", invalid="ignore"):
        for sign in (-1.0, 1.0):
            vx = mean + 0.5 * sign * root
            x = -time * (2.0 * mean - 2.0 * v1 - sign * root) / (2.0 * (v1 - v0))
            good = open_ & (x > 0) & (x < time)
            rate, apex = np.where(good, (vx - v0) / x, rate), np.where(good, vx, apex)
            open_ &= ~good
        apex = np.where(is_equal, 2.0 * mean - v0, apex)
        rate = np.where(is_equal, 2.0 * (apex - v0) / time, rate)
    return rate, apex
