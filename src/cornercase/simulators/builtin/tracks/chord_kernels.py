"""Compiled twins of `ClothoidSpline`, for one scenario at a time."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, call-arg, var-annotated"

from __future__ import annotations

import math

from cornercase._common.addresses import floats_at, integers_at
from cornercase._common.compiling import kernel
from cornercase.simulators.builtin.tracks import columns

_kernel = kernel(error_model="numpy", forceinline=True, _nrt=False)


@_kernel
def place_on_chords(tracks, g, n, distance, offset):
    """Place at a distance along a spline.

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
    length, chord = chords_length(tracks, g, n), floats_at(tracks.address[g, columns.CHORD], n + 1)[n]
    last = integers_at(tracks.address[g, columns.LAST], n + 1)[n]
    along = min(max(distance, 0.0), length)
    # What is no number is nowhere.
    place = along / chord
    k = min(int(place), last) if place >= 0.0 else 0
    before = chord * k
    span = min(before + chord, length) - before
    part = (along - before) / (span if span > 0.0 else 1.0)
    after = k + min(1, tracks.size[g] - 1)
    at_x, at_y = _mixed(tracks, g, n, columns.X, k, after, part), _mixed(tracks, g, n, columns.Y, k, after, part)
    heading = _mixed(tracks, g, n, columns.HEADING, k, after, part)
    beyond = distance - along
    if beyond != 0.0 or offset != 0.0:
        cos, sin = math.cos(heading), math.sin(heading)
        at_x, at_y = at_x + beyond * cos - offset * sin, at_y + beyond * sin + offset * cos
    return at_x, at_y, heading


@_kernel
def chords_length(tracks, g, n):
    """Length of a spline in m.

    Parameters
    ----------
    tracks : Tracks
    g, n : int
        Row of the track, and scenario.

    Returns
    -------
    float
    """
    return floats_at(tracks.address[g, columns.LENGTH], n + 1)[n]


@_kernel
def chords_last_time(tracks, g, n):
    """Time at which a spline with a clock ends, on that clock, in s.

    Parameters
    ----------
    tracks : Tracks
    g, n : int
        Row of the track, and scenario.

    Returns
    -------
    float
    """
    count = tracks.bends[g]
    return floats_at(tracks.address[g, columns.TIME] + 8 * count * n, count)[count - 1]


@_kernel
def distance_on_chords_at(tracks, g, n, time):
    """Distance along a spline with a clock, at a time of that clock.

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
    count = tracks.bends[g]
    clock = floats_at(tracks.address[g, columns.TIME] + 8 * count * n, count)
    table = floats_at(tracks.address[g, columns.DISTANCE] + 8 * count * n, count)
    k = 0
    while k + 2 < count and clock[k + 1] <= time:
        k += 1
    begin, span = clock[k], clock[k + 1] - clock[k]
    speed = (table[k + 1] - table[k]) / (span if clock[k + 1] > clock[k] else 1.0)
    return table[k] + min(max(time - begin, 0.0), span) * speed


@_kernel
def _mixed(tracks, g, n, column, k, after, part):
    count = tracks.size[g]
    values = floats_at(tracks.address[g, column] + (0 if tracks.alike[g] else 8 * count * n), count)
    return values[k] + part * (values[after] - values[k])
