"""What an agent on CARLA does wrong costs its own scenario, is said, and is not taken for the server's fault."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cornercase._common.errors import SimulationError, SimulatorError
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin, Carla
from helpers.carla_or_stand_in import AGAIN_IF_THE_CLIENT_CRASHES, REAL, Served
from helpers.passing_cars import write_passing_cars

pytestmark = [
    AGAIN_IF_THE_CLIENT_CRASHES,
    pytest.mark.skipif(
        find_spec("carla") is None or bool(REAL), reason="it takes the client of the extra 'carla', and a stand-in"
    ),
    pytest.mark.skipif(sys.platform != "linux", reason="signals, and a folder that is removed while it is in use"),
]
RUNNER = Path(__file__).parents[1] / "fake_scenario_runner"


@pytest.fixture
def scenario(tmp_path):
    return write_passing_cars(tmp_path)


@pytest.fixture
def run(scenario, monkeypatch):
    """Run the scenario with something that goes wrong, and then without; return the outcome of the former."""

    def run_scenario(wrong, **more):
        faults = scenario.with_name("faults")
        faults.write_text(f"{wrong}\n\n")
        monkeypatch.setenv("FAKE_RUNNER", f"@{faults}")
        options: dict[str, Any] = {
            # As long as a busy machine needs to start a process.
            "patience": 20.0,
            "scenario_runner": str(RUNNER),
            "python": sys.executable,
            "ego": "Ego",
        } | more
        with Served(scenario.parent / "motorway.xodr") as server:
            simulator = Carla(hosts=server.host, port=server.port, **options)
            simulator.on_notice = notices.append
            with simulator:
                found, well = simulator.run([ConcreteScenario(scenario, {})] * 2)
        # Where the client crashed in the first run, the second one meets the fault.
        assert isinstance(well, Recording), (found, well)
        return found

    notices: list[str] = []
    run_scenario.notices = notices  # type: ignore[attr-defined]
    return run_scenario


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ("agent removes the ego", "Ego was removed from CARLA at t = 0.3 s, while the storyboard went on"),
        pytest.param(
            "agent changes the time step", "the time step of CARLA became 0.1 s at t = 0.3 s", marks=pytest.mark.slow
        ),
        pytest.param(
            "agent removes the folder",
            "scenario_runner.log, which ScenarioRunner wrote into the folder of the run, cannot be read (No such file"
            " or directory); an agent must not change that folder",
            marks=pytest.mark.slow,
        ),
        ("agent writes files", "cannot be read (Is a directory); an agent must not change that folder"),
        ("agent ends the process", "to its end: it ended with exit code 3; its last words: no such weights"),
        ("agent raises", "to its end: ValueError: lost TimeoutError: time-out of 5000ms"),
        pytest.param("cannot plan", "to its end: networkx.exception.NetworkXNoPath: 0 from 2", marks=pytest.mark.slow),
        pytest.param("agent raises and the client aborts", "to its end: ValueError: lost", marks=pytest.mark.slow),
    ],
)
def test_what_an_agent_does_wrong_is_a_failed_scenario(run, wrong, words):
    found = run(wrong)
    assert type(found) is SimulationError, found
    assert str(found).endswith(words)


def test_an_agent_that_hangs_is_told_from_a_server_that_does(run, tmp_path):
    (tmp_path / "my_agent.py").write_text("class MyAgent:\n    def __init__(self, config):\n        pass\n")
    found = run("agent hangs", patience=3.0, agent=str(tmp_path / "my_agent.py"))
    assert type(found) is SimulationError
    assert str(found).startswith(
        "CARLA sent no frame for 9 s, although it answers, because ScenarioRunner requested no frame"
    )
    assert "the agent my_agent.py hangs, or needs a larger `simulator` carla:patience=" in str(found)


@pytest.mark.slow
def test_where_no_agent_hangs_it_is_tried_again(run):
    """ScenarioRunner or CARLA's client hangs, which may not happen again."""
    assert type(run("agent hangs", patience=3.0)) is SimulatorError


def test_an_agent_may_print_a_lot_but_not_without_end(run):
    assert isinstance(run("agent prints much"), Recording)
    found = run("agent prints without end")
    assert type(found) is SimulationError
    assert "ScenarioRunner and the agent in it printed more than 1 GiB" in str(found)


def test_another_entity_that_vanishes_is_said(run):
    found = run("agent removes another")
    assert isinstance(found, Recording)
    assert run.notices == ["T00 vanished from CARLA in a run, although no action of the scenario removes it"]


def test_a_scenario_may_remove_its_ego(run, scenario):
    trigger = (
        '<StartTrigger><ConditionGroup><Condition name="c" delay="0" conditionEdge="none"><ByValueCondition>'
        '<SimulationTimeCondition value="{}" rule="greaterThan"/></ByValueCondition></Condition></ConditionGroup>'
        "</StartTrigger>"
    )
    event = (
        '<Event name="e" priority="overwrite"><Action name="a"><GlobalAction><EntityAction entityRef="Ego">'
        f"<DeleteEntityAction/></EntityAction></GlobalAction></Action>{trigger.format(0.3)}</Event>"
    )
    story = (
        '<Story name="s"><ParameterDeclarations/><Act name="a"><ManeuverGroup name="g" maximumExecutionCount="1">'
        f'<Actors selectTriggeringEntities="false"/><Maneuver name="m">{event}</Maneuver></ManeuverGroup>'
        f"{trigger.format(0)}</Act></Story>"
    )
    text = scenario.read_text()
    scenario.write_text(text.replace("<StopTrigger>", story + "<StopTrigger>"))
    (found,) = Builtin().run([ConcreteScenario(scenario, {})])
    assert isinstance(found, Recording), found
    assert np.isfinite(found.x[0]).sum() < 10 < len(found.time)
    found = run("agent removes the ego")
    assert isinstance(found, Recording), found
    assert found.time[-1] == pytest.approx(0.25)


def test_an_actor_that_an_agent_names_like_an_entity_is_not_taken_for_it(run):
    found = run("agent makes namesakes")
    assert isinstance(found, Recording), found
    # As far as CARLA's boxes reach ahead of where the scenario has the entity.
    assert found.x[:, 0] == pytest.approx([100.0, 140.0], abs=4.0)
