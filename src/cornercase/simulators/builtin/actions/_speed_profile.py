"""Speed profiles, with or without a limit on the jerk."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from lxml import etree

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.scenario._batch_split import BatchSplitError
from cornercase.scenario._scope import Scope
from cornercase.simulators.builtin.actions._action import Action
from cornercase.simulators.builtin.actions._longitudinal import read_dynamic_limit
from cornercase.simulators.builtin.paths._positions import read_entity_index
from cornercase.simulators.builtin.world._track_motion import heading_acceleration
from cornercase.simulators.builtin.world._world import LONGITUDINAL, World

# Tolerance of speeds, times and accelerations in m/s, s and m/s².
_TINY: Final = 1e-6

# Time in s after the end of a profile from which an unfinished one keeps its speed; as in esmini.
_MAX_DELAY: Final = 10.0


class ProfileLimits(NamedTuple):
    """Limits of a speed profile in m/s, m/s² and m/s³: one value of at least 0 per scenario."""

    max_speed: FloatArray
    max_acceleration: FloatArray
    max_deceleration: FloatArray
    jerk_up: FloatArray
    jerk_down: FloatArray


class ProfilePhase(NamedTuple):
    """Phase of constant jerk in a speed profile; the values, one per scenario, apply to the start of the phase."""

    time: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    jerk: FloatArray


class SpeedProfileAction(Action):
    """Action that brings an entity to given speeds at given times.

    With the following mode ``position``, the acceleration between two times is constant. With ``follow`` and limits of
    the jerk, the acceleration changes gradually, with the allowed jerk. The entity then reaches the last speed, and
    only comes close to the speeds before. From the time at which the limits do not permit this, the entity moves as
    with ``position``, unless there is only one speed to reach. If the action then runs again, the entity moves as with
    ``position`` all the time.
    """

    domains = (LONGITUDINAL,)

    def __init__(self, element: etree._Element, scope: Scope, world: World, entity: int) -> None:
        self._entity = entity
        self._reference = None if element.get("entityRef") is None else read_entity_index(element, scope, world)
        constraints = element.find("DynamicConstraints")
        names = ("maxSpeed", "maxAcceleration", "maxDeceleration", "maxAccelerationRate", "maxDecelerationRate")
        n, vehicle = scope.n_scenarios, world.entities[entity]
        bounds = [read_dynamic_limit(constraints, name, np.inf, scope) for name in names]
        of_vehicle = (vehicle.max_speed, vehicle.max_acceleration, vehicle.max_deceleration, np.inf, np.inf)
        self._limits = ProfileLimits(
            *(np.minimum(bound, limit) for bound, limit in zip(bounds, of_vehicle, strict=True))
        )
        follow = scope.read_text(element, "followingMode", "position") == "follow"
        self._smooth = np.isfinite(bounds[3]) & np.isfinite(bounds[4]) & follow
        entries = list(element.iterfind("SpeedProfileEntry"))
        if not entries:
            raise scope.error_at(element, "<SpeedProfileAction> has no entries.")
        self._speeds = [scope.read_numbers(limit, "speed") for limit in entries]
        self._durations = [scope.read_numbers(limit, "time", -1.0) for limit in entries]
        if len(np.unique(np.abs(self._durations[0]) < _TINY)) > 1:
            raise BatchSplitError(scope.find_origin_parameters(entries[0].get("time", "")))
        self._profile_index = np.full(n, -1)
        self._profiles: list[list[ProfilePhase]] = []

    def start(self, world: World, where: BoolArray) -> None:
        e = self._entity
        base = world.speed[self._reference] if self._reference is not None else np.zeros(world.scenarios)
        rate = heading_acceleration(world)[e]
        for smooth in (False, True):
            rows = where & (self._smooth == smooth)
            if not rows.any():
                continue
            profile, within_limits = self._linear_phases(world, base, smooth), rows
            if smooth and len(profile) == 2:
                profile, within_limits = _plan_single_target(profile[0], profile[1], rate, self._limits)
            elif smooth:
                profile, within_limits = _smooth_corners(profile, rate, self._limits)
            self._profiles.append(profile)
            self._profile_index[rows] = len(self._profiles) - 1
            self._smooth[rows & ~within_limits] = False

    def step(self, world: World, dt: float, where: BoolArray) -> BoolArray:
        e = self._entity
        target, is_over = world.speed[e].copy(), np.zeros_like(where)
        for k, profile in enumerate(self._profiles):
            rows = where & (self._profile_index == k)
            if rows.any():
                speed, passed = _speed_at(profile, world.time + dt)
                rows &= world.time + dt < profile[-1].time + _MAX_DELAY
                target[rows] = speed[rows]
                # It ends at the speed of the last target after passing all others.
                at_target = np.abs(speed - profile[-1].speed) < _TINY
                is_over[rows] = (at_target & (passed >= len(self._speeds) - 1))[rows]
        world.set_speed(e, where, target)
        return where & is_over

    def _linear_phases(self, world: World, reference_speed: FloatArray, smooth: bool) -> list[ProfilePhase]:
        """Return phases of constant acceleration between the speeds, and a last phase of constant speed."""
        current, time = world.speed[self._entity].copy(), world.time.copy()
        targets = list(zip(self._speeds, self._durations, strict=True))
        zeros = np.zeros(world.scenarios)
        if (np.abs(self._durations[0]) < _TINY).all():
            first, _ = targets.pop(0)
            # A smooth profile starts at the current speed.
            current = current if smooth else reference_speed + first
        lines = []
        for speed, span in targets:
            change = reference_speed + speed - current
            limit = np.where(change < 0, self._limits.max_deceleration, self._limits.max_acceleration)
            fastest = np.where(np.isfinite(limit), np.abs(change) / np.maximum(limit, 1e-9), 0.0)
            needed = np.where(span < -_TINY, fastest, np.maximum(span, fastest))
            lines.append(
                ProfilePhase(
                    time, current, np.where(needed > 0, change / np.where(needed > 0, needed, 1.0), 0.0), zeros
                )
            )
            time, current = time + needed, current + change
        return [*lines, ProfilePhase(time, current, zeros, zeros)]


def _speed_at(profile: list[ProfilePhase], time: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return the speed at a time in each scenario, and the number of phases that have ended by this time."""
    speed = profile[0].speed
    passed, reached = np.zeros(speed.shape, dtype=np.int64), np.ones(speed.shape, dtype=np.bool_)
    for number, phase in enumerate(profile):
        # A phase never begins before the previous one.
        reached &= time > phase.time - _TINY
        since = time - phase.time
        speed = np.where(reached, phase.speed + phase.acceleration * since + 0.5 * phase.jerk * since**2, speed)
        passed = np.where(reached, number, passed)
    return speed, passed


