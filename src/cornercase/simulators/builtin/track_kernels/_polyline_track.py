"""Kernels of `Polyline`, for one scenario at a time."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, call-arg, var-annotated"

from __future__ import annotations

import math

from cornercase._common.numba.kernel import kernel
from cornercase._common.numba.pointers import floats_at_address
from cornercase.simulators.builtin.track_kernels import _track_layout as track_layout
from cornercase.simulators.builtin.track_kernels._track_layout import (
    ALONG_SEGMENTS,
    AT_CORNERS,
    CORNER_HALF_LENGTH,
    VERTEX_TOLERANCE,
)

_kernel = kernel(error_model="numpy", forceinline=True, _nrt=False)


@_kernel
def pose_on_polyline(tracks, row, n, distance, offset):
    """Return x, y (m) and heading (rad) at a distance along a polyline and an offset to the left, both in m."""
    table = floats_at_address(_vertex_array_address(tracks, row, n, track_layout.DISTANCE), tracks.size[row])
    distance = _wrap_distance_if_closed(tracks, row, table, distance)
    clipped, segment, fraction = _locate_on_segment(table, distance, 0.0)
    x = floats_at_address(_vertex_array_address(tracks, row, n, track_layout.X), tracks.size[row])
    y = floats_at_address(_vertex_array_address(tracks, row, n, track_layout.Y), tracks.size[row])
    point_x = x[segment] + fraction * (x[segment + 1] - x[segment])
    point_y = y[segment] + fraction * (y[segment + 1] - y[segment])
    beyond = distance - clipped
    if beyond != 0.0 or offset != 0.0:
        direction = floats_at_address(_direction_array_address(tracks, row, n), tracks.size[row] - 1)[segment]
        cos, sin = math.cos(direction), math.sin(direction)
        point_x, point_y = point_x + beyond * cos - offset * sin, point_y + beyond * sin + offset * cos
    return point_x, point_y, _heading_on_polyline(tracks, row, n, table, distance)


@_kernel
def polyline_length(tracks, row, n):
    """Return the length of a polyline in m; infinite for a closed polyline."""
    count, closed = tracks.size[row], tracks.is_closed[row]
    length = floats_at_address(_vertex_array_address(tracks, row, n, track_layout.DISTANCE), count)[count - 1]
    return math.inf if closed else length


@_kernel
def polyline_direction(tracks, row, n, distance):
    """Return the direction of a polyline in rad at a distance; the heading of an entity there may differ."""
    table = floats_at_address(_vertex_array_address(tracks, row, n, track_layout.DISTANCE), tracks.size[row])
    segment = _locate_on_segment(table, _wrap_distance_if_closed(tracks, row, table, distance), VERTEX_TOLERANCE)[1]
    return floats_at_address(_direction_array_address(tracks, row, n), tracks.size[row] - 1)[segment]


@_kernel
def polyline_heading_is_given(tracks, row, n, distance):
    """Return whether the scenario file defines the heading at a distance along a polyline."""
    last = tracks.size[row] - 1
    table = floats_at_address(_vertex_array_address(tracks, row, n, track_layout.DISTANCE), last + 1)
    distance = _wrap_distance_if_closed(tracks, row, table, distance)
    # On a segment, the vertex at its beginning counts.
    vertex = (
        last if distance > table[last] - VERTEX_TOLERANCE else _locate_on_segment(table, distance, VERTEX_TOLERANCE)[1]
    )
    return not math.isnan(
        floats_at_address(_vertex_array_address(tracks, row, n, track_layout.HEADING), tracks.size[row])[vertex]
    )


@_kernel
def polyline_end_time(tracks, row, n):
    """Return the end time in s of a polyline with times; it counts like these times, not like simulated time."""
    count = tracks.size[row]
    return floats_at_address(_vertex_array_address(tracks, row, n, track_layout.TIME), count)[count - 1]


@_kernel
def polyline_distance_at_time(tracks, row, n, time):
    """Return the distance in m along a polyline at a time in s, which counts like the `times` of the polyline."""
    count = tracks.size[row]
    times = floats_at_address(_vertex_array_address(tracks, row, n, track_layout.TIME), count)
    table = floats_at_address(_vertex_array_address(tracks, row, n, track_layout.DISTANCE), count)
    last = count - 1
    if time > times[last]:
        return table[last]
    segment = _find_segment(times, time, 0.0)
    elapsed = max(time - times[segment], 0.0)
    speed = floats_at_address(_vertex_array_address(tracks, row, n, track_layout.SPEED), count)[segment]
    rate = floats_at_address(_vertex_array_address(tracks, row, n, track_layout.SEGMENT_ACCELERATION), count)[segment]
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
def polyline_time_and_speed(tracks, row, n, distance):
    """Return time and speed in m/s at a distance along a polyline with times.

    The time in s counts like the `times` of the polyline, not like the simulated time.
    """
    count = tracks.size[row]
    table = floats_at_address(_vertex_array_address(tracks, row, n, track_layout.DISTANCE), count)
    times = floats_at_address(_vertex_array_address(tracks, row, n, track_layout.TIME), count)
    speeds = floats_at_address(_vertex_array_address(tracks, row, n, track_layout.SPEED), count)
    _, segment, fraction = _locate_on_segment(table, distance, VERTEX_TOLERANCE)
    time, speed = times[segment], speeds[segment]
    return time + fraction * (times[segment + 1] - time), speed + fraction * (speeds[segment + 1] - speed)


@_kernel
def _vertex_array_address(tracks, row, n, column):
    count = tracks.size[row]
    return tracks.addresses[row, column] + (0 if tracks.is_uniform[row] else 8 * count * n)


@_kernel
def _direction_array_address(tracks, row, n):
    count = tracks.size[row] - 1
    return tracks.addresses[row, track_layout.DIRECTION] + (0 if tracks.is_uniform[row] else 8 * count * n)


@_kernel
def _wrap_distance_if_closed(tracks, row, table, distance):
    """Return the distance within one lap if the polyline is closed, rounded as by `numpy.mod`; otherwise unchanged."""
    return distance % table[table.size - 1] if tracks.is_closed[row] else distance


@_kernel
def _find_segment(table, value, tolerance):
    """Return the index of the last segment that begins at least `tolerance` before `value`; 0 if there is none."""
    low, high = 0, table.size - 1
    while high - low > 1:
        middle = (low + high) // 2
        if table[middle] + tolerance <= value:
            low = middle
        else:
            high = middle
    return low


@_kernel
def _locate_on_segment(table, distance, tolerance):
    """Return the distance clipped to the length of the line, the index of the segment there, and a fraction.

    The fraction is the part of the segment that lies before the distance, from 0 to 1.
    """
    clipped = max(distance, 0.0)
    clipped = min(clipped, table[table.size - 1])
    segment = _find_segment(table, clipped, tolerance)
    span = table[segment + 1] - table[segment]
    return clipped, segment, (clipped - table[segment]) / span if span > 0.0 else 0.0


@_kernel
def _heading_on_polyline(tracks, row, n, table, distance):
    clipped, segment, fraction = _locate_on_segment(table, distance, VERTEX_TOLERANCE)
    last = tracks.size[row] - 2
    vertex_headings = floats_at_address(_vertex_array_address(tracks, row, n, track_layout.VERTEX_HEADING), last + 2)
    current, after = vertex_headings[segment], vertex_headings[segment + 1]
    at_end = clipped > table[last + 1] - VERTEX_TOLERANCE
    if tracks.heading_interpolation[row] == ALONG_SEGMENTS:
        return current + (1.0 if at_end else fraction) * (after - current)
    if at_end:
        return after
    if tracks.heading_interpolation[row] != AT_CORNERS:
        return current
    span = table[segment + 1] - table[segment]
    reach = max(min(CORNER_HALF_LENGTH, 0.5 * span), VERTEX_TOLERANCE)
    since_start = clipped - table[segment]
    until_end = span - since_start
    if since_start < reach:
        return (
            vertex_headings[segment - 1] + 0.5 * (1.0 + since_start / reach) * (current - vertex_headings[segment - 1])
            if segment > 0
            else current
        )
    if until_end < reach:
        # On the last segment the heading turns fully to the end heading, on any other segment halfway.
        return current + (0.5 * (1.0 - until_end / reach) if segment < last else 1.0 - until_end / reach) * (
            after - current
        )
    return current
