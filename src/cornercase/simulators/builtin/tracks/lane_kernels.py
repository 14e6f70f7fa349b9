"""Compiled twins of `LaneTrack` and `LanePath`, for one scenario at a time."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, call-arg, var-annotated"

from __future__ import annotations

import math

from cornercase._common.addresses import floats_at, integers_at, truths_at
from cornercase._common.compiling import kernel
from cornercase.roads import KINK
from cornercase.simulators.builtin.tracks import columns

SHRUNK = 0.1
"""Where a lane is shorter than this part of the reference line, an entity moves along the lane alone."""


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
        distance,
        offset,
        way,
    )


@kernel(error_model="numpy", _nrt=False)
def _advance(distances, references, centers, count, bends_at, bends, known, distance, offset, way):
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
    if shrunk < SHRUNK:
        return min(max(distance + way, 0.0), table[count - 1])
    ahead = along + way / shrunk
    return _between(reference, table, count, ahead, _last_within(reference, count, ahead, max(j, 0)))


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
