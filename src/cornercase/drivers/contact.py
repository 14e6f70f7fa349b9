"""Times and positions at which the driven entity's box would touch another box.

The driven entity is tested at samples of its path; the other one moves along straight legs.
"""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math

from cornercase.drivers.traffic import inline_kernel, plain_kernel
from cornercase.drivers.way import lay

# m; closer boxes are tested exactly.
_HAIR = 1e-6


@plain_kernel
def meeting(places, row, ego, margin, other, horizon):
    """First and last contact in s, and the leg of the first, if the driven entity were at a path sample.

    Separating axes: the projections overlap during one interval on each of four axes; the boxes overlap during the
    intersection. `ego` is (half length, half width) in m, widened by `margin` on either side; `other` is
    (legs, half length, half width, speed). With horizon 0 the other stays where it is. Without contact: (inf, -inf, 0).
    """
    legs = other[0]
    own_length, own_width = ego[0], ego[1] + margin
    if horizon <= 0.0:
        if _touching(places, row, own_length, own_width, other):
            return legs[0, 4], legs[0, 4], 0
        return math.inf, -math.inf, 0
    enters, leaves, at = math.inf, -math.inf, 0
    for leg in range(legs.shape[0]):
        if leg > 0 and legs[leg, 4] >= horizon:
            break
        first, last = _on_leg(places, row, own_length, own_width, other, leg, horizon)
        if first <= last:
            if enters == math.inf:
                enters, at = legs[leg, 4] + first, leg
            leaves = legs[leg, 4] + last
    return enters, leaves, at


@inline_kernel
def last_contact(places, row, ego, margin, other, horizon, instant, after):
    """Leg and interval of the last contact at a path sample, if its end + `time_offset` is later than `min_end`.

    The interval is counted from the start of the leg, in s; the leg is -1 if there is no such contact. The horizon is
    above 0. Skips the computation if contact ends too early.
    """
    legs = other[0]
    own_length, own_width = ego[0], ego[1] + margin
    leg = legs.shape[0]
    while leg > 0:
        leg -= 1
        if leg > 0 and legs[leg, 4] >= horizon:
            continue
        if not _duration(legs, leg, horizon) + legs[leg, 4] + after > instant:
            return -1, math.inf, -math.inf
        first, last = _on_leg(places, row, own_length, own_width, other, leg, horizon)
        if first <= last:
            return (leg if legs[leg, 4] + last + after > instant else -1), first, last
    return -1, math.inf, -math.inf


@inline_kernel
def begins_before(places, row, ego, margin, other, horizon, found, instant, before):
    """Check that the first contact at a path sample, plus `time_offset`, begins earlier than `max_start`.

    `known_contact` is the result of `last_contact_ending_after`, with a leg.
    """
    legs = other[0]
    for early in range(found[0]):
        if not legs[early, 4] + before < instant:
            return False
        first, last = _on_leg(places, row, ego[0], ego[1] + margin, other, early, horizon)
        if first <= last:
            return legs[early, 4] + first + before < instant
    return legs[found[0], 4] + found[1] + before < instant


@inline_kernel
def _duration(legs, leg, horizon):
    return max(min(legs[leg, 5], horizon) - legs[leg, 4], 0.0)


@plain_kernel
def _on_leg(places, row, own_length, own_width, other, leg, horizon):
    """First and last contact in s from the start of a leg; first > last if there is none."""
    legs, half_length, half_width, speed = other
    first, last = 0.0, _duration(legs, leg, horizon)
    dx, dy = legs[leg, 0] - places[row, 1], legs[leg, 1] - places[row, 2]
    reach = own_length + own_width + half_length + half_width + abs(speed) * last
    if abs(dx) > reach or abs(dy) > reach:
        return math.inf, -math.inf
    # First the axis without motion, which needs no division.
    sideways = dy * legs[leg, 2] - dx * legs[leg, 3]
    if abs(sideways) > own_length + own_width + half_width:
        return math.inf, -math.inf
    cos = places[row, 3] * legs[leg, 2] + places[row, 4] * legs[leg, 3]
    sin = places[row, 3] * legs[leg, 3] - places[row, 4] * legs[leg, 2]
    if abs(sideways) > half_width + own_length * abs(sin) + own_width * abs(cos):
        return math.inf, -math.inf
    along = dx * legs[leg, 2] + dy * legs[leg, 3]
    first, last = _during(first, last, along, half_length + own_length * abs(cos) + own_width * abs(sin), speed)
    if first > last:
        return math.inf, -math.inf
    along, lateral = dx * places[row, 3] + dy * places[row, 4], dy * places[row, 3] - dx * places[row, 4]
    radius = own_length + half_length * abs(cos) + half_width * abs(sin)
    first, last = _during(first, last, along, radius, speed * cos)
    radius = own_width + half_length * abs(sin) + half_width * abs(cos)
    return _during(first, last, lateral, radius, speed * sin)


