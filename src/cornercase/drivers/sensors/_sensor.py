"""Base class of sensors, which turn the true traffic into the objects that a driver knows."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Final

from cornercase._common.configurable import Configurable
from cornercase._common.registry import Registry
from cornercase._common.typing import FloatArray
from cornercase.drivers._base import Situation
from cornercase.drivers._driving_function import Start


@dataclass(frozen=True, eq=False)
class SensedObjects:
    """Objects that a sensor knows in N scenarios: A other entities, and F false objects that do not exist.

    Attributes
    ----------
    x, y, heading, speed : ndarray of float64, shape (N, A + F)
        State of the reference points in m, rad and m/s, as measured; NaN if the sensor does not know the object.
    measured_at : ndarray of float64, shape (N, A + F)
        Time of the last measurement in s.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase.drivers import SensedObjects
    >>> known = SensedObjects(x=np.array([[30.0, np.nan]]), y=np.array([[0.0, np.nan]]), heading=np.zeros((1, 2)),
    ...                       speed=np.array([[15.0, np.nan]]), measured_at=np.full((1, 2), 0.4))
    >>> np.isfinite(known.x)
    array([[ True, False]])
    """

    x: FloatArray
    y: FloatArray
    heading: FloatArray
    speed: FloatArray
    measured_at: FloatArray


class Sensor(Configurable, ABC):
    """Base class of sensors, which turn the true situation into what a driver knows, for all scenarios of a batch.

    All numeric options of the constructor can be dimensions of a search: `start.parameters` then has one value for each
    scenario. Take random numbers from `Start.generator` only.

    Attributes
    ----------
    name : str
        Name under which the sensor is registered.
    is_random : bool
        True if runs with different seeds can differ.
    random_options : frozenset of str
        Options that make the sensor random if they are above 0.
    false_objects : int
        Number F of false objects that the sensor may report at the same time.

    Examples
    --------
    >>> import cornercase as cc
    >>> import numpy as np
    >>> from cornercase.drivers import DRIVERS, EquippedDriver, SensedObjects, Sensor
    >>> class Nearsighted(Sensor):
    ...     def start(self, start, label):
    ...         pass
    ...
    ...     def perceive(self, situation):
    ...         s = situation
    ...         distance = np.hypot(s.others_x - s.x[:, None], s.others_y - s.y[:, None])
    ...         known = np.where(distance < 20.0, 0.0, np.nan)
    ...         state = (s.others_x, s.others_y, s.others_heading, s.others_speed)
    ...         return SensedObjects(*(values + known for values in state), np.full(known.shape, s.time))
    >>> driver = EquippedDriver(DRIVERS.create("normal"), sensors=[Nearsighted()])
    >>> cc.simulate("examples/r157/deceleration.xosc", drivers={"Ego": driver})
    <Recording of Ego (car), Other (car), 4.55 s in 92 instants, Ego and Other collide at 4.55 s>
    """

    is_random: bool = False
    random_options: ClassVar[frozenset[str]] = frozenset()
    false_objects: int = 0

    @abstractmethod
    def start(self, start: Start, label: str) -> None:
        """Reset all state for a batch.

        Parameters
        ----------
        start : Start
            Description of the batch.
        label : str
            Name of this sensor among the sensors of the entity, such as ``"radar 2"``. If the sensor calls
            `Start.generator`, let the argument `purpose` begin with this label.
        """

    @abstractmethod
    def perceive(self, situation: Situation) -> SensedObjects:
        """Return the objects that the sensor knows.

        The scenarios of a batch may differ in the path along which the ego drives. In each time step, the method is
        called once for each path, and ``situation.active`` marks the scenarios with this path. The state of all other
        scenarios must not change.

        Parameters
        ----------
        situation : Situation
            True situation.

        Returns
        -------
        SensedObjects
        """


SENSORS: Final[Registry[Sensor]] = Registry("sensor", "cornercase.sensors", Sensor)
"""Sensors by name."""

for _name in ("camera", "lidar", "radar"):
    SENSORS.register(_name, f"cornercase.drivers.sensors._object_sensor:{_name.capitalize()}")
