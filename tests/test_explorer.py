from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import time

import numpy as np
import pytest

from cornercase.errors import InputError
from cornercase.optimizers import OPTIMIZERS
from cornercase.pipeline import demonstration, explore_scenario
from cornercase.scenario.space import ParameterSpace
from cornercase.study import Study

SPACE = ParameterSpace.from_ranges(["a=0:1:0.02", "b=0:1:0.02", "c=0:1"])


def ridge(points):
    return np.minimum(5 * np.abs(points[:, 0] - points[:, 1]), 1.0)


@pytest.mark.parametrize("name", ["bayes", "sobol", "random", "grid"])
def test_an_optimizer_that_is_told_again_asks_the_same(name):
    first = OPTIMIZERS.create(name, space=SPACE, seed=3)
    rounds = []
    for _ in range(4):
        points = first.ask(10)
        first.tell(points, ridge(points))
        rounds.append(points)
    second = OPTIMIZERS.create(name, space=SPACE, seed=3)
    for points in rounds:
        np.testing.assert_array_equal(second.ask(10), points)
        second.tell(points, ridge(points))
    every = np.concatenate(rounds)
    assert len(np.unique(every, axis=0)) == len(every)
    np.testing.assert_array_equal(SPACE.snap(every), every)


@pytest.mark.parametrize("name", ["bayes", "sobol", "random", "grid"])
def test_a_small_space_is_run_whole_and_then_over(name):
    space = ParameterSpace.from_ranges(["a=0:3:1", "b=0:7:1"])
    optimizer, every = OPTIMIZERS.create(name, space=space, seed=1), []
    while len(points := optimizer.ask(5)):
        optimizer.tell(points, ridge(points))
        every.append(points)
    assert len(np.unique(np.concatenate(every), axis=0)) == len(np.concatenate(every)) == 32


def test_bayes_finds_the_ridge_from_end_to_end():
    optimizer = OPTIMIZERS.create("bayes", space=SPACE, seed=2)
    every = []
    for _ in range(16):
        points = optimizer.ask(10)
        optimizer.tell(points, ridge(points))
        every.append(points)
    found = np.concatenate(every)
    critical = found[ridge(found) < 0.25]
    assert len(critical) > 2 * 160 * 0.1
    assert critical[:, 0].min() < 0.2
    assert critical[:, 0].max() > 0.8


def test_bayes_stands_failures_and_equal_scores():
    optimizer = OPTIMIZERS.create("bayes", space=SPACE, seed=2)
    for scores in (np.zeros(10), np.full(10, np.nan), np.zeros(10), np.ones(10)):
        points = optimizer.ask(10)
        assert len(points) == 10
        optimizer.tell(points, scores)


def results(path):
    with Study.open(path, readonly=True) as study:
        rows = study.rows()
        return [(r.id, r.round, r.values, r.state) for r in rows], study.scores("wttc").tolist()


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    path = tmp_path_factory.mktemp("studies") / "study.db"
    explore_scenario(demonstration("x-intersection", budget=40, seed=1), path)
    return path


def test_a_killed_exploration_goes_on_as_if_undisturbed(undisturbed, tmp_path):
    path = tmp_path / "killed" / "study.db"
    command = [sys.executable, "-c", "from cornercase.cli import main; main()", "demo", "x-intersection",
               "--budget", "40", "--seed", "1", "-o", str(path.parent)]  # fmt: skip
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and process.poll() is None:
        try:
            with sqlite3.connect(f"file:{path}?mode=ro", uri=True) as reader:
                if reader.execute("SELECT count(*) FROM scenarios WHERE state = 'done'").fetchone()[0] >= 13:
                    break
        except sqlite3.Error:
            pass
        time.sleep(0.002)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    interrupted, _ = results(path)
    assert 13 <= sum(state == "done" for *_, state in interrupted) < 40
    result = explore_scenario(demonstration("x-intersection", budget=40, seed=1), path)
    assert result.done == 40
    assert results(path) == results(undisturbed)


def test_workers_change_nothing(undisturbed, tmp_path):
    from dataclasses import replace

    explore_scenario(replace(demonstration("x-intersection", budget=40, seed=1), workers=2), tmp_path / "s.db")
    assert results(tmp_path / "s.db") == results(undisturbed)


def test_a_larger_budget_goes_on(tmp_path):
    path = tmp_path / "s.db"
    explore_scenario(demonstration("x-intersection", budget=10), path)
    assert explore_scenario(demonstration("x-intersection", budget=20), path).done == 20


def test_patience_ends_it(tmp_path):
    from dataclasses import replace

    exploration = replace(demonstration("x-intersection", budget=400), optimizer="sobol", patience=2, batch=3)
    result = explore_scenario(exploration, tmp_path / "s.db")
    assert result.done < 400
    assert "nothing new" in result.reason


def test_a_study_of_something_else_is_refused_and_kept(undisturbed):
    before = results(undisturbed)
    with pytest.raises(InputError, match="another seed"):
        explore_scenario(demonstration("x-intersection", budget=40, seed=2), undisturbed)
    with pytest.raises(InputError, match="another scenario"):
        explore_scenario(demonstration("t-intersection", budget=40, seed=1), undisturbed)
    assert results(undisturbed) == before


def test_two_explorers_never_write_at_once(undisturbed):
    with Study.open(undisturbed), pytest.raises(InputError, match="another cornercase"):
        Study.open(undisturbed)


def test_a_recording_comes_back_bit_for_bit(undisturbed):
    from conftest import same_recording
    from cornercase.scenario.logical import ConcreteScenario
    from cornercase.simulators.builtin import BuiltinSimulator

    with Study.open(undisturbed, readonly=True) as study:
        row = study.done()[17]
        (again,) = BuiltinSimulator().run([ConcreteScenario(study.meta["scenario"], row.values)])
        assert same_recording(study.recording(row.id), again)


def test_what_is_no_study_is_refused(tmp_path):
    (tmp_path / "text.db").write_text("hello")
    with pytest.raises(InputError, match=r"text\.db"):
        Study.open(tmp_path / "text.db")
    with sqlite3.connect(tmp_path / "other.db") as connection:
        connection.execute("CREATE TABLE a (b)")
    with pytest.raises(InputError, match="no cornercase study"):
        Study.open(tmp_path / "other.db")
    with pytest.raises(InputError, match="no such study"):
        Study.open(tmp_path / "absent.db")
