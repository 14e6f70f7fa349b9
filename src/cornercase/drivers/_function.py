"""Driving functions: drivers that decide more than an acceleration, for all scenarios of a batch."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.drivers._base import Driver, Situation
from cornercase.drivers._controls import Controls

if TYPE_CHECKING:
    from cornercase.roads._network import RoadNetwork


@dataclass(frozen=True, eq=False)
class Body:
    """The driven vehicle, as the scenario file describes it.

    Attributes
    ----------
    name, object_type : str
        Name of the entity; vehicle category, ``"pedestrian"`` or ``"misc"``.
    length, width, center_x : float
        Bounding box in m, as in a recording.
    wheelbase : float
        Distance of the axles in m; by default 0.6 of the length.
    max_steering : float
        Largest angle of the front wheels in rad.
    max_speed, max_acceleration, max_deceleration : float
        Limits in m/s and m/s²; infinite if the file has none.

    Examples
    --------
    A driving function reads it when a batch starts:

    >>> import cornercase as cc
    >>> from cornercase.drivers import Controls, DrivingFunction
    >>> class BrakeFully(DrivingFunction):
    ...     def prepare(self, start):
    ...         self.limit = min(start.body.max_deceleration, 8.0)
    ...
    ...     def decide(self, situation):
    ...         return Controls.from_acceleration(0.0 * situation.speed - self.limit)
    >>> recording = cc.simulate("examples/r157/deceleration.xosc", drivers={"Ego": BrakeFully()}, duration=1.0)
    >>> round(float(recording.acceleration[recording.entity_index("Ego"), -1]), 3)
    -8.0
    """

    name: str
    object_type: str
    length: float
    width: float
    center_x: float
    wheelbase: float
    max_steering: float
    max_speed: float = np.inf
    max_acceleration: float = np.inf
    max_deceleration: float = np.inf


@dataclass(frozen=True, eq=False)
class Start:
    """What a driving function, a sensor and a vehicle know when a batch of N scenarios starts.

    Attributes
    ----------
    body : Body
        The driven vehicle.
    time_step : float
        In s.
    parameters : mapping of str to ndarray of float64, shape (N,)
        Own parameters that differ between scenarios, such as ``"reaction"`` for a dimension ``Ego.reaction``. An
        `AttachedDriver` is given those of all its parts; driver, sensors and vehicle are given their own.
    values : tuple of mapping, length N
        Values of the scenario file's parameters that differ from those in the file, by scenario.
    seeds : sequence of int, length N
        Seed of each scenario and run. The same scenario in the same run of the same study has the same seed, whatever
        the batch and the number of workers.
    others : tuple of str, length A
        Names of the other entities.
    network : RoadNetwork or None
        The roads.
    friction : ndarray of float64, shape (N,)
        Friction coefficient of the road: the scenario's ``frictionScaleFactor``, with which it changes during the
        batch; 1 as long as there is none.

    Examples
    --------
    >>> import cornercase as cc
    >>> import numpy as np
    >>> from cornercase.drivers import Controls, DrivingFunction
    >>> class Hesitant(DrivingFunction):
    ...     def prepare(self, start):
    ...         self.delay = np.array([start.generator(n, "delay").uniform(1.0, 3.0) for n in range(start.scenarios)])
    ...
    ...     def decide(self, situation):
    ...         return Controls.from_acceleration(np.where(situation.time < self.delay, 0.0, -4.0))
    >>> cc.simulate("examples/r157/deceleration.xosc", drivers={"Ego": Hesitant()}, duration=5.0)
    <Recording of Ego (car), Other (car), 5 s in 101 instants, no collision>
    """

    body: Body
    time_step: float
    parameters: Mapping[str, FloatArray]
    values: tuple[Mapping[str, object], ...]
    seeds: Sequence[int]
    others: tuple[str, ...]
    network: RoadNetwork | None
    friction: FloatArray

    @property
    def scenarios(self) -> int:
        """Number N of scenarios."""
        return len(self.seeds)

    def generator(self, scenario: int, purpose: str) -> np.random.Generator:
        """Return the random generator of a scenario.

        Parameters
        ----------
        scenario : int
            Its number in the batch.
        purpose : str
            Such as the name of a sensor: each purpose has random numbers of its own, for each driven entity.

        Returns
        -------
        numpy.random.Generator
        """
        return np.random.default_rng([self.seeds[scenario], *f"{self.body.name}: {purpose}".encode()])


class DrivingFunction(Driver):
    """A driver that decides controls for a batch: adapters of what users attach derive from it.

    `prepare` is called once per batch, before the first step; `Start.parameters` has a value for each scenario of those
    `numeric_parameters` that are dimensions of a search. `decide` is called in each step once per path, with the
    mask ``active`` as in `Driver.acceleration`. `release` is called when the batch has ended, also after a failure.

    Examples
    --------
    >>> import cornercase as cc
    >>> from cornercase.drivers import Controls, DrivingFunction
    >>> class KeepSpeed(DrivingFunction):
    ...     def __init__(self, gain=0.5):
    ...         self.gain = gain
    ...
    ...     def decide(self, situation):
    ...         return Controls.from_acceleration(self.gain * (20.0 - situation.speed))
    >>> recording = cc.simulate("examples/r157/cut_out.xosc", drivers={"Ego": KeepSpeed(gain=2.0)}, duration=5.0)
    >>> round(float(recording.speed[recording.entity_index("Ego"), -1]), 3)
    20.0
    """

    options_may_vary: ClassVar[bool] = False
    """Whether an option that it is given can be a dimension of a search, too."""

    def options_in_force(self) -> Mapping[str, object]:
        """Return its options with their values, for people.

        Returns
        -------
        mapping of str to object
            By default those that are numbers.
        """
        return self.numeric_parameters()

    def prepare(self, start: Start) -> None:
        """Reset all state at the start of a batch; does nothing by default.

        Parameters
        ----------
        start : Start
            What is known then.
        """

    @abstractmethod
    def decide(self, situation: Situation) -> Controls:
        """Decide the coming time step.

        Parameters
        ----------
        situation : Situation
            State of the driven entity and of the others.

        Returns
        -------
        Controls
            Those of scenarios that are not active are ignored.
        """

    def describe(self) -> Sequence[str]:
        """Return lines about it that `cornercase check` prints; none by default.

        Returns
        -------
        sequence of str
            Such as what is connected to what.
        """
        return ()

    def release(self) -> None:
        """Release processes and files at the end of a batch."""

    def acceleration(self, situation: Situation) -> FloatArray:
        """Return the acceleration that `decide` gives.

        Parameters
        ----------
        situation : Situation
            As for `decide`.

        Returns
        -------
        ndarray of float64, shape (N,)
            In m/s²; NaN where it decides something else.
        """
        return self.decide(situation).acceleration
