"""Functions for tracks of any type (lane, polyline or clothoid spline), in one scenario or in many."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math

import numpy as np

from cornercase._common.numba.kernel import kernel
from cornercase.simulators.builtin.track_kernels import _clothoid_track as clothoid_track
from cornercase.simulators.builtin.track_kernels import _polyline_track as polyline_track
from cornercase.simulators.builtin.track_kernels import _track_layout as track_layout
from cornercase.simulators.builtin.track_kernels._lane_track import pose_on_lane, road_position_on_lane

_kernel = kernel(error_model="numpy", forceinline=True, _nrt=False)


@_kernel
def pose_on_track(tracks, row, n, distance, offset):
    """Return x, y (m) and heading (rad) at a distance along a track and an offset to the left, both in m."""
    if tracks.kind[row] == track_layout.LANE_TRACK:
        return pose_on_lane(tracks, row, distance, offset)
    if tracks.kind[row] == track_layout.POLYLINE_TRACK:
        return polyline_track.pose_on_polyline(tracks, row, n, distance, offset)
    return clothoid_track.pose_on_spline(tracks, row, n, distance, offset)


@_kernel
def trajectory_length(tracks, row, n):
    """Return the length of a trajectory in m; infinite for a closed trajectory."""
    if tracks.kind[row] == track_layout.POLYLINE_TRACK:
        return polyline_track.polyline_length(tracks, row, n)
    return clothoid_track.spline_length(tracks, row, n)


@_kernel
def trajectory_direction(tracks, row, n, distance):
    """Return the direction of a trajectory in rad at a distance; the heading of an entity there may differ."""
    if tracks.kind[row] == track_layout.POLYLINE_TRACK:
        return polyline_track.polyline_direction(tracks, row, n, distance)
    return clothoid_track.pose_on_spline(tracks, row, n, distance, 0.0)[2]


@_kernel
def trajectory_has_heading(tracks, row, n, distance):
    """Return whether the scenario file defines the heading at a distance along a trajectory; False for splines."""
    return tracks.kind[row] == track_layout.POLYLINE_TRACK and polyline_track.polyline_heading_is_given(
        tracks, row, n, distance
    )


@_kernel
def trajectory_end_time(tracks, row, n):
    """Return the end time in s of a trajectory with times; it counts like these times, not like simulated time."""
    if tracks.kind[row] == track_layout.POLYLINE_TRACK:
        return polyline_track.polyline_end_time(tracks, row, n)
    return clothoid_track.spline_end_time(tracks, row, n)


@_kernel
def trajectory_distance_at_time(tracks, row, n, time):
    """Return the distance in m along a trajectory at a time in s, which counts like the `times` of the trajectory."""
    if tracks.kind[row] == track_layout.POLYLINE_TRACK:
        return polyline_track.polyline_distance_at_time(tracks, row, n, time)
    return clothoid_track.spline_distance_at_time(tracks, row, n, time)


@_kernel
def trajectory_time_and_speed(tracks, row, n, distance):
    """Return time and speed in m/s at a distance along a trajectory with times.

    The time in s counts like the `times` of the trajectory, not like the simulated time.
    """
    if tracks.kind[row] == track_layout.POLYLINE_TRACK:
        return polyline_track.polyline_time_and_speed(tracks, row, n, distance)
    return clothoid_track.spline_time_and_speed(tracks, row, n, distance)


@kernel(interpreted_seconds=lambda tracks, scenarios, points: 5e-5 * scenarios.size, error_model="numpy")
def evaluate_track(tracks, scenarios, points):
    """Evaluate the only track in a table at R points.

    `scenarios` (R,) has the scenario of each point, `points` (2, R) the distance along the track and the offset to its
    left, in m. Returns an array (8, R): x, y, heading, direction of the track, whether the file defines the heading,
    time (counted like the `times` of the track), speed, and s. Time and speed are NaN for a track without times; s is
    NaN unless the track is a lane.
    """
    result = np.empty((8, scenarios.size))
    for i in range(scenarios.size):
        n, distance = scenarios[i], points[0, i]
        x, y, heading = pose_on_track(tracks, 0, n, distance, points[1, i])
        direction, has_heading, time, speed, s = heading, False, math.nan, math.nan, math.nan
        if tracks.kind[0] == track_layout.LANE_TRACK:
            s = road_position_on_lane(tracks, 0, distance)[2]
        else:
            direction = trajectory_direction(tracks, 0, n, distance)
            has_heading = trajectory_has_heading(tracks, 0, n, distance)
        if tracks.has_times[0]:
            time, speed = trajectory_time_and_speed(tracks, 0, n, distance)
        result[0, i], result[1, i], result[2, i], result[3, i] = x, y, heading, direction
        result[4, i], result[5, i], result[6, i], result[7, i] = has_heading, time, speed, s
    return result
