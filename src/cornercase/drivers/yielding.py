"""The driver model's decisions: how fast to go, whom to follow, to whom to give way.

Everything is asked of the driven entity's own box at places along its route: where, and when, would it
touch another's box? So distances are those that the driven entity can still travel, bumper to bumper, in
curves too.
"""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from typing import Final

import numpy as np

from cornercase._common.compiling import kernel
from cornercase.drivers.contact import first_contact, meeting, rows_apart

STANDING: Final = 0.2
"""Below this speed in m/s an entity stands."""

ALIGNED: Final = 0.7
"""Cosine of the angle to the route up to which an entity moves along it (45°)."""

CUT_IN: Final = 2.0
"""Time in s for which the motion of entities that move along the route is foreseen across it.

One of the same direction that will cut in ahead within it is followed already. An oncoming one matters only
if it is in the corridor or will be within it: seen from a bend, all oncoming traffic seems to come across.
"""

LANE: Final = 2.0
"""How far beside the corridor, in m, such an entity may be."""

ROADSIDE: Final = 1.5
"""Up to this distance from the corridor, in m, a standing pedestrian or cyclist is passed with caution."""

LAST_METRE: Final = 0.5
"""Distance to the conflict in m that remains when the driver brakes as hard as it can."""

COMMITTED: Final = 0.5
"""Share of the safety time that is enough to go first when it is too late to stop comfortably."""

NARROW: Final = 0.25
"""Gap in s that is enough to go first when it is too late to stop at all."""

RELEASE: Final = 1.25
"""Multiple of the safety time that ends giving way, so that the decision does not flutter."""

TURNING: Final = 2.0
"""Time in s for which an entity that turns is expected to go on turning."""

TURN_LEGS: Final = 8
"""Straight legs into which that is divided."""

STRAIGHT: Final = 0.05
"""Rate of turn in rad/s up to which an entity is taken to go straight."""

LOOKAHEAD: Final = 150.0
"""m."""

_kernel = kernel(error_model="numpy")


@_kernel
def decide(behaviour, route, time, time_step, active, driven, seen, boxes, conflicts):
    """Acceleration for each scenario.

    Parameters
    ----------
    behaviour : Behaviour
    route : Route
    time, time_step : float
        s.
    active : ndarray of bool, shape (N,)
        Scenarios to decide; of the others nothing changes.
    driven : Driven
    seen : Perceived
        The others as the driver knows them.
    boxes : Boxes
        Of the others.
    conflicts : Conflicts
        Updated.

    Returns
    -------
    ndarray of float64, shape (N,)
        m/s²; 0 where not active.
    """
    scenarios = active.shape[0]
    result = np.zeros(scenarios)
    # Row 0 is where the driven entity is, the others are the route's samples ahead of it: distance from here, centre
    # of the box, cosine and sine of its heading, time of arrival.
    places = np.empty((route.x.shape[1] + 1, 6))
    legs, arrivals = np.empty((TURN_LEGS + 1, 6)), np.empty(2)
    for n in range(scenarios):
        if active[n]:
            tables = (places, arrivals, legs)
            a = _decide_one(behaviour, route, time, time_step, n, driven, seen, boxes, conflicts, tables)
            a = min(max(a, -behaviour.max_deceleration), behaviour.acceleration)
            result[n] = max(a, -driven.speed[n] / time_step)
    return result


@_kernel
def _decide_one(behaviour, route, time, time_step, n, driven, seen, boxes, conflicts, tables):
    """Acceleration in one scenario, before it is cut to what the vehicle can do."""
    places, arrivals, legs = tables
    row = n if route.x.shape[0] > 1 else 0
    v = max(driven.speed[n], 0.0)
    wanted = driven.target_speed[n] * behaviour.target_share
    if not wanted < math.inf:
        wanted = behaviour.max_speed
    count, before, most = _look_ahead(behaviour, route, row, n, driven, v, places)
    # Row up to which times of arrival are known, and the square of the speed there: few are ever asked for.
    arrivals[0], arrivals[1] = 0.0, v * v
    ahead = (places[:count], most, arrivals, route.squared_speed[row, before:], wanted * wanted)
    a = _keep_speed(behaviour, route, row, time_step, driven.distance[n], v, wanted)
    ego = (driven.half_length, driven.half_width)
    for o in range(seen.known.shape[1]):
        if not seen.noticed[n, o]:
            conflicts.since[n, o], conflicts.yielding[n, o] = math.inf, False
            continue
        count_legs = _foresee(seen, n, o, boxes.center_x[o], behaviour.horizon, legs)
        other = (legs[:count_legs], boxes.half_length[o], boxes.half_width[o], seen.speed[n, o])
        limit, conflict = _react(
            behaviour, time_step, ahead, ego, v, wanted, other, boxes.vulnerable[o], conflicts.yielding[n, o]
        )
        if conflict:
            conflicts.since[n, o] = min(conflicts.since[n, o], time)
            # The tolerance absorbs rounding errors in the sums of time steps.
            if time - conflicts.since[n, o] >= behaviour.reaction_time - 1e-9:
                conflicts.yielding[n, o] = True
        else:
            conflicts.since[n, o], conflicts.yielding[n, o] = math.inf, False
        if seen.known[n, o] and (conflicts.yielding[n, o] or not conflict):
            a = min(a, limit)
    return a


