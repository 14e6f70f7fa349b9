"""Poses on tracks of any compiled kind, for one scenario at a time."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

from cornercase._common.compiling import kernel
from cornercase.simulators.builtin.tracks import chord_kernels, line_kernels, pool
from cornercase.simulators.builtin.tracks.lane_kernels import place_on_lane

_kernel = kernel(error_model="numpy", forceinline=True, _nrt=False)


@_kernel
def place_on(tracks, g, n, distance, offset):
    """x, y (m) and heading (rad) at a distance along track row `row`, and an offset to the left."""
    if tracks.kind[g] == pool.LANE:
        return place_on_lane(tracks, g, distance, offset)
    if tracks.kind[g] == pool.LINE:
        return line_kernels.place_on_line(tracks, g, n, distance, offset)
    return chord_kernels.place_on_chords(tracks, g, n, distance, offset)


@_kernel
def trajectory_length(tracks, g, n):
    """Length of a trajectory in m, inf for a closed one."""
    if tracks.kind[g] == pool.LINE:
        return line_kernels.line_length(tracks, g, n)
    return chord_kernels.chords_length(tracks, g, n)


@_kernel
def trajectory_direction(tracks, g, n, distance):
    """Direction of a trajectory in rad, whatever the entity's heading is."""
    if tracks.kind[g] == pool.LINE:
        return line_kernels.direction_on(tracks, g, n, distance)
    return chord_kernels.place_on_chords(tracks, g, n, distance, 0.0)[2]


@_kernel
def trajectory_oriented(tracks, g, n, distance):
    """Whether the file gives the heading at a distance; never on a spline."""
    return tracks.kind[g] == pool.LINE and line_kernels.oriented_on(tracks, g, n, distance)


@_kernel
def trajectory_end(tracks, g, n):
    """Time in s at which a trajectory with times ends, on its own clock."""
    if tracks.kind[g] == pool.LINE:
        return line_kernels.last_time(tracks, g, n)
    return chord_kernels.chords_last_time(tracks, g, n)


@_kernel
def trajectory_distance_at(tracks, g, n, time):
    """Distance in m along a trajectory at a time in s of its own clock."""
    if tracks.kind[g] == pool.LINE:
        return line_kernels.distance_at(tracks, g, n, time)
    return chord_kernels.distance_on_chords_at(tracks, g, n, time)
