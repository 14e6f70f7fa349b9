"""Parameters of drivers, sensors and vehicles by name, and their values in each scenario of a batch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Optional

import numpy as np
import pytest

import cornercase as cc
from conftest import EXAMPLES, ran, same_recording
from cornercase.drivers import NORMAL, BehaviourDriver, Driver, EquippedDriver, ReferenceDriver, Sensor, VehicleModel
from cornercase.drivers._driver_overview import describe_driver
from cornercase.drivers._parameters import check_parameters, find_parameter, read_parameters, spec_with_values
from cornercase.drivers._resolve import driver_by_name
from cornercase.drivers.sensors._sensor import SensedObjects
from cornercase.simulators import Builtin

X = EXAMPLES / "x_intersection" / "x_intersection.xosc"
VALUES = {"ego_start": 60.0, "pedestrian_wait": 6.0, "p1_speed": 8.0}


class Brake(cc.SystemUnderTest):
    def __init__(self, deceleration=2.0, after: float = 1.0, steps: int = 1, mode: str = "hard"):
        if deceleration < 0.0:
            raise ValueError("deceleration has to be 0 or more")
        self.deceleration, self.after = deceleration, after

    def step(self, view, dt):
        return -self.deceleration if view.time >= self.after else 0.0


BRAKE: Any = Brake()


class BrakeArrays(Driver):
    batches: list[int] = []  # noqa: RUF012 - what a test asks

    def __init__(self, deceleration=2.0):
        self.deceleration = deceleration

    def start(self, scenarios, others):
        BrakeArrays.batches.append(scenarios)

    def acceleration(self, situation):
        return 0.0 * situation.speed - self.deceleration


class Delayed(Sensor):
    name = "delayed"
    given: dict[str, dict[str, list[float]]] = {}  # noqa: RUF012 - what a test asks

    def __init__(self, latency: float = 0.1, range: float = 100.0, label: str = ""):  # noqa: A002
        self.label = label

    def start(self, start, label):
        Delayed.given[self.label] = {name: values.tolist() for name, values in start.parameters.items()}

    def perceive(self, situation):
        s = situation
        measured_at = np.full_like(s.others_x, s.time)
        return SensedObjects(s.others_x, s.others_y, s.others_heading, s.others_speed, measured_at)


class Heavy(VehicleModel):
    name = "heavy"
    steers = False
    given: dict[str, list[float]] = {}  # noqa: RUF012 - what a test asks

    def __init__(self, mass: float = 1500.0, latency: float = 0.0):
        pass

    def start(self, start):
        Heavy.given = {name: values.tolist() for name, values in start.parameters.items()}

    def step(self, motion, acceleration, steering, friction, time_step, active):
        return motion


def concretes(name: str, values: Sequence[float | str]) -> list[cc.ConcreteScenario]:
    file = cc.LogicalScenario.read(X)
    return [file.concrete_scenario({**VALUES, name: value}) for value in values]


def recordings(name: str, values: Sequence[float], driver: Any) -> list[cc.Recording]:
    return ran(Builtin(drivers={"Ego": driver}, duration=8.0), concretes(name, values))


@pytest.mark.parametrize(
    ("driver", "option", "values"),
    [
        ("normal", "reaction_time", [0.1, 1.5, 0.5]),
        pytest.param("normal", "lateral_acceleration", [0.5, 3.0, 2.0], marks=pytest.mark.slow),
        pytest.param("aggressive", "comfortable_deceleration", [1.0, 3.5, 2.0], marks=pytest.mark.slow),
        ("simple", "time_headway", [0.5, 2.0]),
        ("cc-human", "delay", [0.1, 2.0]),
    ],
)
def test_a_value_of_a_scenario_is_the_same_as_the_option_in_it_alone(driver, option, values):
    together = recordings(f"Ego.{option}", values, driver)
    for value, recording in zip(values, together, strict=True):
        (alone,) = recordings(f"Ego.{option}", [value], driver)
        fixed = cc.simulate(X, VALUES, drivers={"Ego": f"{driver}:{option}={value}"}, duration=8.0)
        assert same_recording(recording, alone)
        assert same_recording(recording, fixed)
    if option != "delay":
        assert not np.array_equal(together[0].speed, together[1].speed)


@pytest.mark.parametrize("driver", [BRAKE, BrakeArrays(), BehaviourDriver(NORMAL)])
def test_objects_of_users_take_values_too(driver):
    option, values = ("reaction_time", [0.2, 0.9]) if isinstance(driver, BehaviourDriver) else ("deceleration", [1, 4])
    together = recordings(f"Ego.{option}", values, driver)
    for value, recording in zip(values, together, strict=True):
        fixed = driver.with_options(**{option: float(value)})
        assert same_recording(recording, cc.simulate(X, VALUES, drivers={"Ego": fixed}, duration=8.0))


def test_a_driver_of_arrays_runs_in_a_batch_for_each_value():
    BrakeArrays.batches.clear()
    recordings("Ego.deceleration", [1.0, 4.0, 1.0, 4.0, 1.0], BrakeArrays())
    assert sorted(BrakeArrays.batches) == [2, 3]


def test_scenarios_without_a_value_have_the_option_of_the_driver():
    with_value, without = concretes("Ego.deceleration", [4.0])[0], cc.ConcreteScenario(X, VALUES)
    results = ran(Builtin(drivers={"Ego": BRAKE}, duration=3.0), [with_value, without, with_value])
    assert same_recording(results[0], results[2])
    assert same_recording(results[1], cc.simulate(X, VALUES, drivers={"Ego": BRAKE}, duration=3.0))


def test_a_value_that_a_driver_refuses_fails_its_scenario_only():
    simulator = Builtin(drivers={"Ego": "normal"}, duration=2.0)
    good, bad, text = simulator.run(concretes("Ego.reaction_time", [0.5, -1.0, "much"]))
    assert isinstance(good, cc.Recording)
    assert "reaction_time is -1" in str(bad)
    assert str(text) == "the parameter Ego.reaction_time is 'much', which is not a number"
    (only,) = simulator.run(concretes("Ego.reaction_time", [-1.0]))
    assert isinstance(only, cc.SimulationError)
    good, bad = Builtin(drivers={"Ego": BRAKE}, duration=2.0).run(concretes("Ego.deceleration", [1.0, -1.0]))
    assert isinstance(good, cc.Recording)
    assert "deceleration has to be 0 or more" in str(bad)


def test_each_part_is_given_its_own_values():
    driver = EquippedDriver(
        Brake(), [Delayed(label="front"), Delayed(label="rear")], Heavy()
    )  # fmt: skip
    names = ("after", "delayed1.latency", "delayed2.latency", "delayed2.range", "mass")
    parameters, problems = read_parameters("Ego", driver, [dict.fromkeys(names, 1.0), dict.fromkeys(names, 2.0)])
    assert not problems
    file = cc.LogicalScenario.read(X)
    scenarios = [file.concrete_scenario({**VALUES, **{f"Ego.{name}": v for name in names}}) for v in (1.0, 2.0)]
    ran(Builtin(drivers={"Ego": driver}, duration=0.5), scenarios)
    assert {*parameters} == {*names}
    assert Delayed.given == {"front": {"latency": [1.0, 2.0]}, "rear": {"latency": [1.0, 2.0], "range": [1.0, 2.0]}}
    assert Heavy.given == {"mass": [1.0, 2.0]}


@pytest.mark.parametrize(
    ("name", "part"),
    [
        ("after", ("driver", "after")),
        ("driver.after", ("driver", "after")),
        ("range", ("delayed", "range")),
        ("delayed.latency", ("delayed", "latency")),
        ("vehicle.latency", ("vehicle", "latency")),
    ],
)
def test_a_name_means_one_option(name, part):
    assert find_parameter("Ego", EquippedDriver(Brake(), [Delayed()], Heavy()), name) == part


@pytest.mark.parametrize(
    ("names", "sentence"),
    [
        (["latency"], "is an option of delayed and of vehicle; write Ego.delayed.latency or Ego.vehicle.latency."),
        (["afer"], "has no option 'afer' that takes numbers; did you mean 'after'?"),
        (["mode"], "has no option 'mode' that takes numbers"),
        (["delayed.label"], "has no option 'delayed.label' that takes numbers"),
        (["after", "driver.after"], "Ego.driver.after: is the same option as Ego.after; keep one of them."),
    ],
)
def test_a_name_that_means_no_option_or_two_is_refused(names, sentence):
    with pytest.raises(cc.InputError) as refused:
        check_parameters("Ego", EquippedDriver(Brake(), [Delayed()], Heavy()), names)
    assert sentence in str(refused.value)


@pytest.mark.parametrize("driver", [Brake(after=0.5), ReferenceDriver("rss", delay=0.3)])
def test_an_option_that_is_fixed_is_not_varied_too(driver):
    with pytest.raises(cc.InputError, match="is given with a fixed"):
        cc.simulate(X, {"Ego.after" if isinstance(driver, Brake) else "Ego.delay": 0.2}, drivers={"Ego": driver})


def test_what_is_listed_as_searchable_can_be_searched():
    name = "normal + radar:range=120 + lidar"
    *_, line = describe_driver("Ego", name)
    listed = line.partition("LOW:HIGH: ")[2].split(", ")
    assert "lidar.range" in listed
    check_parameters("Ego", driver_by_name(name), listed)


@pytest.mark.parametrize("annotation", [int | None, Optional[int], "int | None", "Optional[int]", int])  # noqa: UP045
def test_a_whole_number_that_may_be_none_stays_one(annotation):
    class Counts(cc.SystemUnderTest):
        def __init__(self, steps=None):
            self.steps = steps

        def step(self, view, dt):
            assert type(self.steps) is int
            return 0.0

    vars(Counts.__init__)["__wrapped__"].__annotations__["steps"] = annotation
    cc.simulate(X, {"Ego.steps": 2.0}, drivers={"Ego": Counts()}, duration=0.5)
    with pytest.raises(cc.InputError, match=r"'steps' takes a whole number, not 1\.5; use a step of 1 in its range\."):
        cc.simulate(X, {"Ego.steps": 1.5}, drivers={"Ego": Counts()})


def test_a_whole_number_stays_one():
    with pytest.raises(cc.InputError, match=r"'steps' takes a whole number, not 1\.5; use a step of 1 in its range\."):
        cc.simulate(X, {"Ego.steps": 1.5}, drivers={"Ego": BRAKE})
    cc.simulate(X, {"Ego.steps": 2.0}, drivers={"Ego": BRAKE}, duration=0.5)


def test_the_text_of_a_driver_with_values_makes_the_same_driver():
    driver = BehaviourDriver(NORMAL._replace(horizon=4.0))
    assert spec_with_values("Ego", driver, {"reaction_time": 0.25}) == "normal:horizon=4.0,reaction_time=0.25"
    assert spec_with_values("Ego", ReferenceDriver("rss"), {"delay": 0.5}) == "rss:delay=0.5"
