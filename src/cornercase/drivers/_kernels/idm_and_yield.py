"""Decisions of the built-in driver: target speed, following, yielding.

Distances are measured along the route until the boxes touch: they are bumper-to-bumper gaps, also in curves.
"""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from typing import Final

from cornercase.drivers._kernels.conflict import (
    contact_interval,
    find_first_contact_row,
    is_first_contact_before,
    last_contact_ending_after,
    next_candidate_rows,
)
from cornercase.drivers._kernels.lookahead import (
    arrival_time,
    build_lookahead,
    compute_sample,
    distance_to,
    earliest_arrival_time,
)
from cornercase.drivers._kernels.predict import STANDING_SPEED, predict_legs
from cornercase.drivers._kernels.structs import (
    CENTER_X,
    CONFLICT_SINCE,
    HALF_LENGTH,
    HALF_WIDTH,
    HEADING,
    KNOWN,
    NOTICED,
    SPEED,
    VULNERABLE,
    YIELDING,
    inline_kernel,
    plain_kernel,
)

ALIGNED_COSINE: Final = 0.7
"""Cosine of the largest angle (45°) at which an entity counts as moving along the route."""

CUT_IN_TIME: Final = 2.0
"""Time in s for which lateral motion of entities that move along the route is predicted.

The driver already follows an entity of the same direction that will cut in within this time. An oncoming entity only
matters if it is in the corridor or will be within this time: seen from a bend, all oncoming traffic seems to cross.
"""

LANE_MARGIN: Final = 2.0
"""Largest lateral distance in m from the corridor at which an entity counts as cutting in."""

ROADSIDE_DISTANCE: Final = 1.5
"""Distance from the corridor in m within which a standing pedestrian or cyclist is passed with caution."""

EMERGENCY_STOP_MARGIN: Final = 0.5
"""Remaining distance to the conflict in m in emergency braking."""

COMMITTED_SHARE: Final = 0.5
"""Fraction of the safety time that suffices to go first when it is too late to stop comfortably."""

NARROW_GAP: Final = 0.25
"""Time gap in s that suffices to go first when it is too late to stop at all."""

RELEASE_FACTOR: Final = 1.25
"""Multiple of the safety time at which yielding ends (hysteresis)."""

# Comparisons with a smaller relative difference are repeated exactly.
_TOLERANCE = 1e-9


@inline_kernel
def plan_acceleration(behaviour, routes, route, scene, buffers):
    """Return the acceleration in m/s² that the built-in driver wants in one scenario, not yet clipped to its limits.

    Also updates two rows of `scene`: since when each entity has been in conflict with the driver
    (`memory[CONFLICT_SINCE]`), and whether the driver yields to this entity (`awareness[YIELDING]`).
    """
    driven, boxes, memory, awareness = scene.driven, scene.boxes, scene.memory, scene.awareness
    v = max(driven.speed, 0.0)
    target_speed = driven.target_speed * behaviour.target_share
    if not target_speed < math.inf:
        target_speed = behaviour.max_speed
    a = _free_acceleration(behaviour, routes, route, scene, v, target_speed)
    lookahead = build_lookahead(behaviour, routes, route, scene, v, target_speed, buffers)
    for o in range(boxes.shape[1]):
        if not awareness[NOTICED, o]:
            memory[CONFLICT_SINCE, o], awareness[YIELDING, o] = math.inf, False
            continue
        if buffers.seen[o]:
            direction = (buffers.boxes[o, 2], buffers.boxes[o, 3])
        else:
            direction = (math.cos(memory[HEADING, o]), math.sin(memory[HEADING, o]))
        count = predict_legs(memory, o, direction[0], direction[1], boxes[CENTER_X, o], behaviour.horizon, buffers.legs)
        other = (buffers.legs[:count], boxes[HALF_LENGTH, o], boxes[HALF_WIDTH, o], memory[SPEED, o])
        vulnerable, yielding = boxes[VULNERABLE, o] > 0.0, awareness[YIELDING, o]
        # For an entity that the driver does not know yet, only the conflict matters.
        lowest = a if awareness[KNOWN, o] else -math.inf
        limit, conflict = _react_to_other(behaviour, scene.time_step, lookahead, other, vulnerable, yielding, lowest)
        if conflict:
            memory[CONFLICT_SINCE, o] = min(memory[CONFLICT_SINCE, o], scene.time)
            # The tolerance absorbs rounding errors in the sums of time steps.
            if scene.time - memory[CONFLICT_SINCE, o] >= behaviour.reaction_time - 1e-9:
                awareness[YIELDING, o] = True
        else:
            memory[CONFLICT_SINCE, o], awareness[YIELDING, o] = math.inf, False
        if awareness[KNOWN, o] and (awareness[YIELDING, o] or not conflict):
            a = min(a, limit)
    return a