@_kernel
def _look_ahead(behaviour, route, row, n, driven, v, places):
    """Fill the table of places ahead, but for times of arrival.

    Returns their number, the route's sample before them, and an upper bound of the way in m between two of them.
    """
    distance, x, y, heading = driven.distance[n], driven.x[n], driven.y[n], driven.heading[n]
    center_x, step, samples = driven.center_x, route.step[row], route.x.shape[1]
    cos, sin = math.cos(heading), math.sin(heading)
    places[0, 0] = 0.0
    places[0, 1], places[0, 2] = x + center_x * cos, y + center_x * sin
    places[0, 3], places[0, 4], places[0, 5] = cos, sin, 0.0
    at = min(max(distance / step, 0.0), samples - 1.0)
    first = int(at)
    part = at - first
    after = min(first + 1, samples - 1)
    # The driven entity is expected to keep its lateral offset from the path.
    path_x = route.x[row, first] + part * (route.x[row, after] - route.x[row, first])
    path_y = route.y[row, first] + part * (route.y[row, after] - route.y[row, first])
    offset = (y - path_y) * route.cos[row, first] - (x - path_x) * route.sin[row, first]
    braking = v * v / (2.0 * behaviour.comfortable_deceleration)
    reach = min(max(v * behaviour.horizon, braking) + behaviour.braking_distance + 30.0, LOOKAHEAD)
    before = first
    while before + 1 < samples and (before + 1) * step - distance <= 1e-6:
        before += 1
    last = max(before, min(samples - 1, int((reach + distance) / step) + 1))
    while last > before and last * step - distance > reach:
        last -= 1
    for k in range(1, 1 + last - before):
        cos, sin = route.cos[row, before + k], route.sin[row, before + k]
        places[k, 0] = (before + k) * step - distance
        places[k, 1] = route.x[row, before + k] + center_x * cos - offset * sin
        places[k, 2] = route.y[row, before + k] + center_x * sin + offset * cos
        places[k, 3], places[k, 4] = cos, sin
    most = route.longest[row] + (abs(center_x) + abs(offset)) * route.sharpest[row]
    return 1 + last - before, before, most


@_kernel
def _arrive(behaviour, ahead, k):
    """Time in s at which the driven entity is to come to a place ahead."""
    places, _, arrivals, squared_limits, squared_wanted = ahead
    for i in range(int(arrivals[0]) + 1, k + 1):
        leg, squared = places[i, 0] - places[i - 1, 0], arrivals[1]
        limit = min(squared_wanted, squared_limits[i])
        slowest = max(squared - 2.0 * behaviour.comfortable_deceleration * leg, 0.0)
        then = max(min(squared + 2.0 * behaviour.acceleration * leg, limit), slowest)
        both = math.sqrt(squared) + math.sqrt(then)
        places[i, 5] = places[i - 1, 5] + (2.0 * leg / both if both > 0.0 else math.inf)
        arrivals[0], arrivals[1] = i, then
    return places[k, 5]


@_kernel
def _foresee(seen, n, o, center_x, horizon, legs):
    """Fill the table of straight legs that the other is expected to go, and return how many there are.

    It keeps its rate of turn for some time, then goes straight on. A leg is the centre of the box where it
    begins, cosine and sine of the heading, and the times at which it begins and ends.
    """
    x, y, heading, speed, turn = seen.x[n, o], seen.y[n, o], seen.heading[n, o], seen.speed[n, o], seen.turn[n, o]
    count = 1
    if abs(turn) > STRAIGHT and abs(speed) >= STANDING:
        count = TURN_LEGS + 1
    for k in range(count):
        duration = TURNING / TURN_LEGS
        towards = heading + 0.5 * turn * duration
        if k == 0:
            # The first leg begins with the present heading of the box.
            towards = heading
        if k == count - 1:
            duration = horizon - k * duration
            towards = heading
        cos, sin = math.cos(towards), math.sin(towards)
        legs[k, 0], legs[k, 1] = x + center_x * cos, y + center_x * sin
        legs[k, 2], legs[k, 3] = cos, sin
        legs[k, 4] = legs[k - 1, 5] if k > 0 else 0.0
        legs[k, 5] = legs[k, 4] + duration
        x, y = x + speed * duration * cos, y + speed * duration * sin
        heading += turn * duration
    return count


