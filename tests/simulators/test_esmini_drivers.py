"""Systems under test and drivers in esmini, with the real library: the same as in the builtin simulator."""

from __future__ import annotations

import math
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cornercase as cc
from conftest import (
    EXAMPLES,
    car,
    event,
    moving,
    private,
    ran,
    same_recording,
    scenario_file,
    speed_action,
    story_of,
    teleport,
    time_trigger,
)
from cornercase._common.errors import InputError, NoticeWarning
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin, Esmini
from cornercase.simulators._create import create_simulator
from helpers.command_line import cornercase

X = EXAMPLES / "x_intersection" / "x_intersection.xosc"
DECELERATION = EXAMPLES / "r157" / "deceleration.xosc"
CUT_IN = EXAMPLES / "r157" / "cut_in.xosc"
LIBRARY = os.environ.get("CORNERCASE_ESMINI", "")
pytestmark = pytest.mark.skipif(not Path(LIBRARY).is_file(), reason="CORNERCASE_ESMINI names no library")


class Aeb(cc.SystemUnderTest):
    """Keeps its speed, and brakes when it would soon hit something."""

    def __init__(self, time_to_brake: float = 1.5) -> None:
        self.time_to_brake = time_to_brake

    def step(self, view, dt):
        leader = view.leader
        return -8.0 if leader is not None and leader.gap < self.time_to_brake * leader.closing else 0.0


class Deaf(cc.SystemUnderTest):
    """Brakes evenly, whatever the scenario asks for."""

    def step(self, view, dt):
        return -0.5


class Slowing(cc.SystemUnderTest):
    """Brakes evenly at some rate."""

    def __init__(self, rate: float = 0.2) -> None:
        self.rate = rate

    def step(self, view, dt):
        return -self.rate


class Obedient(cc.SystemUnderTest):
    """Has the target speed within a second."""

    def step(self, view, dt):
        return max(min(view.target_speed - view.ego.speed, 3.0), -3.0)


class Swerve(cc.SystemUnderTest):
    """Steers to the left from the first second on, for half a second."""

    def step(self, view, dt):
        return cc.Control(acceleration=0.0, steering=0.04 if 1.0 <= view.time < 1.5 else 0.0)


class LaneChanger(cc.SystemUnderTest):
    """Asks for the left lane from the first second on."""

    def step(self, view, dt):
        return cc.Control(acceleration=0.5, lane_change="left" if view.time >= 1.0 else None)


class Failing(cc.SystemUnderTest):
    """Fails after a second, in one way or another."""

    def __init__(self, way: str = "raise", above: float = 0.0) -> None:
        self.way, self.above = way, above

    def start(self, ego, road, rng):
        self.fails = float(ego.values.get("ego_start", 1.0)) > self.above

    def step(self, view, dt):
        if view.time < 1.0 or not self.fails:
            return 0.0
        if self.way == "exit":
            os._exit(3)
        if self.way == "raise":
            raise RuntimeError("no gap")
        return math.nan


def of_ego(driver: Any) -> Any:
    return {"Ego": driver}


def both(path, driver, values=(), **options):
    """Recordings by esmini and by the builtin simulator of the ego with a driver."""
    concretes = [ConcreteScenario(path, dict(values))]
    options = {"duration": 20.0, "drivers": of_ego(driver), **options}
    return ran(Esmini(**options), concretes)[0], ran(Builtin(**options), concretes)[0]


def ego(recording):
    k = recording.entity_index("Ego")
    return {name: getattr(recording, name)[k] for name in ("x", "y", "heading", "speed")}


def distance(esmini, builtin):
    """Largest distance of the ego's positions."""
    here, there, n = ego(esmini), ego(builtin), min(esmini.time.size, builtin.time.size)
    return float(np.hypot(here["x"][:n] - there["x"][:n], here["y"][:n] - there["y"][:n]).max())


def straight(folder, *actions, other=""):
    """A scenario on a straight road, whose ego begins at 10 m/s; actions begin at their times."""
    events = "".join(event(f"e{k}", action, time_trigger(str(time))) for k, (time, action) in enumerate(actions))
    return scenario_file(
        folder,
        init=moving() + (moving("120", "0", "Other") if other else ""),
        story=story_of(events) if events else "",
        entities=car("Ego") + (car("Other") if other else ""),
    )


