"""Compiled decision of a driver in a scenario."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, no-untyped-call, untyped-decorator, call-arg, attr-defined"

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import types

from cornercase._common.numba.kernel import kernel
from cornercase._common.numba.late_kernels import LateKernels
from cornercase._common.numba.pointers import call_for_float
from cornercase._common.numba.tuple_pointers import reference_to, reference_type
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
from cornercase.drivers.vehicles._kernels.actuators import change_speed


@inline_kernel
def compute_acceleration(fleet, driver, scenario, route, time, time_step, driven, others, buffers):
    """Return the acceleration in m/s² that a driver chooses in one scenario, and update the driver's memory.

    `driver` is the index of a compiled driver in the fleet. `route` comes from `find_route_row`. `others` (4, A) is x,
    y, heading and speed of A other entities, NaN if an entity does not exist or is not visible.
    """
    arguments = (fleet, driver, scenario, route, time, time_step, driven, others, buffers)
    if fleet.kind[driver] == SIMPLE:
        return call_for_float(_decide_as_simple_driver, fleet.kernels[SIMPLE], arguments)
    return call_for_float(_decide_by_behaviour, fleet.kernels[BEHAVIOUR], arguments)


@inline_kernel
def change_vehicle_speed(fleet, driver, scenario, speed, acceleration, request, time_step):
    """Return the speed in m/s after a time step of an entity with a vehicle model of actuators.

    `acceleration` is the present acceleration, `request` the acceleration that the driver wants, both in m/s².
    """
    row, friction = fleet.first_vehicle[driver] + scenario, fleet.friction[scenario]
    return change_speed(fleet.vehicles, row, speed, acceleration, request, friction, time_step)


@plain_kernel
def _decide_as_simple_driver(fleet, driver, scenario, route, time, time_step, driven, others, buffers):
    p = fleet.parameters[driver, scenario]
    parameters = FollowParameters(p[0], p[1], p[2], p[3], p[4], p[5], p[6])
    return follow_with_idm(parameters, _driver_scene(fleet, driver, scenario, time, time_step, driven, others))


@plain_kernel
def _decide_by_behaviour(fleet, driver, scenario, route, time, time_step, driven, others, buffers):
    scene = _driver_scene(fleet, driver, scenario, time, time_step, driven, others)
    p = fleet.parameters[driver, scenario]
    behaviour = Behaviour(
        p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], p[9], p[10], p[11], p[12], p[13], p[14], p[15], p[16]
    )
    eye = eye_pose(scene.own, driven.x, driven.y, scene.cos, scene.sin)
    update_visible_others(
        behaviour.field_of_view, behaviour.sight_range, eye, scene.boxes, others, buffers.boxes, buffers.seen
    )
    update_perception(behaviour, scene, buffers.seen)
    a = plan_acceleration(behaviour, fleet.routes, route, scene, buffers)
    a = min(max(a, -behaviour.max_deceleration), behaviour.acceleration)
    return max(a, -driven.speed / time_step)


@inline_kernel
def _driver_scene(fleet, driver, scenario, time, time_step, driven, others):
    return DriverScene(
        time,
        time_step,
        driven,
        math.cos(driven.heading),
        math.sin(driven.heading),
        fleet.own[driver],
        fleet.boxes[driver],
        others,
        fleet.memory[driver, scenario],
        fleet.awareness[driver, scenario],
    )


@plain_kernel
def find_route_row(fleet, driver, track, scenario):
    """Return the row in `Routes` of a driver's route along path number `track`; -1 if no route is planned.

    The result is 0 for a driver that needs no route.
    """
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


DRIVER_KERNELS: Final = LateKernels({SIMPLE: _decide_as_simple_driver, BEHAVIOUR: _decide_by_behaviour}, types.float64)
"""Kernels that decide, by kind of driver."""
DECISION_INPUTS: Final = (
    *(types.int64, types.int64, types.int64, types.float64, types.float64),
    types.NamedUniTuple(types.float64, len(DrivenState._fields), DrivenState),
    types.float64[:, ::1],
    reference_type(make_workspace.py_func(1)),
)
"""Types of the arguments of these kernels after the fleet."""


@kernel(error_model="numpy")
def compute_accelerations(fleet, driver, track, time, time_step, driven, others, active):
    """Return the acceleration in m/s² of a driver of a fleet in each of N scenarios, (N,); 0 if not `active`.

    `track` is the number of the path. `driven` (N, 6) has the fields of `DrivenState`. `others` has shape (N, 4, A), as
    in `compute_acceleration`. Call `compile_fleet_kernels` before.
    """
    result, work = np.zeros(len(active)), make_workspace(others.shape[2])
    _fill_accelerations(
        reference_to(fleet), driver, track, time, time_step, driven, others, active, reference_to(work), result
    )
    return result


@plain_kernel
def _fill_accelerations(fleet, driver, track, time, time_step, driven, others, active, work, result):
    for n in range(len(active)):
        if active[n]:
            s, route = driven[n], find_route_row(fleet, driver, track, n)
            state = DrivenState(s[0], s[1], s[2], s[3], s[4], s[5])
            result[n] = compute_acceleration(fleet, driver, n, route, time, time_step, state, others[n], work)
