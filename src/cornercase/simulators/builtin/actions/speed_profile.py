"""Speeds at given times, with or without a bound on the jerk between them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.scenario import Scope, VariesError
from cornercase.simulators.builtin.actions.action import Action
from cornercase.simulators.builtin.paths.positions import entity_index
from cornercase.simulators.builtin.world.state import LONGITUDINAL, World


class Limits(NamedTuple):
    """Bounds on acceleration and jerk, upwards and downwards, each (N,) and not negative."""

    up: FloatArray
    down: FloatArray
    jerk_up: FloatArray
    jerk_down: FloatArray


class Phase(NamedTuple):
    """A piece of a profile, each (N,): when it begins, and speed, acceleration and jerk there."""

    time: FloatArray
    speed: FloatArray
    rate: FloatArray
    jerk: FloatArray


class SpeedProfileAction(Action):
    """Takes an entity through speeds at given times.

    Followed by ``position``, the acceleration is constant between them; by ``follow``, it changes with the jerk that
    is allowed, so that several speeds are only come near to.
    """

    domains = (LONGITUDINAL,)

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity = entity
        self._reference = None if element.get("entityRef") is None else entity_index(element, scope, world)
        constraints = element.find("DynamicConstraints")
        names = ("maxAcceleration", "maxDeceleration", "maxAccelerationRate", "maxDecelerationRate")
        n = scope.scenarios
        bounds = [
            np.full(n, np.inf) if constraints is None else scope.number(constraints, name, np.inf) for name in names
        ]
        own = world.entities[entity]
        self._limits = Limits(
            np.minimum(bounds[0], own.max_acceleration), np.minimum(bounds[1], own.max_deceleration), *bounds[2:]
        )
        follow = scope.text(element, "followingMode", "position") == "follow"
        self._smooth = follow and bool(np.isfinite(bounds[2]).all() and np.isfinite(bounds[3]).all())
        entries = list(element.iterfind("SpeedProfileEntry"))
        if not entries:
            raise InputError(f"{scope.source}, line {element.sourceline}: <SpeedProfileAction> has no entries.")
        self._speeds = [scope.number(one, "speed") for one in entries]
        self._spans = [scope.number(one, "time", -1.0) for one in entries]
        if len(np.unique(np.abs(self._spans[0]) < 1e-6)) > 1:
            raise VariesError(scope.origins(entries[0].get("time", "")))
        self._phases: list[Phase] = []
        self._mine = np.full(n, -1)
        self._profiles: list[list[Phase]] = []

    def start(self, world: World, where: BoolArray) -> None:
        e = self._entity
        base = world.speed[self._reference] if self._reference is not None else np.zeros(world.scenarios)
        lines = self._lines(world, base)
        rate = world.acceleration[e].copy()
        if not self._smooth:
            profile = lines
        elif len(lines) == 2:
            profile = _one_target(lines[0], lines[1], rate, self._limits)
        else:
            profile = _smoothed(lines, rate, self._limits)
        self._profiles.append(profile)
        self._mine[where] = len(self._profiles) - 1

    def step(self, world: World, dt: float, where: BoolArray) -> BoolArray:
        e = self._entity
        wanted, over = world.speed[e].copy(), np.zeros_like(where)
        for k, profile in enumerate(self._profiles):
            rows = where & (self._mine == k)
            if rows.any():
                speed, ended = _at(profile, world.time + dt)
                wanted[rows], over[rows] = speed[rows], ended[rows]
        world.set_speed(e, where, wanted)
        return where & over

    def _lines(self, world: World, base: FloatArray) -> list[Phase]:
        """Phases of constant acceleration from target to target, and a last one that keeps the speed."""
        now, time = world.speed[self._entity].copy(), np.full(world.scenarios, world.time)
        targets = list(zip(self._speeds, self._spans, strict=True))
        still = np.zeros(world.scenarios)
        if (np.abs(self._spans[0]) < 1e-6).all():
            first, _ = targets.pop(0)
            # A smooth profile begins at the present speed.
            now = now if self._smooth else base + first
        lines = []
        for speed, span in targets:
            change = base + speed - now
            limit = np.where(change < 0, self._limits.down, self._limits.up)
            fastest = np.where(np.isfinite(limit), np.abs(change) / np.maximum(limit, 1e-9), 0.0)
            needed = np.where(span < -1e-6, fastest, np.maximum(span, fastest))
            lines.append(Phase(time, now, np.where(needed > 0, change / np.where(needed > 0, needed, 1.0), 0.0), still))
            time, now = time + needed, now + change
        return [*lines, Phase(time, now, still, still)]


def _at(profile: list[Phase], time: float) -> tuple[FloatArray, BoolArray]:
    """Speed at a time, and whether the profile has ended, each (N,)."""
    speed = profile[0].speed
    for phase in profile:
        since = np.maximum(time - phase.time, 0.0)
        value = phase.speed + phase.rate * since + 0.5 * phase.jerk * since**2
        speed = np.where(time > phase.time - 1e-6, value, speed)
    return speed, np.asarray(time > profile[-1].time - 1e-6)


def _jerk(change: FloatArray, limits: Limits) -> FloatArray:
    return np.where(change < 0, -limits.jerk_down, limits.jerk_up)


def _smoothed(lines: list[Phase], rate: FloatArray, limits: Limits) -> list[Phase]:
    """Turn the corners between lines of constant acceleration into arcs of constant jerk that touch both."""
    first = lines[0]
    jerk = _jerk(first.rate - rate, limits)
    span = (first.rate - rate) / jerk
    speed = first.speed + rate * span + 0.5 * jerk * span**2
    now = Phase(first.time + span, speed, first.rate, np.zeros_like(speed))
    phases = [Phase(first.time, first.speed, rate, jerk), now]
    for line in lines[1:]:
        change = line.rate - now.rate
        jerk = _jerk(change, limits)
        bends = np.abs(change) > 1e-9
        # With the lines as speed = rate * time + level, the arc begins where it touches both.
        level, new = now.speed - now.rate * now.time, line.speed - line.rate * line.time
        with np.errstate(divide="ignore", invalid="ignore"):
            begin = (change**2 - 2.0 * jerk * (level - new)) / (-2.0 * jerk * change)
        begin = np.where(bends, np.maximum(begin, now.time), now.time)
        speed = now.speed + now.rate * (begin - now.time)
        phases.append(Phase(begin, speed, now.rate, np.where(bends, jerk, 0.0)))
        span = np.where(bends, change / jerk, 0.0)
        speed = speed + now.rate * span + 0.5 * jerk * span**2
        now = Phase(begin + span, speed, line.rate, np.zeros_like(speed))
        phases.append(now)
    return phases


def _one_target(line: Phase, end: Phase, rate: FloatArray, limits: Limits) -> list[Phase]:
    """Reach one speed at a time, or as soon as it can be, with an acceleration that begins at `rate` and ends at 0."""
    j0 = _jerk(line.rate - rate, limits)
    j1 = np.where(line.rate < 0, limits.jerk_up, -limits.jerk_down)
    change, span = end.speed - line.speed, end.time - line.time
    # With the peak acceleration p: change = (p² - rate²) / 2 j0 - p² / 2 j1 + p (span - (p - rate) / j0 + p / j1).
    a = 0.5 / j1 - 0.5 / j0
    b, c = span + rate / j0, -0.5 * rate**2 / j0 - change
    root = b**2 - 4.0 * a * c
    with np.errstate(divide="ignore", invalid="ignore"):
        # Of the two solutions, the peak nearer to 0 leaves time between the two phases of jerk.
        peak = np.where(root >= 0.0, -2.0 * c / (b + np.sqrt(np.maximum(root, 0.0))), 0.0)
        # If there is no such time, the acceleration falls as soon as it has risen.
        sharp = np.sign(j0) * np.sqrt(np.maximum((change + 0.5 * rate**2 / j0) / (0.5 / j0 - 0.5 / j1), 0.0))
    peak = np.where(root >= 0.0, peak, sharp)
    peak = np.clip(peak, -limits.down, limits.up)
    rise, fall = (peak - rate) / j0, -peak / j1
    done = (peak**2 - rate**2) / (2.0 * j0) - peak**2 / (2.0 * j1)
    with np.errstate(divide="ignore", invalid="ignore"):
        even = np.where(np.abs(peak) > 1e-9, np.maximum((change - done) / peak, 0.0), 0.0)
    t1 = line.time + rise
    v1 = line.speed + rate * rise + 0.5 * j0 * rise**2
    t2, v2 = t1 + even, v1 + peak * even
    still = np.zeros_like(peak)
    return [
        Phase(line.time, line.speed, rate, j0),
        Phase(t1, v1, peak, still),
        Phase(t2, v2, peak, j1),
        Phase(t2 + fall, end.speed, still, still),
    ]