def test_a_function_drives_as_in_the_builtin_simulator():
    # Constant speeds of the others: nothing depends on who is updated first.
    for path, driver, tolerance in (
        (DECELERATION, Aeb(), 1e-9),
        (X, Aeb(), 1e-4),
        (X, Deaf(), 1e-4),
        (CUT_IN, Aeb(), 1e-9),
    ):
        esmini, builtin = both(path, driver)
        assert distance(esmini, builtin) < tolerance
        assert esmini.collisions == builtin.collisions
        assert esmini.time.size == builtin.time.size


def test_a_preset_reacts_one_step_later_to_a_change_of_speed():
    assert distance(*both(CUT_IN, "cc-human", duration=5.0)) < 1e-9
    coarse, fine = (distance(*both(DECELERATION, "normal", duration=10.0, time_step=step)) for step in (0.05, 0.025))
    assert coarse < 0.5
    assert fine == pytest.approx(0.5 * coarse, rel=0.2)


def test_drivers_that_the_file_names_drive():
    named, given = Esmini(duration=15.0), Esmini(duration=15.0, drivers={"Ego": "normal"})
    (a,), (b,), (without,) = (
        ran(simulator, [ConcreteScenario(X, {})]) for simulator in (named, given, Esmini(duration=15.0, undriven=True))
    )
    assert same_recording(a, b)
    assert not np.array_equal(ego(a)["x"], ego(without)["x"])


def test_a_speed_action_sets_the_target_and_moves_nobody(tmp_path):
    path = straight(tmp_path, (1.0, speed_action("20")), (3.0, speed_action("4", "linear", "time", "2")))
    esmini, builtin = both(path, Deaf())
    assert distance(esmini, builtin) < 1e-6
    np.testing.assert_allclose(ego(esmini)["speed"], ego(builtin)["speed"], atol=1e-12)
    np.testing.assert_allclose(ego(esmini)["heading"], 0.0, atol=1e-9)
    path = straight(tmp_path, (1.0, speed_action("20")))
    esmini, builtin = both(path, Obedient())
    # One step later.
    np.testing.assert_allclose(ego(esmini)["speed"][1:], ego(builtin)["speed"][:-1], atol=1e-9)


def test_an_ego_that_stands_is_told_to_stay(tmp_path):
    class StopAndGo(cc.SystemUnderTest):
        """Stands for three seconds, then has the target speed."""

        def step(self, view, dt):
            return -20.0 if view.time < 3.0 else view.target_speed - view.ego.speed

    told, untold = (
        straight(tmp_path, (2.0, speed_action("0"))),
        scenario_file(tmp_path, init=moving(), name="untold.xosc"),
    )
    stays, goes = (ego(both(path, StopAndGo(), duration=10.0)[0])["speed"][-1] for path in (told, untold))
    assert stays == 0.0
    assert goes == pytest.approx(10.0, abs=0.1)


def test_a_function_steers_changes_lanes_and_hits_what_it_hits(tmp_path):
    for driver in (Swerve(), LaneChanger()):
        esmini, builtin = both(DECELERATION, driver, duration=6.0)
        assert distance(esmini, builtin) < 1e-6
        assert np.ptp(ego(esmini)["y"]) > 1.0
    (tmp_path / "oncoming").mkdir()
    path = scenario_file(
        tmp_path / "oncoming",
        init=moving() + moving("120", "0", "Other", "1"),
        entities=car("Ego") + car("Other"),
    )
    esmini, builtin = both(path, Swerve(), on_collision="stop")
    assert [c.entities for c in esmini.collisions] == [("Ego", "Other")]
    assert esmini.collisions[0].time == pytest.approx(builtin.collisions[0].time, abs=0.051)


