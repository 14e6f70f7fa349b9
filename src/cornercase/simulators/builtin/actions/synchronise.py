"""Arriving at a place when another entity arrives at another."""

from __future__ import annotations

from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.scenario import Scope
from cornercase.simulators.builtin.actions.action import Action
from cornercase.simulators.builtin.actions.longitudinal import child
from cornercase.simulators.builtin.paths.positions import entity_index, read_position
from cornercase.simulators.builtin.tracks.track import Pose
from cornercase.simulators.builtin.world.gaps import remaining
from cornercase.simulators.builtin.world.state import LONGITUDINAL, World
from cornercase.simulators.builtin.world.whereabouts import ahead_on_road, on_lane, speed_along_road

# What an entity does on its way to its place: nothing yet; the first of two phases of constant acceleration, below or
# above the mean speed; the last phase; waiting for the master to move; braking hard; standing until the last phase
# begins; going on at the final speed.
_NEW, _FIRST, _LAST, _WAITING, _BRAKING, _STANDING, _STEADY = range(7)

_TINY: Final = 1e-6
_NEVER: Final = 1e10

# m/s²; how hard an entity brakes that has no room for anything else. esmini's figure.
_HARDEST: Final = 8.0

# So much further from its place than in the last step, in m, an entity has passed it.
_AWAY: Final = 1e-3

# A speed that differs from that of the last phase by less, in m/s, begins it.
_ON_LINE: Final = 0.1


