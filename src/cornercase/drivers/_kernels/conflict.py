"""Times and distances at which the box of the driven entity would touch another box.

The driven entity is tested at the samples of its path ahead. The other entity moves along its predicted legs.
"""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math

from cornercase.drivers._kernels.lookahead import compute_sample
from cornercase.drivers._kernels.structs import inline_kernel, plain_kernel

# m; closer boxes are tested exactly.
_TOLERANCE = 1e-6


@plain_kernel
def contact_interval(samples, row, ego, margin, other, horizon):
    """Return the times of first and last contact, in s from now, if the driven entity stood at a path sample.

    The third result is the leg of the first contact: a leg is a straight piece of the other entity's predicted motion.
    `ego` is (half length, half width) in m, and `margin` is added on either side. `other` is (legs, half length, half
    width, speed). With horizon 0, the other entity stands still. Without contact, the result is (inf, -inf, 0). By the
    separating axis theorem, the boxes overlap while their projections on all four axes overlap.
    """
    legs = other[0]
    own_length, own_width = ego[0], ego[1] + margin
    if horizon <= 0.0:
        if _boxes_overlap_now(samples, row, own_length, own_width, other):
            return legs[0, 4], legs[0, 4], 0
        return math.inf, -math.inf, 0
    enters, leaves, at = math.inf, -math.inf, 0
    for leg in range(legs.shape[0]):
        if leg > 0 and legs[leg, 4] >= horizon:
            break
        first, last = _contact_interval_on_leg(samples, row, own_length, own_width, other, leg, horizon)
        if first <= last:
            if enters == math.inf:
                enters, at = legs[leg, 4] + first, leg
            leaves = legs[leg, 4] + last
    return enters, leaves, at


@inline_kernel
def last_contact_ending_after(samples, row, ego, margin, other, horizon, min_end, time_offset):
    """Return leg, start and end of the last contact at a path sample, if end + `time_offset` is after `min_end`.

    Start and end are in s from the start of the leg; `min_end` is in s from now. The leg is -1 without such a contact.
    The horizon must be above 0.
    """
    legs = other[0]
    own_length, own_width = ego[0], ego[1] + margin
    leg = legs.shape[0]
    while leg > 0:
        leg -= 1
        if leg > 0 and legs[leg, 4] >= horizon:
            continue
        if not _leg_duration(legs, leg, horizon) + legs[leg, 4] + time_offset > min_end:
            return -1, math.inf, -math.inf
        first, last = _contact_interval_on_leg(samples, row, own_length, own_width, other, leg, horizon)
        if first <= last:
            return (leg if legs[leg, 4] + last + time_offset > min_end else -1), first, last
    return -1, math.inf, -math.inf


@inline_kernel
def is_first_contact_before(samples, row, ego, margin, other, horizon, known_contact, max_start, time_offset):
    """Check whether the first contact at a path sample begins earlier than `max_start` - `time_offset`.

    `known_contact` is the result of `last_contact_ending_after`, whose leg must not be -1.
    """
    legs = other[0]
    for early in range(known_contact[0]):
        if not legs[early, 4] + time_offset < max_start:
            return False
        first, last = _contact_interval_on_leg(samples, row, ego[0], ego[1] + margin, other, early, horizon)
        if first <= last:
            return legs[early, 4] + first + time_offset < max_start
    return legs[known_contact[0], 4] + known_contact[1] + time_offset < max_start


@inline_kernel
def _leg_duration(legs, leg, horizon):
    return max(min(legs[leg, 5], horizon) - legs[leg, 4], 0.0)


@plain_kernel
def _contact_interval_on_leg(samples, row, own_length, own_width, other, leg, horizon):
    """Return first and last contact on a leg, in s from its start; first > last if there is no contact."""
    legs, half_length, half_width, speed = other
    first, last = 0.0, _leg_duration(legs, leg, horizon)
    dx, dy = legs[leg, 0] - samples[row, 1], legs[leg, 1] - samples[row, 2]
    reach = own_length + own_width + half_length + half_width + abs(speed) * last
    if abs(dx) > reach or abs(dy) > reach:
        return math.inf, -math.inf
    # First the axis without motion, which needs no division.
    sideways = dy * legs[leg, 2] - dx * legs[leg, 3]
    if abs(sideways) > own_length + own_width + half_width:
        return math.inf, -math.inf
    cos = samples[row, 3] * legs[leg, 2] + samples[row, 4] * legs[leg, 3]
    sin = samples[row, 3] * legs[leg, 3] - samples[row, 4] * legs[leg, 2]
    if abs(sideways) > half_width + own_length * abs(sin) + own_width * abs(cos):
        return math.inf, -math.inf
    along = dx * legs[leg, 2] + dy * legs[leg, 3]
    first, last = _clip_to_overlap(
        first, last, along, half_length + own_length * abs(cos) + own_width * abs(sin), speed
    )
    if first > last:
        return math.inf, -math.inf
    along, lateral = dx * samples[row, 3] + dy * samples[row, 4], dy * samples[row, 3] - dx * samples[row, 4]
    radius = own_length + half_length * abs(cos) + half_width * abs(sin)
    first, last = _clip_to_overlap(first, last, along, radius, speed * cos)
    radius = own_width + half_length * abs(sin) + half_width * abs(cos)
    return _clip_to_overlap(first, last, lateral, radius, speed * sin)


