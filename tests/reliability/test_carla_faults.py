"""CARLA's servers die, hang, refuse, answer late, and lose frames during a search, and nothing is lost or doubled."""

from __future__ import annotations

import sys
import time
from collections import Counter
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario
from cornercase.simulators.pool._simulator import WorkerSimulator
from cornercase.study import StudyFile
from helpers.carla_or_stand_in import REAL, free_port
from helpers.command_line import cornercase
from helpers.passing_cars import write_passing_cars

pytestmark = pytest.mark.skipif(
    find_spec("carla") is None or bool(REAL), reason="it takes the client of the extra 'carla', and a stand-in"
)
HERE = Path(__file__).parents[1]
SERVER = HERE / "helpers" / "carla_protocol_server.py"
RUNNER = HERE / "fake_scenario_runner"


@pytest.fixture
def scenario(tmp_path):
    return write_passing_cars(tmp_path)


def options(scenario, *wrong):
    start = f"{sys.executable} {SERVER} {{port}} {scenario.parent / 'motorway.xodr'} stay {' '.join(wrong)}"
    return {
        "port": free_port(), "scenario_runner": str(RUNNER), "python": sys.executable, "patience": 2.0,
        "start": start.strip(),
    }  # fmt: skip


def is_whole(recording, start):
    """Whether a recording is that of the scenario with the van at this point."""
    e = recording.entity_index("T00")
    # At 15 m/s; the centre of its box is 1.9 m ahead.
    return np.abs(recording.x[e] - (start + 1.9 + 15.0 * recording.time)).max() < 1.0


def test_a_server_is_started_for_each_worker_and_again_after_some_scenarios(scenario, tmp_path, monkeypatch):
    monkeypatch.setenv("FAKE_RUNNER", "plays")
    faults = tmp_path / "faults"
    faults.mkdir()
    given = options(scenario, f"random={faults}:2") | {"restart_after": 2}
    simulator = WorkerSimulator("carla", given, retries=2)
    starts = [140.0, 150.0, 160.0, 170.0]
    outcomes = list(simulator.run([ConcreteScenario(scenario, {"start": start}) for start in starts]))
    simulator.close()
    for outcome, start in zip(outcomes, starts, strict=True):
        assert isinstance(outcome, Recording), outcome
        assert is_whole(outcome, start)
    # One died, one lost a frame, and others were started after two scenarios each.
    assert {path.read_text().split()[0] for path in faults.iterdir()} == {"die-at", "lose"}


def test_a_server_that_never_starts_ends_the_search(scenario):
    given = options(scenario) | {"start": f"{sys.executable} -c \"print('no GPU'); import sys; sys.exit(1)\" {{port}}"}
    done = explore(scenario, given, "s.db", 2)
    assert done.returncode == 2
    assert "ended with exit code 1; its last words: no GPU" in done.stderr


def test_a_server_that_dies_as_soon_as_it_answers_costs_a_try_alone(scenario, tmp_path, monkeypatch):
    monkeypatch.setenv("FAKE_RUNNER", "plays")
    simulator = WorkerSimulator("carla", options(scenario, f"die-once={tmp_path / 'died'}"), retries=1)
    (found,) = simulator.run([ConcreteScenario(scenario, {"start": 140.0})])
    simulator.close()
    assert (tmp_path / "died").exists()
    assert is_whole(found, 140.0)


def test_a_server_that_dies_in_a_run_is_not_waited_for(scenario, monkeypatch):
    monkeypatch.setenv("FAKE_RUNNER", "plays")
    patience = 60.0
    simulator = WorkerSimulator("carla", options(scenario, "die-at=20") | {"patience": patience}, retries=0)
    begin = time.monotonic()
    (found,) = simulator.run([ConcreteScenario(scenario, {"start": 140.0})])
    seconds = time.monotonic() - begin
    simulator.close()
    assert str(found) == "while the scenario ran, CARLA ended with exit code 1; its last words: ready, tried once"
    assert seconds < patience


def test_a_scenario_runner_that_aborts_is_run_again(scenario, monkeypatch):
    # CARLA's client aborts if what its server sends is cut.
    monkeypatch.setenv("FAKE_RUNNER", "aborts")
    simulator = WorkerSimulator("carla", options(scenario), retries=1)
    (found,) = simulator.run([ConcreteScenario(scenario, {"start": 140.0})])
    simulator.close()
    assert str(found).endswith("tried 2 times")


def explore(scenario, given, study, budget, *more):
    spec = ",".join(f"{name}={value}" for name, value in given.items())
    return cornercase(
        "explore", scenario, "--range", "start=130:200", "--ego", "Ego", "--other", "T00", "--metric", "distance",
        "--optimizer", "sobol", "--budget", budget, "--simulator", f"carla:{spec}", "-o", scenario.parent / study,
        "--timeout", "20", *more,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("n_faults", "budget"),
    [pytest.param(8, 10, marks=pytest.mark.slow), pytest.param(200, 250, marks=pytest.mark.torture)],
)
def test_faults_at_random_lose_and_double_nothing(scenario, tmp_path, monkeypatch, n_faults, budget):
    monkeypatch.setenv("FAKE_RUNNER", "plays")
    faults = tmp_path / "faults"
    faults.mkdir()
    # Every server has a fault as long as there are any left, so that a scenario may need many tries.
    given = options(scenario, f"random={faults}:{n_faults}")
    done = explore(
        scenario, given, "s.db", budget, "--workers", "2", "--retries", "40", "--max-failures", "0",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert len([*faults.iterdir()]) == n_faults
    with StudyFile.open(tmp_path / "s.db", readonly=True) as study:
        rows = list(study.rows())
        values = [row.values["start"] for row in rows]
        assert len(rows) == len({*values}) == budget
        assert {row.error for row in rows} == {None}
        wrong = [row.id for row in rows if not is_whole(study.recording(row.id), row.values["start"])]
    assert wrong == []
    kinds = Counter(path.read_text().split()[0] for path in faults.iterdir())
    assert len(kinds) == 8
