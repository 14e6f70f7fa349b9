"""Compiled step of a vehicle that steers along its path, for simulators whose loop is compiled."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, no-untyped-call, untyped-decorator, call-arg"

from __future__ import annotations

from cornercase._common.numba.angles import wrap_angle
from cornercase._common.numba.kernel import kernel
from cornercase.drivers._kernels.path_projection import interpolate_on_path, project_point_nearby
from cornercase.drivers._kernels.steer import steering_angle
from cornercase.drivers.vehicles._kernels.actuators import ACTUATORS, MAX_STEERING, WHEELBASE, steering_response
from cornercase.drivers.vehicles._kernels.steered import move_steered_vehicle


@kernel(error_model="numpy", _nrt=False, forceinline=True)
def has_steered_vehicle(fleet, driver):
    """Return whether the entity that a driver drives has a vehicle model that steers.

    `driver` is the index of the driver in `fleet`, which holds the drivers and vehicles of all entities.
    """
    return fleet.first_vehicle[driver] >= 0 and fleet.vehicle_kind[driver] != ACTUATORS


@kernel(error_model="numpy", _nrt=False)
def move_along_path(fleet, driver, scenario, path, curvature, distance, motion, request, time_step):
    """Move a vehicle by one time step along a path, as `VehicleMover` does; return its distance along the path.

    `path` has four arrays over the path's samples, distance, x, y and heading, and then the largest distance in m
    between consecutive samples. `motion` (5,) is x, y, heading, speed and acceleration, and is changed in place.
    `distance` is the approximate position along the path in m. `request` is the acceleration in m/s² that the driver
    chooses.
    """
    row = fleet.first_vehicle[driver] + scenario
    parameters = fleet.vehicles.parameters[row]
    along, offset, direction, _ = project_point_nearby(*path, distance, motion[0], motion[1])
    response, speed = steering_response(parameters), motion[3]
    bend = interpolate_on_path(path[0], curvature, along + speed * (0.5 * time_step + response))
    turn = wrap_angle(motion[2] - direction)
    angle = steering_angle(offset, turn, bend, speed, parameters[WHEELBASE], response)
    angle = min(max(angle, -parameters[MAX_STEERING]), parameters[MAX_STEERING])
    kind, friction = fleet.vehicle_kind[driver], fleet.friction[scenario]
    move_steered_vehicle(kind, fleet.vehicle_kernels, fleet.vehicles, row, motion, request, angle, friction, time_step)
    return project_point_nearby(*path, distance, motion[0], motion[1])[0]
