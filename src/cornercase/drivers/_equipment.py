"""Drivers with sensors and a vehicle model, such as ``"normal + radar:range=120 + single-track:mass=1500"``."""

from __future__ import annotations

from collections.abc import Sequence

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.typing import FloatArray
from cornercase.drivers._base import Driver, Situation
from cornercase.drivers._registry import SEPARATOR
from cornercase.drivers._system_under_test import PerScenarioDriver, SystemUnderTest
from cornercase.drivers.sensors._sensor import SENSORS, Sensor
from cornercase.drivers.vehicles._vehicle_model import VEHICLES, VehicleModel


class EquippedDriver(Driver):
    """A driver that is given what sensors measure, and moves a vehicle model.

    Parameters
    ----------
    driver : Driver or SystemUnderTest
        Driver that decides.
    sensors : sequence of Sensor, optional
        Sensors through which the driver sees the traffic; without sensors, the driver is given the true traffic.
    vehicle : VehicleModel, optional
        Vehicle model; without a model, the entity does at once what the driver decides.

    Raises
    ------
    InputError
        If `driver` is a name.

    Examples
    --------
    >>> from cornercase.drivers import DRIVERS, EquippedDriver
    >>> str(EquippedDriver(DRIVERS.create("normal")))
    'normal'
    """

    def __init__(
        self, driver: Driver | SystemUnderTest, sensors: Sequence[Sensor] = (), vehicle: VehicleModel | None = None
    ) -> None:
        if isinstance(driver, str):
            raise InputError(
                f"`driver` {driver}: is a name; give a driver, as in EquippedDriver(DRIVERS.create({driver!r}))."
            )
        self.driver: Driver = PerScenarioDriver(driver) if isinstance(driver, SystemUnderTest) else driver
        self.sensors, self.vehicle = tuple(sensors), vehicle
        self.settings = {
            "driver": dict(driver.settings),
            "sensors": [str(sensor) for sensor in self.sensors],
            "vehicle": None if vehicle is None else str(vehicle),
        }

    @property
    def equipment(self) -> tuple[Sensor | VehicleModel, ...]:
        """Sensors and vehicle model of the driver."""
        return (*self.sensors, *(() if self.vehicle is None else (self.vehicle,)))

    def __str__(self) -> str:
        return SEPARATOR.join(map(str, (self.driver, *self.equipment)))

    def start(self, scenarios: int, others: int) -> None:
        """Reset the driver; the simulator resets sensors and vehicle model by itself.

        Parameters
        ----------
        scenarios, others : int
            As in `Driver.start`.
        """
        self.driver.start(scenarios, others)

    def acceleration(self, situation: Situation) -> FloatArray:
        """Return the acceleration that the driver decides, without sensors and vehicle model.

        Parameters
        ----------
        situation : Situation
            As in `Driver.acceleration`.

        Returns
        -------
        ndarray of float64, shape (N,)
            Acceleration in m/s².
        """
        return self.driver.acceleration(situation)


def equip(driver: Driver, equipment: Sequence[str]) -> Driver:
    """Return a driver with the sensors and the vehicle model that `equipment` names, as in ``"radar:range=120"``.

    Raises `InputError` if a name is unknown, or if there are two vehicle models.
    """
    if not equipment:
        return driver
    sensors, vehicle = list[Sensor](), None
    for spec in equipment:
        name = spec.partition(":")[0]
        if name in SENSORS:
            sensors.append(SENSORS.create(spec))
        elif name not in VEHICLES:
            hint = suggest_name(name, (*SENSORS.names(), *VEHICLES.names()))
            if str(driver).startswith("exec:"):
                hint += f" If '{SEPARATOR}' belongs to the command, put it in double quotes."
            raise InputError(f"There is no sensor or vehicle '{name}'; {hint}")
        elif vehicle is not None:
            raise InputError(f"A driver moves one vehicle, not both '{vehicle}' and '{spec}'; give one.")
        else:
            vehicle = VEHICLES.create(spec)
    return EquippedDriver(driver, sensors, vehicle)