@inline_kernel
def _during(first, last, apart, radius, rate):
    """Clip a time interval to when a point at offset `offset`, moving at `rate`, is within `radius`."""
    first_crossing, second_crossing = (-radius - apart) / rate, (radius - apart) / rate
    is_still = abs(rate) < 1e-9
    begin, end = max(first, min(first_crossing, second_crossing)), min(last, max(first_crossing, second_crossing))
    end_if_still = -1.0 if abs(apart) > radius else last
    return (first if is_still else begin), (end_if_still if is_still else end)


@inline_kernel
def _touching(places, row, own_length, own_width, other):
    """Check whether the boxes overlap with the other at the start of its first leg."""
    legs, half_length, half_width, _ = other
    dx, dy = legs[0, 0] - places[row, 1], legs[0, 1] - places[row, 2]
    reach = own_length + own_width + half_length + half_width
    if abs(dx) > reach or abs(dy) > reach:
        return False
    sideways = dy * legs[0, 2] - dx * legs[0, 3]
    if abs(sideways) > own_length + own_width + half_width:
        return False
    cos = abs(places[row, 3] * legs[0, 2] + places[row, 4] * legs[0, 3])
    sin = abs(places[row, 3] * legs[0, 3] - places[row, 4] * legs[0, 2])
    return not (
        abs(dx * places[row, 3] + dy * places[row, 4]) > own_length + half_length * cos + half_width * sin
        or abs(dy * places[row, 3] - dx * places[row, 4]) > own_width + half_length * sin + half_width * cos
        or abs(dx * legs[0, 2] + dy * legs[0, 3]) > half_length + own_length * cos + own_width * sin
        or abs(sideways) > half_width + own_length * sin + own_width * cos
    )


@plain_kernel
def first_contact(places, most, ego, margin, other, horizon, way=None):
    """Row of the first path sample ahead with contact; -1 if there is none.

    Row 0 is skipped. `max_spacing` is the largest distance in m between centres at consecutive samples. Samples are
    computed on demand if `lookahead` is given.
    """
    k, count, until = 0, len(places), -1
    if way is not None:
        count = way.rows
    while k + 1 < count:
        k += 1
        if k > until:
            if way is not None:
                k, until = next_rows(way, k, margin, other, 0.0, horizon)
            else:
                k += rows_apart(places, most, k, ego, margin, other, 0.0, horizon)
            if k >= count:
                break
        elif way is not None:
            lay(way, k)
        if meeting(places, k, ego, margin, other, horizon)[0] <= horizon:
            return k
    return -1


@inline_kernel
def next_rows(way, k, margin, other, since, horizon):
    """First and last row of the next consecutive samples with possible contact; computes the first.

    Contacts that end before `min_time` (s) are ignored. The first row may be past the end of the path.
    """
    straight = int(way.points[way.first_point + k, 5])
    lay(way, k)
    if straight < 2:
        first = until = k + rows_apart(way.samples, way.max_spacing, k, way.ego, margin, other, since, horizon)
    else:
        begin, end = _stretch(way.samples, k, way.ego, margin, other, since, horizon, straight * way.step)
        first = until = k + straight + 1
        if begin < math.inf:
            first, until = k + int(begin / way.step), k + min(int(end / way.step) + 1, straight)
    if k < first < way.rows:
        lay(way, first)
    return first, until


