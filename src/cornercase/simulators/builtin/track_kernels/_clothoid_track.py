"""Kernels of `ClothoidSpline`, for one scenario at a time."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, call-arg, var-annotated"

from __future__ import annotations

import math

from cornercase._common.numba.kernel import kernel
from cornercase._common.numba.pointers import floats_at_address, ints_at_address
from cornercase.simulators.builtin.track_kernels import _track_layout as track_layout

_kernel = kernel(error_model="numpy", forceinline=True, _nrt=False)


@_kernel
def pose_on_spline(tracks, row, n, distance, offset):
    """Return x, y (m) and heading (rad) at a distance along a clothoid spline and an offset to the left, both in m."""
    length = spline_length(tracks, row, n)
    chord = floats_at_address(tracks.addresses[row, track_layout.CHORD], n + 1)[n]
    last = ints_at_address(tracks.addresses[row, track_layout.LAST_CHORD], n + 1)[n]
    clipped = min(max(distance, 0.0), length)
    # NaN maps to chord 0, and stays NaN in the result.
    position = clipped / chord
    k = min(int(position), last) if position >= 0.0 else 0
    before = chord * k
    span = min(before + chord, length) - before
    fraction = (clipped - before) / (span if span > 0.0 else 1.0)
    after = k + min(1, tracks.size[row] - 1)
    point_x = _interpolate(tracks, row, n, track_layout.X, k, after, fraction)
    point_y = _interpolate(tracks, row, n, track_layout.Y, k, after, fraction)
    heading = _interpolate(tracks, row, n, track_layout.HEADING, k, after, fraction)
    beyond = distance - clipped
    if beyond != 0.0 or offset != 0.0:
        cos, sin = math.cos(heading), math.sin(heading)
        point_x, point_y = point_x + beyond * cos - offset * sin, point_y + beyond * sin + offset * cos
    return point_x, point_y, heading


@_kernel
def spline_length(tracks, row, n):
    """Return the length of a clothoid spline in m in scenario `n`."""
    return floats_at_address(tracks.addresses[row, track_layout.LENGTH], n + 1)[n]


@_kernel
def spline_end_time(tracks, row, n):
    """Return the end time in s of a clothoid spline with times; it counts like these times, not like simulated time."""
    count = tracks.n_curvatures[row]
    return floats_at_address(tracks.addresses[row, track_layout.TIME] + 8 * count * n, count)[count - 1]


@_kernel
def spline_distance_at_time(tracks, row, n, time):
    """Return the distance in m along a clothoid spline at a time in s, which counts like the `times` of the spline."""
    count = tracks.n_curvatures[row]
    times = floats_at_address(tracks.addresses[row, track_layout.TIME] + 8 * count * n, count)
    table = floats_at_address(tracks.addresses[row, track_layout.DISTANCE] + 8 * count * n, count)
    k = 0
    while k + 2 < count and times[k + 1] <= time:
        k += 1
    begin, span = times[k], times[k + 1] - times[k]
    speed = (table[k + 1] - table[k]) / (span if times[k + 1] > times[k] else 1.0)
    return table[k] + min(max(time - begin, 0.0), span) * speed


@_kernel
def spline_time_and_speed(tracks, row, n, distance):
    """Return time and speed in m/s at a distance along a clothoid spline with times.

    The time in s counts like the `times` of the spline, not like the simulated time.
    """
    count = tracks.n_curvatures[row]
    times = floats_at_address(tracks.addresses[row, track_layout.TIME] + 8 * count * n, count)
    table = floats_at_address(tracks.addresses[row, track_layout.DISTANCE] + 8 * count * n, count)
    k = 0
    while k + 2 < count and table[k + 1] <= distance:
        k += 1
    length, span = table[k + 1] - table[k], times[k + 1] - times[k]
    fraction = (distance - table[k]) / (length if length > 0.0 else 1.0)
    return times[k] + fraction * span, length / (span if span > 0.0 else math.inf)


@_kernel
def _interpolate(tracks, row, n, column, k, after, fraction):
    count = tracks.size[row]
    values = floats_at_address(tracks.addresses[row, column] + (0 if tracks.is_uniform[row] else 8 * count * n), count)
    return values[k] + fraction * (values[after] - values[k])
