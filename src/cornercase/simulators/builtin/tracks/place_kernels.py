"""Where a distance along a track of any kind that kernels know is, for one scenario at a time."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

from cornercase._common.compiling import kernel
from cornercase.simulators.builtin.tracks import chord_kernels, line_kernels, pool
from cornercase.simulators.builtin.tracks.lane_kernels import place_on_lane

_kernel = kernel(error_model="numpy", forceinline=True, _nrt=False)


@_kernel
def place_on(tracks, g, n, distance, offset):
    """Place at a distance along a track of a kind that kernels know.

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
    if tracks.kind[g] == pool.LANE:
        return place_on_lane(tracks, g, distance, offset)
    if tracks.kind[g] == pool.LINE:
        return line_kernels.place_on_line(tracks, g, n, distance, offset)
    return chord_kernels.place_on_chords(tracks, g, n, distance, offset)


@_kernel
def trajectory_length(tracks, g, n):
    """Length of a line or spline in m, infinite for a closed one.

    Parameters
    ----------
    tracks : Tracks
    g, n : int
        Row of the track, and scenario.

    Returns
    -------
    float
    """
    if tracks.kind[g] == pool.LINE:
        return line_kernels.line_length(tracks, g, n)
    return chord_kernels.chords_length(tracks, g, n)


@_kernel
def trajectory_direction(tracks, g, n, distance):
    """Direction of a line or spline itself, whatever heading an entity has there, in rad.

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
    if tracks.kind[g] == pool.LINE:
        return line_kernels.direction_on(tracks, g, n, distance)
    return chord_kernels.place_on_chords(tracks, g, n, distance, 0.0)[2]


@_kernel
def trajectory_oriented(tracks, g, n, distance):
    """Whether the file says which heading an entity has on a line or spline at a distance; on a spline it never does.

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
    return tracks.kind[g] == pool.LINE and line_kernels.oriented_on(tracks, g, n, distance)


@_kernel
def trajectory_end(tracks, g, n):
    """Time at which a line or spline with a clock ends, on that clock, in s.

    Parameters
    ----------
    tracks : Tracks
    g, n : int
        Row of the track, and scenario.

    Returns
    -------
    float
    """
    if tracks.kind[g] == pool.LINE:
        return line_kernels.last_time(tracks, g, n)
    return chord_kernels.chords_last_time(tracks, g, n)


@_kernel
def trajectory_distance_at(tracks, g, n, time):
    """Distance along a line or spline with a clock, at a time of that clock.

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
    if tracks.kind[g] == pool.LINE:
        return line_kernels.distance_at(tracks, g, n, time)
    return chord_kernels.distance_on_chords_at(tracks, g, n, time)
