"""Driving functions: drivers that can also steer, follow trajectories and change lanes."""

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
        Name of the entity, and its category: a vehicle category such as ``"car"``, ``"pedestrian"`` or ``"misc"``.
    length, width, center_x : float
        Length and width of the bounding box, and position of its centre ahead of the reference point, in m.
    wheelbase : float
        Distance between the axles in m; by default 0.6 of the length.
    max_steering : float
        Largest angle of the front wheels in rad.
    max_speed, max_acceleration, max_deceleration : float
        Limits in m/s and m/s²; infinite if the scenario file has none, but 0 for the speed of a misc object.

    Examples
    --------
    A driving function reads the limits of its vehicle before the first step:

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
    """Information for driving functions, sensors and vehicle models when N scenarios start to be simulated together.

    Attributes
    ----------
    body : Body
        The driven vehicle.
    time_step : float
        Duration of a time step in s.
    parameters : mapping of str to ndarray of float64, shape (N,)
        Options that differ between scenarios, such as ``"reaction"`` if ``Ego.reaction`` is a dimension of the search.
        The driver, each sensor and the vehicle model are given only their own options.
    values : tuple of mapping, length N
        For each scenario, the values that are set for parameters of the scenario file. Parameters that are left out
        have the value in the file.
    seeds : sequence of int, length N
        Seed of each scenario. The seed follows from the seed of the study, the number of the repetition, and the
        parameter values of the scenario; the number of scenarios and of worker processes has no effect.
    others : tuple of str, length A
        Names of the other entities.
    network : RoadNetwork or None
        The roads.
    friction : ndarray of float64, shape (N,)
        Friction coefficient of the road: the scenario's ``frictionScaleFactor``, or 1 before the scenario sets one. The
        values change when the scenario changes the friction.

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
        """Return a random generator for one scenario and one purpose.

        Parameters
        ----------
        scenario : int
            Index of the scenario.
        purpose : str
            Any text, such as the name of a sensor; each purpose of each driven entity has its own random numbers.

        Returns
        -------
        numpy.random.Generator
        """
        return np.random.default_rng([self.seeds[scenario], *f"{self.body.name}: {purpose}".encode()])


class DrivingFunction(Driver):
    """Base class of drivers that can also steer, follow trajectories and change lanes, in many scenarios at once.

    A batch is a set of scenarios that are simulated together. `prepare` is called once per batch, before the first
    step. If a search varies some of the `numeric_parameters`, `Start.parameters` has one value per scenario for each
    of them. In each step, `decide` is called once for each path that the driven entity follows in some scenarios of the
    batch; the mask ``Situation.active`` marks these scenarios. `release` is called at the end of the batch, also after
    a failure.

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
    """True if an option that was given can still be a dimension of a search."""

    def options_in_force(self) -> Mapping[str, object]:
        """Return the options of the function with their values, for display.

        Returns
        -------
        mapping of str to object
            By default the numeric options.
        """
        return self.numeric_parameters()

    def prepare(self, start: Start) -> None:
        """Reset all state before a batch (scenarios simulated together) starts; does nothing by default.

        Parameters
        ----------
        start : Start
            Vehicle, parameters, seeds and roads of the scenarios.
        """

    @abstractmethod
    def decide(self, situation: Situation) -> Controls:
        """Return the decisions for the coming time step.

        Parameters
        ----------
        situation : Situation
            State of the driven entity and of the others.

        Returns
        -------
        Controls
            Decisions in scenarios that are not active are ignored.
        """

    def describe(self) -> Sequence[str]:
        """Return text lines about the function, which `cornercase check` prints; none by default.

        Returns
        -------
        sequence of str
            Lines such as which inputs and outputs are connected.
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
            Acceleration in m/s²; NaN in scenarios in which `decide` gives something else, such as a trajectory.
        """
        return self.decide(situation).acceleration