@_kernel
def _keep_speed(behaviour, route, row, time_step, distance, v, wanted):
    """Acceleration towards the speed that is wanted and that the curves ahead allow."""
    next_place = distance + (v + behaviour.acceleration * time_step) * time_step
    at = min(max(next_place / route.step[row], 0.0), route.x.shape[1] - 1.0)
    k = min(int(at), route.x.shape[1] - 2)
    squared = route.squared_speed[row, k] + (at - k) * (route.squared_speed[row, k + 1] - route.squared_speed[row, k])
    # Too fast for a curve, it brakes harder than is comfortable, but not as in an emergency.
    in_curve = max((math.sqrt(squared) - v) / time_step, -2.0 * behaviour.comfortable_deceleration)
    free = max((wanted - v) / time_step, -behaviour.comfortable_deceleration)
    return min(in_curve, free)


@_kernel
def _react(behaviour, time_step, ahead, ego, v, wanted, other, vulnerable, yielding):
    """Acceleration that one other entity leaves to the driver, and whether their ways conflict.

    Returns ``(inf, False)`` where the other does not matter.
    """
    legs, half_length, half_width, speed = other
    places = ahead[0]
    dx, dy = legs[0, 0] - places[0, 1], legs[0, 1] - places[0, 2]
    way = places[-1, 0] + abs(speed) * behaviour.horizon
    if math.hypot(dx, dy) > way + ego[0] + ego[1] + half_length + half_width + LANE:
        return math.inf, False
    if meeting(places, 0, ego, 0.0, other, 0.0)[0] <= 0.0:
        in_front = dx * places[0, 3] + dy * places[0, 4] > 0.0
        return (-behaviour.max_deceleration if in_front else math.inf), False
    # The margin is dropped where the other is already within it.
    margin = behaviour.lateral_margin
    if meeting(places, 0, ego, margin, other, 0.0)[0] <= 0.0:
        margin = 0.0

    standing = abs(speed) < STANDING
    k = first_contact(places, ahead[1], ego, margin, other, 0.0)
    if k > 0 and (standing or _along(places, k, other, 0) >= ALIGNED):
        gap = _refine(ahead, k, ego, margin, other, 0.0)
        return _follow(behaviour, v, gap, 0.0 if standing else _speed_along(places, k, other)), False
    if standing:
        if vulnerable and behaviour.standing_caution < 1.0:
            return _pass_with_caution(behaviour, time_step, ahead, ego, v, wanted, other), False
        return math.inf, False
    return _give_way(behaviour, time_step, ahead, ego, margin, v, other, k > 0, yielding)


@_kernel
def _give_way(behaviour, time_step, ahead, ego, margin, v, other, in_corridor, yielding):
    """Acceleration that gives way to another who crosses, and whether that is needed."""
    places = ahead[0]
    enters, _, leg = meeting(places, 0, ego, margin, other, behaviour.horizon)
    in_its_way = enters < math.inf
    inside = in_its_way and _along(places, 0, other, leg) > -ALIGNED
    gap = behaviour.safety_time * (RELEASE if yielding else 1.0)
    start, conflict = _find_conflict(behaviour, ahead, ego, margin, other, gap, gap, inside)
    if conflict < 0:
        return math.inf, False
    since, _, leg = meeting(places, start, ego, margin, other, behaviour.horizon)
    along = _along(places, start, other, leg)
    if along <= -ALIGNED and since > CUT_IN and not in_corridor:
        return math.inf, False
    if along >= ALIGNED and since <= CUT_IN:
        beside = behaviour.lateral_margin + LANE
        if meeting(places, 0, ego, beside, other, 0.0)[0] > 0.0:
            k = first_contact(places, ahead[1], ego, beside, other, 0.0)
            if k > 0:
                way = _refine(ahead, k, ego, beside, other, 0.0)
                return _follow(behaviour, v, way, _speed_along(places, k, other)), False

    if inside:
        room = 0.0
    elif in_its_way and start == 1:
        room = places[conflict, 0]
    else:
        room = _refine(ahead, start, ego, margin, other, behaviour.horizon)
    soft = _needed(v, room - behaviour.braking_distance)
    hard = _needed(v, room - LAST_METRE)
    comfortable = behaviour.comfortable_deceleration
    if inside:
        if _find_conflict(behaviour, ahead, ego, 0.0, other, 0.0, 0.0, True)[1] < 0:
            return math.inf, False
    elif hard > comfortable and not yielding:
        first = NARROW if hard > behaviour.max_deceleration else COMMITTED * behaviour.safety_time
        if _find_conflict(behaviour, ahead, ego, margin, other, min(first, gap), gap, True)[1] < 0:
            return math.inf, False
    if soft <= comfortable:
        left = max(room - behaviour.braking_distance - v * time_step, 0.0)
        return max((math.sqrt(2.0 * comfortable * left) - v) / time_step, -comfortable), True
    return -max(comfortable, hard), True


