"""Speed profiles, with or without a limit on the jerk."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.scenario import Scope, VariesError
from cornercase.simulators.builtin.actions.action import Action
from cornercase.simulators.builtin.paths.positions import entity_index
from cornercase.simulators.builtin.world.motion import acceleration_ahead
from cornercase.simulators.builtin.world.state import LONGITUDINAL, World

# Tolerance of speeds, times and accelerations in m/s, s and m/s².
_TINY: Final = 1e-6

# Time in s after the end of a profile from which an unfinished one keeps its speed; as in esmini.
_PATIENCE: Final = 10.0


class Limits(NamedTuple):
    """Limits of speed, and of acceleration and jerk up and down; not negative, each of shape (N,)."""

    fastest: FloatArray
    up: FloatArray
    down: FloatArray
    jerk_up: FloatArray
    jerk_down: FloatArray


class Phase(NamedTuple):
    """Start of a piece of a profile: time, speed, acceleration and jerk, each of shape (N,)."""

    time: FloatArray
    speed: FloatArray
    rate: FloatArray
    jerk: FloatArray


class SpeedProfileAction(Action):
    """Takes an entity through speeds at given times.

    With ``position`` the acceleration between them is constant; with ``follow`` it changes with the allowed jerk, so
    intermediate speeds are only approached. Where limits leave no room for that, the rest of the profile uses
    ``position``, and so does the whole profile when the action runs again.
    """

    domains = (LONGITUDINAL,)

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity = entity
        self._reference = None if element.get("entityRef") is None else entity_index(element, scope, world)
        constraints = element.find("DynamicConstraints")
        names = ("maxSpeed", "maxAcceleration", "maxDeceleration", "maxAccelerationRate", "maxDecelerationRate")
        n, vehicle = scope.scenarios, world.entities[entity]
        unlimited = np.full(n, np.inf)
        bounds = [unlimited if constraints is None else scope.number(constraints, name, np.inf) for name in names]
        of_vehicle = (vehicle.max_speed, vehicle.max_acceleration, vehicle.max_deceleration, np.inf, np.inf)
        self._limits = Limits(*(np.minimum(bound, limit) for bound, limit in zip(bounds, of_vehicle, strict=True)))
        follow = scope.text(element, "followingMode", "position") == "follow"
        self._smooth = np.isfinite(bounds[3]) & np.isfinite(bounds[4]) & follow
        entries = list(element.iterfind("SpeedProfileEntry"))
        if not entries:
            raise InputError(f"{scope.source}, line {element.sourceline}: <SpeedProfileAction> has no entries.")
        self._speeds = [scope.number(limit, "speed") for limit in entries]
        self._spans = [scope.number(limit, "time", -1.0) for limit in entries]
        if len(np.unique(np.abs(self._spans[0]) < _TINY)) > 1:
            raise VariesError(scope.origins(entries[0].get("time", "")))
        self._mine = np.full(n, -1)
        self._profiles: list[list[Phase]] = []

    def start(self, world: World, where: BoolArray) -> None:
        e = self._entity
        base = world.speed[self._reference] if self._reference is not None else np.zeros(world.scenarios)
        rate = acceleration_ahead(world)[e]
        for smooth in (False, True):
            rows = where & (self._smooth == smooth)
            if not rows.any():
                continue
            profile, within_limits = self._lines(world, base, smooth), rows
            if smooth and len(profile) == 2:
                profile, within_limits = _one_target(profile[0], profile[1], rate, self._limits)
            elif smooth:
                profile, within_limits = _smoothed(profile, rate, self._limits)
            self._profiles.append(profile)
            self._mine[rows] = len(self._profiles) - 1
            self._smooth[rows & ~within_limits] = False

    def step(self, world: World, dt: float, where: BoolArray) -> BoolArray:
        e = self._entity
        target, is_over = world.speed[e].copy(), np.zeros_like(where)
        for k, profile in enumerate(self._profiles):
            rows = where & (self._mine == k)
            if rows.any():
                speed, passed = _at(profile, world.time + dt)
                rows &= world.time + dt < profile[-1].time + _PATIENCE
                target[rows] = speed[rows]
                # It ends at the speed of the last target after passing all others.
                at_target = np.abs(speed - profile[-1].speed) < _TINY
                is_over[rows] = (at_target & (passed >= len(self._speeds) - 1))[rows]
        world.set_speed(e, where, target)
        return where & is_over

    def _lines(self, world: World, base: FloatArray, smooth: bool) -> list[Phase]:
        """Phases of constant acceleration between targets, and a last one of constant speed."""
        current, time = world.speed[self._entity].copy(), world.time.copy()
        targets = list(zip(self._speeds, self._spans, strict=True))
        zeros = np.zeros(world.scenarios)
        if (np.abs(self._spans[0]) < _TINY).all():
            first, _ = targets.pop(0)
            # A smooth profile starts at the current speed.
            current = current if smooth else base + first
        lines = []
        for speed, span in targets:
            change = base + speed - current
            limit = np.where(change < 0, self._limits.down, self._limits.up)
            fastest = np.where(np.isfinite(limit), np.abs(change) / np.maximum(limit, 1e-9), 0.0)
            needed = np.where(span < -_TINY, fastest, np.maximum(span, fastest))
            lines.append(
                Phase(time, current, np.where(needed > 0, change / np.where(needed > 0, needed, 1.0), 0.0), zeros)
            )
            time, current = time + needed, current + change
        return [*lines, Phase(time, current, zeros, zeros)]


def _at(profile: list[Phase], time: FloatArray) -> tuple[FloatArray, IntArray]:
    """Speed at a time, and the number of phases passed by then, each of shape (N,)."""
    speed = profile[0].speed
    passed, reached = np.zeros(speed.shape, dtype=np.int64), np.ones(speed.shape, dtype=np.bool_)
    for number, phase in enumerate(profile):
        # A phase never begins before the previous one.
        reached &= time > phase.time - _TINY
        since = time - phase.time
        speed = np.where(reached, phase.speed + phase.rate * since + 0.5 * phase.jerk * since**2, speed)
        passed = np.where(reached, number, passed)
    return speed, passed


def _jerk(change: FloatArray, limits: Limits) -> FloatArray:
    return np.where(change < 0, -limits.jerk_down, limits.jerk_up)


def _allowed(phase: Phase, limits: Limits) -> BoolArray:
    """Check whether a phase starts within the limits on speed and acceleration, shape (N,)."""
    slow = np.abs(phase.speed) <= limits.fastest + _TINY
    return np.asarray(slow & (phase.rate <= limits.up + _TINY) & (phase.rate >= -limits.down - _TINY))


def _either(where: BoolArray, one: Phase, other: Phase) -> Phase:
    """Select one phase in the scenarios of a mask, and the other one in the rest."""
    return Phase(*(np.where(where, a, b) for a, b in zip(one, other, strict=True)))


def _smoothed(lines: list[Phase], rate: FloatArray, limits: Limits) -> tuple[list[Phase], BoolArray]:
    """Replace corners between constant accelerations by arcs of constant jerk tangent to both.

    `acceleration` (N,) is the initial acceleration in m/s². If an arc would begin before the last one ends, or a limit
    is exceeded, the lines are kept from there on. Returns the phases, and where all of them are smooth, shape (N,).
    """
    first, zeros = lines[0], np.zeros_like(rate)
    jerk = _jerk(first.rate - rate, limits)
    # A profile that starts at constant speed has no initial arc.
    span = np.where(np.abs(first.rate) > _TINY, (first.rate - rate) / jerk, 0.0)
    arc = Phase(first.time, first.speed, rate, jerk)
    current = Phase(first.time + span, first.speed + rate * span + 0.5 * jerk * span**2, first.rate, zeros)
    is_smooth = (_allowed(arc, limits) | (span == 0.0)) & _allowed(current, limits)
    plain = Phase(current.time, first.speed + first.rate * span, first.rate, zeros)
    current = _either(is_smooth, current, plain)
    phases = [arc, current]
    # Lines as speed = rate * time + level.
    level = current.speed - current.rate * current.time
    for line in lines[1:]:
        change = line.rate - current.rate
        jerk, bends = _jerk(change, limits), np.abs(change) > _TINY
        # The arc begins where it touches both lines.
        new = line.speed - line.rate * line.time
        with np.errstate(divide="ignore", invalid="ignore"):
            begin = np.where(bends, (change**2 - 2.0 * jerk * (level - new)) / (-2.0 * jerk * change), current.time)
        is_smooth &= begin >= current.time
        span = np.where(bends, change / jerk, 0.0)
        arc = Phase(
            begin, current.speed + current.rate * (begin - current.time), current.rate, np.where(bends, jerk, 0.0)
        )
        after = Phase(begin + span, arc.speed + current.rate * span + 0.5 * jerk * span**2, line.rate, zeros)
        phases += [_either(is_smooth, arc, current), _either(is_smooth, after, line)]
        current, level = phases[-1], new
        is_smooth &= _allowed(arc, limits) & _allowed(after, limits)
    return phases, is_smooth


def _one_target(line: Phase, end: Phase, rate: FloatArray, limits: Limits) -> tuple[list[Phase], BoolArray]:
    """Reach one speed at a given time, or as early as possible, with final acceleration 0.

    `line` is the constant acceleration to the target `end`; `acceleration` (N,) the initial acceleration in m/s².
    Returns the phases, and where all of them are within the limits, shape (N,).
    """
    j0 = _jerk(line.rate - rate, limits)
    j1 = np.where(line.rate < 0, limits.jerk_up, -limits.jerk_down)
    change, span = end.speed - line.speed, end.time - line.time
    # With the peak acceleration p: change = (p² - rate²) / 2 j0 - p² / 2 j1 + p (span - (p - rate) / j0 + p / j1).
    a = 0.5 / j1 - 0.5 / j0
    b, c = span + rate / j0, -0.5 * rate**2 / j0 - change
    root = b**2 - 4.0 * a * c
    with np.errstate(divide="ignore", invalid="ignore"):
        # Of the two solutions, the peak nearer to 0 leaves time between the two phases of jerk.
        square_root = np.sqrt(np.maximum(root, 0.0))
        peak = np.where(a == 0.0, -c / b, np.where(b > 0.0, -2.0 * c / (b + square_root), 0.5 * (square_root - b) / a))
        # Without such a phase, the acceleration falls as soon as it has risen.
        sharp = np.sign(j0) * np.sqrt(np.maximum((change + 0.5 * rate**2 / j0) / (0.5 / j0 - 0.5 / j1), 0.0))
    peak = np.where(root >= 0.0, peak, sharp)
    peak = np.clip(peak, -limits.down, limits.up)
    rise, fall = (peak - rate) / j0, -peak / j1
    ramps_change = (peak**2 - rate**2) / (2.0 * j0) - peak**2 / (2.0 * j1)
    with np.errstate(divide="ignore", invalid="ignore"):
        constant_time = np.where(np.abs(peak) > 1e-9, (change - ramps_change) / peak, 0.0)
    t1 = line.time + rise
    v1 = line.speed + rate * rise + 0.5 * j0 * rise**2
    t2, v2 = t1 + constant_time, v1 + peak * constant_time
    zeros = np.zeros_like(peak)
    phases = [
        Phase(line.time, line.speed, rate, j0),
        Phase(t1, v1, peak, zeros),
        Phase(t2, v2, peak, j1),
        Phase(t2 + fall, end.speed, zeros, zeros),
    ]
    return phases, np.logical_and.reduce([_allowed(phase, limits) for phase in phases])
