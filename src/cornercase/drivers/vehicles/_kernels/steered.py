"""Compiled vehicles that steer, by kind."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, no-untyped-call, untyped-decorator, call-arg"

from __future__ import annotations

from typing import Final

from numba import types

from cornercase._common.numba.kernel import kernel
from cornercase._common.numba.late import LateKernels
from cornercase._common.numba.pointers import call_for_float
from cornercase._common.numba.references import reference_to
from cornercase.drivers.vehicles._kernels.actuators import KINEMATIC, SINGLE_TRACK
from cornercase.drivers.vehicles._kernels.rolling import roll_vehicle
from cornercase.drivers.vehicles._kernels.sliding import slide_vehicle

VEHICLE_KERNELS: Final = LateKernels({KINEMATIC: roll_vehicle, SINGLE_TRACK: slide_vehicle}, types.float64)
"""Kernels that move a vehicle, by kind."""
MOTION_INPUTS: Final = (types.int64, types.float64[::1], *4 * [types.float64])
"""Types of the arguments of these kernels after the vehicles."""


@kernel(error_model="numpy", _nrt=False, forceinline=True)
def move_steered_vehicle(kind, kernels, vehicles, row, motion, request, steering, friction, time_step):
    """Move a vehicle by one time step, and return its speed; `motion` (5,) is changed.

    `kernels` are the addresses of `VEHICLE_KERNELS`. `request` is an acceleration in m/s², `steering` an angle in rad.
    """
    arguments = (vehicles, row, motion, request, steering, friction, time_step)
    if kind == KINEMATIC:
        return call_for_float(roll_vehicle, kernels[KINEMATIC], arguments)
    return call_for_float(slide_vehicle, kernels[SINGLE_TRACK], arguments)


@kernel(
    interpreted_seconds=lambda kind, _, vehicles, *__: (2e-3 if kind == SINGLE_TRACK else 3e-4) * len(vehicles.state),
    error_model="numpy",
)
def step_vehicles(kind, kernels, vehicles, motion, acceleration, steering, friction, time_step, active):
    """Move the active vehicles of a kind by one time step; `motion` (N, 5) is changed."""
    _step_all(kind, kernels, reference_to(vehicles), motion, acceleration, steering, friction, time_step, active)


@kernel(error_model="numpy", _nrt=False)
def _step_all(kind, kernels, vehicles, motion, acceleration, steering, friction, time_step, active):
    for n in range(active.size):
        if active[n]:
            request, angle, mu = acceleration[n], steering[n], friction[n]
            move_steered_vehicle(kind, kernels, vehicles, n, motion[n], request, angle, mu, time_step)
