"""Drives of vehicle models from the origin."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.drivers import VEHICLES, Body, PlanarMotion, Start, VehicleModel

DT: Final = 0.05
WHEELBASE: Final = 2.7
_Input = Callable[[float], float]


def start(vehicle: str | VehicleModel, n: int = 1, dt: float = DT, **parameters: FloatArray) -> VehicleModel:
    """Return a started vehicle model."""
    model = VEHICLES.create(vehicle) if isinstance(vehicle, str) else vehicle
    body = Body("Ego", "car", 4.5, 1.8, 1.4, WHEELBASE, 0.6)
    model.start(Start(body, dt, parameters, ({},) * n, (0,) * n, (), None, np.ones(n)))
    return model


def drive(
    vehicle: str | VehicleModel,
    speed: float,
    duration: float,
    acceleration: _Input = lambda t: 0.0,
    steering: _Input = lambda t: 0.0,
    friction: float = 1.0,
    dt: float = DT,
) -> Mapping[str, FloatArray]:
    """Drive from the origin, and return the motion over time."""
    model, states = start(vehicle, dt=dt), [np.array([0.0, 0.0, 0.0, speed, 0.0])]
    for k in range(round(duration / dt)):
        motion = PlanarMotion(*states[-1][:, None])
        a, angle, active = np.array([acceleration(k * dt)]), np.array([steering(k * dt)]), np.ones(1, dtype=bool)
        moved = model.step(motion, a, angle, np.array([friction]), dt, active)
        states.append(np.concatenate((moved.x, moved.y, moved.heading, moved.speed, moved.acceleration)))
    return dict(zip(("x", "y", "heading", "speed", "acceleration"), np.array(states).T, strict=True))
