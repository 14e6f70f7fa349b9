"""The kinematic single-track model: a vehicle that rolls where its wheels point."""

from __future__ import annotations

from typing import Any

from cornercase.drivers.vehicles._actuated import SteeredVehicle
from cornercase.drivers.vehicles._kernels.actuators import KINEMATIC


class Kinematic(SteeredVehicle):
    """Kinematic single-track model about the rear axle: its wheels do not slip.

    If a curve asks for more than the tyres can do, the vehicle understeers. See ``docs/vehicles.md``.

    Parameters
    ----------
    wheelbase : float, optional
        Distance between the axles in m; by default the one in the scenario file.
    **options
        Options of `SteeredVehicle`, such as ``steering_lag`` and ``delay``.

    Raises
    ------
    InputError
        If an option is out of range.

    Examples
    --------
    >>> import cornercase as cc
    >>> from cornercase.drivers import DRIVERS, EquippedDriver, Kinematic
    >>> driver = EquippedDriver(DRIVERS.create("normal"), vehicle=Kinematic())
    >>> cc.simulate("examples/r157/deceleration.xosc", drivers={"Ego": driver})
    <Recording of Ego (car), Other (car), 35.05 s in 702 instants, no collision>
    """

    name = "kinematic"
    kind = KINEMATIC

    def __init__(self, *, wheelbase: float | None = None, **options: Any) -> None:
        super().__init__(**options)
        if wheelbase is not None:
            self._set_parameters(wheelbase=wheelbase)
