"""Vehicle models against closed forms."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.drivers import VEHICLES, Body, PlanarMotion, VehicleModel
from cornercase.drivers.vehicles._pedals import pedals_to_acceleration
from helpers.vehicle_drives import DT, WHEELBASE, drive, start

GRAVITY = 9.81


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
    # Both ask for more than the tyres can do, and each gets the same share.
    angle = math.atan(12.0 * WHEELBASE / 20.0**2)
    motion = drive("kinematic", 20.0, 0.01, lambda t: -12.0, lambda t: angle if t else 0.0, dt=0.001)
    lateral = np.diff(motion["heading"])[-1] / 0.001 * motion["speed"][-1]
    assert -motion["acceleration"][-1] == pytest.approx(GRAVITY / math.sqrt(2.0), rel=1e-3)
    assert lateral == pytest.approx(GRAVITY / math.sqrt(2.0), rel=1e-3)


@pytest.mark.parametrize(("front", "rear"), [(20.0, 20.0), (14.0, 20.0), (20.0, 17.0)])
def test_steady_yaw_rate_of_the_dynamic_model(front: float, rear: float) -> None:
    speed, angle, wheelbase, mu = 15.0, 0.02, 1.1562 + 1.4227, 1.0489
    spec = f"single-track:front_stiffness={front},rear_stiffness={rear}"
    motion = drive(spec, speed, 6.0, lambda t: 0.02 if t > 3.0 else 0.0, steering=lambda t: angle)
    understeer = (1.0 / front - 1.0 / rear) / (mu * GRAVITY)
    now = motion["speed"][-1]
    expected = now * angle / (wheelbase + understeer * now**2)
    assert np.diff(motion["heading"])[-1] / DT == pytest.approx(expected, rel=0.01)
    # Without the slip of its tyres, it would differ by more.
    assert (front == rear) == (abs(expected / (now * angle / wheelbase) - 1.0) < 0.01)


@pytest.mark.parametrize("model", ["kinematic", "single-track", "actuators"])
def test_a_vehicle_without_friction_keeps_its_speed(model: str) -> None:
    motion = drive(model, 10.0, 2.0, lambda t: -5.0, lambda t: 0.1, friction=0.0)
    assert set(motion["speed"]) == {10.0}
    assert not motion["heading"].any()


@pytest.mark.parametrize("speed", [0.0, 0.05, 3.0])
def test_dynamic_model_rolls_at_low_speed(speed: float) -> None:
    motion = drive("single-track", speed, 4.0, lambda t: -2.0 if t < 2.0 else 1.0, steering=lambda t: 0.2)
    rolling = drive(
        "kinematic:wheelbase=2.5789,max_steering_rate=0.4",
        speed,
        4.0,
        lambda t: -2.0 if t < 2.0 else 1.0,
        steering=lambda t: 0.2,
    )
    assert motion["speed"][40] == 0.0
    for quantity in ("x", "y", "heading"):
        assert motion[quantity] == pytest.approx(rolling[quantity], abs=0.02)


def test_dynamic_model_brakes_in_a_curve_on_ice() -> None:
    motion = drive("single-track", 20.0, 18.0, lambda t: -8.0, lambda t: 0.1, friction=0.2)
    assert all(np.isfinite(values).all() for values in motion.values())
    grip = 0.2 * 1.0489 * GRAVITY
    ways = np.hypot(np.diff(motion["x"]), np.diff(motion["y"]))
    assert motion["speed"][-1] == 0.0
    assert 20.0**2 / (2.0 * grip) < ways.sum() < 20.0**2 / (2.0 * grip) * 1.5


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


@pytest.mark.parametrize(
    "spec",
    ["kinematic:mu=0.2,wheelbase=2.5,steering_lag=0.1", "single-track:mass=1500,mu=0.9", "actuators:lag=0.2"],
)
def test_text_of_a_vehicle_makes_it_again(spec: str) -> None:
    assert str(VEHICLES.create(spec)) == spec
    assert VEHICLES.create(str(VEHICLES.create(spec))) == VEHICLES.create(spec)


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("kinematic:mu=0", "`mu` 0: give a number above 0"),
        ("kinematic:wheelbase=long", "takes a number for 'wheelbase', not 'long'"),
        ("kinematic:lag=-1", "`lag` -1: give a number of 0 or more"),
        ("kinematic:mass=1500", "no option 'mass'"),
    ],
)
def test_wrong_options_are_refused(spec: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        VEHICLES.create(spec)


@pytest.mark.parametrize("spec", ["kinematic:steering_lag=0.3", "single-track"])
def test_a_vehicle_that_was_put_elsewhere_begins_anew(spec: str) -> None:
    def step(model: VehicleModel, begin: list[float], steering: float) -> list[float]:
        motion = PlanarMotion(*np.array(begin)[:, None])
        moved = model.step(motion, np.zeros(1), np.array([steering]), np.ones(1), DT, np.ones(1, dtype=bool))
        return [float(values[0]) for values in (moved.x, moved.y, moved.heading, moved.speed, moved.acceleration)]

    model, state = start(spec), [0.0, 0.0, 0.0, 15.0, 0.0]
    for _ in range(20):
        state = step(model, state, 0.05)
    # With the speed that it has, which alone would tell nothing.
    elsewhere = [200.0, 0.0, 0.0, state[3], 0.0]
    begun = step(start(spec), elsewhere, 0.0)
    assert step(model, elsewhere, 0.0) == begun
    assert begun[1:3] == [0.0, 0.0]


def test_pedals_are_linear_up_to_the_limits_of_the_vehicle() -> None:
    throttle, brake = np.array([0.5, 0.0, 1.0, np.nan, np.nan]), np.array([np.nan, 0.25, 1.0, 1.0, np.nan])
    unlimited = Body("Ego", "car", 4.5, 1.8, 1.4, 2.7, 0.6)
    limited = replace(unlimited, max_acceleration=2.0, max_deceleration=6.0)
    assert pedals_to_acceleration(throttle, brake, unlimited) == pytest.approx(
        [1.5, -2.0, -5.0, -8.0, np.nan], nan_ok=True
    )
    assert pedals_to_acceleration(throttle, brake, limited) == pytest.approx(
        [1.0, -1.5, -4.0, -6.0, np.nan], nan_ok=True
    )
