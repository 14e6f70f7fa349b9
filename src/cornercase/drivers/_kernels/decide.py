"""Compiled decision of a driver in a scenario."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, no-untyped-call, untyped-decorator"

from __future__ import annotations

import math

import numpy as np

from cornercase._common.numba.kernel import kernel
from cornercase.drivers._kernels.follow import follow_with_idm
from cornercase.drivers._kernels.idm_and_yield import plan_acceleration
from cornercase.drivers._kernels.lookahead import MAX_SAMPLES
from cornercase.drivers._kernels.predict import TURN_LEGS
from cornercase.drivers._kernels.structs import (
    BEHAVIOUR,
    SIMPLE,
    DrivenState,
    DriverScene,
    Workspace,
    inline_kernel,
    plain_kernel,
)
from cornercase.drivers._kernels.visibility import eye_pose, update_perception, update_visible_others
from cornercase.drivers._presets import Behaviour, FollowParameters


@inline_kernel
def compute_acceleration(fleet, driver, scenario, route, time, time_step, driven, others, buffers):
    """Return the acceleration in m/s² that a driver chooses in one scenario, and update the driver's memory.

    `driver` is the row of a compiled driver; `route` comes from `find_route_row`. `others` (4, A) is x, y, heading and
    speed, NaN if an entity does not exist or is not visible.
    """
    cos, sin = math.cos(driven.heading), math.sin(driven.heading)
    scene = DriverScene(
        time,
        time_step,
        driven,
        cos,
        sin,
        fleet.own[driver],
        fleet.boxes[driver],
        others,
        fleet.memory[driver, scenario],
        fleet.awareness[driver, scenario],
    )
    p = fleet.parameters[driver]
    if fleet.kind[driver] == SIMPLE:
        return follow_with_idm(FollowParameters(p[0], p[1], p[2], p[3], p[4], p[5], p[6]), scene)
    behaviour = Behaviour(
        p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], p[9], p[10], p[11], p[12], p[13], p[14], p[15], p[16]
    )
    eye = eye_pose(scene.own, driven.x, driven.y, cos, sin)
    update_visible_others(
        behaviour.field_of_view, behaviour.sight_range, eye, scene.boxes, others, buffers.boxes, buffers.seen
    )
    update_perception(behaviour, scene, buffers.seen)
    a = plan_acceleration(behaviour, fleet.routes, route, scene, buffers)
    a = min(max(a, -behaviour.max_deceleration), behaviour.acceleration)
    return max(a, -driven.speed / time_step)


@plain_kernel
def find_route_row(fleet, driver, track, scenario):
    """Return the row of a driver's route along a track in a scenario; -1 if `set_route` has not planned it."""
    if fleet.kind[driver] != BEHAVIOUR:
        return 0
    routes = fleet.routes
    if track >= routes.row.shape[1] or routes.row[driver, track] < 0:
        return -1
    return routes.row[driver, track] + (scenario if routes.rows[driver, track] > 1 else 0)


@kernel(error_model="numpy")
def make_workspace(n_others):
    """Allocate the `Workspace` in which one thread makes decisions among `n_others` other entities."""
    return Workspace(
        np.full((n_others, 5), np.nan),
        np.empty(n_others, dtype=np.bool_),
        np.empty((MAX_SAMPLES, 6)),
        np.empty((TURN_LEGS + 1, 6)),
        np.empty(3),
        np.empty((1, 6)),
    )


@kernel(error_model="numpy")
def compute_accelerations(fleet, track, time, time_step, driven, others, active):
    """Return the acceleration in m/s² of the first driver of a fleet in each scenario, shape (N,); 0 if not active.

    `driven` (N, 6) has the fields of `DrivenState`. `others` has shape (N, 4, A), as in `compute_acceleration`.
    """
    result, work = np.zeros(len(active)), make_workspace(others.shape[2])
    for n in range(len(active)):
        if active[n]:
            s = driven[n]
            state = DrivenState(s[0], s[1], s[2], s[3], s[4], s[5])
            result[n] = compute_acceleration(
                fleet, 0, n, find_route_row(fleet, 0, track, n), time, time_step, state, others[n], work
            )
    return result
