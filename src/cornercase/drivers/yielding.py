"""Decisions of the built-in driver: target speed, following, yielding.

All distances are from the driven entity's own box at samples of its route to contact with another box, so they are
bumper to bumper, also in curves.
"""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from typing import Final

from cornercase.drivers.contact import begins_before, first_contact, last_contact, meeting, next_rows
from cornercase.drivers.foreseeing import STANDING, foresee
from cornercase.drivers.traffic import (
    CENTER_X,
    HALF_LENGTH,
    HALF_WIDTH,
    HEADING,
    KNOWN,
    NOTICED,
    SINCE,
    SPEED,
    VULNERABLE,
    YIELDING,
    inline_kernel,
    plain_kernel,
)
from cornercase.drivers.way import arrive, distance_to, lay, look_ahead, soonest

ALIGNED: Final = 0.7
"""Cosine of the largest angle (45°) at which an entity counts as moving along the route."""

CUT_IN: Final = 2.0
"""Time in s for which lateral motion of entities that move along the route is predicted.

The driver already follows one of the same direction that will cut in within this time. An oncoming one only matters
if it is in the corridor or will be within this time: seen from a bend, all oncoming traffic seems to cross.
"""

LANE: Final = 2.0
"""Largest lateral distance of such an entity from the corridor, in m."""

ROADSIDE: Final = 1.5
"""Distance from the corridor in m within which a standing pedestrian or cyclist is passed with caution."""

LAST_METRE: Final = 0.5
"""Remaining distance to the conflict in m in emergency braking."""

COMMITTED: Final = 0.5
"""Fraction of the safety time that suffices to go first when it is too late to stop comfortably."""

NARROW: Final = 0.25
"""Time gap in s that suffices to go first when it is too late to stop at all."""

RELEASE: Final = 1.25
"""Multiple of the safety time at which yielding ends (hysteresis)."""

# Closer comparisons, relatively, are repeated exactly.
_CLOSE = 1e-9


@inline_kernel
def decide(behaviour, routes, route, scene, work):
    """Acceleration in m/s² in one scenario, before it is limited to what the vehicle can do.

    Updates in the scene which entities conflict, and which ones the driver yields to.
    """
    driven, boxes, memory, awareness = scene.driven, scene.boxes, scene.memory, scene.awareness
    v = max(driven.speed, 0.0)
    target_speed = driven.target_speed * behaviour.target_share
    if not target_speed < math.inf:
        target_speed = behaviour.max_speed
    a = _keep_speed(behaviour, routes, route, scene, v, target_speed)
    lookahead = look_ahead(behaviour, routes, route, scene, v, target_speed, work)
    for o in range(boxes.shape[1]):
        if not awareness[NOTICED, o]:
            memory[SINCE, o], awareness[YIELDING, o] = math.inf, False
            continue
        if work.seen[o]:
            direction = (work.boxes[o, 2], work.boxes[o, 3])
        else:
            direction = (math.cos(memory[HEADING, o]), math.sin(memory[HEADING, o]))
        count = foresee(memory, o, direction[0], direction[1], boxes[CENTER_X, o], behaviour.horizon, work.legs)
        other = (work.legs[:count], boxes[HALF_LENGTH, o], boxes[HALF_WIDTH, o], memory[SPEED, o])
        vulnerable, yielding = boxes[VULNERABLE, o] > 0.0, awareness[YIELDING, o]
        # For an entity it does not know yet, only the conflict matters.
        lowest = a if awareness[KNOWN, o] else -math.inf
        limit, conflict = _react(behaviour, scene.time_step, lookahead, other, vulnerable, yielding, lowest)
        if conflict:
            memory[SINCE, o] = min(memory[SINCE, o], scene.time)
            # The tolerance absorbs rounding errors in the sums of time steps.
            if scene.time - memory[SINCE, o] >= behaviour.reaction_time - 1e-9:
                awareness[YIELDING, o] = True
        else:
            memory[SINCE, o], awareness[YIELDING, o] = math.inf, False
        if awareness[KNOWN, o] and (awareness[YIELDING, o] or not conflict):
            a = min(a, limit)
    return a


@inline_kernel
def _keep_speed(behaviour, routes, route, scene, v, wanted):
    """Acceleration towards the wanted speed, limited by the curves ahead."""
    samples, points, time_step = routes.samples[route], routes.points, scene.time_step
    next_place = scene.driven.distance + (v + behaviour.acceleration * time_step) * time_step
    at = min(max(next_place / routes.measures[route, 0], 0.0), samples - 1.0)
    segment = min(int(at), samples - 2)
    k = routes.begin[route] + segment
    squared = points[k, 4] + (at - segment) * (points[k + 1, 4] - points[k, 4])
    # Too fast for a curve: brake harder than comfortable, but not as in an emergency.
    in_curve = max((math.sqrt(squared) - v) / time_step, -2.0 * behaviour.comfortable_deceleration)
    free = max((wanted - v) / time_step, -behaviour.comfortable_deceleration)
    return min(in_curve, free)


