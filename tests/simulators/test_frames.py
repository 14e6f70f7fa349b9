"""Compiled frames equal frames in which the storyboard is evaluated, with any number of threads and batches."""

import random
import signal
import threading
from pathlib import Path

import numpy as np
import pytest

from conftest import at_night
from cornercase import LogicalScenario
from cornercase._common.errors import SimulationError
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.drivers import NORMAL, BehaviourDriver, Driver
from cornercase.optimizers import Random
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin
from cornercase.simulators.builtin import _simulator as simulator
from cornercase.simulators.builtin import _stepper as stepper
from cornercase.simulators.builtin._batch import Batch
from cornercase.simulators.builtin.storyboard._storyboard import Storyboard
from helpers.isolation import ROOT
from helpers.random_storyboards import storyboard, write_roads

EXAMPLES = ROOT / "examples"


def drawn(name: str, count: int) -> list[ConcreteScenario]:
    base = EXAMPLES / name / name
    logical = LogicalScenario.read(f"{base}.xosc", f"{base}.space.xosc")
    points = Random().start(logical.space, 3).ask(count)
    return [logical.concrete_scenario(values) for values in logical.space.values(points)]


def recordings(concretes: list[ConcreteScenario], duration: float = 20.0) -> list[Recording | SimulationError]:
    return list(Builtin(duration=duration).run(concretes))


def look_in_each_frame(monkeypatch) -> None:
    plain = stepper.Stepper.__init__

    def init(self, *arguments) -> None:
        plain(self, *arguments)
        self._python_step = True

    monkeypatch.setattr(stepper.Stepper, "__init__", init)


def assert_same(found, held, tolerance: float) -> None:
    for one, other in zip(found, held, strict=True):
        assert isinstance(one, SimulationError) == isinstance(other, SimulationError)
        if isinstance(one, SimulationError):
            assert str(one) == str(other)
            continue
        np.testing.assert_array_equal(one.time, other.time)
        for name in ("x", "y", "heading", "speed", "acceleration"):
            np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=0.0, atol=tolerance, err_msg=name)
        assert one.collisions == other.collisions


@pytest.mark.parametrize("name", ["x_intersection", "t_intersection"])
def test_examples_are_the_same_with_a_look_in_each_frame(name, monkeypatch):
    held = recordings(drawn(name, 12))
    look_in_each_frame(monkeypatch)
    assert_same(recordings(drawn(name, 12)), held, 1e-9)


@pytest.mark.parametrize("seed", at_night(range(24), range(1, 24)))
def test_random_storyboards_are_the_same_with_a_look_in_each_frame(seed, tmp_path, monkeypatch):
    write_roads(tmp_path)
    path = Path(tmp_path) / "storyboard.xosc"
    path.write_text(storyboard(random.Random(1000 + seed)))
    held = recordings([ConcreteScenario(path, {})])
    look_in_each_frame(monkeypatch)
    assert_same(recordings([ConcreteScenario(path, {})]), held, 1e-9)


# One batch with up to 5 threads, and two batches with up to 2 threads each.
@pytest.mark.parametrize("count", [170, 1030])
def test_any_number_of_threads_gives_the_same_bytes(count, monkeypatch):
    concretes = drawn("x_intersection", count)
    found = []
    for threads in (1, 2, 5):
        monkeypatch.setattr(simulator, "count_available_cpus", lambda threads=threads: threads)
        found.append(recordings(concretes, duration=10.0))
    for other in found[1:]:
        assert_same(other, found[0], 0.0)


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="no signal can be sent to a thread here")
def test_who_interrupts_batches_beside_each_other_does_not_wait_for_their_end(monkeypatch):
    looks, halted, waits = [], threading.Event(), threading.main_thread().ident
    # Two batches may both be evaluated before either counts, so that neither sees the tenth evaluation.
    first = threading.Lock()
    assert waits is not None
    plain_look, plain_halt = Storyboard.evaluate_triggers, Batch.cancel

    def look(self, dt: float) -> None:
        looks.append(dt)
        if len(looks) >= 10 and first.acquire(blocking=False):
            signal.pthread_kill(waits, signal.SIGINT)
        if len(looks) >= 10:
            halted.wait(120.0)
        plain_look(self, dt)

    def halt(self) -> None:
        plain_halt(self)
        halted.set()

    look_in_each_frame(monkeypatch)
    monkeypatch.setattr(Storyboard, "evaluate_triggers", look)
    monkeypatch.setattr(Batch, "cancel", halt)
    monkeypatch.setattr(simulator, "count_available_cpus", lambda: 2)
    with pytest.raises(KeyboardInterrupt):
        recordings(drawn("t_intersection", 1024))
    assert len(looks) < 100


# Within the limits of all vehicles.
CALM, CALM_NAME = NORMAL._replace(acceleration=1.0, max_deceleration=3.0), "normal:acceleration=1,max_deceleration=3"


class InPython(Driver):
    """A built-in driver that Python asks, as one of a user's own."""

    def __init__(self) -> None:
        self.inner, self.asked = BehaviourDriver(CALM), list[tuple[float, BoolArray]]()

    def start(self, scenarios: int, others: int) -> None:
        self.asked.clear()
        self.inner.start(scenarios, others)

    def acceleration(self, situation) -> FloatArray:
        self.asked.append((situation.time, situation.active))
        return self.inner.acceleration(situation)


@pytest.mark.parametrize("count", at_night([1, 9], {1}))
@pytest.mark.parametrize("name", ["x_intersection", "t_intersection"])
@pytest.mark.parametrize("in_python", [(True, False, True), (False, True, True), (False, True, False)])
def test_who_decides_in_python_decides_as_in_compiled_code(name, in_python, count):
    concretes = drawn(name, count)
    names = [one.get("name", "") for one in concretes[0].load_file().root.iterfind("Entities/ScenarioObject")]
    compiled = dict.fromkeys(names[:3], CALM_NAME)
    some = {
        entity: InPython() if by_python else CALM_NAME for entity, by_python in zip(names[:3], in_python, strict=False)
    }
    held = list(Builtin(duration=20.0, drivers=compiled).run(concretes))
    assert_same(Builtin(duration=20.0, drivers=some).run(concretes), held, 0.0)
    for driver in some.values():
        if isinstance(driver, InPython):
            times = [time for time, _ in driver.asked]
            assert times == sorted(times)
            for time in set(times):
                masks = [active for at, active in driver.asked if at == time]
                assert np.sum(masks, axis=0).max() == 1
            # Once for each path, whatever the number of scenarios: some wait for others.
            assert len(times) < 2.5 * len(set(times))


def test_a_scenario_looks_only_where_something_happens(monkeypatch):
    looks = []
    plain = Storyboard.evaluate_triggers

    def look(self, dt: float) -> None:
        looks.append(int(self._world.running.sum()))
        plain(self, dt)

    monkeypatch.setattr(Storyboard, "evaluate_triggers", look)
    for drivers in ({}, {"Ego": InPython()}):
        looks.clear()
        (recording,) = Builtin(duration=20.0, drivers=drivers).run(drawn("x_intersection", 1))
        assert isinstance(recording, Recording)
        assert len(recording.time) > 300
        assert sum(looks) < 15
