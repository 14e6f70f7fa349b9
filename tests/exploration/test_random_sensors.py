"""Runs with sensors: what they do to a driver, and where the random numbers of a run come from."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cornercase as cc
from conftest import car, moving, ran, same_recording, scenario_file
from cornercase._common.errors import NoticeWarning
from cornercase.drivers import DRIVERS, EquippedDriver, Radar
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario
from cornercase.scenario._concrete_file import write_concrete_file
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._seeds import ScenarioSeeds, seed_of_run
from cornercase.simulators import Builtin, simulate
from cornercase.simulators.pool._simulator import WorkerSimulator
from cornercase.study import StudyFile

NOISY = "normal + radar:noise=1.5,speed_noise=1,miss=0.3"
SPEED = '<ParameterDeclaration name="v" parameterType="double" value="14"/>'
DURATION = 8.0


@pytest.fixture
def approach(tmp_path) -> Path:
    """The ego approaches a car that stands 90 m ahead of it."""
    init = moving(s="10", speed="$v") + moving(s="100", speed="0", entity="A")
    return scenario_file(tmp_path, init=init, parameters=SPEED, entities=car("Ego") + car("A"))


def drive(path, driver, v=14.0, seed=0, **options) -> Recording:
    return simulate(path, {"v": v}, drivers={"Ego": driver}, duration=DURATION, seed=seed, **options)


def explored(path, study, driver=NOISY, *, budget=6, seed=3, **options: Any) -> None:
    given = {"optimizer": "sobol", "duration": DURATION, "critical": 3.0, **options}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NoticeWarning)
        cc.explore(
            path, study, ranges=["v=10:16"], ego="Ego", other="A", metrics=["clearance"], drivers={"Ego": driver},
            budget=budget, seed=seed, **given,
        )  # fmt: skip


def stored(path) -> list[object]:
    with StudyFile.open(path, readonly=True) as study:
        recordings = [study.recording(row.id) for row in study.finished_rows()]
        spread = study.score_range("clearance")
        scores = study.scores("clearance").tolist()
        return [scores, None if spread is None else spread.tolist(), [one.x.tobytes() for one in recordings]]


def test_a_driver_with_a_short_sight_brakes_later(approach):
    def first_braking(driver):
        recording = drive(approach, driver)
        return recording.time[np.argmax(recording.acceleration[recording.entity_index("Ego")] < -1.0)]

    begins = [first_braking(name) for name in ("normal", "normal + radar", "normal + radar:range=30")]
    assert begins[0] <= begins[1] < begins[2] - 0.5
    later = first_braking("normal + radar:range=30,latency=0.6")
    assert later - begins[2] == pytest.approx(0.5, abs=0.11)
    both = first_braking("normal + radar:range=30 + camera:range=60")
    assert begins[1] < both < begins[2]


def test_a_sensor_without_errors_needs_no_seed(approach):
    assert same_recording(drive(approach, "normal + radar", seed=1), drive(approach, "normal + radar", seed=2))
    assert not same_recording(drive(approach, NOISY, seed=1), drive(approach, NOISY, seed=2))
    assert same_recording(drive(approach, NOISY, seed=1), drive(approach, NOISY, seed=1))


def test_an_object_is_what_its_text_is(approach):
    driver = EquippedDriver(DRIVERS.create("normal"), [Radar(noise=1.5, speed_noise=1.0, miss=0.3)])
    assert same_recording(drive(approach, driver, seed=1), drive(approach, NOISY, seed=1))


def test_a_scenario_gives_the_same_bytes_alone_in_a_batch_and_in_workers(approach):
    drivers = {"Ego": NOISY + " + lidar:false_rate=0.5"}
    concretes = [
        ConcreteScenario(approach, {"v": v}, seed=seed) for v, seed in ((10.0, 0), (14.0, 0), (14.0, 7), (16.0, 0))
    ]
    batch = ran(Builtin(duration=DURATION, drivers=drivers), concretes)
    assert not same_recording(batch[1], batch[2])
    for concrete, recording in zip(concretes, batch, strict=True):
        (alone,) = ran(Builtin(duration=DURATION, drivers=drivers), [concrete])
        assert same_recording(alone, recording)
    with WorkerSimulator("builtin", {"duration": DURATION, "drivers": drivers}, workers=2) as simulator:
        for one, other in zip(simulator.run(concretes), batch, strict=True):
            assert same_recording(one, other)


def test_a_file_with_the_values_has_the_random_numbers_of_the_scenario(approach, tmp_path):
    scenario = ScenarioFile.read(approach)
    (tmp_path / "written").mkdir()
    written = tmp_path / "written" / "one.xosc"
    write_concrete_file(scenario, {"v": 12.345678901234567}, written, {"Ego": NOISY})
    one = drive(approach, NOISY, 12.345678901234567, seed=4)
    assert same_recording(simulate(written, duration=DURATION, seed=4), one)
    assert not same_recording(simulate(written, duration=DURATION, seed=5), one)


def test_seeds_depend_on_run_and_values_only():
    values = {"b": np.array([1.0, 2.0, 2.0]), "a": "wet"}
    seeds = ScenarioSeeds([0, 0, 1], values)
    assert len({*seeds}) == 3
    assert ScenarioSeeds([1], {"a": "wet", "b": 2})[0] == seeds[2]
    assert seeds[1:] == (seeds[1], seeds[2])
    assert seed_of_run(5, 0) == 5
    assert len({seed_of_run(seed, run) for seed in range(4) for run in range(4)}) == 16


def test_the_runs_of_a_scenario_differ_and_the_first_has_the_seed_of_the_study(approach, tmp_path):
    explored(approach, tmp_path / "one.db")
    explored(approach, tmp_path / "five.db", repeats=5)
    with StudyFile.open(tmp_path / "one.db", readonly=True) as study:
        for row in study.finished_rows():
            assert same_recording(study.recording(row.id), drive(approach, NOISY, row.values["v"], seed=3))
        assert study.meta.repeatability == {"scenario": 1, "same": True, "apart": None, "random": True}
    with StudyFile.open(tmp_path / "five.db", readonly=True) as study:
        spread = study.score_range("clearance")
        assert spread is not None
        assert (spread[:, 1] - spread[:, 0] > 0.01).all()
        # Its first scenario was repeated with the seed of the run that was stored.
        assert study.meta.repeatability["same"]
        assert not study.meta.nondeterminism_text
        rates = study.critical_run_rates()
        assert rates is not None
        rate, low, high = rates.T
        assert ((low <= rate) & (rate <= high) & (high > low)).all()
        assert len(np.unique(rate)) > 1


def test_a_study_is_the_same_with_workers_and_after_an_interruption(approach, tmp_path):
    explored(approach, tmp_path / "whole.db", repeats=3)
    explored(approach, tmp_path / "parts.db", repeats=3, budget=3)
    explored(approach, tmp_path / "parts.db", repeats=3)
    explored(approach, tmp_path / "workers.db", repeats=3, workers=2)
    assert stored(tmp_path / "parts.db") == stored(tmp_path / "workers.db") == stored(tmp_path / "whole.db")


def test_a_single_run_of_a_random_sensor_is_noticed(approach, tmp_path):
    options: dict[str, Any] = {
        "ranges": ["v=10:16"], "ego": "Ego", "other": "A", "metrics": ["clearance"], "optimizer": "sobol", "budget": 2,
        "duration": 2.0,
    }  # fmt: skip
    with pytest.warns(NoticeWarning, match=r"sensors of Ego are random.*single run.*`repeats`"):
        cc.explore(approach, tmp_path / "s.db", drivers={"Ego": NOISY}, **options)
    with warnings.catch_warnings():
        warnings.filterwarnings("error", "sensors of", NoticeWarning)
        cc.explore(approach, tmp_path / "t.db", drivers={"Ego": NOISY}, repeats=2, **options)
        cc.explore(approach, tmp_path / "u.db", drivers={"Ego": "normal + radar"}, **options)
    with StudyFile.open(tmp_path / "u.db", readonly=True) as study:
        assert "random" not in study.meta.repeatability


def test_versions_with_random_sensors_are_compared_by_tests(approach, tmp_path):
    """A grid has the same scenarios with any seed, but not the same random numbers."""
    for name, driver, seed in (("a", NOISY, 1), ("b", NOISY, 2), ("late", NOISY + ",latency=1,range=25", 3)):
        explored(approach, tmp_path / f"{name}.db", driver, seed=seed, budget=21, optimizer="grid")
    same = cc.compare(tmp_path / "a.db", tmp_path / "b.db")
    assert sum(pair.run == "otherwise" for pair in same.pairs) > 13
    assert not same.is_deterministic
    assert not same.changed
    assert same.verdict == "the same"
    worse = cc.compare(tmp_path / "a.db", tmp_path / "late.db")
    assert worse.changed
    assert worse.verdict == "worse"


def test_a_suite_repeats_the_runs_of_its_study(approach, tmp_path):
    explored(approach, tmp_path / "s.db", budget=12, seed=9)
    cc.analyze(tmp_path / "s.db", ["clearance"])
    cc.reduce(tmp_path / "s.db", tmp_path / "reduced", size=3, scenario=approach)
    result = cc.run_suite(tmp_path / "reduced", tmp_path / "run.db", require=["no collision"])
    differences = [one.difference for one in result.scenarios]
    assert len(differences) == 3
    assert all(one is not None and one.same for one in differences)
    with StudyFile.open(tmp_path / "run.db", readonly=True) as study:
        assert study.meta.repeatability["random"]
