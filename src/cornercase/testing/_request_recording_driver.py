"""Driver that passes on the decisions of another driver, and records the strongest ones."""

from __future__ import annotations

from typing import NamedTuple, cast

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.drivers import Controls, Driver, DrivingFunction, Situation, Start


class DriverRequest(NamedTuple):
    """Acceleration or steering angle that a driver requests, and the time of the request in s."""

    value: float
    time: float

    def stronger_of(self, values: FloatArray, rows: BoolArray, time: float) -> DriverRequest:
        """Return this request, or the strongest request in `values` if it is stronger.

        `values` are requested at `time`, one in each scenario; only scenarios with True in `rows` count.
        """
        given = values[rows & np.isfinite(values)]
        value = float(given[np.abs(given).argmax()]) if len(given) else 0.0
        return DriverRequest(value, time) if abs(value) > abs(self.value) else self


class RequestRecordingDriver(DrivingFunction):
    """Driving function that decides like a given driver, and records its strongest requests.

    These are the strongest acceleration in m/s² and the strongest steering angle in rad.
    """

    def __init__(self, driver: Driver) -> None:
        self._driver = driver
        self.settings = driver.settings
        self.most_acceleration = self.most_steering = DriverRequest(0.0, 0.0)
        self.max_steering = np.inf

    def prepare(self, start: Start) -> None:
        """Prepare the given driver for a batch of scenarios."""
        self.max_steering = start.body.max_steering
        if isinstance(self._driver, DrivingFunction):
            self._driver.prepare(start)

    def start(self, scenarios: int, others: int) -> None:
        """Reset the given driver before a batch of scenarios."""
        self._driver.start(scenarios, others)

    def decide(self, situation: Situation) -> Controls:
        """Return the decision of the given driver; record its requests if they are the strongest so far."""
        active, time = situation.active.copy(), situation.time
        if not isinstance(self._driver, DrivingFunction):
            accelerations = self._driver.acceleration(situation)
            self.most_acceleration = self.most_acceleration.stronger_of(
                np.asarray(accelerations, np.float64), active, time
            )
            # The simulator takes accelerations instead of controls, too.
            return cast(Controls, accelerations)
        controls = self._driver.decide(situation)
        self.most_acceleration = self.most_acceleration.stronger_of(controls.acceleration, active, time)
        self.most_steering = self.most_steering.stronger_of(controls.steering, active, time)
        return controls

    def release(self) -> None:
        """Release processes and files of the given driver at the end of a batch."""
        if isinstance(self._driver, DrivingFunction):
            self._driver.release()
