"""Kernels of `Polyline`, for one scenario at a time."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, call-arg, var-annotated"

from __future__ import annotations

import math

from cornercase._common.addresses import floats_at
from cornercase._common.compiling import kernel
from cornercase.simulators.builtin.tracks import columns
from cornercase.simulators.builtin.tracks.polyline import CORNER, TINY

_ALONG_LEGS, _AT_CORNERS = 0, 1

_kernel = kernel(error_model="numpy", forceinline=True, _nrt=False)


@_kernel
def place_on_line(tracks, g, n, distance, offset):
    """x, y (m) and heading (rad) at a distance along a polyline, and an offset to the left."""
    table = floats_at(_row(tracks, g, n, columns.DISTANCE), tracks.size[g])
    distance = _round(tracks, g, table, distance)
    clipped, segment, fraction = _leg(table, distance, 0.0)
    x = floats_at(_row(tracks, g, n, columns.X), tracks.size[g])
    y = floats_at(_row(tracks, g, n, columns.Y), tracks.size[g])
    point_x = x[segment] + fraction * (x[segment + 1] - x[segment])
    point_y = y[segment] + fraction * (y[segment + 1] - y[segment])
    beyond = distance - clipped
    if beyond != 0.0 or offset != 0.0:
        direction = floats_at(_legs(tracks, g, n), tracks.size[g] - 1)[segment]
        cos, sin = math.cos(direction), math.sin(direction)
        point_x, point_y = point_x + beyond * cos - offset * sin, point_y + beyond * sin + offset * cos
    return point_x, point_y, _heading(tracks, g, n, table, distance)


@_kernel
def line_length(tracks, g, n):
    """Length of a polyline in m, inf for a closed one."""
    count, closed = tracks.size[g], tracks.closed[g]
    length = floats_at(_row(tracks, g, n, columns.DISTANCE), count)[count - 1]
    return math.inf if closed else length


@_kernel
def direction_on(tracks, g, n, distance):
    """Direction of the polyline in rad, whatever the entity's heading is."""
    table = floats_at(_row(tracks, g, n, columns.DISTANCE), tracks.size[g])
    segment = _leg(table, _round(tracks, g, table, distance), TINY)[1]
    return floats_at(_legs(tracks, g, n), tracks.size[g] - 1)[segment]


@_kernel
def oriented_on(tracks, g, n, distance):
    """Whether the file gives the heading at a distance."""
    table, last = floats_at(_row(tracks, g, n, columns.DISTANCE), tracks.size[g]), tracks.size[g] - 1
    distance = _round(tracks, g, table, distance)
    # On a segment, the vertex at its beginning counts.
    vertex = last if distance > table[last] - TINY else _leg(table, distance, TINY)[1]
    return not math.isnan(floats_at(_row(tracks, g, n, columns.HEADING), tracks.size[g])[vertex])


@_kernel
def last_time(tracks, g, n):
    """Time in s at which a polyline with times ends, on its own clock."""
    return floats_at(_row(tracks, g, n, columns.TIME), tracks.size[g])[tracks.size[g] - 1]


@_kernel
def distance_at(tracks, g, n, time):
    """Distance in m along a polyline at a time in s of its own clock."""
    count = tracks.size[g]
    times = floats_at(_row(tracks, g, n, columns.TIME), count)
    table = floats_at(_row(tracks, g, n, columns.DISTANCE), count)
    last = count - 1
    if time > times[last]:
        return table[last]
    segment = _leg_begun(times, time, 0.0)
    elapsed = max(time - times[segment], 0.0)
    speed = floats_at(_row(tracks, g, n, columns.SPEED), count)[segment]
    rate = floats_at(_row(tracks, g, n, columns.RATE), count)[segment]
    begin = table[segment]
    if rate == 0.0:
        span = times[segment + 1] - times[segment]
        fraction = min(elapsed / span, 1.0) if span > 0.0 else 0.0
        return begin + fraction * (table[segment + 1] - begin)
    # An entity that brakes to a stop waits there for the rest of the segment's time.
    if rate < 0.0:
        elapsed = min(elapsed, -speed / rate)
    return begin + speed * elapsed + 0.5 * rate * (elapsed * elapsed)


@_kernel
def _row(tracks, g, n, column):
    count = tracks.size[g]
    return tracks.address[g, column] + (0 if tracks.alike[g] else 8 * count * n)


@_kernel
def _legs(tracks, g, n):
    count = tracks.size[g] - 1
    return tracks.address[g, columns.DIRECTION] + (0 if tracks.alike[g] else 8 * count * n)


@_kernel
def _round(tracks, g, table, distance):
    """Distance within one lap of a closed polyline, as `numpy.mod` computes it."""
    return distance % table[table.size - 1] if tracks.closed[g] else distance


@_kernel
def _leg_begun(table, place, beyond):
    """Last segment that begins `tolerance` before `value`; at least the first one."""
    low, high = 0, table.size - 1
    while high - low > 1:
        middle = (low + high) // 2
        if table[middle] + beyond <= place:
            low = middle
        else:
            high = middle
    return low


@_kernel
def _leg(table, distance, beyond):
    """Distance clipped to the line, its segment, and the fraction of the segment."""
    clipped = max(distance, 0.0)
    clipped = min(clipped, table[table.size - 1])
    segment = _leg_begun(table, clipped, beyond)
    span = table[segment + 1] - table[segment]
    return clipped, segment, (clipped - table[segment]) / span if span > 0.0 else 0.0


@_kernel
def _heading(tracks, g, n, table, distance):
    clipped, segment, fraction = _leg(table, distance, TINY)
    vertex_headings, last = floats_at(_row(tracks, g, n, columns.FACING), tracks.size[g]), tracks.size[g] - 2
    current, after = vertex_headings[segment], vertex_headings[segment + 1]
    at_end = clipped > table[last + 1] - TINY
    if tracks.turning[g] == _ALONG_LEGS:
        return current + (1.0 if at_end else fraction) * (after - current)
    if at_end:
        return after
    if tracks.turning[g] != _AT_CORNERS:
        return current
    span = table[segment + 1] - table[segment]
    reach = max(min(CORNER, 0.5 * span), TINY)
    since_start = clipped - table[segment]
    until_end = span - since_start
    if since_start < reach:
        return (
            vertex_headings[segment - 1] + 0.5 * (1.0 + since_start / reach) * (current - vertex_headings[segment - 1])
            if segment > 0
            else current
        )
    if until_end < reach:
        # The last segment turns fully to its end heading, any other halfway.
        return current + (0.5 * (1.0 - until_end / reach) if segment < last else 1.0 - until_end / reach) * (
            after - current
        )
    return current
