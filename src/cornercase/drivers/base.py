"""The base class of drivers, and what they are given."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class DrivenPath:
    """What the reference point of the driven entity will follow.

    A lane is the same for all scenarios of a batch and has arrays of shape (P,). A trajectory may run otherwise in
    each scenario; then they are of shape (N, P).

    Attributes
    ----------
    distance : ndarray of float64, shape (P,) or (N, P)
        m along the path, increasing from 0, at most about 0.5 m apart in curves.
    x, y : ndarray of float64, shape (P,) or (N, P)
        m.
    heading : ndarray of float64, shape (P,) or (N, P)
        rad, unwrapped.
    curvature : ndarray of float64, shape (P,) or (N, P)
        1/m, positive to the left.

    Raises
    ------
    ValueError
        Fewer than two samples, unequal shapes, or distances that do not increase from 0.
    """

    distance: FloatArray
    x: FloatArray
    y: FloatArray
    heading: FloatArray
    curvature: FloatArray

    def __post_init__(self) -> None:
        shape = self.distance.shape
        if len(shape) not in (1, 2) or shape[-1] < 2:
            raise ValueError("a path has at least two samples")
        if any(getattr(self, name).shape != shape for name in ("x", "y", "heading", "curvature")):
            raise ValueError("all arrays of a path have one shape")
        if self.distance[..., 0].any() or not (np.diff(self.distance) > 0.0).all():
            raise ValueError("the distances of a path increase from 0")


@dataclass(frozen=True, eq=False)
class Situation:
    """What a driver is told at one instant, for N concrete scenarios and A other entities.

    It is the truth, not what can be seen: what a driver perceives of it is the driver's own business.

    Attributes
    ----------
    time, time_step : float
        s.
    path : DrivenPath
    distance : ndarray of float64, shape (N,)
        Place of the driven entity along the path, in m.
    x, y, heading, speed, acceleration : ndarray of float64, shape (N,)
        Motion of the driven entity's reference point in m, rad, m/s, m/s².
    length, width, center_x : float
        Its bounding box in m, as in a recording.
    target_speed : ndarray of float64, shape (N,)
        What the scenario's speed actions ask for, in m/s; infinite or NaN where they ask nothing.
    others_x, others_y, others_heading, others_speed : ndarray of float64, shape (N, A)
        Motion of the other entities; NaN where one does not exist.
    others_length, others_width, others_center_x : ndarray of float64, shape (A,)
        m.
    others_kind : tuple of str, length A
        Vehicle category, ``"pedestrian"`` or ``"misc"``.
    active : ndarray of bool, shape (N,)
        Scenarios in which the entity is to be driven along this path now.
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
    others_kind: tuple[str, ...]
    active: BoolArray


class Driver(ABC):
    """Decides the speed of one entity along its path, for all concrete scenarios of a batch in lock-step.

    What a driver does in one scenario is a function of that scenario's past alone: no random numbers, no clock,
    nothing of the other scenarios. A driver of your own is a subclass with `acceleration`; one with a state also
    overrides `start`.

    Attributes
    ----------
    settings : dict
        Everything that its decisions depend on, as plain JSON values. It is stored with a study, and a study goes on
        only with the same settings. By default the name of the class, which is enough where nothing can be set.
    """

    settings: dict[str, object]

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if not any("settings" in vars(one) for one in cls.__mro__):
            cls.settings = {"driver": f"{cls.__module__}:{cls.__qualname__}"}

    def start(self, scenarios: int, others: int) -> None:  # noqa: B027
        """Forget everything, as a batch begins; by default there is nothing to forget.

        Parameters
        ----------
        scenarios, others : int
            Numbers N of concrete scenarios, and A of other entities in each.
        """

    @abstractmethod
    def acceleration(self, situation: Situation) -> FloatArray:
        """Acceleration along the path for the coming time step.

        In each time step it is called once per path, with masks ``active`` that exclude each other. What is returned
        for scenarios that are not active is not used, and what is kept of them must not change.

        Parameters
        ----------
        situation : Situation

        Returns
        -------
        ndarray of float64, shape (N,)
            m/s².
        """