def test_a_failure_ends_one_scenario_only():
    concretes = [ConcreteScenario(X, {"ego_start": start}) for start in (20.0, 30.0, 40.0)]
    for way, says in (
        ("raise", r"the driver of Ego \(.*:Failing\) failed at t = 1 s: RuntimeError: no gap"),
        ("nan", "returned no control at t = 1 s: acceleration is nan"),
    ):
        driver = Failing(way=way, above=35.0)
        found = list(Esmini(duration=3.0, drivers=of_ego(driver)).run(concretes))
        assert [isinstance(one, Exception) for one in found] == [False, False, True]
        assert re.search(says, str(found[2]))
    (alone,) = ran(Esmini(duration=3.0, drivers=of_ego(driver)), concretes[1:2])
    assert same_recording(alone, found[1])


def test_a_crash_costs_one_scenario_and_workers_change_nothing():
    concretes = [ConcreteScenario(X, {"ego_start": start}) for start in (20.0, 30.0, 40.0)]
    for workers in (1, 2):
        options = {"duration": 3.0, "drivers": of_ego(Failing(way="exit", above=35.0))}
        with create_simulator("esmini", options, workers=workers, retries=0) as simulator:
            found = list(simulator.run(concretes))
        assert [isinstance(one, Exception) for one in found] == [False, False, True]
        expected = ran(Esmini(duration=3.0, drivers=of_ego(Failing(above=50.0))), concretes[:2])
        assert all(same_recording(a, b) for a, b in zip(found[:2], expected, strict=True))


def test_limits_of_the_vehicle_hold(tmp_path):
    path = straight(tmp_path)
    path.write_text(path.read_text().replace('maxDeceleration="200"', 'maxDeceleration="0.2"'))
    with pytest.warns(NoticeWarning, match=r"exceeds the deceleration of 0.2 m/s² in <Performance>"):
        (found,) = ran(Esmini(duration=5.0, drivers=of_ego(Deaf())), [ConcreteScenario(path, {})])
    assert ego(found)["speed"][-1] == pytest.approx(9.0)


class InDegrees(cc.SystemUnderTest):
    def step(self, view, dt):
        return cc.Control(acceleration=0.0, steering=2.0)


def test_steering_beyond_what_the_wheels_can_do_is_said(tmp_path):
    with pytest.warns(NoticeWarning, match=r"exceeds the steering angle of .* rad that .*; first 2 rad at t = 0 s"):
        ran(Esmini(duration=1.0, drivers=of_ego(InDegrees())), [ConcreteScenario(straight(tmp_path), {})])


TRAJECTORY = """<PrivateAction><RoutingAction><FollowTrajectoryAction><TrajectoryRef><Trajectory name="t" closed="false">
<Shape><Polyline><Vertex time="0"><Position><WorldPosition x="50" y="-2"/></Position></Vertex><Vertex time="9"><Position>
<WorldPosition x="150" y="-2"/></Position></Vertex></Polyline></Shape></Trajectory></TrajectoryRef><TimeReference>{}
</TimeReference><TrajectoryFollowingMode followingMode="position"/></FollowTrajectoryAction></RoutingAction></PrivateAction>"""
TIMING = '<Timing domainAbsoluteRelative="relative" scale="1" offset="0"/>'
SWITCH = '<PrivateAction><ActivateControllerAction longitudinal="false"/></PrivateAction>'


def test_what_cannot_be_driven_is_refused_in_one_sentence(tmp_path):
    story = {
        "esmini cannot change who drives": story_of(event("e", SWITCH, time_trigger("1"))),
        "only a trajectory without times, and only from the start": story_of(
            event("e", TRAJECTORY.format("<None/>"), time_trigger("1"))
        ),
    }
    files = {
        says: scenario_file(tmp_path, init=moving(), story=text, name=f"{len(says)}.xosc")
        for says, text in story.items()
    }
    on_trajectory = private("Ego", teleport("50"), speed_action("10"), TRAJECTORY)
    files["which decides the speed on the trajectory"] = scenario_file(
        tmp_path, init=on_trajectory.format(TIMING), name="timed.xosc"
    )
    files["target speed on a trajectory"] = scenario_file(
        tmp_path, init=on_trajectory.format("<None/>"), name="speed.xosc",
        story=story_of(event("e", speed_action("3"), time_trigger("1"))),
    )  # fmt: skip
    files["has no road file"] = tmp_path / "roadless.xosc"
    files["has no road file"].write_text(
        straight(tmp_path).read_text().replace('<LogicFile filepath="road.xodr"/>', "")
    )
    for says, path in files.items():
        with pytest.raises(InputError, match=says):
            list(Esmini(drivers={"Ego": "normal"}).run([ConcreteScenario(path, {})]))
        ran(Esmini(duration=1.0), [ConcreteScenario(path, {})])
    with pytest.raises(InputError, match="no entity 'Eggo'"):
        list(Esmini(drivers={"Eggo": "normal"}).run([ConcreteScenario(straight(tmp_path), {})]))


