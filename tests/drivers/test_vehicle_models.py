"""Vehicle models against closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from itertools import pairwise

import numpy as np
import pytest

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.drivers import VEHICLES, Body, PlanarMotion, Start, VehicleModel

DT = 0.05
WHEELBASE = 2.7
GRAVITY = 9.81
Input = Callable[[float], float]


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
    acceleration: Input = lambda t: 0.0,
    steering: Input = lambda t: 0.0,
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


@pytest.mark.parametrize(
    ("options", "friction", "distance"),
    [
        ("", 1.0, 20.0**2 / (2 * 6.0)),
        # A dead time costs its time at full speed; so does a lag, less a term that is quadratic in it.
        ("delay=0.12", 1.0, 20.0 * 0.12 + 20.0**2 / (2 * 6.0)),
        ("delay=0.1,lag=0.2", 1.0, 20.0 * 0.3 + 20.0**2 / (2 * 6.0) - 6.0 * 0.2**2 / 2),
        # Brakes that build up at 20 m/s³ are full after 0.3 s.
        ("max_jerk=20", 1.0, 20.0 * 0.15 + 20.0**2 / (2 * 6.0) - 6.0 * 0.3**2 / 24),
        ("mu=0.8", 0.5, 20.0**2 / (2 * 0.4 * GRAVITY)),
    ],
)
def test_braking_distance(options: str, friction: float, distance: float) -> None:
    spec = ":".join(filter(None, ("kinematic", options)))
    motion = drive(spec, 20.0, 8.0, lambda t: -6.0, friction=friction)
    assert motion["speed"][-1] == 0.0
    assert motion["x"][-1] == pytest.approx(distance, rel=1e-3)


@pytest.mark.parametrize("dt", [0.01, 0.05, 0.1])
def test_lag_is_a_time_constant_for_any_time_step(dt: float) -> None:
    motion = drive("kinematic:delay=0.1,lag=0.3", 5.0, 2.0, lambda t: 2.0, dt=dt)
    time = dt * np.arange(len(motion["speed"]))
    late = np.maximum(time - 0.1, 0.0)
    assert motion["acceleration"][1:] == pytest.approx(2.0 * (1.0 - np.exp(-late / 0.3))[1:], abs=1e-9)
    assert motion["speed"] == pytest.approx(5.0 + 2.0 * (late - 0.3 * (1.0 - np.exp(-late / 0.3))), abs=1e-9)


def test_kinematic_model_drives_a_circle() -> None:
    motion = drive("kinematic", 10.0, 10.0, steering=lambda t: 0.1)
    radius = WHEELBASE / math.tan(0.1)
    assert motion["heading"][-1] == pytest.approx(100.0 / radius)
    assert np.hypot(motion["x"], motion["y"] - radius) == pytest.approx(radius)


def test_kinematic_model_understeers_at_the_friction_limit() -> None:
    motion = drive("kinematic:mu=0.2", 20.0, 2.0, steering=lambda t: 0.2)
    yaw_rates = np.diff(motion["heading"]) / DT
    assert motion["speed"][-1] * yaw_rates[-1] == pytest.approx(0.2 * GRAVITY)


def test_braking_and_steering_share_the_friction() -> None:
    # v²/R = 5 m/s² leaves √(9.81² - 5²) m/s².
    angle = math.atan(5.0 * WHEELBASE / 20.0**2)
    motion = drive("kinematic", 20.0, 0.01, lambda t: -9.81, lambda t: angle if t else 0.0, dt=0.001)
    assert motion["acceleration"][-1] == pytest.approx(-math.sqrt(GRAVITY**2 - 5.0**2), rel=0.02)


def test_steering_turns_late_slowly_and_up_to_its_limit() -> None:
    motion = drive("kinematic:steering_delay=0.1,max_steering_rate=0.4", 1.0, 3.0, steering=lambda t: 1.0)
    curvature = np.diff(motion["heading"]) / DT
    assert not curvature[:2].any()
    assert curvature[3] == pytest.approx(math.tan(0.4 * 0.075) / WHEELBASE, rel=1e-3)
    assert curvature[-1] == pytest.approx(math.tan(0.6) / WHEELBASE)


def test_scenarios_have_parameters_of_their_own_and_the_same_bytes_alone() -> None:
    mu = np.array([0.2, 0.5, 1.0])
    friction, active = np.array([1.0, 0.9, 0.8]), np.array([True, True, False])

    def run(chosen: slice) -> list[FloatArray]:
        model = start("kinematic:delay=0.07,lag=0.2", len(mu[chosen]), mu=mu[chosen])
        zeros = np.zeros(len(mu[chosen]))
        motion = PlanarMotion(zeros, zeros, zeros, zeros + 15.0, zeros)
        for _ in range(40):
            inputs = zeros - 7.0, zeros + 0.02, friction[chosen]
            motion = model.step(motion, *inputs, DT, active[chosen])
        return list(vars(motion).values())

    together, alone = run(slice(None)), [run(slice(k, k + 1)) for k in range(3)]
    for quantity, row in enumerate(together):
        assert row.tolist() == [values[quantity].item() for values in alone]
    assert together[3][2] == 15.0
    assert all(slower > faster for slower, faster in pairwise(together[3][:2]))


def test_something_else_that_sets_the_speed_resets_the_actuators() -> None:
    model, one = start("kinematic:lag=0.5"), np.ones(1, dtype=bool)
    zero, motion = np.zeros(1), PlanarMotion(*np.array([0.0, 0.0, 0.0, 20.0, 0.0])[:, None])
    motion = model.step(motion, zero - 8.0, zero, zero + 1.0, DT, one)
    braked = PlanarMotion(motion.x, motion.y, motion.heading, zero + 10.0, zero - 3.0)
    assert model.step(braked, zero - 3.0, zero, zero + 1.0, DT, one).speed[0] == pytest.approx(10.0 - 3.0 * DT)


def test_text_of_a_vehicle_makes_it_again() -> None:
    spec = "kinematic:mu=0.2,wheelbase=2.5,steering_lag=0.1"
    assert str(VEHICLES.create(spec)) == spec
    assert VEHICLES.create(str(VEHICLES.create(spec))) == VEHICLES.create(spec)


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("kinematic:mu=0", "`mu` 0: give a number above 0"),
        ("kinematic:wheelbase=long", "`wheelbase` 'long': give a number above 0"),
        ("kinematic:lag=-1", "`lag` -1: give a number of 0 or more"),
        ("kinematic:mass=1500", "no option 'mass'"),
    ],
)
def test_wrong_options_are_refused(spec: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        VEHICLES.create(spec)
