"""Vehicle models with actuators, which follow a driver's requests with delay, lag and limits."""

# Kernels are declared as plain functions, without the methods of their dispatcher.
# mypy: disable-error-code="attr-defined"

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, ClassVar, Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray, FloatArray
from cornercase._common.validation import check_float
from cornercase.drivers._driving_function import Start
from cornercase.drivers.vehicles._kernels.actuators import (
    ACTUATORS,
    N_STATE,
    SPEED,
    WHEELBASE,
    Vehicles,
    change_speeds,
    count_requests,
    steering_response,
)
from cornercase.drivers.vehicles._kernels.steered import MOTION_INPUTS, VEHICLE_KERNELS, step_vehicles
from cornercase.drivers.vehicles._vehicle_model import PlanarMotion, VehicleModel

# Parameters in the order of the columns of `Vehicles.parameters`.
_PARAMETERS: Final = (
    *("delay", "lag", "max_jerk", "mu", "steering_delay", "steering_lag", "max_steering_rate"),
    *("max_speed", "max_steering", "wheelbase"),
)
_POSITIVE: Final = frozenset({"max_jerk", "mu", "max_steering_rate", "wheelbase"})
# Allowed ranges of options; beyond them, a step would need too much memory or too small parts.
_LIMITS: Final[dict[str, dict[str, float]]] = {
    "delay": {"minimum": 0.0, "maximum": 60.0},
    "steering_delay": {"minimum": 0.0, "maximum": 60.0},
    "mu": {"above": 0.0, "maximum": 10.0},
    "mass": {"minimum": 50.0, "maximum": 1e6},
    "inertia": {"minimum": 50.0, "maximum": 1e8},
    "front_axle": {"minimum": 0.1, "maximum": 100.0},
    "rear_axle": {"minimum": 0.1, "maximum": 100.0},
    "front_stiffness": {"above": 0.0, "maximum": 1e3},
    "rear_stiffness": {"above": 0.0, "maximum": 1e3},
    "height": {"above": 0.0, "maximum": 10.0},
    "wheelbase": {"above": 0.0, "maximum": 200.0},
}


class ActuatedVehicle(VehicleModel):
    """Base class of vehicle models with actuators, which follow requests with delay, lag and limits.

    `parameter_names` are the options of a derived class that no other model has.
    """

    parameter_names: ClassVar[tuple[str, ...]] = ()
    kind: ClassVar[int]
    """Number of the model, by which its kernels are chosen."""

    _vehicles: Vehicles

    def __init__(self, *, delay: float = 0.0, lag: float = 0.0, max_jerk: float = math.inf, mu: float = 1.0) -> None:
        self._parameters: dict[str, float] = {}
        self._set_parameters(delay=delay, lag=lag, max_jerk=max_jerk, mu=mu)

    def _set_parameters(self, **options: float) -> None:
        """Check options, and store them as parameters of the model."""
        for name, value in options.items():
            if value == math.inf and name.startswith("max_"):
                continue
            try:
                is_positive = name in _POSITIVE or name in self.parameter_names
                limits: dict[str, float] = {"above": 0.0} if is_positive else {"minimum": 0.0}
                check_float(name, value, **_LIMITS.get(name, limits))
            except InputError as error:
                raise InputError(f"The vehicle '{type(self).name}': its option {error}") from None
        self._parameters |= options

    def start(self, start: Start) -> None:
        """Reset all state before scenarios are simulated together."""
        names, n = (*_PARAMETERS, *self.parameter_names), start.scenarios
        body = start.body
        values: dict[str, Any] = {"steering_delay": 0.0, "steering_lag": 0.0, "max_steering_rate": math.inf}
        values |= {"max_speed": body.max_speed, "max_steering": body.max_steering, "wheelbase": body.wheelbase}
        values |= self._parameters | dict(start.parameters)
        values |= self._derived_parameters(values)
        parameters = np.stack([np.broadcast_to(values[name], n) for name in names], axis=1).astype(np.float64)
        size = count_requests(parameters[:, [names.index("delay"), names.index("steering_delay")]], start.time_step)
        state = np.zeros((n, N_STATE))
        state[:, SPEED] = np.nan
        self._vehicles = Vehicles(np.ascontiguousarray(parameters), state, np.zeros((n, 2, size)))

    def _derived_parameters(self, values: dict[str, Any]) -> dict[str, Any]:
        """Return parameters that follow from other parameters; none by default."""
        return {}

    @property
    def tables(self) -> Vehicles:
        """Parameters and state of a started vehicle, for compiled functions."""
        return self._vehicles

    def use_tables(self, tables: Vehicles) -> None:
        """Use these arrays for parameters and state from now on; compiled functions use the same arrays.

        Parameters
        ----------
        tables : Vehicles
            Parameters and state of the started vehicle.
        """
        self._vehicles = tables


