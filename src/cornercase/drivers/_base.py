"""Base class of drivers, and the information that drivers get."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from cornercase._common.configurable import Configurable, describe_as_text, numeric_options
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.drivers._mutation import Mutation


@dataclass(frozen=True, eq=False)
class DrivenPath:
    """Path that the reference point of the driven entity follows.

    A path along a lane is the same in all N scenarios that are simulated together, and has arrays of P samples, shape
    (P,). A trajectory may differ between scenarios, and has arrays of shape (N, P).

    Attributes
    ----------
    distance : ndarray of float64, shape (P,) or (N, P)
        Distance along the path in m, increasing from 0, with steps of at most about 0.5 m in curves.
    x, y : ndarray of float64, shape (P,) or (N, P)
        Position in m.
    heading : ndarray of float64, shape (P,) or (N, P)
        Heading in rad, unwrapped.
    curvature : ndarray of float64, shape (P,) or (N, P)
        Curvature in 1/m, positive to the left.

    Raises
    ------
    ValueError
        If there are fewer than two samples, shapes differ, or distances do not increase from 0.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase.drivers import DrivenPath
    >>> distance = np.linspace(0.0, 100.0, 11)
    >>> along_x = DrivenPath(distance, distance, np.zeros(11), np.zeros(11), np.zeros(11))
    >>> float(np.interp(25.0, along_x.distance, along_x.x))
    25.0
    """

    distance: FloatArray
    x: FloatArray
    y: FloatArray
    heading: FloatArray
    curvature: FloatArray

    def __post_init__(self) -> None:
        shape = self.distance.shape
        if len(shape) not in (1, 2) or shape[-1] < 2:
            raise ValueError("a path needs at least two samples")
        if any(getattr(self, name).shape != shape for name in ("x", "y", "heading", "curvature")):
            raise ValueError("all arrays of a path must have the same shape")
        if self.distance[..., 0].any() or not (np.diff(self.distance) > 0.0).all():
            raise ValueError("the distances along a path must begin with 0, and each must exceed the one before")

    @cached_property
    def rows(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Distance, x, y and heading, shape (1, P) or (N, P), and largest distance between samples, shape (1,) or (N,).

        Compiled functions take the path in this form.
        """
        columns = (self.distance, self.x, self.y, self.heading)
        distance, x, y, heading = (np.ascontiguousarray(np.atleast_2d(column)) for column in columns)
        return distance, x, y, heading, np.hypot(np.diff(x), np.diff(y)).max(axis=1)


@dataclass(frozen=True, eq=False)
class Situation:
    """State of the traffic that a driver gets in a time step, for N concrete scenarios and A other entities.

    This is the true state, including what the driver cannot see: a driver has to model its own perception.

    A `DrivingFunction` gets the state at `time`. In the builtin simulator, any other `Driver` gets the state after the
    storyboard's actions in this step: an entity that an action moves is already at its new position.

    Attributes
    ----------
    time, time_step : float
        Time since the start of the scenarios, and duration of the coming time step, in s.
    path : DrivenPath
        Path of the driven entity, ahead and behind.
    distance : ndarray of float64, shape (N,)
        Position of the driven entity along the path, in m.
    x, y, heading, speed, acceleration : ndarray of float64, shape (N,)
        State of the driven entity's reference point in m, rad, m/s, m/s².
    length, width, center_x : float
        Length and width of the driven entity's bounding box, and position of the box's centre ahead of the reference
        point, in m.
    target_speed : ndarray of float64, shape (N,)
        Speed in m/s that the scenario's speed actions have set; infinite or NaN if none has set a speed.
    others_x, others_y, others_heading, others_speed : ndarray of float64, shape (N, A)
        State of the other entities in m, rad and m/s; NaN while an entity does not exist, or while a visibility action
        of the scenario hides it.
    others_length, others_width, others_center_x : ndarray of float64, shape (A,)
        Bounding boxes of the other entities in m, like that of the driven entity.
    others_object_type : tuple of str, length A
        Category of each other entity: a vehicle category such as ``"car"``, ``"pedestrian"`` or ``"misc"``.
    active : ndarray of bool, shape (N,)
        True in the scenarios in which the entity is driven along `path` in this step.
    others_name : tuple of str, length A
        Names of the other entities. An object that a sensor reports though it does not exist also has a name.
    signals : mapping of str to ndarray of str, shape (N,)
        State of each traffic signal by its name, as the scenario file writes it.

    Examples
    --------
    >>> import cornercase as cc
    >>> import numpy as np
    >>> class KeepAway(cc.Driver):
    ...     def acceleration(self, situation):
    ...         s = situation
    ...         distance = np.hypot(s.others_x - s.x[:, None], s.others_y - s.y[:, None])
    ...         return np.where((distance < 10.0 + 2.0 * s.speed[:, None]).any(axis=1), -6.0, 0.0)
    >>> cc.simulate("examples/r157/deceleration.xosc", drivers={"Ego": KeepAway()})
    <Recording of Ego (car), Other (car), 35.05 s in 702 instants, no collision>
    """

    time: float
    time_step: float
    path: DrivenPath
    distance: FloatArray
    x: FloatArray
    y: FloatArray
    heading: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    length: float
    width: float
    center_x: float
    target_speed: FloatArray
    others_x: FloatArray
    others_y: FloatArray
    others_heading: FloatArray
    others_speed: FloatArray
    others_length: FloatArray
    others_width: FloatArray
    others_center_x: FloatArray
    others_object_type: tuple[str, ...]
    active: BoolArray
    others_name: tuple[str, ...] = ()
    signals: Mapping[str, npt.NDArray[np.str_]] = field(default_factory=dict)