def _signed_jerk(change: FloatArray, limits: ProfileLimits) -> FloatArray:
    return np.where(change < 0, -limits.jerk_down, limits.jerk_up)


def _is_within_limits(phase: ProfilePhase, limits: ProfileLimits) -> BoolArray:
    """Return whether speed and acceleration at the start of a phase are within the limits, for each scenario."""
    slow = np.abs(phase.speed) <= limits.max_speed + _TINY
    return np.asarray(
        slow
        & (phase.acceleration <= limits.max_acceleration + _TINY)
        & (phase.acceleration >= -limits.max_deceleration - _TINY)
    )


def _select_phase(where: BoolArray, inside: ProfilePhase, outside: ProfilePhase) -> ProfilePhase:
    """Return a phase with the values of `inside` in the scenarios of a mask, and of `outside` in other scenarios."""
    return ProfilePhase(*(np.where(where, a, b) for a, b in zip(inside, outside, strict=True)))


def _smooth_corners(
    lines: list[ProfilePhase], acceleration: FloatArray, limits: ProfileLimits
) -> tuple[list[ProfilePhase], BoolArray]:
    """Replace each corner of a speed profile (a jump of the acceleration) by an arc of constant jerk.

    Drawn as speed over time, an arc is tangent to the straight lines before and after it. `acceleration` has the
    initial acceleration in m/s² for each scenario. If an arc would begin before the previous arc ends, its corner and
    all later corners stay. After an arc that exceeds a limit, all later corners stay. Returns the phases, and a mask of
    the scenarios without such arcs.
    """
    first, zeros = lines[0], np.zeros_like(acceleration)
    jerk = _signed_jerk(first.acceleration - acceleration, limits)
    # A profile that starts at constant speed has no initial arc.
    span = np.where(np.abs(first.acceleration) > _TINY, (first.acceleration - acceleration) / jerk, 0.0)
    arc = ProfilePhase(first.time, first.speed, acceleration, jerk)
    current = ProfilePhase(
        first.time + span, first.speed + acceleration * span + 0.5 * jerk * span**2, first.acceleration, zeros
    )
    is_smooth = (_is_within_limits(arc, limits) | (span == 0.0)) & _is_within_limits(current, limits)
    plain = ProfilePhase(current.time, first.speed + first.acceleration * span, first.acceleration, zeros)
    current = _select_phase(is_smooth, current, plain)
    phases = [arc, current]
    # Lines as speed = rate * time + level.
    level = current.speed - current.acceleration * current.time
    for line in lines[1:]:
        change = line.acceleration - current.acceleration
        jerk, bends = _signed_jerk(change, limits), np.abs(change) > _TINY
        # The arc begins where it touches both lines.
        new = line.speed - line.acceleration * line.time
        with np.errstate(divide="ignore", invalid="ignore"):
            begin = np.where(bends, (change**2 - 2.0 * jerk * (level - new)) / (-2.0 * jerk * change), current.time)
        is_smooth &= begin >= current.time
        span = np.where(bends, change / jerk, 0.0)
        arc = ProfilePhase(
            begin,
            current.speed + current.acceleration * (begin - current.time),
            current.acceleration,
            np.where(bends, jerk, 0.0),
        )
        after = ProfilePhase(
            begin + span, arc.speed + current.acceleration * span + 0.5 * jerk * span**2, line.acceleration, zeros
        )
        phases += [_select_phase(is_smooth, arc, current), _select_phase(is_smooth, after, line)]
        current, level = phases[-1], new
        is_smooth &= _is_within_limits(arc, limits) & _is_within_limits(after, limits)
    return phases, is_smooth


