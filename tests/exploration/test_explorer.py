"""The exploration loop: stopped, killed and resumed, always with identical results."""

from __future__ import annotations

import shutil
import signal
import sqlite3
import time
from dataclasses import replace
from itertools import takewhile
from typing import Any

import numpy as np
import pytest

from conftest import EXAMPLES
from cornercase._common.errors import InputError
from cornercase._common.process.signals import collect_interrupts
from cornercase.exploration import explore
from cornercase.exploration._explore import explore_config
from cornercase.exploration._paper_examples import paper_experiment_config
from cornercase.metrics import Metric
from cornercase.optimizers import OPTIMIZERS, Optimizer, Sobol
from cornercase.scenario import Constraint, LogicalScenario, ParameterDeclaration, ParameterSpace
from cornercase.study import StudyFile
from helpers import synthetic_study as synthetic
from helpers.command_line import X, waiting_after
from helpers.synthetic_study import LOGICAL, Synthetic, explorer, opened


def results(path):
    with StudyFile.open(path, readonly=True) as study:
        rows = study.rows()
        return [(r.id, r.round, r.values, r.state) for r in rows], study.scores("wttc").tolist()


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    path = tmp_path_factory.mktemp("studies") / "study.db"
    explore_config(paper_experiment_config("x-intersection", budget=40, seed=1), path)
    return path


@pytest.mark.slow
def test_a_killed_exploration_goes_on_as_if_undisturbed(undisturbed, tmp_path):
    path = tmp_path / "killed" / "study.db"
    command = ("demo", "x-intersection", "--budget", 40, "--seed", 1, "-o", path.parent)
    with waiting_after(13, tmp_path / "waiting", *command) as process:
        process.kill()
        process.wait()
    interrupted, _ = results(path)
    assert 13 <= sum(state == "done" for *_, state in interrupted) < 40
    result = explore_config(paper_experiment_config("x-intersection", budget=40, seed=1), path)
    assert result.n_finished == 40
    assert results(path) == results(undisturbed)


def test_workers_change_nothing(undisturbed, tmp_path):
    from dataclasses import replace

    explore_config(replace(paper_experiment_config("x-intersection", budget=40, seed=1), workers=2), tmp_path / "s.db")
    assert results(tmp_path / "s.db") == results(undisturbed)


def test_a_larger_budget_goes_on(tmp_path):
    path = tmp_path / "s.db"
    explore_config(paper_experiment_config("x-intersection", budget=10), path)
    assert explore_config(paper_experiment_config("x-intersection", budget=20), path).n_finished == 20


def test_a_study_goes_on_where_the_same_files_lie_elsewhere(tmp_path):
    def explored(name, budget):
        folder = shutil.copytree(EXAMPLES / "x_intersection", tmp_path / name)
        logical = LogicalScenario.read(folder / "x_intersection.xosc", folder / "x_intersection.space.xosc")
        options: dict[str, Any] = {"ego": "Ego", "other": "Pedestrian", "metrics": ["wttc"], "optimizer": "sobol"}
        return explore(logical, tmp_path / "s.db", **options, budget=budget)

    explored("here", 10)
    assert explored("there", 20).n_finished == 20


def test_patience_ends_it(tmp_path):
    from dataclasses import replace

    exploration = replace(paper_experiment_config("x-intersection", budget=400), optimizer="sobol", patience=2, batch=3)
    result = explore_config(exploration, tmp_path / "s.db")
    assert result.n_finished < 400
    assert "no improvement" in result.reason


def test_a_study_of_something_else_is_refused_and_kept(undisturbed):
    before = results(undisturbed)
    with pytest.raises(InputError, match="another seed"):
        explore_config(paper_experiment_config("x-intersection", budget=40, seed=2), undisturbed)
    with pytest.raises(InputError, match="another scenario"):
        explore_config(paper_experiment_config("t-intersection", budget=40, seed=1), undisturbed)
    assert results(undisturbed) == before


def test_two_explorers_never_write_at_once(undisturbed):
    with StudyFile.open(undisturbed, readonly=False), pytest.raises(InputError, match="another cornercase"):
        StudyFile.open(undisturbed, readonly=False)


def test_a_recording_comes_back_bit_for_bit(undisturbed):
    from conftest import ran, same_recording
    from cornercase.scenario import ConcreteScenario
    from cornercase.simulators import Builtin

    with StudyFile.open(undisturbed, readonly=True) as study:
        row = study.finished_rows()[17]
        (again,) = ran(Builtin(), [ConcreteScenario(X, row.values)])
        assert same_recording(study.recording(row.id), again)


def test_what_is_no_study_is_refused(tmp_path):
    (tmp_path / "text.db").write_text("hello")
    with pytest.raises(InputError, match=r"text\.db"):
        StudyFile.open(tmp_path / "text.db", readonly=False)
    with sqlite3.connect(tmp_path / "other.db") as connection:
        connection.execute("CREATE TABLE a (b)")
    with pytest.raises(InputError, match="not a cornercase study"):
        StudyFile.open(tmp_path / "other.db", readonly=False)
    with pytest.raises(InputError, match="no such study"):
        StudyFile.open(tmp_path / "absent.db", readonly=False)