class Driver(Configurable, ABC):
    """Base class of drivers, which decide the acceleration of an entity along its path in many scenarios at once.

    A decision in one scenario may depend only on the past of this scenario: no random numbers, no clock, nothing from
    other scenarios. Derive your own driver from this class and implement `acceleration`; if the driver has state, also
    override `start`.

    Attributes
    ----------
    settings : dict
        Everything that decisions depend on, as plain JSON values. It is stored with a study, which can only be resumed
        with the same settings. The default is the name of the class. Options of the constructor that are numbers, texts
        or booleans are stored, too. A study refuses any other option, such as a list or an array, unless `settings` has
        an entry under the option's name, as in ``self.settings = {"gains": [1.0, 2.0]}``.
    mutations : tuple of Mutation, default empty
        Changes that make the driver worse, for `cornercase reduce --kill-mutants` and `cornercase test --mutants`.

    See Also
    --------
    Situation : Input of a driver.

    Examples
    --------
    The class may be defined in a script, a notebook or a module. Objects of the class drive in any simulator that takes
    drivers, also in worker processes, which load the class together with the object.

    >>> import cornercase as cc
    >>> class Brake(cc.Driver):
    ...     def __init__(self, deceleration=2.0):
    ...         self.deceleration = deceleration
    ...
    ...     def acceleration(self, situation):
    ...         return 0.0 * situation.speed - self.deceleration
    >>> scenario = "examples/x_intersection/x_intersection.xosc"
    >>> recording = cc.simulate(scenario, drivers={"Ego": Brake(deceleration=3.0)}, duration=5.0)
    >>> float(recording.speed[recording.entity_index("Ego"), -1])
    0.0
    """

    settings: dict[str, object]
    mutations: ClassVar[tuple[Mutation, ...]] = ()

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if not any("settings" in vars(base) for base in cls.__mro__):
            cls.settings = {"driver": f"{cls.__module__}:{cls.__qualname__}"}

    def __str__(self) -> str:
        # A class of a user may have a `name` of its own.
        return describe_as_text(self)

    def numeric_parameters(self) -> dict[str, float]:
        """Return the numeric options of the constructor, which can be dimensions of a search.

        Returns
        -------
        dict of str to float
        """
        return numeric_options(self)

    def start(self, scenarios: int, others: int) -> None:
        """Reset all state before a batch (scenarios simulated together) starts; does nothing by default.

        Parameters
        ----------
        scenarios, others : int
            Number N of concrete scenarios, and number A of other entities in each scenario.
        """

    @abstractmethod
    def acceleration(self, situation: Situation) -> FloatArray:
        """Return the acceleration along the path for the coming time step.

        In each time step, the method is called once for each path that the driven entity follows in some scenarios; the
        mask ``Situation.active`` marks these scenarios. In all other scenarios, the result is ignored, the situation
        may belong to a later time, and the state of the driver must not change.

        Parameters
        ----------
        situation : Situation
            State of the driven entity and of the others.

        Returns
        -------
        ndarray of float64, shape (N,)
            Acceleration in m/s².
        """
