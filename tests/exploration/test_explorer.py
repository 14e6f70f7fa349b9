from __future__ import annotations

import contextlib
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import synthetic
from conftest import EXAMPLES
from cornercase._common.errors import InputError, SimulationError
from cornercase._common.interrupts import noted_interrupts
from cornercase.drivers import named_driver
from cornercase.exploration import (
    Configuration,
    ScenarioExplorer,
    demonstration,
    examples,
    explore,
    explore_configuration,
)
from cornercase.metrics import Metric
from cornercase.optimizers import OPTIMIZERS, Optimizer, SobolOptimizer
from cornercase.report import summarize, write_report
from cornercase.scenario import LogicalScenario, ParameterSpace
from cornercase.study import Study
from fake_simulators import NoisySimulator
from synthetic import Synthetic, about, explorer, opened

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
    explore_configuration(demonstration("x-intersection", budget=40, seed=1), path)
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
    process.kill()
    process.wait()
    interrupted, _ = results(path)
    assert 13 <= sum(state == "done" for *_, state in interrupted) < 40
    result = explore_configuration(demonstration("x-intersection", budget=40, seed=1), path)
    assert result.ended == 40
    assert results(path) == results(undisturbed)


def test_workers_change_nothing(undisturbed, tmp_path):
    from dataclasses import replace

    explore_configuration(replace(demonstration("x-intersection", budget=40, seed=1), workers=2), tmp_path / "s.db")
    assert results(tmp_path / "s.db") == results(undisturbed)


def test_a_larger_budget_goes_on(tmp_path):
    path = tmp_path / "s.db"
    explore_configuration(demonstration("x-intersection", budget=10), path)
    assert explore_configuration(demonstration("x-intersection", budget=20), path).ended == 20


def test_a_study_goes_on_where_the_same_files_lie_elsewhere(tmp_path):
    def explored(name, budget):
        folder = shutil.copytree(EXAMPLES / "x_intersection", tmp_path / name)
        logical = LogicalScenario.read(folder / "x_intersection.xosc", folder / "x_intersection.space.xosc")
        options: dict[str, Any] = {"ego": "Ego", "other": "Pedestrian", "metrics": ["wttc"], "optimizer": "sobol"}
        return explore(logical, tmp_path / "s.db", **options, budget=budget)

    explored("here", 10)
    assert explored("there", 20).ended == 20


def test_patience_ends_it(tmp_path):
    from dataclasses import replace

    exploration = replace(demonstration("x-intersection", budget=400), optimizer="sobol", patience=2, batch=3)
    result = explore_configuration(exploration, tmp_path / "s.db")
    assert result.ended < 400
    assert "nothing new" in result.reason


def test_a_study_of_something_else_is_refused_and_kept(undisturbed):
    before = results(undisturbed)
    with pytest.raises(InputError, match="another seed"):
        explore_configuration(demonstration("x-intersection", budget=40, seed=2), undisturbed)
    with pytest.raises(InputError, match="another scenario"):
        explore_configuration(demonstration("t-intersection", budget=40, seed=1), undisturbed)
    assert results(undisturbed) == before


def test_two_explorers_never_write_at_once(undisturbed):
    with Study.open(undisturbed, readonly=False), pytest.raises(InputError, match="another cornercase"):
        Study.open(undisturbed, readonly=False)


def test_a_recording_comes_back_bit_for_bit(undisturbed):
    from conftest import ran, same_recording
    from cornercase.scenario import ConcreteScenario
    from cornercase.simulators import BuiltinSimulator

    with Study.open(undisturbed, readonly=True) as study:
        row = study.done()[17]
        (again,) = ran(BuiltinSimulator(), [ConcreteScenario(Path(study.meta.scenario), row.values)])
        assert same_recording(study.recording(row.id), again)


def test_what_is_no_study_is_refused(tmp_path):
    (tmp_path / "text.db").write_text("hello")
    with pytest.raises(InputError, match=r"text\.db"):
        Study.open(tmp_path / "text.db", readonly=False)
    with sqlite3.connect(tmp_path / "other.db") as connection:
        connection.execute("CREATE TABLE a (b)")
    with pytest.raises(InputError, match="no cornercase study"):
        Study.open(tmp_path / "other.db", readonly=False)
    with pytest.raises(InputError, match="no such study"):
        Study.open(tmp_path / "absent.db", readonly=False)


def contents(path):
    """All that must not depend on when it was computed, to the last bit."""
    with sqlite3.connect(path) as connection:
        return [connection.execute(f"SELECT * FROM {table}").fetchall() for table in ("meta", "scenarios", "courses")]


