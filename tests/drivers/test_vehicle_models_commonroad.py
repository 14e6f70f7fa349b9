"""Vehicle models against CommonRoad's own code."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from conftest import at_night
from cornercase._common.typing import FloatArray
from helpers.vehicle_drives import DT, drive

dynamics = pytest.importorskip("vehiclemodels.vehicle_dynamics_st")
kinematics = pytest.importorskip("vehiclemodels.vehicle_dynamics_ks")
parameters = pytest.importorskip("vehiclemodels.parameters_vehicle2")

# Changes of the steering angle in rad, each at the time in s, and an acceleration in m/s² from 1 s on.
MANOEUVRES = {
    "step": ([(0.0, 0.05)], 0.0),
    "lane change": ([(0.0, 0.04), (1.0, -0.04), (2.0, 0.0)], 0.0),
    "braking in a curve": ([(0.0, 0.04)], -3.0),
    "accelerating in a curve": ([(0.0, -0.06)], 1.5),
}
RATE = 0.4
"""Highest steering rate of vehicle 2 in rad/s."""


def integrate(derivative: Callable[..., Any], speed: float, duration: float, manoeuvre: str, size: int) -> FloatArray:
    """Return states of a model of CommonRoad at each time step, by small steps of an integrator of scipy."""
    vehicle = parameters.parameters_vehicle2()
    angles, late = MANOEUVRES[manoeuvre]

    def change(time: float, state: FloatArray) -> FloatArray:
        wanted = [angle for begin, angle in angles if begin <= time + 1e-9][-1]
        steering_rate = np.clip((wanted - state[2]) / 1e-4, -RATE, RATE)
        return np.array(derivative(list(state), [steering_rate, late if time >= 1.0 - 1e-9 else 0.0], vehicle))

    states = [np.array([0.0, 0.0, 0.0, speed] + [0.0] * (size - 4))]
    for k in range(round(duration / DT)):
        span = k * DT, (k + 1) * DT - 1e-7
        states.append(solve_ivp(change, span, states[-1], max_step=2e-4, method="RK23").y[:, -1])
    return np.array(states).T


def steering(manoeuvre: str) -> Callable[[float], float]:
    return lambda t: [angle for begin, angle in MANOEUVRES[manoeuvre][0] if begin <= t + 1e-9][-1]


def acceleration(manoeuvre: str) -> Callable[[float], float]:
    return lambda t: MANOEUVRES[manoeuvre][1] if t >= 1.0 - 1e-9 else 0.0


# At lower speeds slip decays faster than a time step lasts.
DRIVES = [
    (model, manoeuvre, speed)
    for model in ("kinematic", "single-track")
    for manoeuvre, speed in [*((one, 15.0) for one in MANOEUVRES), ("lane change", 5.0)]
]
BY_DAY = {("kinematic", "braking in a curve", 15.0), ("single-track", "lane change", 15.0)}


@pytest.mark.parametrize("drive_of", at_night(DRIVES, {*DRIVES} - BY_DAY), ids=str)
def test_trajectories_agree_within_a_thousandth(drive_of: tuple[str, str, float]) -> None:
    model, manoeuvre, speed = drive_of
    vehicle = parameters.parameters_vehicle2()
    is_kinematic = model == "kinematic"
    spec = f"kinematic:wheelbase={vehicle.a + vehicle.b},max_steering_rate={RATE}" if is_kinematic else model
    driven = drive(spec, speed, 3.0, acceleration(manoeuvre), steering(manoeuvre))
    derivative = kinematics.vehicle_dynamics_ks if is_kinematic else dynamics.vehicle_dynamics_st
    states = integrate(derivative, speed, 3.0, manoeuvre, 5 if is_kinematic else 7)
    x, y, _, _, heading = states[:5]
    if not is_kinematic:
        # Theirs is the centre of gravity, ours the rear axle.
        x, y = x - vehicle.b * np.cos(heading) + vehicle.b, y - vehicle.b * np.sin(heading)
    deviation = np.hypot(driven["x"] - x, driven["y"] - y)
    assert np.abs(y).max() > 0.4
    assert deviation.max() < 1e-3 * np.abs(y).max()
    assert np.abs(driven["heading"] - heading).max() < 1e-3 * np.abs(heading).max()
