"""The dynamic single-track model: a vehicle whose tyres slip."""

from __future__ import annotations

from typing import Any, ClassVar

from cornercase.drivers.vehicles._actuated import SteeredVehicle
from cornercase.drivers.vehicles._kernels.actuators import SINGLE_TRACK


class SingleTrack(SteeredVehicle):
    """Dynamic single-track model with linear tyres that slide at the friction limit.

    This is CommonRoad's model ST (Althoff, Koschi and Manzinger 2017). The defaults are CommonRoad's vehicle 2, a BMW
    320i. See ``docs/vehicles.md``.

    Parameters
    ----------
    mass : float
        Mass in kg.
    inertia : float
        Moment of inertia about the vertical axis in kg m².
    front_axle, rear_axle : float
        Distance of each axle from the centre of gravity in m.
    front_stiffness, rear_stiffness : float
        Lateral force of an axle per slip angle, load and friction coefficient, in 1/rad.
    height : float
        Height of the centre of gravity in m.
    mu : float
        Friction coefficient of the tyres on a dry road; multiplied by the friction coefficient of the road.
    max_steering_rate : float
        Highest change of the angle of the front wheels in rad/s.
    **options
        Options ``delay``, ``lag``, ``max_jerk``, ``steering_delay`` and ``steering_lag``, as in `Kinematic`.

    Raises
    ------
    InputError
        If an option is out of range.

    Examples
    --------
    >>> import cornercase as cc
    >>> from cornercase.drivers import DRIVERS, EquippedDriver, SingleTrack
    >>> driver = EquippedDriver(DRIVERS.create("normal"), vehicle=SingleTrack())
    >>> cc.simulate("examples/r157/deceleration.xosc", drivers={"Ego": driver})
    <Recording of Ego (car), Other (car), 35.05 s in 702 instants, no collision>
    """

    name = "single-track"
    parameter_names: ClassVar = (
        *("mass", "inertia", "front_axle", "rear_axle", "front_stiffness", "rear_stiffness", "height"),
    )
    kind = SINGLE_TRACK

    def __init__(
        self,
        *,
        mass: float = 1093.3,
        inertia: float = 1791.6,
        front_axle: float = 1.1562,
        rear_axle: float = 1.4227,
        front_stiffness: float = 20.898,
        rear_stiffness: float = 20.898,
        height: float = 0.6137,
        mu: float = 1.0489,
        max_steering_rate: float = 0.4,
        **options: Any,
    ) -> None:
        super().__init__(mu=mu, max_steering_rate=max_steering_rate, **options)
        self._set_parameters(
            mass=mass,
            inertia=inertia,
            front_axle=front_axle,
            rear_axle=rear_axle,
            front_stiffness=front_stiffness,
            rear_stiffness=rear_stiffness,
            height=height,
        )

    def _derived_parameters(self, values: dict[str, Any]) -> dict[str, Any]:
        return {"wheelbase": values["front_axle"] + values["rear_axle"]}
