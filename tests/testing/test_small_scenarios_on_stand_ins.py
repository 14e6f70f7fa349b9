"""The checks of small scenarios find faults in a CarMaker and a CARLA that other programs stand in for."""

from __future__ import annotations

import json
import sys
import zipfile
from contextlib import closing
from importlib.util import find_spec
from pathlib import Path

import pytest

from conftest import at_night
from cornercase.simulators import Carla, CarMaker
from cornercase.testing._deviations import run_small_scenario, run_with_agent
from cornercase.testing._example_driver import CarFollowing
from cornercase.testing._small_scenarios import AGENT_DURATIONS, SMALL_SCENARIOS, write_small_scenarios
from helpers.carla_or_stand_in import AGAIN_IF_THE_CLIENT_CRASHES, REAL, Served, free_port
from helpers.carmaker_port import SmallTestRuns, small_port
from helpers.command_line import cornercase

pytestmark = AGAIN_IF_THE_CLIENT_CRASHES
NEEDS_CARLA = pytest.mark.skipif(
    find_spec("carla") is None or bool(REAL), reason="it takes the client of the extra 'carla', and a stand-in"
)
HELPERS = Path(__file__).parents[1] / "helpers"
OWN = "a function of one's own"


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    return write_small_scenarios(tmp_path_factory.mktemp("small"), *SMALL_SCENARIOS, *AGENT_DURATIONS)


@pytest.fixture
def project(tmp_path):
    (tmp_path / "project" / "SimOutput" / "pc").mkdir(parents=True)
    return tmp_path / "project"


def problem(project, small, name, fault=""):
    """What the check of a scenario says of a CarMaker with a fault."""
    port = small_port(project, fault)
    simulator = CarMaker(testrun="{scenario}", project=str(project), hosts="127.0.0.1", port=port.number, via="port")
    with closing(simulator):
        found = run_small_scenario(simulator, name, small[name]).problem
    port.close()
    return found


@pytest.mark.parametrize("name", at_night(SMALL_SCENARIOS, [*SMALL_SCENARIOS][1::2]))
def test_carmaker_agrees(project, small, name):
    assert problem(project, small, name) == ""


FAULTS = {
    "mirror": ("lane change", "y is mirrored"),
    "late": ("braking to a stop", "it is a time step (0.05 s) late"),
    "sensor": ("a stop 0.4 m behind a van", "collisions are invented"),
    "box": ("braking to a stop", "boxes are about another point of their vehicles (Ego +0.70 m ahead)"),
    "drift": ("constant speed", "its clock is 2.0% too fast"),
    "speed": ("braking to a stop", "Ego ignores changes of its speed"),
    "heading": ("lane change", "headings are clockwise"),
    "feet": ("smooth change of speed", "lengths are in feet"),
    "centre": ("braking to a stop", "boxes are about another point of their vehicles (Ego +2.25 m ahead)"),
    "stale": ("constant speed", "the last frame is that before"),
}


@pytest.mark.filterwarnings("ignore:.* the box of Ego:UserWarning")
@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_of_carmaker_is_named(project, small, fault):
    name, words = FAULTS[fault]
    assert f"it looks as if {words}" in problem(project, small, name, fault)


@pytest.mark.slow
def test_the_command_checks_carmaker_and_lets_it_crash(project, tmp_path):
    SmallTestRuns(project)
    program, port, proof = HELPERS / "carmaker_port.py", free_port(), tmp_path / "proof.zip"
    start = f"{sys.executable} {program} {{port}} {project} small"
    spec = f"carmaker:testrun={{scenario}},project={project},via=port,port={port},start={start}"
    done = cornercase("check-simulator", spec, "-o", proof)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "ok     goes on after a crash on purpose" in done.stdout
    with zipfile.ZipFile(proof) as archive:
        found = json.loads(archive.read("proof.json"))
    assert [one["problem"] for one in found["scenarios"]] == [""] * 12
    assert [one["spread"] for one in found["scenarios"]] == [0.0] * 12
    (crash,) = found["crashes"]
    assert (crash["is_server"], crash["n_lost"], crash["spread"]) == (True, 0, 0.0)
    assert str(program) in crash["killed"]
    # What drives the ego is said by the TestRun.
    untried = [one["name"] for one in found["checks"] if one["not_tried"]]
    assert untried == [f"agrees with the builtin simulator, driven by {OWN}: {name}" for name in AGENT_DURATIONS]
    assert (project / "started.txt").read_text().split().count("started") > 12


RUNNER = HELPERS.parent / "fake_scenario_runner"


def problem_of_carla(small, name, monkeypatch, fault="", *wrong):
    """What the check of a scenario says of a CARLA with a fault in its ScenarioRunner or its server."""
    monkeypatch.setenv("FAKE_RUNNER", f"plays {fault}".strip())
    with Served(small[name].path.parent / "motorway.xodr", *wrong) as server:
        simulator = Carla(
            hosts=server.host, port=server.port, scenario_runner=str(RUNNER), python=sys.executable, patience=5.0
        )
        return run_small_scenario(simulator, name, small[name]).problem


IN_THE_DAY = ("a standing van is hit from behind",)


@NEEDS_CARLA
@pytest.mark.parametrize("name", at_night(SMALL_SCENARIOS, {*SMALL_SCENARIOS} - {*IN_THE_DAY}))
def test_carla_agrees(small, name, monkeypatch):
    assert problem_of_carla(small, name, monkeypatch) == ""