@inline_kernel
def _stretch(places, k, ego, margin, other, since, horizon, length):
    """First range in m from sample `row` of a straight line in which the ego may touch the other's swept box.

    (inf, inf) if there is none within `length`. Separating axes: the projections overlap in one range on each of four.
    """
    legs, half_length, half_width, speed = other
    own_length, own_width = ego[0], ego[1] + margin
    begin, end = math.inf, math.inf
    for leg in range(legs.shape[0]):
        if leg > 0 and legs[leg, 4] >= horizon:
            break
        over = min(legs[leg, 5], horizon)
        if over < since:
            continue
        distance, half = _swept(legs, leg, speed, since, over)
        dx = legs[leg, 0] + (distance + half) * legs[leg, 2] - places[k, 1]
        dy = legs[leg, 1] + (distance + half) * legs[leg, 3] - places[k, 2]
        cos = places[k, 3] * legs[leg, 2] + places[k, 4] * legs[leg, 3]
        sin = places[k, 3] * legs[leg, 3] - places[k, 4] * legs[leg, 2]
        swept = half_length + abs(half)
        lateral = dy * places[k, 3] - dx * places[k, 4]
        if abs(lateral) > own_width + swept * abs(sin) + half_width * abs(cos) + _HAIR:
            continue
        longitudinal = dx * places[k, 3] + dy * places[k, 4]
        reach = own_length + swept * abs(cos) + half_width * abs(sin) + _HAIR
        first, last = max(longitudinal - reach, 0.0), min(longitudinal + reach, length)
        if first > last:
            continue
        first, last = _clip(
            first,
            last,
            cos,
            dx * legs[leg, 2] + dy * legs[leg, 3],
            swept + own_length * abs(cos) + own_width * abs(sin) + _HAIR,
        )
        first, last = _clip(
            first,
            last,
            -sin,
            dy * legs[leg, 2] - dx * legs[leg, 3],
            half_width + own_length * abs(sin) + own_width * abs(cos) + _HAIR,
        )
        if first <= last and first < begin:
            begin, end = first, last
    return begin, end


@inline_kernel
def _swept(legs, leg, speed, since, over):
    """Distance that the other has covered on a leg at time `start`, and half of what it covers afterwards, in m."""
    from_then = max(legs[leg, 4], since)
    return speed * (from_then - legs[leg, 4]), 0.5 * speed * max(over - from_then, 0.0)


@inline_kernel
def _clip(first, last, rate, middle, radius):
    """Clip a range to where a projection that grows by `rate` per metre is within `radius` of `center`."""
    if abs(rate) < 1e-9:
        # Hardly any motion on this axis: add a tolerance.
        return (first, last) if abs(middle) <= radius + _HAIR else (math.inf, -math.inf)
    first_crossing, second_crossing = (middle - radius) / rate, (middle + radius) / rate
    return max(first, min(first_crossing, second_crossing)), min(last, max(first_crossing, second_crossing))


@inline_kernel
def rows_apart(places, most, k, ego, margin, other, since, horizon):
    """Number of samples from `first_row` on that are too far from the other for contact."""
    legs, half_length, half_width, speed = other
    width = ego[1] + margin
    radius, min_gap, leg = math.sqrt(ego[0] * ego[0] + width * width), math.inf, legs.shape[0]
    # The last leg is the longest, and the most likely to be near.
    while leg > 0:
        leg -= 1
        if leg > 0 and legs[leg, 4] >= horizon:
            continue
        over = min(legs[leg, 5], horizon)
        if over < since:
            break
        distance, half = _swept(legs, leg, speed, since, over)
        dx, dy = legs[leg, 0] - places[k, 1], legs[leg, 1] - places[k, 2]
        lateral = abs(dy * legs[leg, 2] - dx * legs[leg, 3]) - half_width
        begin = dx * legs[leg, 2] + dy * legs[leg, 3] + distance
        end = begin + 2.0 * half
        along = max(min(begin, end), -max(begin, end)) - half_length
        min_gap = min(min_gap, max(lateral, along) - radius)
        if not min_gap > 1e-6:
            return 0
    return 1 + int(min((min_gap - 1e-6) / most, float(len(places))))