@inline_kernel
def _react(behaviour, time_step, way, other, vulnerable, yielding, least):
    """Acceleration that one other entity allows, and whether there is a conflict.

    ``(inf, False)`` if the other does not matter; without a conflict, any limit of at least `lowest_so_far` is
    equivalent.
    """
    legs, half_length, half_width, speed = other
    samples, ego = way.samples, way.ego
    dx, dy = legs[0, 0] - samples[0, 1], legs[0, 1] - samples[0, 2]
    reach = distance_to(way, way.rows - 1) + abs(speed) * behaviour.horizon
    if _further(dx, dy, reach + ego[0] + ego[1] + half_length + half_width + LANE):
        return math.inf, False
    margin = behaviour.lateral_margin
    if meeting(samples, 0, ego, margin, other, 0.0)[0] <= 0.0:
        if meeting(samples, 0, ego, 0.0, other, 0.0)[0] <= 0.0:
            in_front = dx * samples[0, 3] + dy * samples[0, 4] > 0.0
            return (-behaviour.max_deceleration if in_front else math.inf), False
        # Drop the margin if the other is already within it.
        margin = 0.0

    standing = abs(speed) < STANDING
    k = first_contact(samples, way.max_spacing, ego, margin, other, 0.0, way)
    if k > 0 and (standing or _along(samples, k, other, 0) >= ALIGNED):
        its_speed = 0.0 if standing else _speed_along(samples, k, other)
        # The previous sample is before contact begins: try that cheaper bound first.
        limit = _follow(behaviour, way.speed, distance_to(way, k - 1), its_speed)
        if not limit >= least:
            limit = _follow(behaviour, way.speed, _refine(way, k, margin, other, 0.0), its_speed)
        return limit, False
    if standing:
        if vulnerable and behaviour.standing_caution < 1.0:
            return _pass_with_caution(behaviour, time_step, way, other), False
        return math.inf, False
    return _give_way(behaviour, time_step, way, margin, other, k > 0, yielding)


@inline_kernel
def _further(dx, dy, far):
    """Check whether a vector is longer than a distance; computes the root only in borderline cases."""
    squared, square = dx * dx + dy * dy, far * far
    if squared > square * (1.0 + _CLOSE):
        return True
    return squared > square * (1.0 - _CLOSE) and math.hypot(dx, dy) > far


@plain_kernel
def _give_way(behaviour, time_step, way, margin, other, in_corridor, yielding):
    """Acceleration that yields to a crossing entity, and whether that is needed."""
    samples, ego, v = way.samples, way.ego, way.speed
    enters, _, leg = meeting(samples, 0, ego, margin, other, behaviour.horizon)
    in_its_way = enters < math.inf
    inside = in_its_way and _along(samples, 0, other, leg) > -ALIGNED
    gap = behaviour.safety_time * (RELEASE if yielding else 1.0)
    start, conflict = _find_conflict(behaviour, way, margin, other, gap, gap, inside)
    if conflict < 0:
        return math.inf, False
    since, _, leg = meeting(samples, start, ego, margin, other, behaviour.horizon)
    along = _along(samples, start, other, leg)
    if along <= -ALIGNED and since > CUT_IN and not in_corridor:
        return math.inf, False
    if along >= ALIGNED and since <= CUT_IN:
        wide_margin = behaviour.lateral_margin + LANE
        if meeting(samples, 0, ego, wide_margin, other, 0.0)[0] > 0.0:
            k = first_contact(samples, way.max_spacing, ego, wide_margin, other, 0.0, way)
            if k > 0:
                gap = _refine(way, k, wide_margin, other, 0.0)
                return _follow(behaviour, way.speed, gap, _speed_along(samples, k, other)), False

    if inside:
        stop_distance = 0.0
    elif in_its_way and start == 1:
        stop_distance = samples[conflict, 0]
    else:
        stop_distance = _refine(way, start, margin, other, behaviour.horizon)
    soft_deceleration = _needed(v, stop_distance - behaviour.braking_distance)
    hard_deceleration = _needed(v, stop_distance - LAST_METRE)
    comfortable = behaviour.comfortable_deceleration
    if inside:
        if _find_conflict(behaviour, way, 0.0, other, 0.0, 0.0, True)[1] < 0:
            return math.inf, False
    elif hard_deceleration > comfortable and not yielding:
        first = NARROW if hard_deceleration > behaviour.max_deceleration else COMMITTED * behaviour.safety_time
        if _find_conflict(behaviour, way, margin, other, min(first, gap), gap, True)[1] < 0:
            return math.inf, False
    if soft_deceleration <= comfortable:
        distance_left = max(stop_distance - behaviour.braking_distance - v * time_step, 0.0)
        return max((math.sqrt(2.0 * comfortable * distance_left) - v) / time_step, -comfortable), True
    return -max(comfortable, hard_deceleration), True