@inline_kernel
def _free_acceleration(behaviour, routes, route, scene, speed, target_speed):
    """Return the acceleration towards the wanted speed, limited by the curves ahead."""
    samples, points, time_step = routes.samples[route], routes.points, scene.time_step
    next_distance = scene.driven.distance + (speed + behaviour.acceleration * time_step) * time_step
    at = min(max(next_distance / routes.measures[route, 0], 0.0), samples - 1.0)
    segment = min(int(at), samples - 2)
    k = routes.begin[route] + segment
    squared = points[k, 4] + (at - segment) * (points[k + 1, 4] - points[k, 4])
    # Too fast for a curve: brake harder than comfortable, but not as in an emergency.
    in_curve = max((math.sqrt(squared) - speed) / time_step, -2.0 * behaviour.comfortable_deceleration)
    free = max((target_speed - speed) / time_step, -behaviour.comfortable_deceleration)
    return min(in_curve, free)


@inline_kernel
def _react_to_other(behaviour, time_step, lookahead, other, is_vulnerable, is_yielding, lowest_so_far):
    """Return the acceleration that one other entity allows, and whether the driver must yield to the entity.

    The result is ``(inf, False)`` if the other entity does not matter. An acceleration that is not below
    `lowest_so_far` has no effect, and may be inexact.
    """
    legs, half_length, half_width, speed = other
    samples, ego = lookahead.samples, lookahead.ego
    dx, dy = legs[0, 0] - samples[0, 1], legs[0, 1] - samples[0, 2]
    reach = distance_to(lookahead, lookahead.rows - 1) + abs(speed) * behaviour.horizon
    if _is_longer_than(dx, dy, reach + ego[0] + ego[1] + half_length + half_width + LANE_MARGIN):
        return math.inf, False
    margin = behaviour.lateral_margin
    if contact_interval(samples, 0, ego, margin, other, 0.0)[0] <= 0.0:
        if contact_interval(samples, 0, ego, 0.0, other, 0.0)[0] <= 0.0:
            in_front = dx * samples[0, 3] + dy * samples[0, 4] > 0.0
            return (-behaviour.max_deceleration if in_front else math.inf), False
        # Drop the margin if the other entity is already within it.
        margin = 0.0

    standing = abs(speed) < STANDING_SPEED
    k = find_first_contact_row(samples, lookahead.max_spacing, ego, margin, other, 0.0, lookahead)
    if k > 0 and (standing or _direction_cosine(samples, k, other, 0) >= ALIGNED_COSINE):
        its_speed = 0.0 if standing else _speed_along_route(samples, k, other)
        # The previous sample is before contact begins: try that cheaper bound first.
        limit = _idm_interaction(behaviour, lookahead.speed, distance_to(lookahead, k - 1), its_speed)
        if not limit >= lowest_so_far:
            limit = _idm_interaction(
                behaviour, lookahead.speed, _refine_contact_distance(lookahead, k, margin, other, 0.0), its_speed
            )
        return limit, False
    if standing:
        if is_vulnerable and behaviour.standing_caution < 1.0:
            return _acceleration_past_standing_person(behaviour, time_step, lookahead, other), False
        return math.inf, False
    return _yield_acceleration(behaviour, time_step, lookahead, margin, other, k > 0, is_yielding)


@inline_kernel
def _is_longer_than(dx, dy, distance):
    """Check whether a vector is longer than a distance; the square root is computed only in borderline cases."""
    squared, square = dx * dx + dy * dy, distance * distance
    if squared > square * (1.0 + _TOLERANCE):
        return True
    return squared > square * (1.0 - _TOLERANCE) and math.hypot(dx, dy) > distance


