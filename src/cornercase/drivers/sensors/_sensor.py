"""Base class of sensors, which stand between the true traffic and a driver."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, Final

from cornercase._common.configurable import Configurable
from cornercase._common.registry import Registry
from cornercase.drivers._base import Situation
from cornercase.drivers._function import Start


class Sensor(Configurable, ABC):
    """Turns the true situation into what a driver is given, for all concrete scenarios of a batch.

    All numeric options of the constructor can be dimensions of a search: `start.parameters` then has one value for each
    scenario. Random numbers come from `Start.generator` alone.

    Attributes
    ----------
    name : str
        As registered.
    is_random : bool
        Whether runs with other seeds differ.
    """

    is_random: ClassVar[bool] = False

    @abstractmethod
    def start(self, start: Start) -> None:
        """Reset all state for a batch.

        Parameters
        ----------
        start : Start
            What is known then.
        """

    @abstractmethod
    def perceive(self, situation: Situation) -> Situation:
        """Return the situation as sensed.

        It is called in each step once per path, with the mask ``active`` of the scenarios that take the step; the state
        of all other scenarios must not change.

        Parameters
        ----------
        situation : Situation
            As it is.

        Returns
        -------
        Situation
            It may have more others than there are (false objects, appended), which are NaN in scenarios without them.
        """


SENSORS: Final[Registry[Sensor]] = Registry("sensor", "cornercase.sensors", Sensor)
"""Sensors by name."""