@plain_kernel
def _find_conflict(behaviour, way, margin, other, gap_first, gap_after, past_choice):
    """Row where the conflict zone begins, and row of the first sample that both reach within the gaps; -1 if none.

    With `is_too_late` (too late to decide), the driver expects entities behind it in the same direction to brake.
    """
    k, until, samples, ego, horizon, earliest = 0, -1, way.samples, way.ego, behaviour.horizon, 0.0
    while k + 1 < way.rows:
        k += 1
        if k > until:
            # Contacts that end long before the arrival here do not matter, here or later.
            since = max(earliest - gap_after - 1e-6, 0.0)
            k, until = next_rows(way, k, margin, other, since, horizon)
            if k >= way.rows:
                break
        else:
            lay(way, k)
        # Most samples are passed long before or after the other: a bound of the arrival time suffices.
        earliest = soonest(behaviour, way, k)
        # Later samples are reached later; the tolerance absorbs rounding errors.
        if earliest >= horizon + gap_after + 1e-6:
            break
        contact = last_contact(samples, k, ego, margin, other, horizon, earliest, gap_after)
        if contact[0] < 0:
            continue
        arrival = arrive(behaviour, way, k)
        if arrival >= horizon + gap_after + 1e-6:
            break
        if not (other[0][contact[0], 4] + contact[2] + gap_after > arrival):
            continue
        if not begins_before(samples, k, ego, margin, other, horizon, contact, arrival, -gap_first):
            continue
        enters, leaves, leg = meeting(samples, k, ego, margin, other, horizon)
        if enters == math.inf or (past_choice and arrival < enters and _along(samples, k, other, leg) >= ALIGNED):
            continue
        if enters - gap_first < arrival < leaves + gap_after:
            return _begin(way, k, margin, other, horizon), k
    return -1, -1


@inline_kernel
def _begin(way, k, margin, other, horizon):
    """First row of the conflict zone that contains row `row`."""
    while k > 1:
        lay(way, k - 1)
        if meeting(way.samples, k - 1, way.ego, margin, other, horizon)[0] == math.inf:
            break
        k -= 1
    return k


@plain_kernel
def _pass_with_caution(behaviour, time_step, way, other):
    slow, samples, ego, v = behaviour.standing_caution * way.target_speed, way.samples, way.ego, way.speed
    if meeting(samples, 0, ego, ROADSIDE, other, 0.0)[0] <= 0.0:
        distance = 0.0
    else:
        k = first_contact(samples, way.max_spacing, ego, ROADSIDE, other, 0.0, way)
        if k < 0:
            return math.inf
        distance = max(samples[k, 0] - v * time_step, 0.0)
    allowed = math.sqrt(slow * slow + 2.0 * behaviour.comfortable_deceleration * distance)
    return max((allowed - v) / time_step, -behaviour.comfortable_deceleration)


@inline_kernel
def _follow(behaviour, v, gap, leader_speed):
    """Interaction term of the Intelligent Driver Model (Treiber, Hennecke, Helbing 2000, eq. 3 and 4)."""
    deceleration = math.sqrt(behaviour.acceleration * behaviour.comfortable_deceleration)
    dynamic = v * behaviour.time_headway + v * (v - leader_speed) / (2.0 * deceleration)
    wanted_gap = behaviour.min_gap + max(dynamic, 0.0)
    return behaviour.acceleration * (1.0 - (wanted_gap / max(gap, 0.01)) ** 2)


@inline_kernel
def _needed(v, room):
    """Deceleration that stops within `distance` m."""
    if v <= 0.0:
        return 0.0
    return v * v / (2.0 * room) if room > 0.0 else math.inf


@inline_kernel
def _along(places, row, other, leg):
    """Cosine between the route and the other's direction of motion on a leg."""
    cosine = places[row, 3] * other[0][leg, 2] + places[row, 4] * other[0][leg, 3]
    return cosine if other[3] >= 0.0 else -cosine


@inline_kernel
def _speed_along(places, row, other):
    """Current speed of the other along the route."""
    return abs(other[3]) * _along(places, row, other, 0)


@plain_kernel
def _refine(way, k, margin, other, horizon):
    """Distance in m at which contact begins, by bisection between row `row` (contact) and the previous row."""
    samples, ego, between = way.samples, way.ego, way.interpolated
    lay(way, k - 1)
    low, high = 0.0, 1.0
    for _ in range(6):
        middle = 0.5 * (low + high)
        for i in range(5):
            between[0, i] = samples[k - 1, i] + middle * (samples[k, i] - samples[k - 1, i])
        if meeting(between, 0, ego, margin, other, horizon)[0] <= horizon:
            high = middle
        else:
            low = middle
    return samples[k - 1, 0] + low * (samples[k, 0] - samples[k - 1, 0])
