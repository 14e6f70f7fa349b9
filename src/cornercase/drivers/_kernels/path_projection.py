"""Projection of points onto the path of a driven entity."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from typing import Final

import numpy as np

from cornercase._common.numba.kernel import kernel
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.drivers._base import DrivenPath

# m along the path behind and ahead of the driven entity; the nearest point is searched in between.
_BEHIND: Final = 100.0
_AHEAD: Final = 300.0
NEARBY: Final = 5.0
"""Distance in m up to which a path counts as near a point."""

# Samples on either side of the middle of a block of the path, and of a part of a block. Blocks and parts are searched
# as a whole or not at all.
_HALF_BLOCK: Final = 64
_HALF_PART: Final = 4
# Samples on either side of the index that a distance would have if samples were evenly spaced.
_NEAR_GUESS: Final = 2


def project_onto_path(
    path: DrivenPath, own_distance: FloatArray, x: FloatArray, y: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Project points onto a path: return distance along the path, offset to the left, and the path's direction there.

    All arrays except `own_distance` (N,) have the shape (N, A): A points in each of N scenarios, in m and rad. The
    fourth result is True for points next to the part of the path from 100 m behind to 300 m ahead of `own_distance`.
    Other points are projected onto the straight line beyond the nearer end of this part. Results are NaN for points
    that are NaN.
    """
    shape = np.shape(x)
    along, offset, direction = np.empty(shape), np.empty(shape), np.empty(shape)
    is_within = np.empty(shape, dtype=np.bool_)
    own, x, y = (np.ascontiguousarray(a, dtype=np.float64) for a in (own_distance, x, y))
    _project(*path.rows, own, x, y, along, offset, direction, is_within)
    return along, offset, direction, is_within


@kernel(error_model="numpy")
def _project(distance, path_x, path_y, heading, max_chord, own, x, y, along, offset, direction, is_within):
    for n in range(x.shape[0]):
        row = n if distance.shape[0] > 1 else 0
        path = distance[row], path_x[row], path_y[row], heading[row], max_chord[row]
        for a in range(x.shape[1]):
            along[n, a], offset[n, a], direction[n, a], is_within[n, a] = project_point(*path, own[n], x[n, a], y[n, a])


@kernel(interpreted_seconds=lambda *arguments: 1e-4 * len(arguments[-1]), error_model="numpy")
def locate_vehicles(distance, path_x, path_y, heading, max_chord, curvature, own, x, y, ahead):
    """Return where N vehicles are on a path, shape (N, 4).

    Columns: distance along the path, offset to the left of the path, direction of the path next to the vehicle, and
    curvature of the path farther on, by the distance `ahead` (N,) in m.
    """
    result = np.empty((x.size, 4))
    for n in range(x.size):
        row = n if distance.shape[0] > 1 else 0
        path = distance[row], path_x[row], path_y[row], heading[row], max_chord[row]
        result[n, 0], result[n, 1], result[n, 2], _ = project_point_nearby(*path, own[n], x[n], y[n])
        result[n, 3] = interpolate_on_path(distance[row], curvature[row], result[n, 0] + ahead[n])
    return result


@kernel(error_model="numpy", _nrt=False)
def interpolate_on_path(distance, values, at):
    """Interpolate `values`, which belong to the samples of a path, at the distance `at` along the path in m.

    Beyond an end of the path, return the value at this end.
    """
    last = distance.size - 1
    if not at < distance[last]:
        return values[last]
    k = max(_find_first_at_or_beyond(distance, at) - 1, 0)
    share = max((at - distance[k]) / (distance[k + 1] - distance[k]), 0.0)
    return values[k] + share * (values[k + 1] - values[k])


@kernel(error_model="numpy", _nrt=False)
def project_point(distance, path_x, path_y, heading, max_chord, own_distance, x, y):
    """Project a point onto a path: return distance along the path, offset to the left, and the path's direction there.

    The fourth result is True if the point is next to the part of the path from 100 m behind to 300 m ahead of
    `own_distance`. Otherwise the point is projected onto the straight line beyond the nearer end of this part.
    `max_chord` is the largest distance in m between consecutive samples.
    """
    if not (math.isfinite(x) and math.isfinite(y)):
        return math.nan, math.nan, math.nan, False
    first = min(max(_find_first_at_or_beyond(distance, own_distance - _BEHIND) - 1, 0), distance.size - 2)
    last = min(_find_first_at_or_beyond(distance, own_distance + _AHEAD) + 1, distance.size - 1)
    nearest = _find_nearest_sample(path_x, path_y, max_chord, first, last, x, y)
    return _project_onto_chords(distance, path_x, path_y, heading, first, last, nearest, x, y)


@kernel(error_model="numpy", _nrt=False)
def _find_first_at_or_beyond(distance, at):
    """Return the index of the first sample at a distance or beyond, as `np.searchsorted` does."""
    count = distance.size
    if not at > 0.0:
        return 0
    if not at <= distance[count - 1]:
        return count
    # Samples are about evenly spaced.
    guess = int(at / distance[count - 1] * (count - 1))
    low, high = max(guess - _NEAR_GUESS, 0), min(guess + _NEAR_GUESS, count - 1)
    if not distance[low] < at <= distance[high]:
        return np.searchsorted(distance, at)
    while distance[low + 1] < at:
        low += 1
    return low + 1