CARLA_FAULTS = {
    "mirror": ("lane change", "y is mirrored", ()),
    "late": ("braking to a stop", "it is a time step (0.05 s) late", ()),
    "collisions": ("a standing van is hit from behind", "collisions are lost", ("no-collisions",)),
    "box": (
        "braking to a stop",
        "boxes are about another point of their vehicles (Ego +0.70 m ahead)",
        ("box-ahead=0.7",),
    ),
    "drift": ("constant speed", "its clock is 2.0% too slow", ()),
    "speed": ("braking to a stop", "Ego ignores changes of its speed", ()),
    "heading": ("lane change", "headings are clockwise", ()),
    "feet": ("smooth change of speed", "lengths are in feet", ()),
    "centre": ("braking to a stop", "the reference point is taken for the centre of the box", ()),
    "stale": ("constant speed", "the last frame is that before", ()),
}


@NEEDS_CARLA
@pytest.mark.parametrize("fault", at_night(CARLA_FAULTS, {*CARLA_FAULTS} - {"mirror"}))
def test_each_fault_of_carla_is_named(small, fault, monkeypatch):
    name, words, wrong = CARLA_FAULTS[fault]
    assert f"it looks as if {words}" in problem_of_carla(small, name, monkeypatch, fault, *wrong)


AGENTS = dict(Carla.own_agents())
FILE = "an AutonomousAgent in a file"
BEHAVIORS = ("aggressive", "cautious", "normal")


def run_of_agent(small, name, agent, monkeypatch, fault="", *wrong):
    """A small scenario on what stands in for CARLA, in which an agent drives the ego, or a function of one's own."""
    monkeypatch.setenv("FAKE_RUNNER", f"plays {fault}".strip())
    with Served(small[name].path.parent / "motorway.xodr", *wrong) as server:
        simulator = Carla(
            hosts=server.host, port=server.port, scenario_runner=str(RUNNER), python=sys.executable, patience=5.0
        )
        if agent == OWN:
            return run_small_scenario(simulator, name, small[name], agent=agent, drivers={"Ego": CarFollowing()})
        return run_with_agent(simulator, name, small[name], agent, AGENTS[agent])


def test_agents_of_carla_are_those_that_users_can_name():
    assert [*AGENTS] == [*(f"CARLA's behaviour agent '{name}'" for name in BEHAVIORS), FILE]
    assert Path(str(AGENTS[FILE]["agent"])).is_file()


@NEEDS_CARLA
@pytest.mark.parametrize("name", at_night(AGENT_DURATIONS, {"a free lane"}))
@pytest.mark.parametrize("agent", at_night([*AGENTS, OWN], {*AGENTS} - {FILE}))
def test_carla_is_driven_by_each_of_its_agents(small, name, agent, monkeypatch):
    run = run_of_agent(small, name, agent, monkeypatch)
    assert run.problem == ""
    assert run.motion is not None
    if name == "a standing van":
        # The agent in a file looks at nothing, and the aggressive one that stands in for CARLA's does not brake.
        assert (run.motion.collision is not None) == (agent == FILE or "aggressive" in agent)


AGENT_FAULTS = {
    "ignored, a function": ("a standing van", OWN, "agent-ignored", "Ego ignores changes of its speed", ()),
    "ignored": ("a standing van", FILE, "agent-ignored", "as if nobody drove it", ()),
    "reverses": ("a free lane", FILE, "agent-reverses", "goes back by", ()),
    "strays": ("a free lane", FILE, "agent-strays", "beside the middle of its lane", ()),
    "no collisions": ("a standing van", FILE, "", "inside the van without a collision", ("no-collisions",)),
}


@NEEDS_CARLA
@pytest.mark.parametrize("fault", at_night(AGENT_FAULTS, {*AGENT_FAULTS} - {"ignored"}))
def test_each_fault_of_an_agent_on_carla_is_named(small, fault, monkeypatch):
    name, agent, kind, words, wrong = AGENT_FAULTS[fault]
    assert words in run_of_agent(small, name, agent, monkeypatch, kind, *wrong).problem


@NEEDS_CARLA
@pytest.mark.slow
def test_the_command_checks_carla_with_all_agents_and_lets_its_server_crash(small, tmp_path, monkeypatch):
    monkeypatch.setenv("FAKE_RUNNER", "plays")
    monkeypatch.setenv("SCENARIO_RUNNER_ROOT", str(RUNNER))
    monkeypatch.setenv("CORNERCASE_CARLA_PYTHON", sys.executable)
    road = small["constant speed"].path.parent / "motorway.xodr"
    start = f"{sys.executable} {HELPERS / 'carla_protocol_server.py'} {{port}} {road} stay"
    proof = tmp_path / "proof.zip"
    done = cornercase("check-simulator", f"carla:port={free_port()},patience=5,start={start}", "-o", proof)
    assert done.returncode == 0, done.stdout + done.stderr
    with zipfile.ZipFile(proof) as archive:
        found = json.loads(archive.read("proof.json"))
    assert [check["name"] for check in found["checks"] if check["problem"] or check["not_tried"]] == []
    assert found["versions"]["CARLA's client"] == found["version"] != ""
    seen = {(one["agent"], one["name"]) for one in found["scenarios"] if one["agent"]}
    assert seen == {(agent, name) for agent in (*AGENTS, OWN) for name in AGENT_DURATIONS}
    (crash,) = found["crashes"]
    assert crash["is_server"]
    assert "carla_protocol_server.py" in crash["killed"]
    assert crash["n_lost"] == 0
    assert crash["spread"] < 0.5