@inline_kernel
def _clip_to_overlap(first, last, offset, radius, rate):
    """Clip a time interval to the times at which a point on an axis is within `radius` of 0.

    The point starts at `offset` and moves at `rate`.
    """
    first_crossing, second_crossing = (-radius - offset) / rate, (radius - offset) / rate
    is_still = abs(rate) < 1e-9
    begin, end = max(first, min(first_crossing, second_crossing)), min(last, max(first_crossing, second_crossing))
    end_if_still = -1.0 if abs(offset) > radius else last
    return (first if is_still else begin), (end_if_still if is_still else end)


@inline_kernel
def _boxes_overlap_now(samples, row, own_length, own_width, other):
    """Check whether the boxes overlap if the other entity is at the start of its first leg."""
    legs, half_length, half_width, _ = other
    dx, dy = legs[0, 0] - samples[row, 1], legs[0, 1] - samples[row, 2]
    reach = own_length + own_width + half_length + half_width
    if abs(dx) > reach or abs(dy) > reach:
        return False
    sideways = dy * legs[0, 2] - dx * legs[0, 3]
    if abs(sideways) > own_length + own_width + half_width:
        return False
    cos = abs(samples[row, 3] * legs[0, 2] + samples[row, 4] * legs[0, 3])
    sin = abs(samples[row, 3] * legs[0, 3] - samples[row, 4] * legs[0, 2])
    return not (
        abs(dx * samples[row, 3] + dy * samples[row, 4]) > own_length + half_length * cos + half_width * sin
        or abs(dy * samples[row, 3] - dx * samples[row, 4]) > own_width + half_length * sin + half_width * cos
        or abs(dx * legs[0, 2] + dy * legs[0, 3]) > half_length + own_length * cos + own_width * sin
        or abs(sideways) > half_width + own_length * sin + own_width * cos
    )


@plain_kernel
def find_first_contact_row(samples, max_spacing, ego, margin, other, horizon, lookahead=None):
    """Return the index of the first path sample ahead at which the boxes touch; -1 if there is none.

    Sample 0, the driven entity itself, is skipped. `max_spacing` is the largest distance in m between the box's centres
    at consecutive samples. If `lookahead` is given, `samples` are its samples, which are computed when needed.
    """
    k, count, until = 0, len(samples), -1
    if lookahead is not None:
        count = lookahead.rows
    while k + 1 < count:
        k += 1
        if k > until:
            if lookahead is not None:
                k, until = next_candidate_rows(lookahead, k, margin, other, 0.0, horizon)
            else:
                k += count_rows_surely_clear(samples, max_spacing, k, ego, margin, other, 0.0, horizon)
            if k >= count:
                break
        elif lookahead is not None:
            compute_sample(lookahead, k)
        if contact_interval(samples, k, ego, margin, other, horizon)[0] <= horizon:
            return k
    return -1


@inline_kernel
def next_candidate_rows(lookahead, first_row, margin, other, min_time, horizon):
    """Return the first and last index of the next path samples, from `first_row` on, with possible contact.

    The sample at the first index is computed. Contacts that end before `min_time` (in s from now) are ignored. If the
    first index is past the end of the path, there is no contact.
    """
    straight = int(lookahead.points[lookahead.first_point + first_row, 5])
    compute_sample(lookahead, first_row)
    if straight < 2:
        first = until = first_row + count_rows_surely_clear(
            lookahead.samples, lookahead.max_spacing, first_row, lookahead.ego, margin, other, min_time, horizon
        )
    else:
        begin, end = _straight_contact_range(
            lookahead.samples, first_row, lookahead.ego, margin, other, min_time, horizon, straight * lookahead.step
        )
        first = until = first_row + straight + 1
        if begin < math.inf:
            first, until = (
                first_row + int(begin / lookahead.step),
                first_row + min(int(end / lookahead.step) + 1, straight),
            )
    if first_row < first < lookahead.rows:
        compute_sample(lookahead, first)
    return first, until


