"""Path ahead of a driven entity, whose samples and arrival times are computed on demand."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from typing import Final, NamedTuple

from cornercase._common.typing import FloatArray
from cornercase.drivers._kernels.structs import CENTER_X, HALF_LENGTH, HALF_WIDTH, inline_kernel, plain_kernel
from cornercase.drivers._route import ROUTE_STEP

LOOKAHEAD: Final = 150.0
"""Longest lookahead in m."""

MAX_SAMPLES: Final = int(2.0 * LOOKAHEAD / ROUTE_STEP) + 4
"""Rows of a table of samples; samples of a route are at least half of `ROUTE_STEP` apart."""

# Relative and absolute (s) difference of arrival times that are computed differently.
_TOLERANCE: Final = 1e-9


class LookaheadPath(NamedTuple):
    """Path ahead of a driven entity, as samples along its route.

    Row 0 of `samples` is the entity itself; the other rows are the next samples of the route. Call `compute_sample`
    before you read a row. `rows` is the number of rows. `max_spacing` is the largest distance in m between the centres
    of consecutive samples.

    `points` are the points of all routes, as in `Routes`. `first_point` is the point before row 1, and `first_index`
    its index within the route. `step` is the distance between points in m. `distance` is the position of the entity
    along the route in m, and `offset` its offset to the left in m. `center_x` is the centre of its box in m, and `ego`
    its half length and half width. `speed` and `target_speed` are the present and the wanted speed in m/s. `arrivals`
    and `interpolated` are buffers, see `Workspace`.
    """

    samples: FloatArray
    arrivals: FloatArray
    interpolated: FloatArray
    rows: int
    max_spacing: float
    points: FloatArray
    first_point: int
    first_index: int
    step: float
    distance: float
    offset: float
    center_x: float
    ego: tuple[float, float]
    speed: float
    target_speed: float


@inline_kernel
def build_lookahead(behaviour, routes, route, scene, speed, target_speed, buffers):
    """Build the path ahead at the present `speed`, with the wanted `target_speed`, both in m/s.

    The path reaches as far as the driver gets at this speed within its prediction horizon, or as far as a comfortable
    stop needs if that is longer, plus a reserve; but at most 150 m.
    """
    driven, cos, sin, center_x = scene.driven, scene.cos, scene.sin, scene.own[CENTER_X]
    samples_ahead, points, distance = buffers.samples, routes.points, driven.distance
    begin, samples, step = routes.begin[route], routes.samples[route], routes.measures[route, 0]
    samples_ahead[0, 0] = 0.0
    samples_ahead[0, 1], samples_ahead[0, 2] = driven.x + center_x * cos, driven.y + center_x * sin
    samples_ahead[0, 3], samples_ahead[0, 4], samples_ahead[0, 5] = cos, sin, 0.0
    at = min(max(distance / step, 0.0), samples - 1.0)
    segment = int(at)
    share = at - segment
    start, end = begin + segment, begin + min(segment + 1, samples - 1)
    # The driven entity is assumed to keep its lateral offset from the path.
    path_x = points[start, 0] + share * (points[end, 0] - points[start, 0])
    path_y = points[start, 1] + share * (points[end, 1] - points[start, 1])
    offset = (driven.y - path_y) * points[start, 2] - (driven.x - path_x) * points[start, 3]
    braking = speed * speed / (2.0 * behaviour.comfortable_deceleration)
    reach = min(max(speed * behaviour.horizon, braking) + behaviour.braking_distance + 30.0, LOOKAHEAD)
    before = segment
    while before + 1 < samples and (before + 1) * step - distance <= 1e-6:
        before += 1
    last = max(before, min(samples - 1, int((reach + distance) / step) + 1))
    while last > before and last * step - distance > reach:
        last -= 1
    max_spacing = routes.measures[route, 1] + (abs(center_x) + abs(offset)) * routes.measures[route, 2]
    arrivals = buffers.arrivals
    arrivals[0], arrivals[1], arrivals[2] = 0.0, speed * speed, math.sqrt(speed * speed)
    return LookaheadPath(
        samples_ahead, arrivals, buffers.interpolated, 1 + last - before, max_spacing, points, begin + before, before,
        step, distance, offset, center_x, (scene.own[HALF_LENGTH], scene.own[HALF_WIDTH]), speed, target_speed,
    )  # fmt: skip


@inline_kernel
def compute_sample(lookahead, row):
    """Fill in sample `row` of the path ahead, except for the arrival time."""
    if row == 0:
        return
    samples, points, at = lookahead.samples, lookahead.points, lookahead.first_point + row
    cos, sin = points[at, 2], points[at, 3]
    samples[row, 0] = distance_to(lookahead, row)
    samples[row, 1] = points[at, 0] + lookahead.center_x * cos - lookahead.offset * sin
    samples[row, 2] = points[at, 1] + lookahead.center_x * sin + lookahead.offset * cos
    samples[row, 3], samples[row, 4] = cos, sin


@inline_kernel
def distance_to(lookahead, row):
    """Return the distance in m along the route from the driven entity to sample `row`."""
    return (lookahead.first_index + row) * lookahead.step - lookahead.distance if row > 0 else 0.0


@plain_kernel
def arrival_time(behaviour, lookahead, row):
    """Return the planned arrival time at a sample, in s from now; earlier arrival times are computed if necessary."""
    known_row = int(lookahead.arrivals[0])
    if row > known_row:
        squared, root, when, distance = (
            lookahead.arrivals[1],
            lookahead.arrivals[2],
            lookahead.samples[known_row, 5],
            distance_to(lookahead, known_row),
        )
        fastest = lookahead.target_speed * lookahead.target_speed
        for i in range(known_row + 1, row + 1):
            next_distance = distance_to(lookahead, i)
            step, distance = next_distance - distance, next_distance
            limit = min(fastest, lookahead.points[lookahead.first_point + i, 4])
            speed_sum = root + root
            # At the limit the speed is constant: skip the slow root.
            if limit != squared:
                slowest = max(squared - 2.0 * behaviour.comfortable_deceleration * step, 0.0)
                squared = max(min(squared + 2.0 * behaviour.acceleration * step, limit), slowest)
                next_root = math.sqrt(squared)
                speed_sum, root = root + next_root, next_root
            when += 2.0 * step / speed_sum if speed_sum > 0.0 else math.inf
            lookahead.samples[i, 5] = when
        lookahead.arrivals[0], lookahead.arrivals[1], lookahead.arrivals[2] = row, squared, root
    return lookahead.samples[row, 5]


@inline_kernel
def earliest_arrival_time(behaviour, lookahead, row):
    """Return a lower bound of the arrival time at a sample in s, as if there were no curves."""
    v, target_speed, a, distance = (
        lookahead.speed,
        lookahead.target_speed,
        behaviour.acceleration,
        distance_to(lookahead, row),
    )
    if row <= lookahead.arrivals[0]:
        return lookahead.samples[row, 5]
    if v >= target_speed:
        return (1.0 - _TOLERANCE) * distance / v if v > 0.0 else 0.0
    root = math.sqrt(v * v + 2.0 * a * distance)
    if root <= target_speed:
        return (1.0 - _TOLERANCE) * (root - v) / a - _TOLERANCE
    acceleration_distance = (target_speed * target_speed - v * v) / (2.0 * a)
    return (1.0 - _TOLERANCE) * (
        (target_speed - v) / a + (distance - acceleration_distance) / target_speed
    ) - _TOLERANCE
