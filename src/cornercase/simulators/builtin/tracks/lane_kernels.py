"""Compiled twins of `LaneTrack` and `LanePath`, for one scenario at a time."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, call-arg, var-annotated"

from __future__ import annotations

import math

import numpy as np

from cornercase._common.addresses import floats_at, integers_at, truths_at
from cornercase._common.compiling import kernel
from cornercase.roads import KINK
from cornercase.simulators.builtin.tracks import columns

# Where a lane is shorter than this part of the reference line, an entity moves along the lane alone.
_SHRUNK = 0.1


# By no more than this part the way of a step over ground differs from that asked for.
_EXACT = 1e-3
# A lane that gets on so much less along the reference line than at both ends of a step has a jump there.
_JUMP = 0.2


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def place_on_lane(tracks, g, distance, offset):
    """Place at a distance along a lane.

    Parameters
    ----------
    tracks : Tracks
    g : int
        Row of the track.
    distance, offset : float
        m along it, and to the left.

    Returns
    -------
    x, y, heading : float
        m, m, rad.
    """
    return place_on_path(
        tracks.address[g, columns.DISTANCE],
        tracks.address[g, columns.X],
        tracks.address[g, columns.Y],
        tracks.address[g, columns.HEADING],
        tracks.address[g, columns.CURVATURE],
        tracks.size[g],
        distance,
        offset,
    )


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def place_on_path(distances, xs, ys, headings, curvatures, count, distance, offset):
    """Place at a distance along a path of lanes, `place_on_lane` without tables.

    Parameters
    ----------
    distances, xs, ys, headings, curvatures : int
        Addresses of its columns.
    count : int
        Its samples.
    distance, offset : float
        m along it, and to the left.

    Returns
    -------
    x, y, heading : float
        m, m, rad.
    """
    table = floats_at(distances, count)
    step = table[1]
    if math.isnan(distance) or not step > 0.0:
        return math.nan, math.nan, math.nan
    place = min(max(distance, 0.0), table[count - 1]) / step
    k = min(int(place), count - 2)
    part = place - k
    heading = _mixed(floats_at(headings, count), k, part)
    x, y = _mixed(floats_at(xs, count), k, part), _mixed(floats_at(ys, count), k, part)
    curvature = _mixed(floats_at(curvatures, count), k, part)
    if abs(curvature) * step < KINK:
        offset = offset - 0.5 * curvature * part * (1.0 - part) * (step * step)
    return x - offset * math.sin(heading), y + offset * math.cos(heading), heading


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def advance_lane(tracks, g, distance, offset, way):
    """Distance along a lane after a step along the reference line.

    Parameters
    ----------
    tracks : Tracks
    g : int
        Row of the track.
    distance, offset : float
        m along it, and to the left.
    way : float
        m; negative backwards.

    Returns
    -------
    float
        m.
    """
    return _advance(
        tracks.address[g, columns.DISTANCE],
        tracks.address[g, columns.REFERENCE],
        tracks.address[g, columns.CENTER],
        tracks.size[g],
        tracks.address[g, columns.BEND_AT],
        tracks.address[g, columns.BEND],
        tracks.bends[g],
        tracks.address[g, columns.HEADING],
        distance,
        offset,
        way,
    )


@kernel(error_model="numpy")
def advance_on_path(addresses, count, known, distance, offset, way):
    """Distances along a path of lanes after steps along the reference line.

    Parameters
    ----------
    addresses : ndarray of int64, shape (14,)
        Where the columns of the path lie.
    count, known : int
        Its samples, and places with a bend.
    distance, offset, way : ndarray of float64, shape (R,)
        m along it, to the left, and of the steps.

    Returns
    -------
    ndarray of float64, shape (R,)
        m.
    """
    result = np.empty(len(distance))
    for i in range(len(distance)):
        result[i] = _advance(
            addresses[columns.DISTANCE],
            addresses[columns.REFERENCE],
            addresses[columns.CENTER],
            count,
            addresses[columns.BEND_AT],
            addresses[columns.BEND],
            known,
            addresses[columns.HEADING],
            distance[i],
            offset[i],
            way[i],
        )
    return result


@kernel(error_model="numpy", _nrt=False)
def _advance(distances, references, centers, count, bends_at, bends, known, headings, distance, offset, way):
    if math.isnan(distance + offset + way):
        return math.nan
    table, reference = floats_at(distances, count), floats_at(references, count)
    bend_at = floats_at(bends_at, known)
    j = _sample(table, count, distance)
    along = _between(table, reference, count, distance, j)
    left = _between(table, floats_at(centers, count), count, distance, j) + offset
    k = _last_within(bend_at, known, along, 0)
    shrunk = 1.0 - _between(bend_at, floats_at(bends, known), known, along, k) * left
    # Near the center of a bend, where the reference line does not lead on, the lane itself does.
    if shrunk < _SHRUNK:
        return min(max(distance + way, 0.0), table[count - 1])
    ahead = along + way / shrunk
    reached = _between(reference, table, count, ahead, _last_within(reference, count, ahead, max(j, 0)))
    return _over_ground(table, reference, floats_at(headings, count), count, distance, offset, way, reached)


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _over_ground(table, reference, heading, count, distance, offset, way, reached):
    """Distance after a step that led to `reached` along the reference line, where the way over ground is another."""
    if abs(_gone(table, heading, count, distance, offset, reached, math.inf)[1] - abs(way)) <= _EXACT * abs(way):
        return reached
    end = table[count - 1] if way > 0.0 else 0.0
    goal, _ = _gone(table, heading, count, distance, offset, end, abs(way))
    # Jumps from a lane or a piece of a road to the next take no time, as in esmini.
    return reached if _jumps(table, reference, count, min(distance, goal), max(goal, reached)) else goal


@kernel(error_model="numpy", _nrt=False)
def _gone(table, heading, count, begin, offset, end, most):
    """How far one beside a path gets from a distance towards another, at most so far over ground: where, and how far.

    Beside a corner it turns on the spot where the path bends by more than it lies aside: every cell of the path counts
    by how far it leads over ground there, backwards too.
    """
    gone, place = 0.0, begin
    sign = 1 if end > begin else -1
    cell = _cell(table, count, begin)
    while (end - place) * sign > 0.0:
        ahead = table[cell + 1] if sign > 0 else table[cell]
        if cell == (count - 2 if sign > 0 else 0) or (ahead - end) * sign > 0.0:
            ahead = end
        rate = abs(1.0 - (heading[cell + 1] - heading[cell]) / (table[cell + 1] - table[cell]) * offset)
        length = abs(ahead - place) * rate
        if gone + length >= most:
            return place + sign * (most - gone) / rate, most
        gone, place = gone + length, ahead
        cell = min(max(cell + sign, 0), count - 2)
    return place, gone


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _jumps(table, reference, count, first, last):
    """Whether a path jumps aside between two distances."""
    j, k = _cell(table, count, first), _cell(table, count, last)
    least = min(reference[j + 1] - reference[j], reference[k + 1] - reference[k])
    for cell in range(min(j, k) + 1, max(j, k)):  # noqa: SIM110 - what is compiled has no generators
        if reference[cell + 1] - reference[cell] < _JUMP * least:
            return True
    return False


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _cell(table, count, x):
    return min(max(_sample(table, count, x), 0), count - 2)


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def lane_place(tracks, g, distance):
    """Where on the roads a distance along a lane is.

    Parameters
    ----------
    tracks : Tracks
    g : int
        Row of the track.
    distance : float
        m.

    Returns
    -------
    road, lane : int
        Index of the road, and number of the lane.
    s : float
        Coordinate on the road in m.
    along : bool
        Whether the track runs along the road's s.
    """
    count, address = tracks.size[g], tracks.address[g]
    table = floats_at(address[columns.DISTANCE], count)
    reference = floats_at(address[columns.REFERENCE], count)
    j = _sample(table, count, distance)
    sample = max(j, 0)
    beyond = _between(table, reference, count, distance, j) - reference[sample]
    along = truths_at(address[columns.ALONG], count)[sample]
    s = floats_at(address[columns.S], count)[sample] + (beyond if along else -beyond)
    road, lane = integers_at(address[columns.ROAD], count)[sample], integers_at(address[columns.NUMBER], count)[sample]
    return road, lane, s, along


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def goes_over(tracks, g, distance):
    """Whether another track leads on from a distance along a lane.

    Parameters
    ----------
    tracks : Tracks
    g : int
        Row of the track.
    distance : float
        m.

    Returns
    -------
    bool
    """
    first, last = tracks.span[g, 0], tracks.span[g, 1]
    return (distance < first) | (distance > last)


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _mixed(values, k, part):
    return values[k] + part * (values[k + 1] - values[k])


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _sample(table, count, x):
    """Last element of an evenly spaced table that does not lie beyond x; -1 before its begin."""
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
    """Last element of an ascending table that does not lie beyond x, looked for from one on; -1 before its begin."""
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
    """Value at x as `numpy.interp` gives it, where j is the last of the places that does not lie beyond x."""
    if j < 0:
        return values[0]
    if j >= count - 1 or places[j] == x:
        return values[j]
    slope = (values[j + 1] - values[j]) / (places[j + 1] - places[j])
    return slope * (x - places[j]) + values[j]