def contents(path):
    """Everything that must be bit-identical in all runs."""
    with sqlite3.connect(path) as connection:
        return [connection.execute(f"SELECT * FROM {table}").fetchall() for table in ("meta", "scenarios", "courses")]


@pytest.mark.parametrize(
    ("optimizer", "deaths"),
    [
        ("bayes", (13, 3)),
        pytest.param("bayes", (1, 13, 3, 9), marks=pytest.mark.slow),
        pytest.param("committee", (1, 13, 3, 9), marks=pytest.mark.slow),
        pytest.param("auto", (1, 13, 3, 9), marks=pytest.mark.slow),
    ],
)
def test_killed_again_and_again_it_ends_with_the_same_bytes(optimizer, deaths, tmp_path):
    with opened(tmp_path / "whole.db") as study:
        result = explorer(study, optimizer=optimizer, metrics=("distance", "wttc")).run()
    assert (result.n_finished, result.reason, result.interrupted) == (
        47,
        "the budget of 47 scenarios is used up",
        False,
    )
    with StudyFile.open(tmp_path / "whole.db", readonly=True) as study:
        # Seven are left for the last round.
        assert [row.round for row in study.rows()] == [1 + k // 10 for k in range(47)]
        assert [row.error for row in study.failed_rows()] == [f"a is {row.values['a']}" for row in study.failed_rows()]
        assert len(study.failed_rows()) > 0
        away = [10 * abs(float(row.values["a"]) - float(row.values["b"])) for row in study.finished_rows()]
        np.testing.assert_allclose(study.scores("distance"), away, atol=1e-12)
    for survives in deaths:
        synthetic.go_on_until_killed(tmp_path / "killed.db", optimizer, survives)
        with StudyFile.open(tmp_path / "killed.db", readonly=True) as study:
            assert len(study.rows()) < 47
    synthetic.go_on(tmp_path / "killed.db", optimizer)
    assert contents(tmp_path / "killed.db") == contents(tmp_path / "whole.db")


class Listening(Optimizer):
    """A Sobol' sequence that records what it is told."""

    name, requires = "listening", frozenset({"features"})

    def prepare(self, space, seed, features):
        self._sequence, self.features, self.told = Sobol().start(space, seed), features, []

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
    # The other stands ahead; its distance is the score.
    np.testing.assert_allclose(column["nearest-ahead"][~failed], scores[~failed], atol=1e-12)
    assert len(made[0].told) == 3
    np.testing.assert_array_equal(np.concatenate([one[2] for one in made[0].told]), features[:23])


def test_interrupted_it_keeps_what_ended_and_says_so(tmp_path):
    with opened(tmp_path / "s.db") as study:
        result = explorer(study, Synthetic(interrupts=14), "sobol").run()
        assert (result.n_finished, result.interrupted) == (14, True)
        assert [row.state for row in study.rows()].count("pending") == 6
        assert explorer(study, optimizer="sobol").run().n_finished == 47


def test_a_simulator_that_ends_early_fails_only_the_scenario_where_it_ends(tmp_path):
    class Short(Synthetic):
        def run(self, concretes):
            runs = zip(concretes, super().run(concretes), strict=True)
            yield from (run for _, run in takewhile(lambda one: one[0].values["a"] > 0.2, runs))

    with opened(tmp_path / "s.db") as study:
        assert explorer(study, Short(), "sobol", budget=20).run().n_finished == 20
        early = {row.id for row in study.rows() if row.values["a"] <= 0.2}
        assert early
        assert {row.id for row in study.failed_rows() if "without a result" in row.error} == early


class Largest(Metric):
    """The same distance, but critical when large."""

    name, unit, lower_is_critical, cap, source = "distance", "m", False, 0.0, ""

    def course(self, recording, ego, other):
        return np.abs(recording.x[1] - recording.x[0])

    def score(self, course):
        return float(course.max())


def test_the_optimizer_is_told_that_lower_is_critical(tmp_path):
    found = {}
    for metric in ("distance", Largest()):
        with opened(tmp_path / f"{type(metric).__name__}.db") as study:
            explorer(study, metrics=(metric,), budget=60).run()
            found[type(metric)] = np.median(study.scores("distance")[-30:])
    assert found[Largest] > 4.0
    assert found[str] < 1.5


def scripted(rounds):
    """An optimizer that lets the round with number k reach the distance rounds[k]."""

    class Scripted:
        name = "scripted"
        requires = ()

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


@pytest.mark.filterwarnings("ignore:.*that were run already:cornercase.NoticeWarning")
@pytest.mark.parametrize(
    ("rounds", "told"),
    [
        ([5, 4, 3, 3.5, 3.6, 2], 5),  # two rounds that are worse than the third
        ([5, 4, 4, 4, 6, 4, 4.5, 4.5, 4], 8),  # a score equal to the best counts as an improvement
        ([3, 2, 1], 3),  # the space is exhausted
    ],
)
def test_patience_counts_rounds_without_news(tmp_path, rounds, told):
    with opened(tmp_path / "s.db") as study:
        one = explorer(study, budget=1000, batch=1, patience=2)
        one._optimizer = scripted(rounds)
        result = one.run()
    assert result.n_finished == told
    assert ("no improvement" in result.reason) == (told < len(rounds))


@pytest.mark.parametrize("asynchronous", [False, True])
def test_all_of_a_space_was_run_only_where_it_was(asynchronous, tmp_path):
    def ended(optimizer, space, **more):
        logical, given = replace(LOGICAL, space=space), {"asynchronous": asynchronous, **more}
        with opened(tmp_path / f"{optimizer} {len(space.declarations)} {more}.db", space, **given) as study:
            return explorer(study, optimizer=optimizer, budget=40, logical=logical, **given).run().reason

    finite = ParameterSpace.from_ranges(["a=0:1:0.25", "b=0:1:0.5"])
    falling = [
        ParameterDeclaration("a", "double", "0"),
        ParameterDeclaration("b", "double", "0", ((Constraint("lessThan", "$a"),),)),
    ]
    assert ended("sobol", finite) == "all 15 scenarios of the space were run"
    # Some of the 15 are audits, and run twice.
    assert ended("sobol", finite, audit=0.2) == "all 15 scenarios of the space were run"
    some = ParameterSpace(finite.parameters, falling)
    assert ended("sobol", some) == "all 6 scenarios of the space were run"
    grid = "the search has no proposals after these 36 scenarios"
    assert ended("grid", LOGICAL.space) == grid


def test_scores_at_the_cap_are_no_news(tmp_path):
    class Nothing(Largest):
        def course(self, recording, ego, other):
            return np.zeros(len(recording.time))

    with opened(tmp_path / "s.db") as study:
        assert explorer(study, metrics=(Nothing(),), optimizer="sobol", budget=400, patience=3).run().n_finished == 40


def test_time_is_a_criterion_and_is_noted(tmp_path):
    with opened(tmp_path / "s.db") as study:
        result = explorer(study, max_seconds=0.0).run()
        assert (result.n_finished, result.reason) == (0, "0 s have passed")
        explorer(study, optimizer="sobol", budget=20).run()
        assert list(study.elapsed_by_stage()) == ["optimize", "simulate", "measure", "store", "judge"]


def test_progress_in_a_file_is_a_line_with_the_best_score(tmp_path, capfd):
    with opened(tmp_path / "s.db") as study:
        explorer(study, optimizer="sobol", budget=20).run(progress=True)
        best = study.scores("distance").min()
    said = capfd.readouterr().err
    assert "20 of 20 scenarios" in said
    assert f"best {best:.3g} m" in said
    assert "\x1b" not in said


def test_an_interrupt_before_the_explorer_listens_is_none_that_is_lost(tmp_path, monkeypatch):
    one = replace(paper_experiment_config("t-intersection", budget=2, seed=1), optimizer="sobol")

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("cornercase.exploration._explore.ScenarioExplorer", interrupted)
    result = explore_config(one, tmp_path / "s.db")
    assert (result.n_finished, result.interrupted) == (0, True)
    monkeypatch.undo()
    assert explore_config(one, tmp_path / "s.db").n_finished == 2
    # Without a study there is nothing to resume.
    monkeypatch.setattr("cornercase.exploration._explore.open_or_create_study", interrupted)
    with pytest.raises(KeyboardInterrupt):
        explore_config(one, tmp_path / "other.db")


def test_an_interrupt_that_compiled_code_turns_into_an_error_is_still_one():
    def compare():
        try:
            signal.raise_signal(signal.SIGINT)
            time.sleep(1)
        except KeyboardInterrupt:
            raise TypeError("cannot compare") from None

    with pytest.raises(KeyboardInterrupt), collect_interrupts():
        compare()
    with pytest.raises(TypeError, match="of its own"), collect_interrupts():
        raise TypeError("of its own")


def test_42_s5_a_simulator_that_raises_in_the_same_process_fails_its_scenario(tmp_path):
    class Broken(Synthetic):
        def run(self, concretes):
            for concrete, run in zip(concretes, super().run(concretes), strict=True):
                if concrete.values["b"] > 0.8:
                    raise SystemExit(0)
                yield run

    with opened(tmp_path / "s.db") as study:
        result = explorer(study, Broken(), "sobol", budget=10).run()
        raised = [row for row in study.rows() if row.values["b"] > 0.8]
        assert result.n_finished == 10
        assert 0 < len(raised) < 5
        for row in raised:
            assert row.error.startswith("the simulator failed: SystemExit: 0 (test_explorer.py line ")
            assert row.error.endswith(" in run: raise SystemExit(0))")
