"""Compiled time step of an entity whose driver steers it along a lane."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, call-arg, var-annotated"

from __future__ import annotations

import math

from cornercase._common.numba.angles import wrap_angle
from cornercase._common.numba.kernel import kernel
from cornercase._common.numba.pointers import floats_at_address
from cornercase.drivers._steered_vehicle import move_along_path
from cornercase.simulators.builtin.track_kernels import _track_layout as track_layout
from cornercase.simulators.builtin.track_kernels._lane_track import pose_on_lane
from cornercase.simulators.builtin.world._state_layout import (
    ACCELERATION,
    DISTANCE,
    FROM_HEADING,
    FROM_X,
    FROM_Y,
    HEADING,
    JUMPED,
    MOVED,
    OFFSET,
    SPEED,
    STEERED,
    TRACK,
    TURN,
    X,
    Y,
)

_inlined_kernel = kernel(error_model="numpy", _nrt=False, forceinline=True)


@kernel(error_model="numpy", _nrt=False)
def steer_along_lane(scene, tracks, fleet, n, driver, e, request, dt, motion):
    """Move an entity that a driver steers along a lane by one time step of `dt` s, in one scenario.

    In Python, `VehicleMover` and `move_to_pose` do the same for all scenarios of a batch. `request` is the acceleration
    in m/s² that the driver chooses; `motion` (5,) is a buffer. Returns whether the entity may have left its lane.
    """
    state, flags = scene.floats[n], scene.flags[n]
    track = scene.integers[n, TRACK, e]
    lane = tracks.rows[e, track]
    # An action may have moved the entity in this step already.
    motion[0] = state[X, e] if flags[JUMPED, e] else state[FROM_X, e]
    motion[1] = state[Y, e] if flags[JUMPED, e] else state[FROM_Y, e]
    motion[2] = state[HEADING, e] if flags[JUMPED, e] else state[FROM_HEADING, e]
    motion[3], motion[4] = state[SPEED, e], state[ACCELERATION, e]
    count, addresses = tracks.size[lane], tracks.addresses[lane]
    path = (
        floats_at_address(addresses[track_layout.DISTANCE], count),
        floats_at_address(addresses[track_layout.X], count),
        floats_at_address(addresses[track_layout.Y], count),
        floats_at_address(addresses[track_layout.HEADING], count),
        tracks.max_sample_gap[lane],
    )
    curvature = floats_at_address(addresses[track_layout.CURVATURE], count)
    along = move_along_path(fleet, driver, n, path, curvature, state[DISTANCE, e], motion, request, dt)
    state[SPEED, e] = motion[3]
    state[X, e], state[Y, e], state[HEADING, e] = motion[0], motion[1], motion[2]
    flags[MOVED, e] = flags[STEERED, e] = True
    distance = min(max(along, 0.0), tracks.length[lane])
    x, y, heading = pose_on_lane(tracks, lane, distance, 0.0)
    state[DISTANCE, e], state[TURN, e] = distance, wrap_angle(motion[2] - heading)
    state[OFFSET, e] = (motion[1] - y) * math.cos(heading) - (motion[0] - x) * math.sin(heading)
    if state[X, e] == state[FROM_X, e] and state[Y, e] == state[FROM_Y, e]:
        return False
    return _may_have_left_lane(tracks, lane, fleet.half_widths[driver, track], distance, state[OFFSET, e])


@_inlined_kernel
def _may_have_left_lane(tracks, lane, half_widths, distance, offset):
    """Return whether an entity may be beyond the edge of its lane; True if the width of the lane is not known.

    `half_widths` is the memory address of half the width at each sample of the lane, or 0.
    """
    if half_widths == 0:
        return True
    count = tracks.size[lane]
    widths = floats_at_address(half_widths, count)
    k = min(int(distance / floats_at_address(tracks.addresses[lane, track_layout.DISTANCE], count)[1]), count - 2)
    return abs(offset) > min(widths[k], widths[k + 1])
