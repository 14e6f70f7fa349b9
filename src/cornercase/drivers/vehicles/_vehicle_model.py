"""Base class of vehicle models, which turn controls into motion."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Final

from cornercase._common.configurable import Configurable
from cornercase._common.registry import Registry
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.drivers._driving_function import Start


@dataclass(frozen=True, eq=False)
class PlanarMotion:
    """Pose and speed of the reference point (middle of the rear axle) in N scenarios.

    Attributes
    ----------
    x, y, heading, speed, acceleration : ndarray of float64, shape (N,)
        Values in m, rad, m/s and m/s². The heading is unwrapped, and the acceleration is along the heading.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import numpy as np
    >>> from cornercase.drivers import PlanarMotion
    >>> x, y, heading, speed, acceleration = np.zeros((5, 2))
    >>> motion = PlanarMotion(x, y, heading, speed + 20.0, acceleration)
    >>> replace(motion, x=motion.x + motion.speed * np.cos(motion.heading) * 0.05).x
    array([1., 1.])
    """

    x: FloatArray
    y: FloatArray
    heading: FloatArray
    speed: FloatArray
    acceleration: FloatArray


class VehicleModel(Configurable, ABC):
    """Base class of vehicle models, which move a vehicle by its controls, in many concrete scenarios at once.

    All numeric options of the constructor can be dimensions of a search: `Start.parameters` then has one value for each
    scenario. Scenarios do not depend on each other.

    Attributes
    ----------
    name : str
        Name in the registry.
    steers : bool
        True if the model computes position and heading. If False, only the speed that it computes is used, and the
        vehicle stays on its path.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import cornercase as cc
    >>> import numpy as np
    >>> from cornercase.drivers import DRIVERS, EquippedDriver, VehicleModel
    >>> class WeakBrakes(VehicleModel):
    ...     steers = False
    ...
    ...     def start(self, start):
    ...         pass
    ...
    ...     def step(self, motion, acceleration, steering, friction, time_step, active):
    ...         reached = np.where(active, np.maximum(acceleration, -3.0), 0.0)
    ...         return replace(motion, speed=np.maximum(motion.speed + reached * time_step, 0.0), acceleration=reached)
    >>> driver = EquippedDriver(DRIVERS.create("normal"), vehicle=WeakBrakes())
    >>> cc.simulate("examples/r157/deceleration.xosc", drivers={"Ego": driver})
    <Recording of Ego (car), Other (car), 6.1 s in 123 instants, Ego and Other collide at 6.1 s>
    """

    steers: bool = True

    @property
    def steering_response(self) -> FloatArray | float:
        """Time in s by which the wheels lag behind a request; a path controller steers earlier by this time.

        Returns
        -------
        ndarray of float64, shape (N,), or float
            A float holds for all scenarios.
        """
        return 0.0

    @property
    def wheelbase(self) -> FloatArray | None:
        """Distance between the axles in m, from which a path controller computes the angle of the wheels.

        Returns
        -------
        ndarray of float64, shape (N,), or None
            None stands for the distance in the scenario file.
        """
        return None

    @abstractmethod
    def start(self, start: Start) -> None:
        """Reset all state before a batch (scenarios simulated together) starts.

        Parameters
        ----------
        start : Start
            Vehicle, parameters, seeds and roads of the scenarios.
        """

    @abstractmethod
    def step(
        self,
        motion: PlanarMotion,
        acceleration: FloatArray,
        steering: FloatArray,
        friction: FloatArray,
        time_step: float,
        active: BoolArray,
    ) -> PlanarMotion:
        """Return the motion at the end of a time step.

        Parameters
        ----------
        motion : PlanarMotion
            Motion at the start of the step; the state of scenarios that are not active must not change.
        acceleration : ndarray of float64, shape (N,)
            Requested acceleration in m/s².
        steering : ndarray of float64, shape (N,)
            Requested angle of the front wheels in rad, positive to the left; ignored by a model that does not steer.
        friction : ndarray of float64, shape (N,)
            Friction coefficient of the road.
        time_step : float
            Duration of the step in s.
        active : ndarray of bool, shape (N,)
            True for the scenarios that take the step.

        Returns
        -------
        PlanarMotion
        """


VEHICLES: Final[Registry[VehicleModel]] = Registry("vehicle", "cornercase.vehicles", VehicleModel)
"""Vehicle models by name."""

VEHICLES.register("actuators", "cornercase.drivers.vehicles._actuated:Actuators")
VEHICLES.register("kinematic", "cornercase.drivers.vehicles._kinematic:Kinematic")
VEHICLES.register("single-track", "cornercase.drivers.vehicles._single_track:SingleTrack")
