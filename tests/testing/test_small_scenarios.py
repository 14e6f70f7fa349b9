"""Small scenarios tell a simulator that is right from one with a fault."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from conftest import at_night
from cornercase.recordings import Collision, Recording
from cornercase.simulators import Builtin
from cornercase.testing import run_checks, simulator_checks
from cornercase.testing._agent_runs import describe_agent_problems, measure_agent_motion
from cornercase.testing._corrections import box_centers as centers
from cornercase.testing._crash import SimulatorCrashResult, crash_during_runs
from cornercase.testing._deviations import SmallRun, run_small_scenario
from cornercase.testing._example_driver import CarFollowing
from cornercase.testing._small_scenarios import AGENT_DURATIONS, SMALL_SCENARIOS, write_small_scenarios
from helpers.command_line import cornercase


class Faulty(Builtin):
    """The builtin simulator, whose recordings have a fault."""

    def __init__(self, fault: Callable[[Recording], Recording]) -> None:
        super().__init__()
        self.fault = fault

    def run(self, concretes):
        for recording in super().run(concretes):
            assert isinstance(recording, Recording)
            yield self.fault(recording)


def ignores_speed(recording: Recording) -> Recording:
    """The ego keeps the speed that it has at first."""
    e = recording.entity_index("Ego")
    x, speed, acceleration = (getattr(recording, name).copy() for name in ("x", "speed", "acceleration"))
    x[e], speed[e], acceleration[e] = x[e, 0] + speed[e, 0] * recording.time, speed[e, 0], 0.0
    return replace(recording, x=x, speed=speed, acceleration=acceleration)


def a_tick_late(recording: Recording) -> Recording:
    late = {
        name: np.concatenate([getattr(recording, name)[:, :1], getattr(recording, name)[:, :-1]], axis=1)
        for name in ("x", "y", "heading", "speed", "acceleration")
    }
    return replace(recording, **late)


def hit_by_all(recording: Recording) -> Recording:
    if len(recording.names) == 1:
        return recording
    return replace(recording, collisions=(Collision(1.0, (recording.names[0], recording.names[1])),))


def with_the_wrong_name(recording: Recording) -> Recording:
    return replace(recording, names=tuple(f"hero_{name}" for name in recording.names))


def which_ends_early(recording: Recording) -> Recording:
    half = len(recording.time) // 2
    arrays = {name: getattr(recording, name)[:, :half] for name in ("x", "y", "heading", "speed", "acceleration")}
    return replace(recording, time=recording.time[:half], **arrays)


def in_feet(recording: Recording) -> Recording:
    arrays = {name: getattr(recording, name) / 0.3048 for name in ("x", "y", "speed", "acceleration")}
    return replace(recording, **arrays)


def stale(recording: Recording) -> Recording:
    arrays = {name: getattr(recording, name).copy() for name in ("x", "y", "heading", "speed", "acceleration")}
    for values in arrays.values():
        values[:, -1] = values[:, -2]
    return replace(recording, **arrays)


# What is wrong, what the checks find, and what it looks like.
FAULTS: dict[str, tuple[Callable[[Recording], Recording], str, str]] = {
    "y is mirrored": (lambda one: replace(one, y=-one.y, heading=-one.heading), "position", "y is mirrored"),
    "positions mirrored": (lambda one: replace(one, y=-one.y), "position", "y of positions alone is mirrored"),
    "a tick late": (a_tick_late, "position", "it is a time step (0.05 s) late"),
    "collisions are lost": (lambda one: replace(one, collisions=()), "collision by any s", "collisions are lost"),
    "collisions are invented": (hit_by_all, "collision by any s", "collisions are invented"),
    "boxes about the wrong point": (
        lambda one: replace(one, center_x=one.center_x + 0.7), "position by", "boxes are about another point",
    ),
    "boxes of another car": (lambda one: replace(one, width=one.width + 0.2), "box by", ""),
    "time drifts": (lambda one: replace(one, time=1.01 * one.time), "position", "its clock is 1.0% too fast"),
    "the ego ignores speeds": (ignores_speed, "speed by", "Ego ignores changes of its speed"),
    "speeds in km/h": (lambda one: replace(one, speed=3.6 * one.speed), "speed by", "speeds are in km/h"),
    "lengths in feet": (in_feet, "position", "lengths are in feet"),
    "headings in degrees": (
        lambda one: replace(one, heading=np.rad2deg(one.heading), center_x=0 * one.center_x, x=centers(one)[0],
                            y=centers(one)[1]),
        "heading by", "headings are in degrees",
    ),
    "headings clockwise": (
        lambda one: replace(one, heading=-one.heading), "heading by", "headings are clockwise",
    ),
    "braking is positive": (
        lambda one: replace(one, acceleration=np.abs(one.acceleration)), "acceleration by", "braking is positive",
    ),
    "centres of boxes for reference points": (
        lambda one: replace(one, x=centers(one)[0], y=centers(one)[1]), "position by",
        "the reference point is that of the centre",
    ),
    "reference points for centres of boxes": (
        lambda one: replace(one, center_x=0.0 * one.center_x), "position by",
        "the reference point is taken for the centre",
    ),
    "a stale last frame": (stale, "position by", "the last frame is that before"),
    "other names": (with_the_wrong_name, "It has other entities: Ego", ""),
    "an early end": (which_ends_early, "end by", ""),
}  # fmt: skip


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    return write_small_scenarios(tmp_path_factory.mktemp("small"))


# Each has a twin that is found in the same way.
AT_NIGHT = {
    "positions mirrored",
    "headings clockwise",
    "collisions are invented",
    "lengths in feet",
    "reference points for centres of boxes",
    "boxes of another car",
}


@pytest.mark.parametrize("fault", at_night(FAULTS, AT_NIGHT))
def test_each_fault_is_found_and_named(fault, small):
    change, words, name_of_fault = FAULTS[fault]
    faulty = Faulty(change)
    # Ends at the first scenario that shows it.
    problems = (run_small_scenario(faulty, name, small[name]).problem for name in SMALL_SCENARIOS)
    seen = next(problem for problem in problems if words in problem and name_of_fault in problem)
    assert ("it looks as if" in seen) == bool(name_of_fault)


@pytest.fixture(scope="module")
def ran(small):
    return {name: run_small_scenario("builtin", name, concrete) for name, concrete in small.items()}


def test_the_builtin_simulator_agrees_with_itself(ran):
    assert len(ran) == 12
    for found in ran.values():
        assert found.problem == ""
        assert found.deviations is not None
        assert found.deviations.position == 0.0


@pytest.mark.parametrize("each", at_night([4, 1], {1}))
def test_it_agrees_at_another_time_step(small, each):
    problems = {
        name: run_small_scenario("builtin:time_step=0.02", name, small[name]).problem for name in [*small][::each]
    }
    assert {problem for problem in problems.values() if problem} == set()


def test_sumo_agrees(small):
    pytest.importorskip("libsumo", reason="SUMO comes with the extra 'sumo'")
    for name in ("lane change", "a walker is hit from the side"):
        assert run_small_scenario("sumo", name, small[name]).problem == ""


def test_collisions_are_where_they_are_to_be(ran):
    hit = {name for name, found in ran.items() if found.expected.collisions}
    assert hit == {"a standing van is hit from behind", "a walker is hit from the side"}


def speeds_replaced(recording: Recording, speed) -> Recording:
    """The ego goes along its lane with these speeds."""
    e = recording.entity_index("Ego")
    x, speeds, acceleration = (getattr(recording, name).copy() for name in ("x", "speed", "acceleration"))
    speeds[e] = speed
    x[e] = x[e, 0] + np.concatenate(
        [[0.0], np.cumsum(np.diff(recording.time) * 0.5 * (speeds[e, 1:] + speeds[e, :-1]))]
    )
    acceleration[e] = np.gradient(speeds[e], recording.time)
    return replace(recording, x=x, speed=speeds, acceleration=acceleration)


def reverses(recording: Recording) -> Recording:
    return speeds_replaced(recording, 5.0 - 2.0 * recording.time)


def drives_through(recording: Recording) -> Recording:
    return replace(speeds_replaced(recording, np.minimum(5.0 + recording.time, 10.0)), collisions=())


def collides_from_afar(recording: Recording) -> Recording:
    return replace(recording, collisions=(Collision(2.0, ("Ego", "T00")),))


def strays(recording: Recording) -> Recording:
    y = recording.y.copy()
    y[recording.entity_index("Ego")] += 0.5 * recording.time
    return replace(recording, y=y)


def slides(recording: Recording) -> Recording:
    return replace(recording, heading=recording.heading + 0.4)


def begins_at_rest(recording: Recording) -> Recording:
    return speeds_replaced(recording, np.minimum(1.5 * recording.time, 8.0))


def lies_about_speed(recording: Recording) -> Recording:
    return replace(recording, speed=recording.speed + 1.5 * (recording.time > 1.0))


def stands(recording: Recording) -> Recording:
    return speeds_replaced(recording, np.maximum(5.0 - 10.0 * recording.time, 0.0))


AGENT_FAULTS: dict[str, tuple[str, Callable[[Recording], Recording], str]] = {
    "an agent that ignores speed": ("a standing van", ignores_speed, "as if nobody drove it"),
    "goes backwards": ("a standing van", reverses, "goes back by"),
    "no collision inside the van": ("a standing van", drives_through, "inside the van without a collision"),
    "a collision without the van": ("a standing van", collides_from_afar, "collides at 2.00 s, though"),
    "leaves its lane": ("a free lane", strays, "beside the middle of its lane (at most 1)"),
    "moves sideways": ("a free lane", slides, "points 0.40 rad away"),
    "another first speed": ("a free lane", begins_at_rest, "begins at 0.00 m/s instead of the 5 m/s"),
    "speeds of somebody else": ("a free lane", lies_about_speed, "its speeds add up to something else"),
    "stays where it is": ("a free lane", stands, "m along its lane (at least 5)"),
    "ends early": ("a free lane", which_ends_early, "is recorded up to 3.00 s instead of 6 s"),
}


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    concretes = write_small_scenarios(tmp_path_factory.mktemp("agents"), *AGENT_DURATIONS)
    return {
        name: run_small_scenario("builtin", name, concrete, agent="its own", drivers={"Ego": CarFollowing()}).expected
        for name, concrete in concretes.items()
    }


def agent_problem(name: str, recording: Recording) -> str:
    return describe_agent_problems(measure_agent_motion(recording), float(recording.time[-1]), AGENT_DURATIONS[name])


@pytest.mark.parametrize("fault", AGENT_FAULTS)
def test_what_no_agent_can_do_is_found(driven, fault):
    name, change, words = AGENT_FAULTS[fault]
    assert agent_problem(name, driven[name]) == ""
    assert words in agent_problem(name, change(driven[name]))


def test_whether_an_agent_stops_at_the_van_or_passes_it_is_its_own_affair(driven):
    name, recording = "a standing van", driven["a standing van"]
    hit = drives_through(recording)
    gaps = hit.x[1] - 3.0 + hit.center_x[1] - hit.x[0] - hit.center_x[0] - 2.25
    instant = float(hit.time[np.argmax(gaps < 0.0)])
    assert agent_problem(name, replace(hit, collisions=(Collision(instant, ("Ego", "T00")),))) == ""
    # On the next lane, to which some change at once.
    passing = drives_through(recording)
    y = passing.y.copy()
    y[0, passing.time > 3.0] += 3.5
    assert agent_problem(name, replace(passing, y=y)) == ""


class Broken(Builtin):
    def run(self, concretes):
        raise RuntimeError("the server died")


def test_a_simulator_that_dies_fails_its_checks():
    runs = list[SmallRun]()
    results = [result for result in run_checks(simulator_checks(Broken(), on_run=runs.append)) if result.problem]
    assert len(results) >= 12
    assert runs == []


def test_the_proof_holds_what_was_seen(tmp_path):
    proof = tmp_path / "proof.zip"
    result = cornercase("check-simulator", "builtin", "-o", proof)
    assert result.returncode == 0
    assert "21 of 21 checks hold for the simulator builtin" in result.stdout
    with zipfile.ZipFile(proof) as archive:
        names = archive.namelist()
        found = json.loads(archive.read("proof.json"))
        summary = archive.read("summary.txt").decode()
        table = archive.read("recordings/lane_change.own.csv")
        assert table == archive.read("recordings/lane_change.builtin.csv")
    assert len([name for name in names if name.endswith(".xosc")]) == 14
    assert len([name for name in names if name.endswith(".csv")]) == 28
    assert [scenario["name"] for scenario in found["scenarios"]] == [*SMALL_SCENARIOS, *AGENT_DURATIONS]
    assert [scenario["agent"] for scenario in found["scenarios"]] == 12 * [""] + 2 * ["a function of one's own"]
    assert found["scenarios"][-1]["motion"]["gap"] == pytest.approx(2.7, abs=0.2)
    assert found["settings"]["time_step"] == 0.05
    assert found["crashes"] == []
    # Whoever opens it reads this first.
    lines = summary.splitlines()
    assert lines[0].startswith("builtin, version ")
    assert found["platform"] in lines[1]
    assert sum(line.startswith("ok ") for line in lines) == 21
    (table_row,) = (line.split() for line in lines if line.startswith("a stop 0.4 m behind a van "))
    assert table_row[-10:-2] == ["0"] * 8
    assert all(scenario["deviations"]["position"] == 0.0 for scenario in found["scenarios"])
    assert all(scenario["spread"] == 0.0 for scenario in found["scenarios"])
    assert all(scenario["seconds_again"] > 0.0 for scenario in found["scenarios"])
    assert found["scenarios"][-1]["boxes"] == {"Ego": [4.5, 1.8], "T00": [6.0, 2.1]}
    assert all(check["problem"] == "" for check in found["checks"])


@pytest.mark.slow
def test_a_crash_on_purpose_hits_a_run_and_costs_nothing_else(small):
    pytest.importorskip("libsumo", reason="SUMO comes with the extra 'sumo'")
    run: SimulatorCrashResult = crash_during_runs("sumo", small["braking to a stop"], "Ego")
    assert not run.is_server
    assert "spawn_main" in run.killed
    assert 1 <= run.n_before < len(run.outcomes)
    assert (run.n_lost, run.spread) == (0, 0.0)
    # The one that it hit waited for a new process.
    assert max(run.seconds) == run.seconds[run.n_before]


def test_a_proof_that_cannot_be_written_is_refused(tmp_path):
    result = cornercase("check-simulator", "builtin", "-o", tmp_path)
    assert result.returncode == 2
    assert str(tmp_path) in result.stderr
