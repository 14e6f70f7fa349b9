"""Compiled time step of vehicle models that steer."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, no-untyped-call, untyped-decorator, call-arg, var-annotated"

from __future__ import annotations

import math
from typing import Final

from numba import types

from cornercase._common.numba.kernel import kernel
from cornercase._common.numba.late_kernels import LateKernels
from cornercase._common.numba.pointers import call_for_float
from cornercase._common.numba.tuple_pointers import reference_to
from cornercase.drivers.vehicles._kernels.actuators import KINEMATIC, LEFT_X, LEFT_Y, SINGLE_TRACK, SPEED
from cornercase.drivers.vehicles._kernels.kinematic_step import X, Y, move_kinematic_vehicle
from cornercase.drivers.vehicles._kernels.single_track_step import move_single_track_vehicle

VEHICLE_KERNELS: Final = LateKernels(
    {KINEMATIC: move_kinematic_vehicle, SINGLE_TRACK: move_single_track_vehicle}, types.float64
)
"""Kernels that move a vehicle, by kind of vehicle model."""
MOTION_INPUTS: Final = (types.int64, types.float64[::1], *4 * [types.float64])
"""Types of the arguments of these kernels after the vehicles."""
MOVED: Final = 0.1
"""Distance in m; a vehicle farther from its position after the last step was moved by something else."""


@kernel(error_model="numpy", _nrt=False, forceinline=True)
def move_steered_vehicle(kind, kernels, vehicles, row, motion, request, steering, friction, time_step):
    """Move a vehicle that steers by one time step, and return its speed.

    `motion` (x, y, heading, speed, acceleration) is changed in place. `kernels` holds the addresses of the compiled
    functions `VEHICLE_KERNELS`. `request` is an acceleration in m/s², `steering` an angle in rad.
    """
    state = vehicles.state[row]
    if abs(motion[X] - state[LEFT_X]) + abs(motion[Y] - state[LEFT_Y]) > MOVED:
        # As before its first step.
        state[SPEED] = math.nan
    arguments = (vehicles, row, motion, request, steering, friction, time_step)
    if kind == KINEMATIC:
        speed = call_for_float(move_kinematic_vehicle, kernels[KINEMATIC], arguments)
    else:
        speed = call_for_float(move_single_track_vehicle, kernels[SINGLE_TRACK], arguments)
    state[LEFT_X], state[LEFT_Y] = motion[X], motion[Y]
    return speed


@kernel(
    interpreted_seconds=lambda kind, _, vehicles, *__: (2e-3 if kind == SINGLE_TRACK else 3e-4) * len(vehicles.state),
    error_model="numpy",
)
def step_vehicles(kind, kernels, vehicles, motion, acceleration, steering, friction, time_step, active):
    """Move the active vehicles by one time step; all vehicles have the same `kind` of model.

    `motion` (N, 5), the columns x, y, heading, speed and acceleration, is changed in place.
    """
    _step_all(kind, kernels, reference_to(vehicles), motion, acceleration, steering, friction, time_step, active)


@kernel(error_model="numpy", _nrt=False)
def _step_all(kind, kernels, vehicles, motion, acceleration, steering, friction, time_step, active):
    for n in range(active.size):
        if active[n]:
            request, angle, mu = acceleration[n], steering[n], friction[n]
            move_steered_vehicle(kind, kernels, vehicles, n, motion[n], request, angle, mu, time_step)