@inline_kernel
def _straight_contact_range(samples, row, ego, margin, other, min_time, horizon, length):
    """Return the first range of distances on a straight line in which the ego may touch the other's moving box.

    Distances are in m from sample `row`; (inf, inf) if there is no contact within `length`.
    """
    legs, half_length, half_width, speed = other
    own_length, own_width = ego[0], ego[1] + margin
    begin, end = math.inf, math.inf
    for leg in range(legs.shape[0]):
        if leg > 0 and legs[leg, 4] >= horizon:
            break
        over = min(legs[leg, 5], horizon)
        if over < min_time:
            continue
        distance, half = _swept_distance(legs, leg, speed, min_time, over)
        dx = legs[leg, 0] + (distance + half) * legs[leg, 2] - samples[row, 1]
        dy = legs[leg, 1] + (distance + half) * legs[leg, 3] - samples[row, 2]
        cos = samples[row, 3] * legs[leg, 2] + samples[row, 4] * legs[leg, 3]
        sin = samples[row, 3] * legs[leg, 3] - samples[row, 4] * legs[leg, 2]
        swept = half_length + abs(half)
        lateral = dy * samples[row, 3] - dx * samples[row, 4]
        if abs(lateral) > own_width + swept * abs(sin) + half_width * abs(cos) + _TOLERANCE:
            continue
        longitudinal = dx * samples[row, 3] + dy * samples[row, 4]
        reach = own_length + swept * abs(cos) + half_width * abs(sin) + _TOLERANCE
        first, last = max(longitudinal - reach, 0.0), min(longitudinal + reach, length)
        if first > last:
            continue
        first, last = _clip_range(
            first,
            last,
            cos,
            dx * legs[leg, 2] + dy * legs[leg, 3],
            swept + own_length * abs(cos) + own_width * abs(sin) + _TOLERANCE,
        )
        first, last = _clip_range(
            first,
            last,
            -sin,
            dy * legs[leg, 2] - dx * legs[leg, 3],
            half_width + own_length * abs(sin) + own_width * abs(cos) + _TOLERANCE,
        )
        if first <= last and first < begin:
            begin, end = first, last
    return begin, end


@inline_kernel
def _swept_distance(legs, leg, speed, start, end):
    """Return the distance that an entity covers on a leg until `start`, and half the distance from `start` to `end`.

    Distances are in m, times in s. Both distances add up to the middle of the piece covered from `start` to `end`.
    """
    from_then = max(legs[leg, 4], start)
    return speed * (from_then - legs[leg, 4]), 0.5 * speed * max(end - from_then, 0.0)


@inline_kernel
def _clip_range(first, last, rate, center, radius):
    """Clip a range of distances along a line to the part whose projection on an axis is within `radius` of `center`.

    The projection is 0 at distance 0, and grows by `rate` per metre.
    """
    if abs(rate) < 1e-9:
        # Hardly any motion on this axis: add a tolerance.
        return (first, last) if abs(center) <= radius + _TOLERANCE else (math.inf, -math.inf)
    first_crossing, second_crossing = (center - radius) / rate, (center + radius) / rate
    return max(first, min(first_crossing, second_crossing)), min(last, max(first_crossing, second_crossing))


@inline_kernel
def count_rows_surely_clear(samples, max_spacing, first_row, ego, margin, other, min_time, horizon):
    """Return how many samples from `first_row` on are surely too far from the other entity for contact."""
    legs, half_length, half_width, speed = other
    width = ego[1] + margin
    radius, min_gap, leg = math.sqrt(ego[0] * ego[0] + width * width), math.inf, legs.shape[0]
    # The last leg is the longest, and the most likely to be near.
    while leg > 0:
        leg -= 1
        if leg > 0 and legs[leg, 4] >= horizon:
            continue
        over = min(legs[leg, 5], horizon)
        if over < min_time:
            break
        distance, half = _swept_distance(legs, leg, speed, min_time, over)
        dx, dy = legs[leg, 0] - samples[first_row, 1], legs[leg, 1] - samples[first_row, 2]
        lateral = abs(dy * legs[leg, 2] - dx * legs[leg, 3]) - half_width
        begin = dx * legs[leg, 2] + dy * legs[leg, 3] + distance
        end = begin + 2.0 * half
        along = max(min(begin, end), -max(begin, end)) - half_length
        min_gap = min(min_gap, max(lateral, along) - radius)
        if not min_gap > 1e-6:
            return 0
    return 1 + int(min((min_gap - 1e-6) / max_spacing, float(len(samples))))
