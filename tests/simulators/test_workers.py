"""Simulators in worker processes that crash, hang and misbehave."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from conftest import at_night, moving, ran, same_recording, scenario_file
from cornercase._common.errors import InputError, SimulationError
from cornercase.drivers._resolve import load_user_driver
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin
from cornercase.simulators._results import run_scenarios
from cornercase.simulators.pool._simulator import WorkerSimulator
from helpers.fake_simulators import BatchSimulator, FailingSimulator, Plan
from helpers.waiting import lives, until

RAISED = "the simulator failed: ZeroDivisionError: of the adapter"


def concretes(count):
    return [ConcreteScenario(Path("none.xosc"), {"k": float(k)}) for k in range(count)]


def results(folder, does, count=6, name="failing", **options):
    with WorkerSimulator(name, {"plan": Plan(folder, does)}, **options) as simulator:
        found = list(simulator.run(concretes(count)))
    return list(places(found))


def places(results):
    """Position of the entity in each recording, or the error."""
    # Without the last lines of a traceback.
    words = (
        str(one).partition(" (fake_simulators.py line ")[0] if isinstance(one, SimulationError) else one
        for one in results
    )
    return (one if isinstance(one, str) else int(one.x[0, 0]) for one in words)


def tries(folder, k):
    return len((folder / f"tries-{k}").read_text())


@pytest.mark.parametrize("workers", at_night([1, 3], {1}))
def test_all_come_in_order_and_each_worker_starts_the_simulator_once(tmp_path, workers):
    assert results(tmp_path, {}, count=9, workers=workers) == list(range(9))
    assert len((tmp_path / "starts").read_text()) <= workers
    assert all(tries(tmp_path, k) == 1 for k in range(9))


@pytest.mark.parametrize("workers", at_night([1, 2], {1}))
@pytest.mark.parametrize("what", at_night(["crash", "cut"], {"cut"}))
def test_who_crashes_is_tried_again_and_costs_itself_alone(tmp_path, what, workers):
    found = results(tmp_path, {1: [what, "well"], 3: [what]}, workers=workers)
    code = {"crash": 3, "cut": 7}[what]
    assert found == [0, 1, 2, f"the simulator's process ended with exit code {code}, tried 2 times", 4, 5]
    assert [tries(tmp_path, k) for k in range(6)] == [1, 2, 1, 2, 1, 1]


def test_who_hangs_is_stopped(tmp_path):
    found = results(tmp_path, {2: ["hang"], 4: ["hang", "well"]}, timeout=2.0)
    assert found == [0, 1, "the simulator did not end within 2 s, tried 2 times", 3, 4, 5]


def test_retries_can_be_none(tmp_path):
    found = results(tmp_path, {0: ["crash"]}, count=2, retries=0)
    assert found == ["the simulator's process ended with exit code 3, tried once", 1]
    assert tries(tmp_path, 0) == 1


def test_what_the_simulator_says_itself_is_not_tried_again(tmp_path):
    found = results(tmp_path, {0: ["fail"], 1: ["raise"]}, count=3)
    assert found == [
        "it cannot be",
        RAISED,
        2,
    ]
    assert [tries(tmp_path, k) for k in range(3)] == [1, 1, 1]


def test_a_process_that_somebody_kills_costs_nothing(tmp_path):
    simulator = WorkerSimulator("failing", {"plan": Plan(tmp_path, {1: ["hang", "well"]})})
    found = places(simulator.run(concretes(3)))
    assert next(found) == 0
    process = simulator._workers[0]._process

    def kill():
        # The file is created before the attempt is counted in it.
        until(lambda: (tmp_path / "tries-1").exists() and tries(tmp_path, 1))
        psutil.Process(process.pid).kill()

    threading.Thread(target=kill).start()
    assert list(found) == [1, 2]
    simulator.close()


def test_a_simulator_that_only_crashes_stops_the_exploration(tmp_path):
    simulator = WorkerSimulator("failing", {"plan": Plan(tmp_path, {k: ["crash"] for k in range(9)})}, retries=0)
    found = simulator.run(concretes(9))
    for _ in range(4):
        assert "exit code 3" in str(next(found))
    with pytest.raises(InputError, match=r"no result in 5 scenarios in a row.*run the same command again"):
        next(found)
    simulator.close()


def test_what_cannot_go_on_at_all_is_said_in_its_own_words(tmp_path):
    with pytest.raises(InputError, match="licence server is gone"):
        results(tmp_path, {1: ["refuse"]})


def test_the_rest_is_stopped_when_nobody_wants_it(tmp_path):
    simulator = WorkerSimulator("failing", {"plan": Plan(tmp_path, {1: ["hang"]})})
    found: Any = simulator.run(concretes(3))
    next(found)
    found.close()
    assert not any(worker.remaining for worker in simulator._workers)
    assert list(places(simulator.run(concretes(1)))) == [0]
    simulator.close()


@pytest.mark.parametrize(
    ("workers", "batches"),
    [pytest.param(1, [6], marks=pytest.mark.slow), (2, [3, 3]), pytest.param(4, [2, 2, 2], marks=pytest.mark.slow)],
)
def test_each_worker_gets_an_equal_share_in_one_batch(tmp_path, workers, batches):
    assert results(tmp_path, {}, name="batches", workers=workers) == list(range(6))
    assert sorted(map(int, (tmp_path / "batches").read_text().split())) == batches


@pytest.mark.parametrize("workers", at_night([1, 2, 3], {1, 3}))
@pytest.mark.parametrize(
    ("does", "words"),
    [
        ("crash", "the simulator's process ended with exit code 3, tried 2 times"),
        ("hang", "the simulator did not end within 1 s, tried 2 times"),
        *(
            # The fast run covers these in a single process.
            pytest.param(*one, marks=pytest.mark.slow)
            for one in (
                ("raise", RAISED),
                ("fail", "it cannot be"),
                ("lose", "the program is gone, tried 2 times"),
                ("end", "the simulator ended without a result"),
                ("none", "the simulator gave None instead of a recording"),
                ("junk", "the simulator gave a dict instead of a recording"),
            )
        ),
    ],
)
def test_what_goes_wrong_in_a_batch_costs_the_one_at_fault_whatever_the_number_of_workers(
    tmp_path, does, words, workers
):
    patience = 1.0 if does == "hang" else None
    found = results(tmp_path, {2: [does]}, name="batches", workers=workers, timeout=patience)
    assert found == [0, 1, words, 3, 4, 5]


@pytest.mark.parametrize("retries", at_night([0, 1], {0}))
def test_a_batch_that_crashes_is_no_try_of_its_members(tmp_path, retries):
    """The first try of 1 crashes in the batch, the second alone; 4 takes the batch of the rest with it once."""
    found = results(tmp_path, {1: ["crash", "crash", "well"]}, name="batches", retries=retries)
    lost = "the simulator's process ended with exit code 3, tried once"
    assert found == [0, 1 if retries else lost, 2, 3, 4, 5]


def test_a_batch_may_take_as_long_as_its_scenarios_one_after_the_other(tmp_path):
    """Six naps of 0.3 s are more than the time-out of one scenario, and none is run again."""
    found = results(tmp_path, {k: ["nap"] for k in range(6)}, name="batches", timeout=1.0)
    assert found == list(range(6))
    assert [tries(tmp_path, k) for k in range(6)] == [1] * 6


@pytest.mark.usefixtures("spawned_workers")
@pytest.mark.parametrize("workers", at_night([1, 2], {1}))
def test_builtin_batches_give_the_same_bytes_in_any_number_of_workers(x_intersection, builtin, workers):
    rng = np.random.default_rng(3)
    wanted = [x_intersection.concrete_scenario(v) for v in x_intersection.space.values(rng.random((7, 3)))]
    alone = list(builtin.run(wanted))
    with WorkerSimulator("builtin", {}, workers, timeout=120.0) as simulator:
        assert all(map(same_recording, alone, simulator.run(wanted)))


@pytest.mark.parametrize(
    ("does", "words"),
    [
        ("end", "the simulator ended without a result"),
        ("none", "the simulator gave None instead of a recording"),
        ("junk", "the simulator gave a dict instead of a recording"),
    ],
)
@pytest.mark.parametrize("made", [FailingSimulator, BatchSimulator])
def test_in_the_same_process_what_is_no_recording_costs_itself_alone_as_well(tmp_path, made, does, words):
    simulator = made(plan=Plan(tmp_path, {2: [does], 5: [does]}))
    assert list(places(run_scenarios(simulator, concretes(6)))) == [0, 1, words, 3, 4, words]


@pytest.mark.parametrize("does", at_night(["end", "none", "junk"], {"end", "none"}))
def test_what_is_no_recording_costs_itself_alone_without_batches(tmp_path, does):
    found = results(tmp_path, {1: [does]}, count=3)
    assert [found[0], found[2]] == [0, 2]
    assert str(found[1]).startswith("the simulator ")


def test_a_simulator_is_closed_when_nothing_follows(tmp_path):
    results(tmp_path, {}, workers=2)
    assert len((tmp_path / "ends").read_text()) == len((tmp_path / "starts").read_text())


def test_what_a_simulator_has_started_ends_with_it(tmp_path):
    """The child of a simulator that hangs is gone with it, not left to itself."""
    results(tmp_path, {0: ["child"]}, count=1, timeout=1.0, retries=0)
    child = int((tmp_path / "children").read_text())
    until(lambda: not lives(child))


def test_a_driver_of_ones_own_in_the_current_folder_drives_in_a_worker_too(tmp_path, monkeypatch):
    (tmp_path / "driver_of_workers.py").write_text(
        "import numpy as np\nfrom cornercase.drivers import Driver\n\nclass Braking(Driver):\n"
        "    def acceleration(self, situation):\n        return np.full(len(situation.speed), -1.5)\n"
    )
    path = scenario_file(tmp_path, init=moving())
    monkeypatch.chdir(tmp_path)
    options: dict[str, Any] = {"duration": 2.0, "drivers": {"Ego": load_user_driver("driver_of_workers:Braking")}}
    with WorkerSimulator("builtin", options) as simulator:
        (found,) = ran(simulator, [ConcreteScenario(path)])
    assert found.speed[0, -1] == pytest.approx(7.0)
    assert same_recording(found, *ran(Builtin(**options), [ConcreteScenario(path)]))