@plain_kernel
def _yield_acceleration(behaviour, time_step, lookahead, margin, other, is_in_corridor, is_yielding):
    """Return the acceleration that yields to a crossing entity, and whether the driver yields.

    For an entity that cuts in, the acceleration is the one that follows the entity. It is inf if neither is needed.
    """
    samples, ego, v = lookahead.samples, lookahead.ego, lookahead.speed
    enters, _, leg = contact_interval(samples, 0, ego, margin, other, behaviour.horizon)
    is_on_path = enters < math.inf
    inside = is_on_path and _direction_cosine(samples, 0, other, leg) > -ALIGNED_COSINE
    gap = behaviour.safety_time * (RELEASE_FACTOR if is_yielding else 1.0)
    start, conflict = _find_conflict(behaviour, lookahead, margin, other, gap, gap, inside)
    if conflict < 0:
        return math.inf, False
    since, _, leg = contact_interval(samples, start, ego, margin, other, behaviour.horizon)
    along = _direction_cosine(samples, start, other, leg)
    if along <= -ALIGNED_COSINE and since > CUT_IN_TIME and not is_in_corridor:
        return math.inf, False
    if along >= ALIGNED_COSINE and since <= CUT_IN_TIME:
        wide_margin = behaviour.lateral_margin + LANE_MARGIN
        if contact_interval(samples, 0, ego, wide_margin, other, 0.0)[0] > 0.0:
            k = find_first_contact_row(samples, lookahead.max_spacing, ego, wide_margin, other, 0.0, lookahead)
            if k > 0:
                gap = _refine_contact_distance(lookahead, k, wide_margin, other, 0.0)
                return _idm_interaction(behaviour, lookahead.speed, gap, _speed_along_route(samples, k, other)), False

    if inside:
        stop_distance = 0.0
    elif is_on_path and start == 1:
        stop_distance = samples[conflict, 0]
    else:
        stop_distance = _refine_contact_distance(lookahead, start, margin, other, behaviour.horizon)
    soft_deceleration = _stopping_deceleration(v, stop_distance - behaviour.braking_distance)
    hard_deceleration = _stopping_deceleration(v, stop_distance - EMERGENCY_STOP_MARGIN)
    comfortable = behaviour.comfortable_deceleration
    if inside:
        if _find_conflict(behaviour, lookahead, 0.0, other, 0.0, 0.0, True)[1] < 0:
            return math.inf, False
    elif hard_deceleration > comfortable and not is_yielding:
        first = (
            NARROW_GAP if hard_deceleration > behaviour.max_deceleration else COMMITTED_SHARE * behaviour.safety_time
        )
        if _find_conflict(behaviour, lookahead, margin, other, min(first, gap), gap, True)[1] < 0:
            return math.inf, False
    if soft_deceleration <= comfortable:
        distance_left = max(stop_distance - behaviour.braking_distance - v * time_step, 0.0)
        return max((math.sqrt(2.0 * comfortable * distance_left) - v) / time_step, -comfortable), True
    return -max(comfortable, hard_deceleration), True


@plain_kernel
def _find_conflict(behaviour, lookahead, margin, other, gap_if_first, gap_if_after, is_too_late):
    """Find the first sample of the path ahead that the driver and the other entity pass with too small a time gap.

    Returns the index of the sample where the conflict zone begins, and the index of the found sample; both are -1
    without conflict. `gap_if_first` and `gap_if_after` are the required gaps in s if the driver passes first or second.
    If `is_too_late` to stop comfortably before the zone, an entity that moves in the driver's direction and arrives
    after the driver is expected to brake, and is no conflict.
    """
    k, until, samples, ego, horizon, earliest = 0, -1, lookahead.samples, lookahead.ego, behaviour.horizon, 0.0
    while k + 1 < lookahead.rows:
        k += 1
        if k > until:
            # Contacts that end long before the arrival here do not matter, here or later.
            since = max(earliest - gap_if_after - 1e-6, 0.0)
            k, until = next_candidate_rows(lookahead, k, margin, other, since, horizon)
            if k >= lookahead.rows:
                break
        else:
            compute_sample(lookahead, k)
        # Most samples are passed long before or after the other: a bound of the arrival time suffices.
        earliest = earliest_arrival_time(behaviour, lookahead, k)
        # Later samples are reached later; the tolerance absorbs rounding errors.
        if earliest >= horizon + gap_if_after + 1e-6:
            break
        contact = last_contact_ending_after(samples, k, ego, margin, other, horizon, earliest, gap_if_after)
        if contact[0] < 0:
            continue
        arrival = arrival_time(behaviour, lookahead, k)
        if arrival >= horizon + gap_if_after + 1e-6:
            break
        if not (other[0][contact[0], 4] + contact[2] + gap_if_after > arrival):
            continue
        if not is_first_contact_before(samples, k, ego, margin, other, horizon, contact, arrival, -gap_if_first):
            continue
        enters, leaves, leg = contact_interval(samples, k, ego, margin, other, horizon)
        if enters == math.inf or (
            is_too_late and arrival < enters and _direction_cosine(samples, k, other, leg) >= ALIGNED_COSINE
        ):
            continue
        if enters - gap_if_first < arrival < leaves + gap_if_after:
            return _first_row_of_conflict_zone(lookahead, k, margin, other, horizon), k
    return -1, -1


