"""Driver of a simulated entity: turns the traffic situation of each time step into the motion of the entity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final, cast

import numpy as np

from cornercase._common.configurable import copy_with_numeric_options
from cornercase._common.errors import InputError, PluginError, SimulationError
from cornercase._common.masks import any_true
from cornercase._common.plugin_errors import (
    format_time_of_failure,
    is_built_in,
    make_scenario_failure,
    reraise_termination_request,
)
from cornercase._common.process.signals import count_termination_requests
from cornercase._common.text.sanitize import quote_name, remove_folders
from cornercase._common.typing import BoolArray, FloatArray
from cornercase._common.validation import repr_short
from cornercase.drivers._base import Driver, Situation
from cornercase.drivers._compiled import is_compiled, limit_driver_acceleration
from cornercase.drivers._controls import Controls
from cornercase.drivers._driving_function import DrivingFunction, Start
from cornercase.drivers._equipment import EquippedDriver
from cornercase.drivers._motion_control import DrivenMotion, VehicleMover
from cornercase.drivers._parameters import (
    DRIVER,
    VEHICLE,
    must_be_same_in_batch,
    options_by_scenario,
    parts_by_name,
    split_parameters,
)
from cornercase.drivers._varied_driver import VariedDriver
from cornercase.drivers.sensors._fusion import SensorFusion
from cornercase.drivers.vehicles._actuated import ActuatedVehicle
from cornercase.drivers.vehicles._pedals import pedals_to_acceleration
from cornercase.drivers.vehicles._vehicle_model import PlanarMotion

# Excess in m/s² or rad that may come from rounding.
_ROUNDING: Final = 1e-9
# m; always allowed, since the first point of a trajectory may be beside the vehicle.
_JUMP: Final = 10.0
# m/s; highest speed of a vehicle without a limit.
_MAX_SPEED: Final = 100.0
_LIMITS: Final = {"acceleration", "deceleration"}
_STATE: Final = ("x", "y", "heading", "speed", "acceleration")


class DriverError(Exception):
    """Failure of a driver that decides for several scenarios at once: an exception, or no valid acceleration.

    The simulator simulates these scenarios again in smaller batches, so that only the scenario at fault fails: in two
    halves if `can_bisect`, else one by one. `error` is the error that a single scenario ends with.
    """

    def __init__(self, error: SimulationError, splits: bool) -> None:
        super().__init__(str(error))
        self.error, self.can_bisect = error, splits


@dataclass(frozen=True, eq=False)
class Decision:
    """Decision of a driver for one time step in N scenarios, as the motion of its entity.

    `motion` is the motion at the end of the step. If the entity is not steered, only the speed in `motion` counts.
    `failures` has the error of each scenario that ends because the driver failed, by index of the scenario.
    """

    motion: DrivenMotion
    failures: Mapping[int, SimulationError] = field(default_factory=dict)


class AttachedDriver:
    """Driver of a simulated entity, with its sensors and its vehicle model.

    `limit_notices` has one sentence, without full stop, for each limit that the driver exceeded: a limit of the
    vehicle, or a lane change to a side without a lane. Notices about the same limit in several simulations are equal up
    to the semicolon; the details after the semicolon, such as the time, may differ.
    """

    def __init__(self, driver: Driver, entity: str) -> None:
        self.driver = driver.driver if isinstance(driver, EquippedDriver) else driver
        self._given = driver
        self._sensors = SensorFusion(driver.sensors if isinstance(driver, EquippedDriver) else ())
        self.vehicle = driver.vehicle if isinstance(driver, EquippedDriver) else None
        self._mover = VehicleMover(self.vehicle, self._note_missing_lane)
        self._entity = entity
        self.limit_notices: dict[str, str] = {}

    @property
    def is_compiled(self) -> bool:
        """True if compiled code can make all decisions of the driver and move its vehicle."""
        is_moved = self.vehicle is None or self.compiled_vehicle is not None
        return is_compiled(self.driver) and not self._sensors and is_moved

    @property
    def sees_start_of_step(self) -> bool:
        """True if the driver is given the traffic at the start of a step, before scenario actions move entities.

        This is so for a `DrivingFunction`. Any other driver is given the traffic after the actions of the step.
        """
        return isinstance(self.driver, DrivingFunction)

    @property
    def compiled_vehicle(self) -> ActuatedVehicle | None:
        """Vehicle model of the driver if compiled code can move it; None without a model, or for a user's own class."""
        is_built = isinstance(self.vehicle, ActuatedVehicle) and is_built_in(type(self.vehicle))
        return cast(ActuatedVehicle, self.vehicle) if is_built else None

    @property
    def display_name(self) -> str:
        """Name of the driver in messages."""
        driver_class = type(self.driver)
        return f"the driver of {quote_name(self._entity)}" + (
            "" if is_built_in(driver_class) else f" ({driver_class.__module__}:{driver_class.__qualname__})"
        )

    @property
    def _full_name(self) -> str:
        """Name of the driver in messages; for an adapter, also the FMU, program or class that the adapter runs."""
        is_adapter = is_built_in(type(self.driver)) and isinstance(self.driver, DrivingFunction)
        return f"{self.display_name} ({remove_folders(str(self.driver))})" if is_adapter else self.display_name

    def start(self, start: Start) -> None:
        """Reset driver, sensors and vehicle before N scenarios are simulated together; raises `DriverError`.

        An object of a user's `Driver` class drives in all N scenarios with the same parameters, so the parameters must
        not differ between the scenarios.
        """
        self._start = start
        parameters = split_parameters(self._entity, self._given, start.parameters)
        requests = count_termination_requests()
        try:
            sensors = [own for part, own in parameters.items() if part not in (DRIVER, VEHICLE)]
            self._start_driver(replace(self._sensors.start(start, sensors), parameters=parameters[DRIVER]))
        except BaseException as error:
            raise self._to_driver_error(error, requests, 0.0) from error
        if is_compiled(self.driver):
            # A compiled driver plans with the limits of its vehicle.
            bounds = {"acceleration": start.body.max_acceleration, "deceleration": start.body.max_deceleration}
            for limit, value in limit_driver_acceleration(self.driver, *bounds.values()).items():
                self.note_exceeded_limit(limit, bounds[limit], f"it would go up to {value:.6g} m/s²")
        self._mover.start(replace(start, parameters=parameters.get(VEHICLE, {})))

    def _start_driver(self, start: Start) -> None:
        options = options_by_scenario(start.parameters, start.scenarios) if start.parameters else []
        if options and must_be_same_in_batch(self._given, DRIVER):
            self.driver = copy_with_numeric_options(parts_by_name(self._given)[DRIVER], options[0])
        if isinstance(self.driver, DrivingFunction):
            self.driver.prepare(start)
        self.driver.start(start.scenarios, len(start.others))
        if options and isinstance(self.driver, VariedDriver) and not must_be_same_in_batch(self._given, DRIVER):
            self.driver.vary(options)

    def release(self) -> None:
        """Release processes and files of the driver after the last time step."""
        if isinstance(self.driver, DrivingFunction):
            self.driver.release()

    def step(self, situation: Situation, begin: PlanarMotion | None = None) -> Decision:
        """Return the decision for the coming time step in the active scenarios; raises `DriverError`.

        Give `begin`, the motion at the start of the step, if the simulator has already moved the entity in this step.
        """
        # The driver may change the arrays that it is given.
        copies = {name: getattr(situation, name).copy() for name in ("active", "distance", *_STATE)}
        truth = replace(situation, **copies)
        controls = self._decide(situation)
        active, time = truth.active, truth.time
        failures = {n: failure for n, failure in controls.failures.items() if active[n]}
        acceleration = controls.acceleration.copy()
        if any_true(active & ~np.isfinite(acceleration)):
            pressed = pedals_to_acceleration(controls.throttle, controls.brake, self._start.body)
            acceleration = np.where(np.isnan(acceleration), pressed, acceleration)
            goes_on = np.isnan(acceleration) & self._mover.follows_trajectory(controls)
            undecided = active & ~(np.isfinite(acceleration) | goes_on)
            if isinstance(self.driver, DrivingFunction):
                self._fail_undecided(undecided & np.isnan(acceleration), time, failures)
            self._fail_invalid_values(undecided, acceleration, "an acceleration in m/s²", time, failures)
        if any_true(steers := active & ~np.isnan(controls.steering)):
            self._fail_invalid_values(
                steers & np.isinf(controls.steering), controls.steering, "an angle in rad", time, failures
            )
            self._note_exceeded_steering(controls.steering, steers, time)
        acceleration = self._clip_acceleration(acceleration, active & np.isfinite(acceleration), time)
        start = PlanarMotion(**{name: copies[name] for name in _STATE}) if begin is None else begin
        motion = self._mover.step(truth, start, controls, acceleration, active)
        if any_true(motion.is_steered):
            self._refuse_jumps(active & motion.is_steered, start, motion.state, truth, failures)
        return Decision(motion, failures)

    def _refuse_jumps(
        self,
        rows: BoolArray,
        begin: PlanarMotion,
        end: PlanarMotion,
        situation: Situation,
        failures: dict[int, SimulationError],
    ) -> None:
        """Add a failure for each scenario of `rows` in which the vehicle would jump.

        It jumps if it moves by more than 10 m plus twice the distance that it drives in a step at its highest speed.
        """
        body, dt = self._start.body, situation.time_step
        fastest = body.max_speed if np.isfinite(body.max_speed) else _MAX_SPEED
        farthest = _JUMP + 2.0 * fastest * dt
        distance = np.hypot(end.x - begin.x, end.y - begin.y)
        for n in np.flatnonzero(rows & (distance > farthest)).tolist():
            jumps = (
                f"{self.display_name} jumps by {distance[n]:.4g} m in the step{format_time_of_failure(situation.time)}"
            )
            failures.setdefault(
                n,
                PluginError(
                    f"{jumps}, and at most {farthest:.3g} m are driven; give a trajectory that begins at the vehicle,"
                    " in m of the map and s since the start of the scenario"
                ),
            )

    def _fail_invalid_values(
        self, rows: BoolArray, values: FloatArray, what: str, time: float, failures: dict[int, SimulationError]
    ) -> None:
        """Add a failure for each scenario of `rows`: the driver did not return `what`, such as "an angle in rad"."""
        for n in np.flatnonzero(rows).tolist():
            returned = f"{self._full_name} returned {values[n]:g}{format_time_of_failure(time)}"
            failures.setdefault(n, PluginError(f"{returned}, which is not {what}"))

    def _fail_undecided(self, rows: BoolArray, time: float, failures: dict[int, SimulationError]) -> None:
        """Add a failure for each scenario of `rows`: the driver did not decide how to move."""
        for n in np.flatnonzero(rows).tolist():
            why = "it gave no acceleration, no throttle or brake, and no trajectory"
            sentence = f"{self._full_name} decided nothing{format_time_of_failure(time)}: {why}"
            failures.setdefault(n, PluginError(sentence))

    def _note_missing_lane(self, time: float, side: str) -> None:
        self.limit_notices.setdefault(
            f"lane {side}",
            f"{self.display_name} asks for a lane on the {side} that is not there or not for its direction, and stays"
            f" in its lane; first{format_time_of_failure(time)}",
        )

    def _decide(self, situation: Situation) -> Controls:
        """Call the sensors and the driver, which may be user code, and check what the driver returns."""
        expected, requests = self._start.scenarios, count_termination_requests()
        try:
            sensed = self._sensors.perceive(situation)
            returned: object = (
                self.driver.decide(sensed)
                if isinstance(self.driver, DrivingFunction)
                else self.driver.acceleration(sensed)
            )
        except BaseException as error:
            raise self._to_driver_error(error, requests, situation.time) from error
        if isinstance(returned, Controls):
            return returned
        try:
            acceleration: FloatArray = np.asarray(returned).astype(np.float64, casting="same_kind")
            # A single number would be broadcast to all scenarios.
            if acceleration.shape != (expected,):
                raise ValueError
        except BaseException as error:
            reraise_termination_request(error, requests)
            expectation = "for the scenario" if expected == 1 else f"for each of {expected} scenarios"
            instant = format_time_of_failure(situation.time)
            why = f"{self.display_name} returned no acceleration {expectation}{instant}, but {_safe_repr(returned)}"
            raise DriverError(PluginError(why), splits=False) from error
        return replace(Controls.empty(expected), acceleration=acceleration)

    def _to_driver_error(self, error: BaseException, requests: int, time: float) -> DriverError:
        """Convert an exception of the driver to a `DriverError`; an `InputError` of an adapter is raised unchanged."""
        if is_built_in(type(self.driver)) and isinstance(self.driver, DrivingFunction):
            if isinstance(error, InputError | DriverError):
                raise error
            if isinstance(error, SimulationError):
                return DriverError(error, splits=True)
        return DriverError(make_scenario_failure(self.display_name, error, requests, time), splits=True)

    def _clip_acceleration(self, acceleration: FloatArray, rows: BoolArray, time: float) -> FloatArray:
        highest, lowest = self._start.body.max_acceleration, -self._start.body.max_deceleration
        if highest == np.inf == -lowest:
            return acceleration
        clipped = acceleration.clip(lowest, highest)
        if not self.limit_notices.keys() >= _LIMITS and bool((rows & (clipped != acceleration)).any()):
            for limit, excess in (("acceleration", acceleration - highest), ("deceleration", lowest - acceleration)):
                worst = float(excess[rows].max())
                if limit not in self.limit_notices and worst > _ROUNDING:
                    requested = worst + (highest if limit == "acceleration" else -lowest)
                    bound = highest if limit == "acceleration" else -lowest
                    self.note_exceeded_limit(limit, bound, f"first {requested:.6g} m/s²{format_time_of_failure(time)}")
        return clipped

    def _note_exceeded_steering(self, steering: FloatArray, rows: BoolArray, time: float) -> None:
        """Add one notice if a steering angle exceeds the limit of the front wheels; `VehicleMover` limits the angle."""
        bound = self._start.body.max_steering
        if "steering" in self.limit_notices:
            return
        is_beyond = rows & np.isfinite(steering) & (np.abs(steering) > bound + _ROUNDING)
        if bool(is_beyond.any()):
            requested = float(steering[is_beyond][np.abs(steering[is_beyond]).argmax()])
            self.limit_notices["steering"] = (
                f"{self.display_name} exceeds the steering angle of {bound:.6g} rad that its front wheels can do, and"
                f" is limited to it; first {requested:.6g} rad{format_time_of_failure(time)}"
            )

    def note_exceeded_limit(self, limit: str, bound: float, requested: str) -> None:
        """Note that the driver exceeds the acceleration or deceleration that its vehicle can reach, `bound` in m/s²."""
        self.limit_notices[limit] = (
            f"{self.display_name} exceeds the {limit} of {bound:.6g} m/s² in <Performance>, and is"
            f" limited to it; {requested}"
        )


def _safe_repr(value: object) -> str:
    try:
        return repr_short(value)
    except Exception:
        return f"a {type(value).__name__}"
