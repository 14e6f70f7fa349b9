"""How far the ego is from the edge of its lane, and requirements on it."""

from __future__ import annotations

import runpy
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cornercase as cc
from conftest import at_night
from cornercase.drivers._system_under_test import PerScenarioDriver
from cornercase.metrics import METRICS, Expression, signals_from_recording
from cornercase.recordings import Recording
from cornercase.suite import Requirement, judge
from helpers.road_networks import lane, road, write

EXAMPLES = Path(__file__).parents[2] / "examples"
MOTORWAY = EXAMPLES / "r157" / "motorway.xodr"
X = EXAMPLES / "x_intersection" / "x_intersection.xosc"


def still(x, y, heading=0.0, roads=MOTORWAY, length=4.0, width=2.0) -> Recording:
    x, y = np.atleast_1d(x).astype(float), np.atleast_1d(y).astype(float)
    x, y = (np.broadcast_to(values, np.broadcast_shapes(x.shape, y.shape)) for values in (x, y))
    rest = np.zeros((2, len(x)))
    return Recording(
        time=0.1 * np.arange(len(x)), names=("Ego", "Other"), object_types=("car", "car"),
        x=np.stack([x, x]), y=np.stack([y, y]), heading=rest + heading, speed=rest, acceleration=rest,
        length=np.full(2, length), width=np.full(2, width), center_x=np.zeros(2), road_file=roads,
    )  # fmt: skip


def margin(recording, name="lane-margin"):
    return METRICS.create(name).course(recording, "Ego", "Other")


def test_it_is_the_distance_of_the_outermost_corner_from_the_lane_mark():
    # Lanes are from 0 to -3.5 and to -7.
    offsets = np.array([-1.75, -1.25, -1.0, -0.5, -3.4, -3.6, -6.5, -8.0])
    expected = [0.75, 0.25, 0.0, -0.5, -0.9, -0.9, -0.5, -2.0]
    assert margin(still(500.0, offsets)) == pytest.approx(expected, abs=1e-9)
    expected = [0.75, 0.25, 0.0, -0.5, 2.4, 2.4, -0.5, -2.0]
    assert margin(still(500.0, offsets), "lane-margin:edge=road") == pytest.approx(expected, abs=1e-9)


def test_a_road_of_a_junction_does_not_count_beyond_its_end(tmp_path):
    roads = write(
        tmp_path,
        road("long", 100.0, right=lane(-1), junction="9"),
        road("short", 20.0, at=(0.0, 1.3, 0.0), right=lane(-1), junction="9"),
        '<junction id="9"/>',
    )
    assert margin(still([10.0, 60.0], -0.9, roads=roads)) == pytest.approx([0.8, -0.1], abs=1e-9)


@pytest.mark.parametrize("angle", [0.3, -0.3, 1.2])
def test_a_box_that_is_turned_is_wider(angle):
    half = 0.5 * (4.0 * abs(np.sin(angle)) + 2.0 * np.cos(angle))
    assert margin(still(500.0, -1.75, angle)) == pytest.approx(1.75 - half, abs=1e-9)


def test_it_is_not_defined_without_roads_or_ego():
    recording = still([500.0, np.nan], -1.75)
    assert np.isnan(margin(recording)).tolist() == [False, True]
    unknown = replace(recording, road_file=None)
    assert np.isnan(margin(unknown)).all()
    np.testing.assert_array_equal(margin(unknown, f"lane-margin:roads={MOTORWAY}"), margin(recording))
    assert judge(Requirement.parse("ego stays in its lane"), unknown, "Ego", "Other").state == "inconclusive"


def test_options_are_checked():
    with pytest.raises(cc.InputError, match="give lane or road"):
        METRICS.create("lane-margin:edge=kerb")
    with pytest.raises(cc.InputError, match=r"nothing\.xodr"):
        margin(still(500.0, -1.75), "lane-margin:roads=nothing.xodr")


@pytest.mark.parametrize("edge", ["lane", "road"])
@pytest.mark.filterwarnings("ignore::cornercase.NoticeWarning")
def test_who_turns_along_its_lane_stays_in_it(edge):
    recording = cc.simulate(X, drivers={"Ego": "normal"}, duration=25.0)
    values = METRICS.create(f"lane-margin:edge={edge}").course(recording, "Ego", "Truck")
    assert values.min() > 0.0
    straight = np.abs(recording.heading[0] - recording.heading[0, 0]) < 1e-6
    assert values[straight & (recording.time < 3.0)] == pytest.approx(0.5 * (3.5 - recording.width[0]), abs=1e-6)


def motion(heading, speed) -> Recording:
    recording = still(np.full(len(heading), 500.0), -1.75)
    return replace(recording, heading=np.stack([heading, heading]), speed=np.stack([speed, speed]))


