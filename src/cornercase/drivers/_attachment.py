"""A driver with its sensors and its vehicle, attached to a simulator: from the situation to motion, step by step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from cornercase._common.configurable import with_numbers
from cornercase._common.errors import PluginError, SimulationError
from cornercase._common.plugin_errors import (
    format_time_of_failure,
    is_built_in,
    make_scenario_failure,
    reraise_termination_request,
)
from cornercase._common.process.signals import count_requests
from cornercase._common.text.sanitize import quote_name
from cornercase._common.typing import BoolArray, FloatArray
from cornercase._common.validation import repr_short
from cornercase.drivers._base import Driver, Situation
from cornercase.drivers._controls import Controls
from cornercase.drivers._equipment import EquippedDriver
from cornercase.drivers._function import DrivingFunction, Start
from cornercase.drivers._parameters import (
    DRIVER,
    VEHICLE,
    is_same_in_batch,
    name_parts,
    rows_of,
    split_parameters,
)
from cornercase.drivers._varied_driver import VariedDriver

# Excess in m/s² that may come from rounding.
_ROUNDING: Final = 1e-9


class DriverError(Exception):
    """A driver raised an exception or returned no acceleration, for several scenarios at once.

    `error` is the error of the scenario at fault. `can_bisect`: whether runs of half of the scenarios can find that
    scenario; otherwise only single runs can.
    """

    def __init__(self, error: SimulationError, splits: bool) -> None:
        super().__init__(str(error))
        self.error, self.can_bisect = error, splits


@dataclass(frozen=True, eq=False)
class Decision:
    """What an attached driver does in one time step, for N scenarios.

    `speed` (N,) is the speed in m/s at the end of the step. `failures` are by scenario, which end.
    """

    speed: FloatArray
    failures: Mapping[int, SimulationError] = field(default_factory=dict)


class Attachment:
    """A driver that is attached to an entity of a simulator.

    `limit_notices` has a sentence without full stop for each limit of the vehicle that the driver exceeded; a semicolon
    precedes what differs between notices about the same limit.
    """

    def __init__(self, driver: Driver, entity: str) -> None:
        self.driver = driver.driver if isinstance(driver, EquippedDriver) else driver
        self._given = driver
        self._sensors = driver.sensors if isinstance(driver, EquippedDriver) else ()
        self._vehicle = driver.vehicle if isinstance(driver, EquippedDriver) else None
        self._entity = entity
        self.limit_notices: dict[str, str] = {}

    @property
    def display_name(self) -> str:
        """Its name in messages."""
        driver_class = type(self.driver)
        return f"the driver of {quote_name(self._entity)}" + (
            "" if is_built_in(driver_class) else f" ({driver_class.__module__}:{driver_class.__qualname__})"
        )

    def start(self, start: Start) -> None:
        """Reset driver, sensors and vehicle for a batch; raises `DriverError`.

        The parameters of a driver that cannot vary within a batch have to be the same in all scenarios.
        """
        self._start = start
        parameters = split_parameters(self._entity, self._given, start.parameters)
        starts = {part: replace(start, parameters=own) for part, own in parameters.items()}
        requests = count_requests()
        try:
            self._start_driver(starts.pop(DRIVER))
        except BaseException as error:
            raise DriverError(make_scenario_failure(self.display_name, error, requests, 0.0), splits=True) from error
        if self._vehicle is not None:
            self._vehicle.start(starts.pop(VEHICLE))
        for sensor, of_sensor in zip(self._sensors, starts.values(), strict=True):
            sensor.start(of_sensor)

    def _start_driver(self, start: Start) -> None:
        options = rows_of(start.parameters, start.scenarios) if start.parameters else []
        if options and is_same_in_batch(self._given, DRIVER):
            self.driver = with_numbers(name_parts(self._given)[DRIVER], options[0])
        if isinstance(self.driver, DrivingFunction):
            self.driver.prepare(start)
        self.driver.start(start.scenarios, len(start.others))
        if options and isinstance(self.driver, VariedDriver) and not is_same_in_batch(self._given, DRIVER):
            self.driver.vary(options)

    def release(self) -> None:
        """Release what the driver holds, at the end of a batch."""
        if isinstance(self.driver, DrivingFunction):
            self.driver.release()

    def step(self, situation: Situation) -> Decision:
        """Decide the coming time step in the active scenarios; raises `DriverError`."""
        # The driver may change the arrays that it is given.
        active, speed, time = situation.active.copy(), situation.speed.copy(), situation.time
        sensed = situation
        for sensor in self._sensors:
            sensed = sensor.perceive(sensed)
        controls = self._decide(sensed)
        failures = {n: failure for n, failure in controls.failures.items() if active[n]}
        acceleration = controls.acceleration
        is_missing = active & ~np.isfinite(acceleration)
        for n in np.flatnonzero(is_missing).tolist():
            if n not in failures:
                returned = f"{self.display_name} returned {acceleration[n]:g}{format_time_of_failure(time)}"
                failures[n] = PluginError(f"{returned}, which is not an acceleration in m/s²")
        acceleration = self._clip_acceleration(acceleration, active & ~is_missing, time)
        speed = np.maximum(speed + acceleration * self._start.time_step, 0.0)
        return Decision(np.minimum(speed, self._start.body.max_speed), failures)

    def _decide(self, situation: Situation) -> Controls:
        """Call the driver, which may be user code, and check what it returns."""
        expected, requests = self._start.scenarios, count_requests()
        try:
            returned: object = (
                self.driver.decide(situation)
                if isinstance(self.driver, DrivingFunction)
                else self.driver.acceleration(situation)
            )
        except BaseException as error:
            raise DriverError(
                make_scenario_failure(self.display_name, error, requests, situation.time), splits=True
            ) from error
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

    def _clip_acceleration(self, acceleration: FloatArray, rows: BoolArray, time: float) -> FloatArray:
        highest, lowest = self._start.body.max_acceleration, -self._start.body.max_deceleration
        if highest == np.inf == -lowest:
            return acceleration
        clipped = acceleration.clip(lowest, highest)
        if len(self.limit_notices) < 2 and bool((rows & (clipped != acceleration)).any()):
            for limit, excess in (("acceleration", acceleration - highest), ("deceleration", lowest - acceleration)):
                worst = float(excess[rows].max())
                if limit not in self.limit_notices and worst > _ROUNDING:
                    requested = worst + (highest if limit == "acceleration" else -lowest)
                    bound = highest if limit == "acceleration" else -lowest
                    self.note_exceeded_limit(limit, bound, f"first {requested:.6g} m/s²{format_time_of_failure(time)}")
        return clipped

    def note_exceeded_limit(self, limit: str, bound: float, requested: str) -> None:
        """Note that the driver exceeds a limit of its vehicle."""
        self.limit_notices[limit] = (
            f"{self.display_name} exceeds the {limit} of {bound:.6g} m/s² in <Performance>, and is"
            f" limited to it; {requested}"
        )


def _safe_repr(value: object) -> str:
    try:
        return repr_short(value)
    except Exception:
        return f"a {type(value).__name__}"