def _plan_single_target(
    line: ProfilePhase, end: ProfilePhase, acceleration: FloatArray, limits: ProfileLimits
) -> tuple[list[ProfilePhase], BoolArray]:
    """Plan phases that reach one speed at a given time, or as early as possible, and end with acceleration 0.

    `line` is the phase of constant acceleration to the target `end`. `acceleration` has the initial acceleration in
    m/s² for each scenario. Returns the phases, and a mask of the scenarios in which all phases are within the limits.
    """
    j0 = _signed_jerk(line.acceleration - acceleration, limits)
    j1 = np.where(line.acceleration < 0, limits.jerk_up, -limits.jerk_down)
    change, span = end.speed - line.speed, end.time - line.time
    # With the peak acceleration p: change = (p² - rate²) / 2 j0 - p² / 2 j1 + p (span - (p - rate) / j0 + p / j1).
    a = 0.5 / j1 - 0.5 / j0
    b, c = span + acceleration / j0, -0.5 * acceleration**2 / j0 - change
    root = b**2 - 4.0 * a * c
    with np.errstate(divide="ignore", invalid="ignore"):
        # Of the two solutions, the peak nearer to 0 leaves time between the two phases of jerk.
        square_root = np.sqrt(np.maximum(root, 0.0))
        peak = np.where(a == 0.0, -c / b, np.where(b > 0.0, -2.0 * c / (b + square_root), 0.5 * (square_root - b) / a))
        # Without such a phase, the acceleration falls as soon as it has risen.
        sharp = np.sign(j0) * np.sqrt(np.maximum((change + 0.5 * acceleration**2 / j0) / (0.5 / j0 - 0.5 / j1), 0.0))
    peak = np.where(root >= 0.0, peak, sharp)
    peak = np.clip(peak, -limits.max_deceleration, limits.max_acceleration)
    rise, fall = (peak - acceleration) / j0, -peak / j1
    ramps_change = (peak**2 - acceleration**2) / (2.0 * j0) - peak**2 / (2.0 * j1)
    with np.errstate(divide="ignore", invalid="ignore"):
        constant_time = np.where(np.abs(peak) > 1e-9, (change - ramps_change) / peak, 0.0)
    t1 = line.time + rise
    v1 = line.speed + acceleration * rise + 0.5 * j0 * rise**2
    t2, v2 = t1 + constant_time, v1 + peak * constant_time
    zeros = np.zeros_like(peak)
    phases = [
        ProfilePhase(line.time, line.speed, acceleration, j0),
        ProfilePhase(t1, v1, peak, zeros),
        ProfilePhase(t2, v2, peak, j1),
        ProfilePhase(t2 + fall, end.speed, zeros, zeros),
    ]
    return phases, np.logical_and.reduce([_is_within_limits(phase, limits) for phase in phases])
