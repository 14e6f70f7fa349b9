"""Kernels of `LaneTrack` and `LanePath`, for one scenario at a time."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, call-arg, var-annotated"

from __future__ import annotations

import math

import numpy as np

from cornercase._common.numba.kernel import kernel
from cornercase._common.numba.pointers import bools_at_address, floats_at_address, ints_at_address
from cornercase.roads._lane_path import KINK_ANGLE
from cornercase.simulators.builtin.track_kernels import _track_layout as track_layout

# If a lane is shorter than this fraction of the reference line, steps are made along the lane.
_MIN_SCALE = 0.1

# Tolerated relative difference between the distance that an entity covers over ground and the requested step.
_STEP_TOLERANCE = 1e-3
# A cell (between two samples) is a sideways jump if it advances along the reference line by less than this fraction of
# the cells at both ends.
_JUMP_RATIO = 0.2


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def pose_on_lane(tracks, row, distance, offset):
    """Return x, y (m) and heading (rad) at a distance along a lane and an offset to its left, both in m."""
    return pose_on_lane_path(tracks.addresses[row], tracks.size[row], distance, offset)


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def pose_on_lane_path(addresses, n_samples, distance, offset):
    """Return x, y (m) and heading (rad) at a distance along a lane path and an offset to its left, both in m.

    `addresses` are the memory addresses of the arrays of the path, which have `n_samples` items.
    """
    table = floats_at_address(addresses[track_layout.DISTANCE], n_samples)
    step = table[1]
    if math.isnan(distance) or not step > 0.0:
        return math.nan, math.nan, math.nan
    position = min(max(distance, 0.0), table[n_samples - 1]) / step
    k = min(int(position), n_samples - 2)
    fraction = position - k
    heading = _interpolate_cell(floats_at_address(addresses[track_layout.HEADING], n_samples), k, fraction)
    x = _interpolate_cell(floats_at_address(addresses[track_layout.X], n_samples), k, fraction)
    y = _interpolate_cell(floats_at_address(addresses[track_layout.Y], n_samples), k, fraction)
    curvature = _interpolate_cell(floats_at_address(addresses[track_layout.CURVATURE], n_samples), k, fraction)
    if abs(curvature) * step < KINK_ANGLE:
        offset = offset - 0.5 * curvature * fraction * (1.0 - fraction) * (step * step)
    return x - offset * math.sin(heading), y + offset * math.cos(heading), heading


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def advance_on_lane(tracks, row, distance, offset, step):
    """Return the distance in m along a lane after an entity has moved by `step` m (negative: backwards).

    The entity has an offset of `offset` m to the left of the lane's centre.
    """
    return _advance_on_samples(
        tracks.addresses[row], tracks.size[row], tracks.n_curvatures[row], distance, offset, step
    )


@kernel(interpreted_seconds=lambda *arguments: 1e-4 * len(arguments[-1]), error_model="numpy")
def advance_on_lane_path(addresses, n_samples, n_curvatures, distance, offset, steps):
    """Return the distances in m along a lane path after R entities have moved by `steps` m, shape (R,).

    `addresses` are the memory addresses of the arrays of the path. The curvatures of the reference line and their
    positions have `n_curvatures` items, all other arrays `n_samples`.
    """
    result = np.empty(len(distance))
    for i in range(len(distance)):
        result[i] = _advance_on_samples(addresses, n_samples, n_curvatures, distance[i], offset[i], steps[i])
    return result


@kernel(error_model="numpy", _nrt=False)
def _advance_on_samples(addresses, n_samples, n_curvatures, distance, offset, step):
    if math.isnan(distance + offset + step):
        return math.nan
    table = floats_at_address(addresses[track_layout.DISTANCE], n_samples)
    reference = floats_at_address(addresses[track_layout.REFERENCE_DISTANCE], n_samples)
    center = floats_at_address(addresses[track_layout.CENTER_OFFSET], n_samples)
    bend_at = floats_at_address(addresses[track_layout.CURVATURE_DISTANCE], n_curvatures)
    bend = floats_at_address(addresses[track_layout.REFERENCE_CURVATURE], n_curvatures)
    j = _find_sample(table, n_samples, distance)
    reference_distance = _interpolate_at(table, reference, n_samples, distance, j)
    offset_from_reference = _interpolate_at(table, center, n_samples, distance, j) + offset
    k = _find_last_not_beyond(bend_at, n_curvatures, reference_distance, 0)
    scale = 1.0 - _interpolate_at(bend_at, bend, n_curvatures, reference_distance, k) * offset_from_reference
    # Near the centre of a bend, the reference line degenerates; follow the lane instead.
    if scale < _MIN_SCALE:
        return min(max(distance + step, 0.0), table[n_samples - 1])
    target = reference_distance + step / scale
    reached = _interpolate_at(
        reference, table, n_samples, target, _find_last_not_beyond(reference, n_samples, target, max(j, 0))
    )
    heading = floats_at_address(addresses[track_layout.HEADING], n_samples)
    return _correct_step_over_ground(table, reference, heading, n_samples, distance, offset, step, reached)


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _correct_step_over_ground(table, reference, heading, count, distance, offset, step, reached):
    """Return the distance along a lane after a step of `step` m, in m.

    `reached` is the distance that follows from a step along the reference line. It is returned if an entity that goes
    there covers about `step` m over ground, or crosses a sideways jump of the lane; otherwise it is corrected.
    """
    if abs(
        _move_over_ground(table, heading, count, distance, offset, reached, math.inf)[1] - abs(step)
    ) <= _STEP_TOLERANCE * abs(step):
        return reached
    end = table[count - 1] if step > 0.0 else 0.0
    target, _ = _move_over_ground(table, heading, count, distance, offset, end, abs(step))
    # As in esmini, sideways jumps between lanes or road sections take no time.
    return (
        reached if _has_sideways_jump(table, reference, count, min(distance, target), max(target, reached)) else target
    )


@kernel(error_model="numpy", _nrt=False)
def _move_over_ground(table, heading, count, begin, offset, end, max_length):
    """Move from `begin` towards `end`, at an offset to the left of a path, by at most `max_length` m over ground.

    Returns the distance reached along the path, and the length covered over ground, both in m. In a bend that is
    tighter than the offset, the entity goes backwards over ground; this length is added, too.
    """
    covered, position = 0.0, begin
    sign = 1 if end > begin else -1
    cell = _find_cell(table, count, begin)
    while (end - position) * sign > 0.0:
        next_position = table[cell + 1] if sign > 0 else table[cell]
        if cell == (count - 2 if sign > 0 else 0) or (next_position - end) * sign > 0.0:
            next_position = end
        rate = abs(1.0 - (heading[cell + 1] - heading[cell]) / (table[cell + 1] - table[cell]) * offset)
        length = abs(next_position - position) * rate
        if covered + length >= max_length:
            return position + sign * (max_length - covered) / rate, max_length
        covered, position = covered + length, next_position
        cell = min(max(cell + sign, 0), count - 2)
    return position, covered


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _has_sideways_jump(table, reference, count, first, last):
    j, k = _find_cell(table, count, first), _find_cell(table, count, last)
    min_progress = min(reference[j + 1] - reference[j], reference[k + 1] - reference[k])
    for cell in range(min(j, k) + 1, max(j, k)):
        if reference[cell + 1] - reference[cell] < _JUMP_RATIO * min_progress:
            return True
    return False


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _find_cell(table, count, x):
    return min(max(_find_sample(table, count, x), 0), count - 2)


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def road_position_on_lane(tracks, row, distance):
    """Return road index, lane number, s in m, and whether the track runs along s, at a distance along a lane track."""
    count, address = tracks.size[row], tracks.addresses[row]
    table = floats_at_address(address[track_layout.DISTANCE], count)
    reference = floats_at_address(address[track_layout.REFERENCE_DISTANCE], count)
    j = _find_sample(table, count, distance)
    sample = max(j, 0)
    after_sample = _interpolate_at(table, reference, count, distance, j) - reference[sample]
    runs_along_s = bools_at_address(address[track_layout.RUNS_ALONG_S], count)[sample]
    s = floats_at_address(address[track_layout.S], count)[sample] + (after_sample if runs_along_s else -after_sample)
    road = ints_at_address(address[track_layout.ROAD], count)[sample]
    lane = ints_at_address(address[track_layout.LANE_NUMBER], count)[sample]
    return road, lane, s, runs_along_s


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def needs_next_lane(tracks, row, distance):
    """Return whether an entity at a distance along a lane track is so near an end that it should change tracks.

    The next track continues along the lanes.
    """
    first, last = tracks.span[row, 0], tracks.span[row, 1]
    return (distance < first) | (distance > last)


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _interpolate_cell(values, k, fraction):
    return values[k] + fraction * (values[k + 1] - values[k])


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _find_sample(table, count, x):
    """Return the index of the last value up to `x` in an evenly spaced ascending table; -1 if all values are above."""
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
def _find_last_not_beyond(table, count, x, start):
    """Return the index of the last value up to `x` in an ascending table; -1 if none. The search begins at `start`."""
    if table[start] <= x:
        low, high, step = start, start + 1, 1
        while high < count and table[high] <= x:
            low, step = high, 2 * step
            high = low + step
        high = min(high, count)
    else:
        low, high, step = start - 1, start, 1
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
def _interpolate_at(positions, values, count, x, j):
    """Return the interpolated value at `x`, like `numpy.interp`; `j` is the index of the last position up to `x`."""
    if j < 0:
        return values[0]
    if j >= count - 1 or positions[j] == x:
        return values[j]
    slope = (values[j + 1] - values[j]) / (positions[j + 1] - positions[j])
    return slope * (x - positions[j]) + values[j]