@inline_kernel
def _first_row_of_conflict_zone(lookahead, row, margin, other, horizon):
    """Return the index of the first path sample of the conflict zone that contains sample `row`."""
    while row > 1:
        compute_sample(lookahead, row - 1)
        if contact_interval(lookahead.samples, row - 1, lookahead.ego, margin, other, horizon)[0] == math.inf:
            break
        row -= 1
    return row


@plain_kernel
def _acceleration_past_standing_person(behaviour, time_step, lookahead, other):
    slow, samples, ego, v = (
        behaviour.standing_caution * lookahead.target_speed,
        lookahead.samples,
        lookahead.ego,
        lookahead.speed,
    )
    if contact_interval(samples, 0, ego, ROADSIDE_DISTANCE, other, 0.0)[0] <= 0.0:
        distance = 0.0
    else:
        k = find_first_contact_row(samples, lookahead.max_spacing, ego, ROADSIDE_DISTANCE, other, 0.0, lookahead)
        if k < 0:
            return math.inf
        distance = max(samples[k, 0] - v * time_step, 0.0)
    allowed = math.sqrt(slow * slow + 2.0 * behaviour.comfortable_deceleration * distance)
    return max((allowed - v) / time_step, -behaviour.comfortable_deceleration)


@inline_kernel
def _idm_interaction(behaviour, speed, gap, leader_speed):
    """Return the acceleration of the Intelligent Driver Model without the term of the wanted speed.

    M. Treiber, A. Hennecke, D. Helbing, 2000, eq. 3 and 4.
    """
    deceleration = math.sqrt(behaviour.acceleration * behaviour.comfortable_deceleration)
    dynamic = speed * behaviour.time_headway + speed * (speed - leader_speed) / (2.0 * deceleration)
    wanted_gap = behaviour.min_gap + max(dynamic, 0.0)
    return behaviour.acceleration * (1.0 - (wanted_gap / max(gap, 0.01)) ** 2)


@inline_kernel
def _stopping_deceleration(speed, distance):
    """Return the deceleration in m/s² that stops within a distance in m."""
    if speed <= 0.0:
        return 0.0
    return speed * speed / (2.0 * distance) if distance > 0.0 else math.inf


@inline_kernel
def _direction_cosine(samples, row, other, leg):
    """Return the cosine of the angle between the route at a sample and the other entity's motion on a leg."""
    cosine = samples[row, 3] * other[0][leg, 2] + samples[row, 4] * other[0][leg, 3]
    return cosine if other[3] >= 0.0 else -cosine


@inline_kernel
def _speed_along_route(samples, row, other):
    """Return the component of the other entity's present speed along the route."""
    return abs(other[3]) * _direction_cosine(samples, row, other, 0)


@plain_kernel
def _refine_contact_distance(lookahead, row, margin, other, horizon):
    """Return the distance in m at which contact begins, between path sample `row` and the sample before."""
    samples, ego, between = lookahead.samples, lookahead.ego, lookahead.interpolated
    compute_sample(lookahead, row - 1)
    low, high = 0.0, 1.0
    for _ in range(6):
        middle = 0.5 * (low + high)
        for i in range(5):
            between[0, i] = samples[row - 1, i] + middle * (samples[row, i] - samples[row - 1, i])
        if contact_interval(between, 0, ego, margin, other, horizon)[0] <= horizon:
            high = middle
        else:
            low = middle
    return samples[row - 1, 0] + low * (samples[row, 0] - samples[row - 1, 0])
