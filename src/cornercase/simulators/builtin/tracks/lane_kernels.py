"""Kernels of `LaneTrack` and `LanePath`, for one scenario at a time."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, call-arg, var-annotated"

from __future__ import annotations

import math

import numpy as np

from cornercase._common.addresses import floats_at, integers_at, truths_at
from cornercase._common.compiling import kernel
from cornercase.roads import KINK
from cornercase.simulators.builtin.tracks import columns

# If a lane is shorter than this fraction of the reference line, steps are made along the lane.
_SHRUNK = 0.1


# Relative difference between the length over ground and the requested step that is tolerated.
_EXACT = 1e-3
# A cell that advances less along the reference line than this fraction of the cells at both ends is a jump.
_JUMP = 0.2


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def place_on_lane(tracks, g, distance, offset):
    """x, y (m) and heading (rad) at a distance along a lane, and an offset to the left."""
    return place_on_path(tracks.address[g], tracks.size[g], distance, offset)


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def place_on_path(addresses, count, distance, offset):
    """Same as `pose_on_lane`, for a lane path given by the addresses of its columns and `n_samples` samples."""
    table = floats_at(addresses[columns.DISTANCE], count)
    step = table[1]
    if math.isnan(distance) or not step > 0.0:
        return math.nan, math.nan, math.nan
    position = min(max(distance, 0.0), table[count - 1]) / step
    k = min(int(position), count - 2)
    fraction = position - k
    heading = _mixed(floats_at(addresses[columns.HEADING], count), k, fraction)
    x = _mixed(floats_at(addresses[columns.X], count), k, fraction)
    y = _mixed(floats_at(addresses[columns.Y], count), k, fraction)
    curvature = _mixed(floats_at(addresses[columns.CURVATURE], count), k, fraction)
    if abs(curvature) * step < KINK:
        offset = offset - 0.5 * curvature * fraction * (1.0 - fraction) * (step * step)
    return x - offset * math.sin(heading), y + offset * math.cos(heading), heading


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def advance_lane(tracks, g, distance, offset, way):
    """Distance in m along a lane after a step of `step` m (negative: backwards) along the reference line."""
    return _advance(tracks.address[g], tracks.size[g], tracks.bends[g], distance, offset, way)


@kernel(error_model="numpy")
def advance_on_path(addresses, count, known, distance, offset, way):
    """Distances in m, shape (R,), along a lane path after steps along the reference line.

    `n_samples` and `n_curvatures` are the numbers of samples and of curvatures.
    """
    result = np.empty(len(distance))
    for i in range(len(distance)):
        result[i] = _advance(addresses, count, known, distance[i], offset[i], way[i])
    return result


@kernel(error_model="numpy", _nrt=False)
def _advance(addresses, count, known, distance, offset, way):
    if math.isnan(distance + offset + way):
        return math.nan
    table = floats_at(addresses[columns.DISTANCE], count)
    reference = floats_at(addresses[columns.REFERENCE], count)
    center = floats_at(addresses[columns.CENTER], count)
    bend_at, bend = floats_at(addresses[columns.BEND_AT], known), floats_at(addresses[columns.BEND], known)
    j = _sample(table, count, distance)
    reference_distance = _between(table, reference, count, distance, j)
    offset_from_reference = _between(table, center, count, distance, j) + offset
    k = _last_within(bend_at, known, reference_distance, 0)
    scale = 1.0 - _between(bend_at, bend, known, reference_distance, k) * offset_from_reference
    # Near the centre of a bend, the reference line degenerates; follow the lane instead.
    if scale < _SHRUNK:
        return min(max(distance + way, 0.0), table[count - 1])
    target = reference_distance + way / scale
    reached = _between(reference, table, count, target, _last_within(reference, count, target, max(j, 0)))
    heading = floats_at(addresses[columns.HEADING], count)
    return _over_ground(table, reference, heading, count, distance, offset, way, reached)


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _over_ground(table, reference, heading, count, distance, offset, way, reached):
    """Distance after a step to `reached` on the reference line, corrected if the distance over ground differs."""
    if abs(_gone(table, heading, count, distance, offset, reached, math.inf)[1] - abs(way)) <= _EXACT * abs(way):
        return reached
    end = table[count - 1] if way > 0.0 else 0.0
    target, _ = _gone(table, heading, count, distance, offset, end, abs(way))
    # As in esmini, sideways jumps between lanes or road sections take no time.
    return reached if _jumps(table, reference, count, min(distance, target), max(target, reached)) else target


@kernel(error_model="numpy", _nrt=False)
def _gone(table, heading, count, begin, offset, end, most):
    """Distance reached from `begin` towards `end` beside a path, at most `max_length` m over ground, and length.

    Inside a corner, the entity turns on the spot where the path bends by more than its offset: each cell of the path
    counts with its length over ground, backwards too.
    """
    covered, position = 0.0, begin
    sign = 1 if end > begin else -1
    cell = _cell(table, count, begin)
    while (end - position) * sign > 0.0:
        next_position = table[cell + 1] if sign > 0 else table[cell]
        if cell == (count - 2 if sign > 0 else 0) or (next_position - end) * sign > 0.0:
            next_position = end
        rate = abs(1.0 - (heading[cell + 1] - heading[cell]) / (table[cell + 1] - table[cell]) * offset)
        length = abs(next_position - position) * rate
        if covered + length >= most:
            return position + sign * (most - covered) / rate, most
        covered, position = covered + length, next_position
        cell = min(max(cell + sign, 0), count - 2)
    return position, covered


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _jumps(table, reference, count, first, last):
    j, k = _cell(table, count, first), _cell(table, count, last)
    min_progress = min(reference[j + 1] - reference[j], reference[k + 1] - reference[k])
    for cell in range(min(j, k) + 1, max(j, k)):  # noqa: SIM110 - what is compiled has no generators
        if reference[cell + 1] - reference[cell] < _JUMP * min_progress:
            return True
    return False


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _cell(table, count, x):
    return min(max(_sample(table, count, x), 0), count - 2)


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def lane_place(tracks, g, distance):
    """Road index, lane number, s in m, and whether the track runs along s, at a distance along a lane."""
    count, address = tracks.size[g], tracks.address[g]
    table = floats_at(address[columns.DISTANCE], count)
    reference = floats_at(address[columns.REFERENCE], count)
    j = _sample(table, count, distance)
    sample = max(j, 0)
    after_sample = _between(table, reference, count, distance, j) - reference[sample]
    runs_along_s = truths_at(address[columns.ALONG], count)[sample]
    s = floats_at(address[columns.S], count)[sample] + (after_sample if runs_along_s else -after_sample)
    road, lane = integers_at(address[columns.ROAD], count)[sample], integers_at(address[columns.NUMBER], count)[sample]
    return road, lane, s, runs_along_s


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def goes_over(tracks, g, distance):
    """Whether another track continues at a distance along a lane."""
    first, last = tracks.span[g, 0], tracks.span[g, 1]
    return (distance < first) | (distance > last)


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _mixed(values, k, part):
    return values[k] + part * (values[k + 1] - values[k])


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _sample(table, count, x):
    """Last element of an evenly spaced table that is not beyond x; -1 before its beginning."""
    if x < table[0]:
        return -1
    if not x < table[count - 1]:
        return count - 1
    j = min(int(x / table[1]), count - 2)
    while table[j] > x:
        j -= 1
    while table[j + 1] <= x:
        j += 1
    return j


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _last_within(table, count, x, near):
    """Last element of an ascending table that is not beyond x, searched from `start` on; -1 before its beginning."""
    if table[near] <= x:
        low, high, step = near, near + 1, 1
        while high < count and table[high] <= x:
            low, step = high, 2 * step
            high = low + step
        high = min(high, count)
    else:
        low, high, step = near - 1, near, 1
        while low >= 0 and table[low] > x:
            high, step = low, 2 * step
            low = high - step
        low = max(low, -1)
    while high - low > 1:
        middle = (low + high) // 2
        if table[middle] <= x:
            low = middle
        else:
            high = middle
    return low


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _between(places, values, count, x, j):
    """Interpolated value at x as by `numpy.interp`; j is the last of `positions` that is not beyond x."""
    if j < 0:
        return values[0]
    if j >= count - 1 or places[j] == x:
        return values[j]
    slope = (values[j + 1] - values[j]) / (places[j + 1] - places[j])
    return slope * (x - places[j]) + values[j]