def test_a_controller_of_esmini_and_a_driver_cannot_both_drive(tmp_path):
    controller = (
        '<ObjectController><Controller name="acc"><Properties><Property name="esminiController" value="ACCController"/>'
        '<Property name="timeGap" value="1.0"/></Properties></Controller></ObjectController></ScenarioObject>'
    )
    activation = '<PrivateAction><ActivateControllerAction longitudinal="true" lateral="false"/></PrivateAction>'
    init = private("Ego", teleport("50"), speed_action("10"), activation)
    path = scenario_file(tmp_path, init=init, entities=car("Ego").replace("</ScenarioObject>", controller))
    with pytest.raises(
        InputError, match=r"'Ego' has both a driver and one of esmini's controllers; .*controllers=false"
    ):
        list(Esmini(drivers={"Ego": "normal"}).run([ConcreteScenario(path, {})]))
    ran(Esmini(drivers={"Ego": "normal"}, controllers=False, duration=1.0), [ConcreteScenario(path, {})])


def test_the_command_line_takes_a_function_of_the_user(tmp_path, monkeypatch):
    (tmp_path / "my_function.py").write_text(
        "import cornercase as cc\n\n\nclass Brake(cc.SystemUnderTest):\n    def __init__(self, rate: float = 1.0):\n"
        "        self.rate = rate\n\n    def step(self, view, dt):\n        return -self.rate\n"
    )
    monkeypatch.chdir(tmp_path)
    done = cornercase(
        "explore", X, "--range", "ego_start=20:40", "--ego", "Ego", "--other", "Pedestrian", "--metric", "ttc", "--simulator",
        "esmini", "--driver", "Ego=my_function:Brake:rate=2", "--optimizer", "sobol", "--budget", 4, "--duration", 5, "-o",
        "s.db",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "4 scenarios" in done.stdout
    assert "my_function:Brake" in cornercase("show", "s.db").stdout


def test_a_parameter_of_the_function_differs_between_scenarios():
    scenarios = [ConcreteScenario(X, {"ego_start": 30.0, "Ego.rate": rate}) for rate in (0.5, 1.0, 0.5)]
    options: dict[str, Any] = {"duration": 5.0, "drivers": of_ego(Slowing())}
    here, there = ran(Esmini(**options), scenarios), ran(Builtin(**options), scenarios)
    assert max(distance(*pair) for pair in zip(here, there, strict=True)) < 1e-4
    assert same_recording(here[0], here[2])
    assert ego(here[1])["speed"][-1] == pytest.approx(5.0)
    with pytest.raises(
        InputError, match=r"Ego\.horizon is a parameter of the driver that the file names for Ego, but .*undriven=true"
    ):
        list(Esmini(undriven=True).run([ConcreteScenario(X, {"Ego.horizon": 4.0})]))
    with pytest.raises(InputError, match="rates"):
        list(Esmini(**options).run([ConcreteScenario(X, {"Ego.rates": 4.0})]))


def test_a_random_sensor_measures_the_same_as_in_the_builtin_simulator():
    spec = "simple + radar:noise=0.5,miss=0.2"
    for seed in (0, 7):
        (here,), (there,) = (
            ran(kind(duration=8.0, drivers={"Ego": spec}), [ConcreteScenario(CUT_IN, {}, seed=seed)])
            for kind in (Esmini, Builtin)
        )
        assert distance(here, there) < 1e-6
