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
from cornercase.testing._deviations import run_small_scenario
from cornercase.testing._small_scenarios import SMALL_SCENARIOS, write_small_scenarios
from helpers.carla_or_stand_in import REAL, Served, free_port
from helpers.carmaker_port import SmallTestRuns, small_port
from helpers.command_line import cornercase

NEEDS_CARLA = pytest.mark.skipif(
    find_spec("carla") is None or bool(REAL), reason="it takes the client of the extra 'carla', and a stand-in"
)
HELPERS = Path(__file__).parents[1] / "helpers"


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    return write_small_scenarios(tmp_path_factory.mktemp("small"))


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


@pytest.mark.parametrize("name", SMALL_SCENARIOS)
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