class Actuators(ActuatedVehicle):
    """Vehicle model that stays on its path, with actuators for its speed.

    In curves, too, the tyres can use all friction for braking and accelerating. See ``docs/vehicles.md``.

    Parameters
    ----------
    delay, lag : float, default 0
        Dead time in s after which the vehicle begins to follow a request, and time constant in s with which its
        acceleration then approaches the request.
    max_jerk : float, optional
        Highest change of the acceleration in m/s³, such as that of brakes that build up pressure; infinite by default.
    mu : float, default 1
        Friction coefficient of the tyres on a dry road; multiplied by the friction coefficient of the road.

    Raises
    ------
    InputError
        If an option is out of range.

    Examples
    --------
    >>> import cornercase as cc
    >>> from cornercase.drivers import NORMAL, Actuators, BehaviourDriver, EquippedDriver
    >>> late_brakes = Actuators(delay=0.2, max_jerk=10.0)
    >>> driver = EquippedDriver(BehaviourDriver(NORMAL), vehicle=late_brakes)
    >>> cc.simulate("examples/r157/deceleration.xosc", drivers={"Ego": driver})
    <Recording of Ego (car), Other (car), 35.05 s in 702 instants, no collision>
    """

    name = "actuators"
    steers = False
    kind = ACTUATORS

    def step(
        self,
        motion: PlanarMotion,
        acceleration: FloatArray,
        steering: FloatArray,
        friction: FloatArray,
        time_step: float,
        active: BoolArray,
    ) -> PlanarMotion:
        """Return the motion at the end of a time step: speed and acceleration are new, the pose is not."""
        speed, reached = np.array(motion.speed), np.array(motion.acceleration)
        inputs = np.ascontiguousarray(acceleration), np.ascontiguousarray(friction)
        change_speeds(self._vehicles, speed, reached, *inputs, time_step, np.ascontiguousarray(active))
        return replace(motion, speed=speed, acceleration=reached)


class SteeredVehicle(ActuatedVehicle):
    """Base class of vehicle models that steer.

    Parameters
    ----------
    steering_delay, steering_lag : float
        Dead time in s and time constant in s of the steering, like `delay` and `lag` of the acceleration.
    max_steering_rate : float
        Highest change of the angle of the front wheels in rad/s.
    **options
        Options of `ActuatedVehicle`: ``delay``, ``lag``, ``max_jerk`` and ``mu``.
    """

    def __init__(
        self,
        *,
        steering_delay: float = 0.0,
        steering_lag: float = 0.0,
        max_steering_rate: float = math.inf,
        **options: float,
    ) -> None:
        super().__init__(**options)
        self._set_parameters(
            steering_delay=steering_delay, steering_lag=steering_lag, max_steering_rate=max_steering_rate
        )

    @property
    def steering_response(self) -> FloatArray:
        """Time in s by which the wheels lag behind a request.

        Returns
        -------
        ndarray of float64, shape (N,)
        """
        return np.asarray(steering_response.py_func(self._vehicles.parameters.T))

    @property
    def wheelbase(self) -> FloatArray:
        """Distance between the axles in m.

        Returns
        -------
        ndarray of float64, shape (N,)
        """
        return self._vehicles.parameters[:, WHEELBASE]

    def step(
        self,
        motion: PlanarMotion,
        acceleration: FloatArray,
        steering: FloatArray,
        friction: FloatArray,
        time_step: float,
        active: BoolArray,
    ) -> PlanarMotion:
        """Return the motion at the end of a time step."""
        table = np.stack((motion.x, motion.y, motion.heading, motion.speed, motion.acceleration), axis=1)
        inputs = [np.ascontiguousarray(array, dtype=np.float64) for array in (acceleration, steering, friction)]
        arguments = self._vehicles, table, *inputs, float(time_step), np.ascontiguousarray(active)
        if not step_vehicles.is_interpreted(self.kind, VEHICLE_KERNELS.addresses, *arguments):
            VEHICLE_KERNELS.compile_needed([self.kind], self._vehicles, *MOTION_INPUTS)
        step_vehicles(self.kind, VEHICLE_KERNELS.addresses, *arguments)
        return PlanarMotion(*np.ascontiguousarray(table.T))
