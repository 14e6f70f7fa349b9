"""Classes of users in all shapes: each scenario gets an object of its own, with the options that were given."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

import cornercase as cc
from conftest import EXAMPLES, ran, same_recording
from cornercase._common.configurable import Configurable
from cornercase.drivers import SENSORS, VEHICLES, Trajectory
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin

X = EXAMPLES / "x_intersection" / "x_intersection.xosc"


@dataclass
class InCentimetres(cc.SystemUnderTest):
    """Its field is in other units after its construction."""

    brake: float = 100.0

    def __post_init__(self):
        self.brake /= 100.0

    def step(self, view, dt):
        return -self.brake


@dataclass
class Remembers(cc.SystemUnderTest):
    """Brakes the harder the more steps it has seen; the list is a field."""

    seen: list[float] = field(default_factory=list)

    def step(self, view, dt):
        self.seen.append(view.time)
        return -0.01 * len(self.seen)


@dataclass
class Base(cc.SystemUnderTest):
    gain: float = 1.0

    def step(self, view, dt):
        return -self.gain


class Derived(Base):
    """Of a dataclass, with a constructor of its own."""

    def __init__(self, strength: float = 2.0):
        super().__init__(gain=0.5 * strength)


class ByPosition(cc.SystemUnderTest):
    def __init__(self, first=1.0, second=2.0, third=3.0, /, fourth=4.0):
        self.options = first, second, third, fourth

    def step(self, view, dt):
        return -self.options[1]


def drive(driver: Any, *waits: float, **options: Any):
    simulator = Builtin(duration=2.0, drivers={"Ego": driver}, **options)
    return ran(simulator, [ConcreteScenario(X, {"pedestrian_wait": wait}) for wait in waits])


def first_acceleration(recording) -> float:
    return float(recording.acceleration[recording.entity_index("Ego"), 1])


@pytest.mark.parametrize(
    ("driver", "expected"),
    [
        (InCentimetres(), -1.0),
        (InCentimetres(brake=250.0), -2.5),
        (Derived(), -1.0),
        (Derived(strength=3.0), -1.5),
        (ByPosition(), -2.0),
        (ByPosition(1.0, 1.25), -1.25),
    ],
)
def test_a_class_drives_with_the_options_that_it_was_given(driver, expected):
    for recording in drive(driver, 0.0, 3.0):
        assert first_acceleration(recording) == pytest.approx(expected)


def test_scenarios_share_no_field_of_a_dataclass():
    driver = Remembers()
    batch = drive(driver, 0.0, 3.0)
    assert all(same_recording(one, drive(driver, wait)[0]) for one, wait in zip(batch, (0.0, 3.0), strict=True))
    assert driver.seen == []


def test_a_dataclass_that_changes_its_fields_cannot_be_varied():
    scenario = ConcreteScenario(X, {"Ego.brake": 200.0})
    with pytest.raises(cc.InputError, match="is given with a fixed 'brake'"):
        list(Builtin(duration=1.0, drivers={"Ego": InCentimetres()}).run([scenario]))
    # Here it has the value of the default again.
    (outcome,) = Builtin(duration=1.0, drivers={"Ego": InCentimetres(10_000.0)}).run([scenario])
    assert isinstance(outcome, cc.SimulationError)
    assert "its dataclass changes fields in __post_init__" in str(outcome)


class Positional(Configurable):
    def __init__(self, a=1, b=2, c=3, d=4, /, e=5):
        self.all = (a, b, c, d, e)


@pytest.mark.parametrize("given", [(), (1, 2, 9), (7,), (4, 3, 2, 1)])
def test_options_by_position_keep_their_places(given):
    cls: Any = Positional
    made = cls(*given, e=6)
    assert made.with_options().all == made.all
    assert made.with_options(c=0).all == (*made.all[:2], 0, *made.all[3:])


@pytest.mark.parametrize("spec", ["single-track:inertia=1e-6", "single-track:mass=1", "actuators:delay=1e12"])
def test_a_vehicle_that_no_step_could_move_is_refused(spec):
    with pytest.raises(cc.InputError, match=spec.partition(":")[2].partition("=")[0]):
        VEHICLES.create(spec)


def test_a_sensor_that_no_memory_could_hold_is_refused():
    with pytest.raises(cc.InputError, match="latency"):
        SENSORS.create("radar:latency=1e9")


def test_a_trajectory_beyond_all_maps_is_refused():
    with pytest.raises(ValueError, match="1e\\+07 m"):
        Trajectory(np.array([0.0, 10.0]), np.array([1e308, -1e308]), np.zeros(2))


def test_an_option_that_is_no_number_is_refused():
    with pytest.raises(cc.InputError, match="takes a number for 'horizon', not 'nan'"):
        cc.drivers.DRIVERS.create("normal:horizon=nan")


def test_a_method_that_cannot_be_called_is_refused_with_its_arguments():
    class StartsOtherwise(cc.SystemUnderTest):
        def start(self, ego):  # type: ignore[override]
            pass

        def step(self, view, dt):
            return 0.0

    class StepsOtherwise(cc.SystemUnderTest):
        def step(self, view):  # type: ignore[override]
            return 0.0

    with pytest.raises(
        cc.InputError, match=r"defines start\(self, ego\), but cornercase calls start\(self, ego, road, rng\)"
    ):
        cc.simulate(X, drivers={"Ego": StartsOtherwise()})
    with pytest.raises(cc.InputError, match=r"defines step\(self, view\), but cornercase calls step\(self, view, dt\)"):
        cc.simulate(X, drivers={"Ego": StepsOtherwise()})
