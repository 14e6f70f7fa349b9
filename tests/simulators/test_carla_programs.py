"""ScenarioRunner is started once for many scenarios, and nothing of one is left for the next."""

from __future__ import annotations

import socket
import sys
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import psutil
import pytest

from cornercase._common.errors import InputError, SimulationError, SimulatorError
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Carla
from cornercase.simulators.carla._server_lock import ServerLock
from helpers.carla_or_stand_in import AGAIN_IF_THE_CLIENT_CRASHES, REAL, Served
from helpers.passing_cars import write_passing_cars
from helpers.waiting import lives, until

pytestmark = [
    pytest.mark.skipif(
        find_spec("carla") is None or bool(REAL), reason="it takes the client of the extra 'carla', and a stand-in"
    ),
    AGAIN_IF_THE_CLIENT_CRASHES,
]
FORKED_ONLY = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere each scenario has a program of its own")
RUNNER = Path(__file__).parents[1] / "fake_scenario_runner"
STARTS = (140.0, 150.0)


@pytest.fixture
def scenario(tmp_path):
    return write_passing_cars(tmp_path)


@pytest.fixture
def programs(tmp_path, monkeypatch):
    """Programs that were started, by the number of each."""
    file = tmp_path / "programs"
    monkeypatch.setenv("FAKE_RUNNER_STARTS", str(file))
    return lambda: [int(line) for line in file.read_text().split()] if file.exists() else []


@pytest.fixture
def server(scenario):
    with Served(scenario.parent / "motorway.xodr") as served:
        yield served


def make_simulator(server, **more):
    return Carla(
        hosts=server.host, port=server.port, scenario_runner=str(RUNNER), python=sys.executable, patience=5.0, **more
    )  # fmt: skip


def run(simulator, scenario, starts):
    with simulator:
        return list(simulator.run([ConcreteScenario(scenario, {"start": start}) for start in starts]))


def are_the_same(some, others):
    """Whether recordings are the same to the last bit."""
    for one, other in zip(some, others, strict=True):
        assert isinstance(one, Recording), one
        assert (one.names, one.collisions) == (other.names, other.collisions)
        for name in ("time", "x", "y", "heading", "speed", "acceleration"):
            assert np.array_equal(getattr(one, name), getattr(other, name), equal_nan=True), name
    return True


@FORKED_ONLY
def test_scenarios_of_one_program_are_as_in_a_program_each(server, scenario, programs):
    alone = [run(make_simulator(server), scenario, [start])[0] for start in STARTS]
    assert len(programs()) == len(STARTS)
    together = run(make_simulator(server), scenario, STARTS)
    assert len(programs()) == len(STARTS) + 1
    assert are_the_same(together, alone)
    # The last one is no longer there.
    assert not lives(programs()[-1])


def test_a_program_with_threads_of_its_own_runs_one_scenario(server, scenario, programs, monkeypatch):
    together = run(make_simulator(server), scenario, STARTS)
    n_programs = len(programs())
    monkeypatch.setenv("FAKE_RUNNER", "thread")
    assert are_the_same(run(make_simulator(server), scenario, STARTS), together)
    assert len(programs()) == n_programs + len(STARTS)


@FORKED_ONLY
def test_after_a_failure_there_is_a_new_program(server, scenario, programs, monkeypatch, tmp_path):
    faults = tmp_path / "faults"
    wrong = ["cannot load", "aborts", "fails at the end", "watchdog", "late watchdog"]
    faults.write_text("".join(f"\n{fault}\n" for fault in wrong) + "\n")
    monkeypatch.setenv("FAKE_RUNNER", f"@{faults}")
    outcomes = run(make_simulator(server), scenario, [140.0] * 11)
    assert are_the_same(outcomes[::2], outcomes[:1] * 6)
    failures = outcomes[1::2]
    # Only what may not happen again is tried again.
    own, others = SimulationError, SimulatorError
    assert [type(failure) for failure in failures] == [own, others, own, others, others]
    assert "KeyError: 'Ego'" in str(failures[0])
    assert "a storyboard that is none" in str(failures[2])
    assert str(failures[4]).endswith("Watchdog exception - Timeout of 6.0 seconds occured")
    assert len(programs()) == 6


