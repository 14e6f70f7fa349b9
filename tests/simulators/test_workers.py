"""Simulators in worker processes, which crash, hang and lie."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path

import pytest

from cornercase._common.errors import InputError, SimulationError
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import WorkerSimulator
from fake_simulators import Plan


def concretes(count):
    return [ConcreteScenario(Path("none.xosc"), {"k": float(k)}) for k in range(count)]


def results(folder, does, count=6, **options):
    simulator = WorkerSimulator("failing", {"plan": Plan(folder, does)}, **options)
    try:
        found = list(simulator.run(concretes(count)))
    finally:
        simulator.close()
    return [str(one) if isinstance(one, SimulationError) else int(one.x[0, 0]) for one in found]


def tries(folder, k):
    return len((folder / f"tries-{k}").read_text())


@pytest.mark.parametrize("workers", [1, 3])
def test_all_come_in_order_and_each_worker_starts_the_simulator_once(tmp_path, workers):
    assert results(tmp_path, {}, count=9, workers=workers) == list(range(9))
    assert len((tmp_path / "starts").read_text()) <= workers
    assert all(tries(tmp_path, k) == 1 for k in range(9))


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("what", ["crash", "cut"])
def test_who_crashes_is_tried_again_and_costs_itself_alone(tmp_path, what, workers):
    found = results(tmp_path, {1: [what, "well"], 3: [what]}, workers=workers)
    code = {"crash": 3, "cut": 7}[what]
    assert found == [0, 1, 2, f"the simulator's process ended with exit code {code}, tried 2 times", 4, 5]
    assert [tries(tmp_path, k) for k in range(6)] == [1, 2, 1, 2, 1, 1]


def test_who_hangs_is_stopped(tmp_path):
    begun = time.monotonic()
    found = results(tmp_path, {2: ["hang"], 4: ["hang", "well"]}, timeout=1.0)
    assert found == [0, 1, "the simulator did not end within 1 s, tried 2 times", 3, 4, 5]
    assert time.monotonic() - begun < 60.0


def test_retries_can_be_none(tmp_path):
    found = results(tmp_path, {0: ["crash"]}, count=2, retries=0)
    assert found == ["the simulator's process ended with exit code 3, tried once", 1]
    assert tries(tmp_path, 0) == 1


def test_what_the_simulator_says_itself_is_not_tried_again(tmp_path):
    found = results(tmp_path, {0: ["fail"], 1: ["raise"]}, count=3)
    assert found == ["it cannot be", "the simulator failed (ZeroDivisionError: of the adapter)", 2]
    assert [tries(tmp_path, k) for k in range(3)] == [1, 1, 1]


def test_a_process_that_somebody_kills_costs_nothing(tmp_path):
    simulator = WorkerSimulator("failing", {"plan": Plan(tmp_path, {1: ["hang", "well"]})})
    found = simulator.run(concretes(3))
    assert int(next(found).x[0, 0]) == 0
    process = simulator._workers[0]._process

    def kill():
        while not (tmp_path / "tries-1").exists():
            time.sleep(0.01)
        os.kill(process.pid, signal.SIGKILL)

    threading.Thread(target=kill).start()
    assert [int(one.x[0, 0]) for one in found] == [1, 2]
    simulator.close()


def test_a_simulator_that_only_crashes_stops_the_exploration(tmp_path):
    simulator = WorkerSimulator("failing", {"plan": Plan(tmp_path, {k: ["crash"] for k in range(9)})}, retries=0)
    found = simulator.run(concretes(9))
    for _ in range(4):
        assert "exit code 3" in str(next(found))
    with pytest.raises(InputError, match=r"no result in 5 scenarios in a row.*goes on when it is well"):
        next(found)
    simulator.close()


def test_what_cannot_go_on_at_all_is_said_in_its_own_words(tmp_path):
    with pytest.raises(InputError, match="licence server is gone"):
        results(tmp_path, {1: ["refuse"]})


def test_the_rest_is_stopped_when_nobody_wants_it(tmp_path):
    simulator = WorkerSimulator("failing", {"plan": Plan(tmp_path, {1: ["hang"]})})
    found = simulator.run(concretes(3))
    next(found)
    found.close()
    assert all(worker.task is None for worker in simulator._workers)
    assert [int(one.x[0, 0]) for one in simulator.run(concretes(1))] == [0]
    simulator.close()