@kernel(error_model="numpy", _nrt=False)
def _find_nearest_sample(path_x, path_y, max_chord, first, last, x, y):
    """Return the index of the sample from `first` to `last` that is nearest to a point."""
    block, part = 2 * _HALF_BLOCK + 1, 2 * _HALF_PART + 1
    nearest, least = first, math.inf
    for start in range(first, last + 1, block):
        middle = min(start + _HALF_BLOCK, last)
        gap = _squared_gap(path_x, path_y, middle, x, y)
        if gap < least:
            nearest, least = middle, gap
    bound = _max_squared_gap(least, _HALF_BLOCK * max_chord)
    for start in range(first, last + 1, block):
        if _squared_gap(path_x, path_y, min(start + _HALF_BLOCK, last), x, y) > bound:
            continue
        end = min(start + block, last + 1)
        part_bound = _max_squared_gap(least, _HALF_PART * max_chord)
        for begin in range(start, end, part):
            if _squared_gap(path_x, path_y, min(begin + _HALF_PART, last), x, y) > part_bound:
                continue
            for k in range(begin, min(begin + part, end)):
                gap = _squared_gap(path_x, path_y, k, x, y)
                if gap < least or (gap == least and k < nearest):
                    nearest, least = k, gap
            part_bound = _max_squared_gap(least, _HALF_PART * max_chord)
        bound = _max_squared_gap(least, _HALF_BLOCK * max_chord)
    return nearest


@kernel(error_model="numpy", _nrt=False, forceinline=True)
def _max_squared_gap(squared_gap, reach):
    """Return the limit in m² above which a block of samples, within `reach` m of its middle, can be skipped.

    If the squared distance of a point to the middle of the block is above the limit, no sample of the block has a
    squared distance below `squared_gap`.
    """
    limit = math.sqrt(squared_gap) + reach
    return (1.0 + 1e-9) * limit * limit


@kernel(error_model="numpy", _nrt=False)
def project_point_nearby(distance, path_x, path_y, heading, max_chord, own_distance, x, y):
    """Project a point as `project_point` does, but prefer the part of the path around `own_distance`.

    If this part is less than 5 m away, the rest of the path is not searched. So a vehicle whose path crosses itself
    does not jump to the crossing branch.
    """
    k = descend_to_nearest_sample(path_x, path_y, _find_first_at_or_beyond(distance, own_distance), x, y)
    if not _squared_gap(path_x, path_y, k, x, y) < NEARBY * NEARBY:
        return project_point(distance, path_x, path_y, heading, max_chord, own_distance, x, y)
    return _project_onto_chords(distance, path_x, path_y, heading, 0, distance.size - 1, k, x, y)


@kernel(error_model="numpy", _nrt=False)
def descend_to_nearest_sample(path_x, path_y, start, x, y):
    """Return the index of the sample nearest to a point; go from `start` along the path while samples get nearer."""
    last = path_x.size - 1
    k = min(max(start, 0), last)
    gap, step = _squared_gap(path_x, path_y, k, x, y), 1
    if k == last or not _squared_gap(path_x, path_y, k + 1, x, y) < gap:
        step = -1
    while 0 <= k + step <= last:
        following = _squared_gap(path_x, path_y, k + step, x, y)
        if not following < gap:
            break
        k, gap = k + step, following
    return k


@kernel(error_model="numpy", _nrt=False, forceinline=True)
def _squared_gap(path_x, path_y, k, x, y):
    return (path_x[k] - x) * (path_x[k] - x) + (path_y[k] - y) * (path_y[k] - y)


@kernel(error_model="numpy", _nrt=False)
def _project_onto_chords(distance, path_x, path_y, heading, first, last, nearest, x, y):
    """Project a point onto the nearer of the two chords at sample `nearest`, with results as of `project_point`.

    Only the samples `first` to `last` count as the path.
    """
    best = math.inf
    along, offset, direction, is_next_to = math.nan, math.nan, math.nan, False
    for k in range(max(nearest - 1, first), min(nearest + 1, last)):
        chord_x, chord_y = path_x[k + 1] - path_x[k], path_y[k + 1] - path_y[k]
        length = math.sqrt(chord_x * chord_x + chord_y * chord_y)
        dx, dy = x - path_x[k], y - path_y[k]
        ahead = (dx * chord_x + dy * chord_y) / length
        share = min(max(ahead / length, 0.0), 1.0)
        squared = (dx - share * chord_x) ** 2 + (dy - share * chord_y) ** 2
        if squared < best:
            best = squared
            is_beyond = (ahead < 0.0 and k == first) or (ahead > length and k + 1 == last)
            part = ahead / length if is_beyond else share
            along = distance[k] + part * (distance[k + 1] - distance[k])
            direction = heading[k] + share * (heading[k + 1] - heading[k])
            offset = (dy * chord_x - dx * chord_y) / length
            if not is_beyond and share != ahead / length:
                # At a corner, the point is next to neither chord.
                offset = math.copysign(math.sqrt(squared), offset)
            is_next_to = not is_beyond
    return along, offset, direction, is_next_to