@_kernel
def _find_conflict(behaviour, ahead, ego, margin, other, gap_first, gap_after, past_choice):
    """First place that both want within the gaps.

    Past the point of choice, the driver expects those behind it in the same direction to brake.
    Returns the row where the stretch that holds the place begins, and its own row (-1: there is none).
    """
    start, k, places, most = -1, 0, ahead[0], ahead[1]
    while k + 1 < len(places):
        k += 1
        rows = rows_apart(places, most, k, ego, margin, other, behaviour.horizon)
        if rows > 0:
            start, k = -1, k + rows - 1
            continue
        enters, leaves, leg = meeting(places, k, ego, margin, other, behaviour.horizon)
        if enters == math.inf:
            start = -1
            continue
        if start < 0:
            start = k
        arrives = _arrive(behaviour, ahead, k)
        if past_choice and arrives < enters and _along(places, k, other, leg) >= ALIGNED:
            continue
        if enters - gap_first < arrives < leaves + gap_after:
            return start, k
    return -1, -1


@_kernel
def _pass_with_caution(behaviour, time_step, ahead, ego, v, wanted, other):
    slow, places = behaviour.standing_caution * wanted, ahead[0]
    if meeting(places, 0, ego, ROADSIDE, other, 0.0)[0] <= 0.0:
        room = 0.0
    else:
        k = first_contact(places, ahead[1], ego, ROADSIDE, other, 0.0)
        if k < 0:
            return math.inf
        room = max(places[k, 0] - v * time_step, 0.0)
    allowed = math.sqrt(slow * slow + 2.0 * behaviour.comfortable_deceleration * room)
    return max((allowed - v) / time_step, -behaviour.comfortable_deceleration)


@_kernel
def _follow(behaviour, v, gap, leader_speed):
    """Intelligent Driver Model (Treiber, Hennecke, Helbing 2000, eq. 3 and 4), its interaction part."""
    best = math.sqrt(behaviour.acceleration * behaviour.comfortable_deceleration)
    dynamic = v * behaviour.time_headway + v * (v - leader_speed) / (2.0 * best)
    wanted = behaviour.min_gap + max(dynamic, 0.0)
    return behaviour.acceleration * (1.0 - (wanted / max(gap, 0.01)) ** 2)


@_kernel
def _needed(v, room):
    """Deceleration that stops within `room`."""
    if v <= 0.0:
        return 0.0
    return v * v / (2.0 * room) if room > 0.0 else math.inf


@_kernel
def _along(places, row, other, leg):
    """Cosine between the route and the other's direction of motion on a leg."""
    cosine = places[row, 3] * other[0][leg, 2] + places[row, 4] * other[0][leg, 3]
    return cosine if other[3] >= 0.0 else -cosine


@_kernel
def _speed_along(places, row, other):
    """Speed of the other along the route now."""
    return abs(other[3]) * _along(places, row, other, 0)


@_kernel
def _refine(ahead, k, ego, margin, other, horizon):
    """Distance from here at which contact begins, between row `k`, where it is, and the row before."""
    place, places = np.empty((1, 6)), ahead[0]
    low, high = 0.0, 1.0
    for _ in range(6):
        middle = 0.5 * (low + high)
        for i in range(5):
            place[0, i] = places[k - 1, i] + middle * (places[k, i] - places[k - 1, i])
        if meeting(place, 0, ego, margin, other, horizon)[0] <= horizon:
            high = middle
        else:
            low = middle
    return places[k - 1, 0] + low * (places[k, 0] - places[k - 1, 0])