def test_lateral_acceleration_is_speed_times_rate_of_turn():
    time = 0.1 * np.arange(30)
    # Beyond π the heading jumps.
    recording = motion((3.0 + 0.2 * time + np.pi) % (2.0 * np.pi) - np.pi, np.full(30, 10.0))
    values = signals_from_recording(recording, "Ego", "Other").values
    assert values["ego.lateral_acceleration"] == pytest.approx(2.0)
    assert values["other.lateral_acceleration"] == pytest.approx(2.0)
    for text, state in (("lateral acceleration < 4 m/s²", "passed"), ("lateral acceleration < 1.9 m/s^2", "failed")):
        assert judge(Requirement.parse(text), recording, "Ego", "Other").state == state
    assert Expression.parse("lateral acceleration < 4 m/s²").text == "abs(ego.lateral_acceleration) < 4 m/s²"


@pytest.mark.parametrize(
    ("text", "state", "reason"),
    [
        ("ego leaves its lane", "passed", "Ego leaves its lane at 0.1 s, by 0.25 m at 0.2 s"),
        ("ego stays in its lane", "failed", "Ego leaves its lane at 0.1 s, by 0.25 m at 0.2 s"),
        ("ego stays on the road", "passed", "Ego stays on the road, 0.75 m from the edge at 0 s"),
        ("ego leaves the road", "failed", "Ego stays on the road"),
        ("always[0.1:0.2](ego leaves its lane)", "passed", ""),
        ("always(ego leaves its lane)", "failed", ""),
        ("no collision and not ego leaves its lane", "failed", ""),
        ("lane-margin > -0.3", "passed", ""),
    ],
)
def test_requirements_see_that_the_ego_leaves_its_lane(text, state, reason):
    verdict = judge(Requirement.parse(text), still(500.0, [-1.75, -2.6, -2.75]), "Ego", "Other")
    assert verdict.state == state
    assert reason in verdict.reason
    assert Requirement.parse(Requirement.parse(text).text) == Requirement.parse(text)


def test_what_is_no_statement_on_lanes_is_refused():
    with pytest.raises(cc.InputError, match="ego stays on the road"):
        Requirement.parse("ego leaves the lanes")


def example(name: str, **options: float) -> Any:
    return runpy.run_path(str(EXAMPLES / "r157" / "lane_change.py"))[name](**options)


CASES = [
    ("cut_in", {"ego_kmh": 100.0, "other_kmh": 60.0, "gap": 60.0}),
    ("cut_out", {"ego_kmh": 90.0, "gap": 60.0, "front_gap": 60.0}),
]


@pytest.mark.parametrize(("file", "values"), CASES)
@pytest.mark.parametrize("function", at_night(["PassSlowLeader", "Evade"], {"PassSlowLeader"}))
@pytest.mark.filterwarnings("ignore::cornercase.NoticeWarning")
def test_functions_on_the_motorway_change_lanes_without_a_collision(file, values, function):
    scenario = EXAMPLES / "r157" / f"{file}.xosc"
    recording = cc.simulate(scenario, values, drivers={"Ego": example(function)}, duration=15.0)
    ego = recording.entity_index("Ego")
    assert recording.y[ego, 0] == pytest.approx(-5.25)
    assert recording.y[ego, -1] == pytest.approx(-1.75, abs=0.05)
    assert not any("Ego" in collision.entities for collision in recording.collisions)
    found = cc.measure(recording, "Ego", "Other", ["lane-margin", "lane-margin:edge=road"])
    assert found.scores["lane-margin"] < -0.5 < 0.0 < found.scores["lane-margin:edge=road"]
    assert judge(Requirement.parse("ego stays in its lane"), recording, "Ego", "Other").state == "failed"
    assert judge(Requirement.parse("ego stays on the road"), recording, "Ego", "Other").state == "passed"
    limit, state = ("2", "passed") if function == "PassSlowLeader" else ("4", "failed")
    assert judge(Requirement.parse(f"lateral acceleration < {limit} m/s²"), recording, "Ego", "Other").state == state
    # Who keeps its lane and speed does not get past.
    asleep = cc.simulate(scenario, values, drivers={"Ego": PerScenarioDriver(Asleep())}, duration=15.0)
    assert any("Ego" in collision.entities for collision in asleep.collisions)


class Asleep(cc.SystemUnderTest):
    def step(self, view, dt):
        return 0.0


@pytest.mark.filterwarnings("ignore::cornercase.NoticeWarning")
def test_a_suite_judges_by_the_roads_of_its_scenarios(tmp_path):
    shutil.copytree(EXAMPLES / "r157", tmp_path / "set", ignore=shutil.ignore_patterns("*.py", "deceleration*"))
    options: Any = {
        "ego": "Ego",
        "other": ["Other"],
        "drivers": {"Ego": PerScenarioDriver(example("PassSlowLeader"))},
        "duration": 15.0,
    }
    for others in (["Other"], "*"):
        options["other"], path = others, tmp_path / f"{len(others)}{others[0]}.db"
        require = ["ego leaves its lane", "ego stays on the road"]
        result = cc.run_suite(tmp_path / "set", path, require=require, **options)
        verdicts = [verdict.state for row in result.scenarios for verdict in row.verdicts]
        assert verdicts == ["passed"] * 4
