"""Compiled twins of `Polyline`, for one scenario at a time."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, call-arg, var-annotated"

from __future__ import annotations

import math

from cornercase._common.addresses import floats_at
from cornercase._common.compiling import kernel
from cornercase.simulators.builtin.tracks import columns
from cornercase.simulators.builtin.tracks.polyline import CORNER, TINY

_ALONG_LEGS, _AT_CORNERS = 0, 1


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def place_on_line(tracks, g, n, distance, offset):
    """Place at a distance along a line.

    Parameters
    ----------
    tracks : Tracks
    g, n : int
        Row of the track, and scenario.
    distance, offset : float
        m along it, and to the left.

    Returns
    -------
    x, y, heading : float
        m, m, rad.
    """
    table = floats_at(_row(tracks, g, n, columns.DISTANCE), tracks.size[g])
    distance = _round(tracks, g, table, distance)
    along, leg, part = _leg(table, distance, 0.0)
    x = floats_at(_row(tracks, g, n, columns.X), tracks.size[g])
    y = floats_at(_row(tracks, g, n, columns.Y), tracks.size[g])
    at_x = x[leg] + part * (x[leg + 1] - x[leg])
    at_y = y[leg] + part * (y[leg + 1] - y[leg])
    beyond = distance - along
    if beyond != 0.0 or offset != 0.0:
        direction = floats_at(_legs(tracks, g, n), tracks.size[g] - 1)[leg]
        cos, sin = math.cos(direction), math.sin(direction)
        at_x, at_y = at_x + beyond * cos - offset * sin, at_y + beyond * sin + offset * cos
    return at_x, at_y, _heading(tracks, g, n, table, distance)


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def line_length(tracks, g, n):
    """Length of a line in m, infinite for a closed one.

    Parameters
    ----------
    tracks : Tracks
    g, n : int
        Row of the track, and scenario.

    Returns
    -------
    float
    """
    count, closed = tracks.size[g], tracks.closed[g]
    length = floats_at(_row(tracks, g, n, columns.DISTANCE), count)[count - 1]
    return math.inf if closed else length


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def direction_on(tracks, g, n, distance):
    """Direction of the line itself, whatever heading an entity has there, in rad.

    Parameters
    ----------
    tracks : Tracks
    g, n : int
        Row of the track, and scenario.
    distance : float
        m.

    Returns
    -------
    float
    """
    table = floats_at(_row(tracks, g, n, columns.DISTANCE), tracks.size[g])
    leg = _leg(table, _round(tracks, g, table, distance), TINY)[1]
    return floats_at(_legs(tracks, g, n), tracks.size[g] - 1)[leg]


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def oriented_on(tracks, g, n, distance):
    """Whether the file says which heading an entity has on a line at a distance.

    Parameters
    ----------
    tracks : Tracks
    g, n : int
        Row of the track, and scenario.
    distance : float
        m.

    Returns
    -------
    bool
    """
    table, last = floats_at(_row(tracks, g, n, columns.DISTANCE), tracks.size[g]), tracks.size[g] - 1
    distance = _round(tracks, g, table, distance)
    # On a leg the vertex at its beginning counts.
    vertex = last if distance > table[last] - TINY else _leg(table, distance, TINY)[1]
    return not math.isnan(floats_at(_row(tracks, g, n, columns.HEADING), tracks.size[g])[vertex])


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def has_clock(tracks, g):
    """Whether a line has times.

    Parameters
    ----------
    tracks : Tracks
    g : int
        Row of the track.

    Returns
    -------
    bool
    """
    return tracks.timed[g]


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def last_time(tracks, g, n):
    """Time at which a line with a clock ends, on that clock, in s.

    Parameters
    ----------
    tracks : Tracks
    g, n : int
        Row of the track, and scenario.

    Returns
    -------
    float
    """
    return floats_at(_row(tracks, g, n, columns.TIME), tracks.size[g])[tracks.size[g] - 1]


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def distance_at(tracks, g, n, time):
    """Distance along a line with a clock, at a time of that clock.

    Parameters
    ----------
    tracks : Tracks
    g, n : int
        Row of the track, and scenario.
    time : float
        s.

    Returns
    -------
    float
        m.
    """
    count = tracks.size[g]
    clock = floats_at(_row(tracks, g, n, columns.TIME), count)
    table = floats_at(_row(tracks, g, n, columns.DISTANCE), count)
    last = count - 1
    if time > clock[last]:
        return table[last]
    leg = _leg_begun(clock, time, 0.0)
    elapsed = max(time - clock[leg], 0.0)
    speed = floats_at(_row(tracks, g, n, columns.SPEED), count)[leg]
    rate = floats_at(_row(tracks, g, n, columns.RATE), count)[leg]
    begin = table[leg]
    if rate == 0.0:
        span = clock[leg + 1] - clock[leg]
        share = min(elapsed / span, 1.0) if span > 0.0 else 0.0
        return begin + share * (table[leg + 1] - begin)
    # Who brakes to a stop waits there for the rest of the leg's time.
    if rate < 0.0:
        elapsed = min(elapsed, -speed / rate)
    return begin + speed * elapsed + 0.5 * rate * (elapsed * elapsed)


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _row(tracks, g, n, column):
    """What a column holds of the vertices in a scenario."""
    count = tracks.size[g]
    return tracks.address[g, column] + (0 if tracks.alike[g] else 8 * count * n)


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _legs(tracks, g, n):
    """Directions of the legs in a scenario."""
    count = tracks.size[g] - 1
    return tracks.address[g, columns.DIRECTION] + (0 if tracks.alike[g] else 8 * count * n)


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _round(tracks, g, table, distance):
    """Distance within one round of a closed line, as `numpy.mod` gives it."""
    return distance % table[table.size - 1] if tracks.closed[g] else distance


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _leg_begun(table, place, beyond):
    """Last leg that begins `beyond` its vertex before a place; the first one begins everywhere."""
    low, high = 0, table.size - 1
    while high - low > 1:
        middle = (low + high) // 2
        if table[middle] + beyond <= place:
            low = middle
        else:
            high = middle
    return low


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _leg(table, distance, beyond):
    """Distance within the line, the leg there, and how much of it is gone; one begins `beyond` its vertex."""
    along = max(distance, 0.0)
    along = min(along, table[table.size - 1])
    leg = _leg_begun(table, along, beyond)
    span = table[leg + 1] - table[leg]
    return along, leg, (along - table[leg]) / span if span > 0.0 else 0.0


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _heading(tracks, g, n, table, distance):
    along, leg, part = _leg(table, distance, TINY)
    facing, last = floats_at(_row(tracks, g, n, columns.FACING), tracks.size[g]), tracks.size[g] - 2
    now, after = facing[leg], facing[leg + 1]
    at_end = along > table[last + 1] - TINY
    if tracks.turning[g] == _ALONG_LEGS:
        return now + (1.0 if at_end else part) * (after - now)
    if at_end:
        return after
    if tracks.turning[g] != _AT_CORNERS:
        return now
    span = table[leg + 1] - table[leg]
    reach = max(min(CORNER, 0.5 * span), TINY)
    gone = along - table[leg]
    left = span - gone
    if gone < reach:
        return facing[leg - 1] + 0.5 * (1.0 + gone / reach) * (now - facing[leg - 1]) if leg > 0 else now
    if left < reach:
        # The last leg turns wholly to the heading of its end, any other halfway.
        return now + (0.5 * (1.0 - left / reach) if leg < last else 1.0 - left / reach) * (after - now)
    return now
