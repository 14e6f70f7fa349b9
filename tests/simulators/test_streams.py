"""Scenarios submitted one at a time to parallel simulators."""

from __future__ import annotations

import threading
import time
from functools import partial
from pathlib import Path

import psutil
import pytest

from cornercase._common.errors import InputError, SimulationError
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Simulator
from cornercase.simulators._executor import SimulatorExecutor
from cornercase.simulators._results import run_scenarios
from cornercase.simulators.pool._simulator import WorkerSimulator
from helpers.fake_simulators import FailingSimulator, Plan
from helpers.waiting import lives, until


def concretes(count):
    return [ConcreteScenario(Path("none.xosc"), {"k": float(k)}) for k in range(count)]


def runs(scenario, simulator):
    return list(run_scenarios(simulator, [scenario]))


def taken(stream, count):
    found = {}
    for _ in range(count):
        key, (outcome,) = stream.wait_for_result(lambda: None)
        found[key] = str(outcome) if isinstance(outcome, SimulationError) else int(outcome.x[0, 0])
    return found


def test_processes_crash_hang_and_are_tried_again_as_in_rounds(tmp_path):
    plan = Plan(tmp_path, {1: ["crash", "well"], 2: ["hang"], 4: ["fail"], 5: ["nap"]})
    with WorkerSimulator("failing", {"plan": plan}, workers=3, timeout=2.0) as simulator:
        stream = SimulatorExecutor({"": simulator})
        assert stream.count_parallel() == 3
        for k, one in enumerate(concretes(9)):
            stream.submit(k, partial(runs, one))
        found = taken(stream, 9)
        stream.close()
    assert found.pop(2) == "the simulator did not end within 2 s, tried 2 times"
    assert found.pop(4) == "it cannot be"
    assert found == {k: k for k in (0, 1, 3, 5, 6, 7, 8)}
    # Each process that ended with the stream closed its simulator first.
    assert len((tmp_path / "ends").read_text()) >= 1


def test_what_is_fast_does_not_wait_for_what_is_slow(tmp_path):
    with WorkerSimulator("failing", {"plan": Plan(tmp_path, {0: ["hang"]})}, workers=2) as simulator:
        stream = SimulatorExecutor({"": simulator})
        for k, one in enumerate(concretes(6)):
            stream.submit(k, partial(runs, one))
        assert taken(stream, 5) == {k: k for k in range(1, 6)}
        stream.close()


def test_a_stream_that_is_closed_ends_what_hangs(tmp_path):
    children = set(psutil.Process().children(recursive=True))
    with WorkerSimulator("failing", {"plan": Plan(tmp_path, {0: ["hang"], 1: ["child"]})}, workers=2) as simulator:
        stream = SimulatorExecutor({"": simulator})
        for k, one in enumerate(concretes(4)):
            stream.submit(k, partial(runs, one))
        until((tmp_path / "children").exists)
        stream.close()
    assert {one for one in psutil.Process().children(recursive=True) if one.is_running()} <= children
    child = int((tmp_path / "children").read_text())
    # A killed process takes a moment to disappear.
    until(lambda: not lives(child))
    # Scenarios that had not started never ran.
    assert not (tmp_path / "tries-3").exists()


def test_a_simulator_that_gives_nothing_any_more_is_at_fault_whoever_runs_it(tmp_path):
    plan = Plan(tmp_path, {k: ["crash"] for k in range(9)})
    with WorkerSimulator("failing", {"plan": plan}, workers=2, retries=0) as simulator:
        stream = SimulatorExecutor({"": simulator})
        for k, one in enumerate(concretes(9)):
            stream.submit(k, partial(runs, one))
        with pytest.raises(InputError, match="no result in 5 scenarios in a row"):
            taken(stream, 9)
        stream.close()


def test_one_of_this_process_runs_when_its_result_is_taken(tmp_path):
    stream = SimulatorExecutor({"": FailingSimulator(plan=Plan(tmp_path))})
    assert stream.count_parallel() == 1
    for k, one in enumerate(concretes(3)):
        stream.submit(k, partial(runs, one))
    assert not (tmp_path / "tries-0").exists()
    assert taken(stream, 1) == {0: 0}
    assert not (tmp_path / "tries-1").exists()
    assert taken(stream, 2) == {1: 1, 2: 2}
    stream.close()


def test_what_never_ends_is_waited_for_no_longer():
    class Deaf(Simulator):
        name = "deaf"

        def run(self, concretes):
            return iter(())

        def parallel_instances(self):
            return [self]

    ends = threading.Event()
    stream = SimulatorExecutor({"": Deaf()})
    stream.submit(1, lambda _: ends.wait(60.0))
    begun = time.monotonic()
    stream.close(cancel_timeout=0.2)
    assert time.monotonic() - begun < 10.0
    ends.set()