class SynchronizeAction(Action):
    """Steers an entity's speed so that it is at its place when the master is at its own.

    With a final speed its speed has two phases of constant acceleration, the last of which ends at the place with that
    speed; where this would mean to drive backwards, it stops in between. With a steady state it reaches the final
    speed before the place, by a distance or a time. Without a final speed it has one constant acceleration.
    """

    domains = (LONGITUDINAL,)

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity = entity
        self._master = entity_index(element, scope, world, "masterEntityRef")
        self._read_target_master = read_position(child(element, "TargetPositionMaster", scope), scope, world)
        self._read_target = read_position(child(element, "TargetPosition", scope), scope, world)
        self._tolerance = scope.number(element, "targetTolerance", 0.0)
        self._tolerance_master = scope.number(element, "targetToleranceMaster", 0.0)
        n = scope.scenarios
        self._final: FloatArray | None = None
        self._relative: FloatArray | None = None
        self._steady_distance, self._steady_time = np.zeros(n), np.zeros(n)
        final = element.find("FinalSpeed")
        inner = None if final is None else next(iter(final.iterchildren("*")), None)
        if inner is not None:
            self._read_final(inner, scope)
        self._factor = inner is not None and scope.text(inner, "speedTargetValueType", "delta") == "factor"
        self._mode = np.full(n, _NEW)
        self._convex = np.zeros(n, dtype=np.bool_)
        self._last, self._last_master = np.full(n, np.inf), np.full(n, np.inf)
        self._target: Pose | None = None
        self._target_master: Pose | None = None
        self._known: tuple[dict[int, FloatArray], dict[int, FloatArray]] = ({}, {})

    def _read_final(self, element: etree._Element, scope: Scope) -> None:
        if element.tag == "AbsoluteSpeed":
            self._final = scope.number(element, "value")
        elif element.tag == "RelativeSpeedToMaster":
            self._relative = scope.number(element, "value")
        else:
            raise InputError(
                f"{scope.source}, line {element.sourceline}: <FinalSpeed> is no <AbsoluteSpeed> or"
                " <RelativeSpeedToMaster>."
            )
        distance, time = element.find("TargetDistanceSteadyState"), element.find("TargetTimeSteadyState")
        if distance is not None:
            self._steady_distance = scope.number(distance, "distance")
        if time is not None:
            name = "time_gap" if time.get("time_gap") is not None else "time"
            self._steady_time = scope.number(time, name)

    def start(self, world: World, where: BoolArray) -> None:
        target, master = self._read_target(world), self._read_target_master(world)
        if self._target is None or self._target_master is None:
            self._target, self._target_master = target, master
        for mine, new in ((self._target, target), (self._target_master, master)):
            mine.x[where], mine.y[where] = new.x[where], new.y[where]
        self._target, self._target_master = _on_roads(world, self._target), _on_roads(world, self._target_master)
        for known in self._known:
            for places in known.values():
                places[where] = np.nan
        self._mode[where] = _NEW
        self._last[where] = self._last_master[where] = np.inf

    def step(self, world: World, dt: float, where: BoolArray) -> BoolArray:
        assert self._target is not None
        assert self._target_master is not None
        e, m = self._entity, self._master
        signed = _way(world, m, self._target_master, self._known[1])
        way, way_master = np.abs(_way(world, e, self._target, self._known[0])), np.abs(signed)
        done = (way < self._tolerance + _TINY) | (way_master < self._tolerance_master + _TINY)
        done |= (way > self._last + _AWAY) | (way_master > self._last_master + _AWAY)
        self._last[where], self._last_master[where] = way[where], way_master[where]
        way = np.maximum(way - self._tolerance, _TINY)
        way_master = np.maximum(way_master - self._tolerance_master, _TINY)
        # Of the master's speed, the part along its road and towards its target counts.
        ahead = _sign(world.speed[m]) * np.sign(signed * np.cos(world.turn[m]))
        speed_master = ahead * speed_along_road(world, m)
        comes = (speed_master > _TINY) & (dt > 0)
        time = np.where(comes, way_master / np.where(comes, speed_master, 1.0), _NEVER)
        done |= comes & (time < dt)

        final, waited = self._final_speed(world), self._mode == _WAITING
        if final is None:
            wanted = self._arrive(world, dt, way, time, comes)
        else:
            wanted = self._arrive_with(world, dt, way, time, final, comes, where & ~done)
            wanted = np.where(done, final, wanted)
        # An entity with a driver is asked for a speed that it can reach.
        speed = np.clip(wanted, 0.0, world.entities[e].max_speed)
        # Who arrives without a final speed keeps its own, unless its master has just stopped coming.
        change = where if final is not None else where & ~(done & (comes | waited))
        own = np.where(np.isfinite(wanted), wanted, world.speed[e])
        world.set_speed(e, change, np.where(world.driven[e], speed, own))
        return where & done

    def _final_speed(self, world: World) -> FloatArray | None:
        if self._relative is None:
            return self._final
        master = world.speed[self._master]
        return np.asarray(master * self._relative if self._factor else master + self._relative)

    def _arrive(self, world: World, dt: float, way: FloatArray, time: FloatArray, comes: BoolArray) -> FloatArray:
        """Speed at the end of the step, with one constant acceleration."""
        speed, mean, driven = world.speed[self._entity], way / time, world.driven[self._entity]
        even = speed + 2.0 * (mean - speed) / time * dt
        waits = ~comes & (self._mode != _WAITING)
        self._mode = np.where(driven, self._mode, np.where(comes, _LAST, _WAITING))
        return np.where(driven, mean, np.where(comes, even, np.where(waits, 0.0, speed)))

    def _arrive_with(
        self,
        world: World,
        dt: float,
        way: FloatArray,
        time: FloatArray,
        final: FloatArray,
        comes: BoolArray,
        acting: BoolArray,
    ) -> FloatArray:
        """Speed at the end of the step, with a final speed."""
        v0, mode = world.speed[self._entity], self._mode.copy()
        shown = _sign(v0) * speed_along_road(world, self._entity)
        safe = np.maximum(np.abs(final), 1e-9)
        steady_way = np.where(self._steady_time > 0, self._steady_time * final, self._steady_distance)
        steady_time = steady_way / safe
        begins = (steady_way > 0) & (mode != _STEADY)
        reached = begins & ((way - steady_way < _TINY) | (time - steady_time < _TINY))
        mode[reached] = _STEADY
        shorter = begins & ~reached
        way, time = np.where(shorter, way - steady_way, way), np.where(shorter, time - steady_time, time)

        result = v0.copy()
        left = acting.copy()

        def settle(where: BoolArray, speed: FloatArray | float) -> None:
            nonlocal left
            where = where & left
            result[where] = np.broadcast_to(speed, v0.shape)[where]
            left = left & ~where

        settle(mode == _STEADY, final)
        stands = ~comes & left
        result[stands & (mode != _WAITING)] = 0.0
        mode[stands] = _WAITING
        left &= ~stands
        # An entity that waited begins anew; with a steady state the last phase comes next, as in esmini.
        released = left & (mode == _WAITING)
        mode[released] = np.where((v0 > 0) | (steady_way <= 0), _NEW, _LAST)[released]
        settle(released & (mode == _LAST), 0.0)
        braking = mode == _BRAKING
        stopped = braking & (v0 - _HARDEST * dt < 0)
        mode[stopped & left] = _NEW
        settle(braking, np.maximum(v0 - _HARDEST * dt, 0.0))
        standing = (mode == _STANDING) & left
        mode[standing & (time < 2.0 * way / safe)] = _LAST
        settle((mode == _STANDING), 0.0)
        line = 2.0 * way / time - np.maximum(final, 0.0)
        settle(mode == _LAST, np.where((time < 1e-3) | (way < 1e-3), 0.0, np.maximum(line, 0.0)))
        passed = (mode == _FIRST) & left & (np.abs(v0 - (2.0 * way / time - final)) < _ON_LINE)
        mode[passed] = _LAST
        settle(passed, v0)
        new = (mode == _NEW) & left
        mode[new] = _FIRST
        self._convex[new] = ((final + v0) / 2.0 < way / time)[new]

        rate, apex = _first_phase(shown, final, way, time)
        turned = left & (mode == _FIRST) & np.where(self._convex, rate < 0, rate > 0)
        mode[turned] = _LAST
        rate = np.where(turned, 0.0, rate)
        # Instead of driving backwards it stops, waits, and continues in time.
        back = left & (mode == _FIRST) & (apex < 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            stop_time = 2.0 * shown * way / (shown**2 + final**2)
            gentle = np.where(stop_time > _TINY, -shown / stop_time, 0.0)
        hard = back & (stop_time * shown / 2.0 > way / 2.0)
        rate = np.where(back, np.where(hard, -_HARDEST, gentle), rate)
        mode[hard] = _BRAKING
        stopped = back & (shown + rate * dt < 0)
        mode[stopped] = _STANDING
        settle(stopped, 0.0)
        settle(left, v0 + rate * dt)
        self._mode = np.where(acting, mode, self._mode)
        return np.asarray(result)


def _on_roads(world: World, place: Pose) -> Pose:
    """Return a place with where on the roads it is."""
    if world.network is None:
        return place
    return Pose(place.x, place.y, place.heading, *world.network.locate(place.x, place.y))


def _way(world: World, entity: int, target: Pose, known: dict[int, FloatArray]) -> FloatArray:
    """Distance to a target along the entity's trajectory, else along its road's reference line, in m, shape (N,)."""
    way = remaining(world, entity, target, known)
    follows = on_lane(world, entity)
    return np.where(follows, ahead_on_road(world, entity, target, way), way) if follows.any() else way


def _sign(speed: FloatArray) -> FloatArray:
    """1 for driving forwards, and for who has just been stopped; -1 for driving backwards, shape (N,)."""
    return np.where(speed < 0.0, -1.0, 1.0)


def _first_phase(v0: FloatArray, v1: FloatArray, way: FloatArray, time: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Acceleration of the first of two phases, and the speed at which it ends, each (N,).

    The phases have accelerations a and -a, cover `way` in `time`, begin with v0 and end with v1. With vx between them
    after the time x: way = x (v0 + vx) / 2 + (time - x) (v1 + vx) / 2 and (vx - v0) / x = (vx - v1) / (time - x).
    """
    mean = way / time
    root = np.sqrt(np.maximum(2.0 * (2.0 * mean**2 - 2.0 * (v0 + v1) * mean + v0**2 + v1**2), 0.0))
    rate, apex = np.zeros_like(v0), np.zeros_like(v0)
    same = np.abs(v1 - v0) < _TINY
    open_ = ~same
    with np.errstate(divide="ignore", invalid="ignore"):
        for sign in (-1.0, 1.0):
            vx = mean + 0.5 * sign * root
            x = -time * (2.0 * mean - 2.0 * v1 - sign * root) / (2.0 * (v1 - v0))
            good = open_ & (x > 0) & (x < time)
            rate, apex = np.where(good, (vx - v0) / x, rate), np.where(good, vx, apex)
            open_ &= ~good
        apex = np.where(same, 2.0 * mean - v0, apex)
        rate = np.where(same, 2.0 * (apex - v0) / time, rate)
    return rate, apex