@pytest.mark.parametrize(
    ("optimizer", "deaths"),
    [
        ("bayes", (13, 3)),
        pytest.param("bayes", (1, 13, 3, 9), marks=pytest.mark.slow),
        pytest.param("committee", (1, 13, 3, 9), marks=pytest.mark.slow),
    ],
)
def test_killed_again_and_again_it_ends_with_the_same_bytes(optimizer, deaths, tmp_path):
    with opened(tmp_path / "whole.db") as study:
        result = explorer(study, optimizer=optimizer, metrics=("distance", "wttc")).run()
    assert (result.ended, result.reason, result.interrupted) == (47, "the budget of 47 scenarios is used up", False)
    with Study.open(tmp_path / "whole.db", readonly=True) as study:
        # Seven are left for the last round.
        assert [row.round for row in study.rows()] == [1 + k // 10 for k in range(47)]
        assert [row.error for row in study.failed()] == [f"a is {row.values['a']}" for row in study.failed()]
        assert len(study.failed()) > 0
        away = [10 * abs(float(row.values["a"]) - float(row.values["b"])) for row in study.done()]
        np.testing.assert_allclose(study.scores("distance"), away, atol=1e-12)
    for survives in deaths:
        synthetic.go_on_until_killed(tmp_path / "killed.db", optimizer, survives)
        with Study.open(tmp_path / "killed.db", readonly=True) as study:
            assert len(study.rows()) < 47
    synthetic.go_on(tmp_path / "killed.db", optimizer)
    assert contents(tmp_path / "killed.db") == contents(tmp_path / "whole.db")


class Listening(Optimizer):
    """A Sobol' sequence that keeps what it is told."""

    name, needs = "listening", frozenset({"features"})

    def __init__(self, space, seed, features):
        self._sequence, self.features, self.told = SobolOptimizer(space, seed), features, []

    def ask(self, n):
        return self._sequence.ask(n)

    def tell(self, points, scores, features=None):
        self._sequence.tell(points, scores)
        self.told.append((points, scores, features))


def test_an_optimizer_is_told_what_happened_also_when_it_goes_on(monkeypatch, tmp_path):
    made = []
    monkeypatch.setattr(OPTIMIZERS, "_factories", {**OPTIMIZERS._factories, "listening": (Listening, {})})
    for budget in (23, 47):
        with opened(tmp_path / "s.db") as study:
            one = explorer(study, optimizer="listening", budget=budget)
            made.append(one._optimizer)
            one.run()
    points, scores, features = (np.concatenate(column) for column in zip(*made[1].told, strict=True))
    assert len(points) == 47
    column = {feature.name: features[:, j] for j, feature in enumerate(made[1].features)}
    failed = np.isnan(scores)
    assert failed.any()
    assert np.isnan(features[failed]).all()
    assert np.isfinite(features[~failed]).all()
    # The other stands ahead, at the distance that is the score.
    np.testing.assert_allclose(column["nearest-ahead"][~failed], scores[~failed], atol=1e-12)
    assert len(made[0].told) == 3
    np.testing.assert_array_equal(np.concatenate([one[2] for one in made[0].told]), features[:23])


def test_interrupted_it_keeps_what_ended_and_says_so(tmp_path):
    with opened(tmp_path / "s.db") as study:
        result = explorer(study, Synthetic(interrupts=14), "sobol").run()
        assert (result.ended, result.interrupted) == (14, True)
        assert [row.state for row in study.rows()].count("pending") == 6
        assert explorer(study, optimizer="sobol").run().ended == 47


def test_a_simulator_that_ends_early_fails_only_the_scenario_where_it_ends(tmp_path):
    class Short(Synthetic):
        def run(self, concretes):
            runs = zip(concretes, super().run(concretes), strict=True)
            yield from (run for _, run in takewhile(lambda one: one[0].values["a"] > 0.2, runs))

    with opened(tmp_path / "s.db") as study:
        assert explorer(study, Short(), "sobol", budget=20).run().ended == 20
        early = {row.id for row in study.rows() if row.values["a"] <= 0.2}
        assert early
        assert {row.id for row in study.failed() if "without a result" in row.error} == early


class Largest(Metric):
    """The same distance, but large is critical."""

    name, unit, lower_is_critical, cap, source = "distance", "m", False, 0.0, ""

    def course(self, recording, ego, other):
        return np.abs(recording.x[1] - recording.x[0])

    def score(self, course):
        return float(course.max())


def test_the_optimizer_is_told_that_lower_is_critical(tmp_path):
    found = {}
    for metric in ("distance", Largest()):
        with opened(tmp_path / f"{metric}.db") as study:
            explorer(study, metrics=(metric,), budget=60).run()
            found[type(metric)] = np.median(study.scores("distance")[-30:])
    assert found[Largest] > 4.0
    assert found[str] < 1.5


def scripted(rounds):
    """An optimizer that lets the round with number k reach the distance rounds[k]."""

    class Scripted:
        name = "scripted"

        def __init__(self):
            self.told = 0

        def ask(self, n):
            if self.told == len(rounds):
                return np.zeros((0, 2))
            away = rounds[self.told] / 10
            return np.array([[0.005 + 0.01 * k, 0.01 * k + away] for k in range(n)])

        def tell(self, points, scores):
            self.told += 1

    return Scripted()


@pytest.mark.parametrize(
    ("rounds", "told"),
    [
        ([5, 4, 3, 3.5, 3.6, 2], 5),  # two rounds that are worse than the third
        ([5, 4, 4, 4, 6, 4, 4.5, 4.5, 4], 8),  # as critical as the best before is another critical scenario
        ([3, 2, 1], 3),  # the space is used up
    ],
)
def test_patience_counts_rounds_without_news(tmp_path, rounds, told):
    with opened(tmp_path / "s.db") as study:
        one = explorer(study, budget=1000, batch=1, patience=2)
        one._optimizer = scripted(rounds)
        result = one.run()
    assert result.ended == told
    assert ("nothing new" in result.reason) == (told < len(rounds))


def test_scores_at_the_cap_are_no_news(tmp_path):
    class Nothing(Largest):
        def course(self, recording, ego, other):
            return np.zeros(len(recording.time))

    with opened(tmp_path / "s.db") as study:
        assert explorer(study, metrics=(Nothing(),), optimizer="sobol", budget=400, patience=3).run().ended == 40


def test_time_is_a_criterion_and_is_noted(tmp_path):
    with opened(tmp_path / "s.db") as study:
        result = explorer(study, max_seconds=0.0).run()
        assert (result.ended, result.reason) == (0, "0 s have passed")
        explorer(study, optimizer="sobol", budget=20).run()
        assert list(study.elapsed()) == ["optimize", "simulate", "measure", "store", "judge"]


def test_progress_in_a_file_is_a_line_with_the_best_score(tmp_path, capfd):
    with opened(tmp_path / "s.db") as study:
        explorer(study, optimizer="sobol", budget=20).run(progress=True)
        best = study.scores("distance").min()
    said = capfd.readouterr().err
    assert "20 of 20 scenarios" in said
    assert f"best {best:.3g} m" in said
    assert "\x1b" not in said


def test_of_repeated_runs_the_median_is_stored_and_the_spread_of_all(tmp_path):
    one, simulator = demonstration("t-intersection", budget=6, seed=1), NoisySimulator()
    meta = about(one.logical.space, "distance", repeats=3, other="C", seed=1)
    optimizer = OPTIMIZERS.create("sobol", space=one.logical.space, seed=1)
    with Study.create(tmp_path / "s.db", meta) as study:
        ScenarioExplorer(replace(one, metrics=("distance",), budget=6, repeats=3), simulator, optimizer, study).run()
        runs = [[k for k in simulator.given[i : i + 3] if k is not None] for i in range(0, 18, 3)]
        expected = [sorted(run)[(len(run) - 1) // 2] for run in runs]
        assert min(map(len, runs)) == 2
        np.testing.assert_allclose(study.scores("distance"), expected)
        spread = study.spread("distance")
        assert spread is not None
        np.testing.assert_allclose(spread, [[min(run), max(run)] for run in runs])
        for row, score in zip(study.done(), expected, strict=True):
            assert study.recording(row.id).x[1, 0] == pytest.approx(score)
            assert study.course(row.id, "distance")[0] == pytest.approx(score)
        said = summarize(study).metrics["distance"]
        assert said.spread is not None
        assert said.spread[1] == pytest.approx(max(max(run) - min(run) for run in runs))
        write_report(study, tmp_path / "r.html")
        assert "Each was run 3 times" in (tmp_path / "r.html").read_text()
        study.export(tmp_path / "csv")
        head = (tmp_path / "csv" / "scenarios.csv").read_text().splitlines()[0]
        assert "lowest_distance,highest_distance" in head


def test_a_scenario_fails_only_when_all_its_runs_do(tmp_path):
    class Failing(NoisySimulator):
        def run(self, concretes):
            for number, run in enumerate(super().run(concretes)):
                yield SimulationError(f"run {number}") if number < 3 else run

    one = demonstration("t-intersection", budget=2, seed=1)
    meta = about(one.logical.space, "distance", repeats=3, other="C", seed=1)
    optimizer = OPTIMIZERS.create("sobol", space=one.logical.space, seed=1)
    with Study.create(tmp_path / "s.db", meta) as study:
        ScenarioExplorer(replace(one, metrics=("distance",), budget=2, repeats=3), Failing(), optimizer, study).run()
        assert [row.state for row in study.rows()] == ["failed", "done"]
        assert study.failed()[0].error == "run 0"


def test_a_study_of_repeats_is_not_gone_on_with_otherwise(tmp_path):
    one = replace(demonstration("t-intersection", budget=2, seed=1), optimizer="sobol", repeats=2)
    explore_configuration(one, tmp_path / "s.db")
    with pytest.raises(InputError, match="another number of repeats"):
        explore_configuration(replace(one, repeats=3), tmp_path / "s.db")
    with Study.open(tmp_path / "s.db", readonly=False) as study:
        # The builtin simulator gives the same each time.
        spread = study.spread("ttc")
        assert spread is not None
        np.testing.assert_array_equal(*spread.T)


def test_an_interrupt_before_the_explorer_listens_is_none_that_is_lost(tmp_path, monkeypatch):
    one = replace(demonstration("t-intersection", budget=2, seed=1), optimizer="sobol")

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("cornercase.exploration.exploring.ScenarioExplorer", interrupted)
    result = explore_configuration(one, tmp_path / "s.db")
    assert (result.ended, result.interrupted) == (0, True)
    monkeypatch.undo()
    assert explore_configuration(one, tmp_path / "s.db").ended == 2
    # Before there is a study there is nothing to go on with.
    monkeypatch.setattr("cornercase.exploration.exploring.Study.create", interrupted)
    with pytest.raises(KeyboardInterrupt):
        explore_configuration(one, tmp_path / "other.db")


def test_an_interrupt_that_compiled_code_turns_into_an_error_is_still_one():
    def compare():
        try:
            signal.raise_signal(signal.SIGINT)
            time.sleep(1)
        except KeyboardInterrupt:
            raise TypeError("cannot compare") from None

    with pytest.raises(KeyboardInterrupt), noted_interrupts():
        compare()
    with pytest.raises(TypeError, match="of its own"), noted_interrupts():
        raise TypeError("of its own")


T = examples() / "t_intersection"


def test_from_python_a_scenario_is_explored_by_its_path_or_as_it_was_read(tmp_path):
    search = partial(explore, ego="Ego", other="C", metrics=["distance"], optimizer="sobol", seed=1)
    file, space = T / "t_intersection.xosc", T / "t_intersection.space.xosc"
    found = search(file, tmp_path / "a.db", space=space, budget=3)
    assert (found.study, found.done, found.failed, found.ended) == (tmp_path / "a.db", 3, 0, 3)
    assert "3 scenarios done" in repr(found)
    assert "budget of 3" in repr(found)
    logical = LogicalScenario.read(file, space)
    normal = named_driver("normal")
    search(logical, str(tmp_path / "b.db"), budget=2)
    # With a larger budget it goes on.
    assert search(logical, tmp_path / "b.db", budget=3).ended == 3
    driven = search(logical, tmp_path / "c.db", budget=2, drivers={"Ego": normal})
    with Study.open(driven.study, readonly=True) as study:
        assert study.meta.settings["drivers"] == {"Ego": normal.settings}
    with Study.open(tmp_path / "a.db", readonly=True) as one, Study.open(tmp_path / "b.db", readonly=True) as two:
        np.testing.assert_array_equal(one.scores("distance"), two.scores("distance"))
    with pytest.raises(InputError, match="belong to a scenario file"):
        search(logical, tmp_path / "d.db", space=space)


@pytest.mark.parametrize("given", [{"budget": 0}, {"batch": 0}, {"seed": -1}, {"repeats": 0}, {"patience": 0}])
def test_numbers_out_of_range_are_refused(given):
    (name,) = given
    with pytest.raises(InputError, match=f"`{name}`"):
        Configuration(demonstration("t-intersection").logical, "Ego", "C", ("distance",), **given)


NAN = float("nan")
T_SEARCH = {
    "scenario": T / "t_intersection.xosc",
    "space": T / "t_intersection.space.xosc",
    "ego": "Ego",
    "other": "C",
    "metrics": ["distance"],
    "optimizer": "sobol",
    "budget": 2,
}
WRONG = {
    "scenario": (3,),
    "space": (3, ["a"]),
    "ego": (None, 3),
    "other": (None, 3),
    "metrics": (None, [3], [None], 3),
    "ranges": ([("a", 0, 1)], None, 3),
    "continuous": ("yes",),
    "optimizer": (None, 3),
    "critical": ("x", NAN),
    "weights": ({"distance": "x"}, [("distance", 1)], "distance", {3: 1.0}),
    "pareto": ("yes",),
    "stop_when": (None, [3]),
    "budget": (NAN, "4", None, 2.5, True, float("inf")),
    "batch": ("4", 1.5, None),
    "patience": ("4", 1.5),
    "max_seconds": (NAN, -1, "4"),
    "seed": ("4", 1.5, None),
    "simulator": (None, 3),
    "workers": ("4", 1.5, None, 99_999_999),
    "timeout": ("4", NAN, 0),
    "retries": ("4", 1.5),
    "repeats": ("4", 1.5),
    "time_step": ("4", None, NAN),
    "duration": ("4", None, NAN),
    "on_collision": (None, 3, "stopp"),
    "drivers": ("normal", ["normal"], {"Ego": 3}, {"Ego": type(named_driver("normal"))}, {"Ego": None}, {3: "normal"}),
    "progress": ("yes",),
}


@pytest.mark.parametrize(("name", "wrong"), [(name, wrong) for name, several in WRONG.items() for wrong in several])
def test_what_is_of_another_type_is_refused_in_one_sentence_and_nothing_is_written(tmp_path, name, wrong):
    given: dict[str, Any] = T_SEARCH | {name: wrong}
    with pytest.raises(InputError, match=f"^`{name}` .*: .*[.?]$"):
        explore(given.pop("scenario"), tmp_path / "s.db", **given)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("study", [None, 3])
def test_a_study_without_a_path_is_refused(study):
    given: dict[str, Any] = dict(T_SEARCH)
    with pytest.raises(InputError, match=r"^`study` .*: give the path"):
        explore(given.pop("scenario"), study, **given)


def test_numbers_of_numpy_are_numbers(tmp_path):
    of_numpy: dict[str, Any] = {
        "seed": np.int64(3), "budget": np.int32(2), "batch": np.uint8(2), "critical": np.float32(2.5),
        "time_step": np.float64(0.1), "duration": np.int64(5),
    }  # fmt: skip
    usual = {name: value.item() for name, value in of_numpy.items()}
    for name, numbers in (("a.db", of_numpy), ("b.db", usual)):
        given: dict[str, Any] = T_SEARCH | numbers
        explore(given.pop("scenario"), tmp_path / name, **given)
    with Study.open(tmp_path / "a.db", readonly=True) as one, Study.open(tmp_path / "b.db", readonly=True) as two:
        assert one.meta == two.meta


def test_a_driven_entity_that_is_not_there_is_refused_before_there_is_a_study(tmp_path):
    given: dict[str, Any] = dict(T_SEARCH)
    scenario = given.pop("scenario")
    with pytest.raises(InputError, match="has no entity 'Nobody' to be the driven entity"):
        explore(scenario, tmp_path / "typo.db", drivers={"Nobody": "normal"}, **given)
    assert not list(tmp_path.iterdir())
    assert explore(scenario, tmp_path / "typo.db", drivers={"Ego": "normal"}, **given).ended == 2


def test_a_simulator_that_raises_in_the_same_process_is_named_and_what_has_ended_is_kept(tmp_path):
    class Broken(Synthetic):
        def run(self, concretes):
            for number, run in enumerate(super().run(concretes)):
                if number == 4:
                    raise KeyError("of the\nadapter")
                yield run

    with opened(tmp_path / "s.db") as study:
        with pytest.raises(InputError, match=r"^The simulator 'builtin' failed \(KeyError: .*\); mend it.*\.$"):
            explorer(study, Broken(), "sobol", budget=10).run()
        assert [row.state == "pending" for row in study.rows()] == [False] * 4 + [True] * 6
    with opened(tmp_path / "s.db") as study:
        assert explorer(study, Synthetic(), "sobol", budget=10).run().ended == 10


def test_a_study_whose_budget_grew_is_that_of_the_larger_budget_byte_for_byte(tmp_path):
    def stored(name, *budgets):
        for budget in budgets:
            given: dict[str, Any] = T_SEARCH | {"budget": budget, "batch": 2}
            explore(given.pop("scenario"), tmp_path / name, **given)
        with contextlib.closing(sqlite3.connect(tmp_path / name)) as connection:
            return [
                sorted(connection.execute(f"SELECT * FROM {table}").fetchall())
                for table in ("meta", "scenarios", "courses")
            ]

    grown = stored("grown.db", 2, 5)
    assert grown == stored("at_once.db", 5)
    assert grown == stored("grown.db", 3)