def test_a_folder_that_cannot_be_written_is_said(server, scenario, tmp_path):
    (tmp_path / "taken").write_text("")
    with pytest.raises(InputError, match=r"folder=.*taken: cannot be written \(File exists\); choose another folder"):
        run(make_simulator(server, folder=str(tmp_path / "taken")), scenario, STARTS[:1])


def test_a_server_serves_one_search_at_a_time(server, scenario):
    first, second = make_simulator(server), make_simulator(server)
    assert isinstance(run_one(first, scenario), Recording)
    with pytest.raises(
        InputError, match=f"Another cornercase process runs scenarios on CARLA on localhost:{server.port}; "
    ):
        # As a second search does, but without its patience.
        ServerLock(server.host, server.port).acquire(timeout=0.0)
    first.close()
    # Nobody closes it, as its worker may be killed.
    assert isinstance(run_one(second, scenario), Recording)
    second._runner.close()
    del second
    third = make_simulator(server)
    assert isinstance(run_one(third, scenario), Recording)
    third.close()


def test_the_port_of_another_scenario_runners_traffic_manager_is_left_alone(server, scenario):
    # That of the first worker of any other search, if nobody has it yet.
    with suppress(OSError), socket.create_server(("", 8000)):
        (found,) = run(make_simulator(server), scenario, STARTS[:1])
        assert isinstance(found, Recording), found


def test_a_program_of_an_agent_does_not_get_what_is_for_the_next_scenario(server, scenario, monkeypatch):
    monkeypatch.setenv("FAKE_RUNNER", "agent starts a program")
    for found in run(make_simulator(server), scenario, STARTS[:2]):
        assert isinstance(found, Recording), found


@FORKED_ONLY
def test_programs_that_an_agent_has_left_end_with_its_scenario(server, scenario, programs, monkeypatch, tmp_path):
    monkeypatch.setenv("FAKE_RUNNER", "agent leaves programs")
    simulator = make_simulator(server, folder=str(tmp_path / "kept"))
    found = run_one(simulator, scenario)
    assert isinstance(found, Recording), found
    (log,) = (tmp_path / "kept").glob("*/scenario_runner.log")
    left = [int(line.split()[1]) for line in log.read_text().splitlines() if line.startswith("LEFT")]
    assert len(left) == 2
    # Also that with a session of its own, while the one that runs scenarios goes on.
    assert not [number for number in left if lives(number)]
    assert lives(programs()[0])
    simulator.close()


def test_things_and_friction_of_a_scenario_are_gone_in_the_next_one(server, scenario, monkeypatch):
    monkeypatch.setenv("FAKE_RUNNER", "leaves things")
    simulator = make_simulator(server)
    assert isinstance(run_one(simulator, scenario), Recording)
    monkeypatch.setenv("FAKE_RUNNER", "")
    simulator.close()
    simulator = make_simulator(server)
    assert isinstance(run_one(simulator, scenario), Recording)
    simulator.close()
    carla = pytest.importorskip("carla")
    actors = carla.Client(server.host, server.port).get_world().get_actors()
    assert not [one.type_id for one in actors if one.type_id.startswith("static.")]


@FORKED_ONLY
def test_a_scenario_that_does_not_end_is_killed_alone(server, scenario, programs, monkeypatch, tmp_path):
    faults = tmp_path / "faults"
    faults.write_text("\n".join(["does not end", "", ""]))
    monkeypatch.setenv("FAKE_RUNNER", f"@{faults}")
    killed, *others = run(make_simulator(server, duration=0.5), scenario, [140.0, 140.0])
    assert are_the_same([killed], others)
    assert len(programs()) == 1


@FORKED_ONLY
def test_a_program_that_was_killed_between_two_scenarios_is_started_again(server, scenario, programs):
    simulator = make_simulator(server)
    first = run_one(simulator, scenario)
    psutil.Process(programs()[0]).kill()
    until(lambda: not lives(programs()[0]))
    second = run_one(simulator, scenario)
    simulator.close()
    assert are_the_same([second], [first])
    assert len(programs()) == 2


def run_one(simulator, scenario):
    (found,) = simulator.run([ConcreteScenario(scenario, {"start": 140.0})])
    return found
