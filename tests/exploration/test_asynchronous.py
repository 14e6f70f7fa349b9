"""Searches without rounds: calls of ask and tell, killed searches, and verified proposals."""

from __future__ import annotations

import shutil
import signal
import sqlite3
import threading
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from conftest import at_night
from cornercase._common.errors import InputError, SimulationError
from cornercase.cli import app
from cornercase.exploration import explore
from cornercase.exploration._asynchronous import AsynchronousExplorer
from cornercase.exploration._config import ExplorationConfig
from cornercase.exploration._explore import explore_config
from cornercase.exploration._paper_examples import paper_experiment_config
from cornercase.exploration._verify_proposals import verify_proposals
from cornercase.metrics import METRICS
from cornercase.optimizers import OPTIMIZERS, Optimizer, Sobol
from cornercase.study import StudyFile
from helpers import synthetic_study as synthetic
from helpers.checksums import reseal
from helpers.synthetic_study import LOGICAL, SPACE, Synthetic
from helpers.waiting import until

pytestmark = pytest.mark.filterwarnings("ignore:without effect")


class Slow(Synthetic):
    """Parallel simulator in which some scenarios take much longer than others."""

    def __init__(self, places, survives=None, gather=False):
        super().__init__()
        self.places, self.survives, self.most, self.now = places, survives, 0, 0
        self.lock, self.gathered, self.given_up = threading.Lock(), threading.Event(), threading.Event()
        if not gather:
            self.gathered.set()

    def cancel(self):
        self.given_up.set()

    def parallel_instances(self):
        return [self] * self.places

    def run(self, concretes):
        with self.lock:
            self.now += 1
            self.most = max(self.most, self.now)
            if self.survives is not None and self.ran >= self.survives and not self.given_up.is_set():
                # The main thread receives the signal, and cancels what runs in this thread.
                signal.raise_signal(signal.SIGINT)
                self.given_up.wait(120.0)
            if self.most == self.places:
                self.gathered.set()
        # On a busy machine, one scenario would end before the next starts.
        self.gathered.wait(120.0)
        time.sleep(0.03 if concretes[0].values["b"] < 0.2 else 0.003)
        yield from super().run(concretes)
        with self.lock:
            self.now -= 1


class Listening(Optimizer):
    """Records the calls of ask and tell of another optimizer."""

    name = "listening"

    def __init__(self, inner):
        self.inner, self.calls = inner, []

    def prepare(self, space, seed):
        raise AssertionError("it has begun")

    def ask(self, n):
        raise AssertionError("nothing else runs")

    def ask_async(self, n, pending, *lies):
        found = self.inner.ask_async(n, pending, *lies)
        self.calls.append(("asked", found, pending))
        return found

    def tell(self, points, scores):
        self.calls.append(("told", points, scores))
        self.inner.tell(points, scores)


def about(optimizer="sobol", **options):
    given: dict[str, Any] = {"budget": 47, "asynchronous": True, "seed": 7} | options
    return ExplorationConfig(
        LOGICAL, ego="Ego", other="B", metrics=("distance",), optimizer=optimizer, critical=1.0, **given
    )


def fresh(one):
    return OPTIMIZERS.resolve(one.optimizer, "optimizer").start(SPACE, one.seed, threshold=1.0, budget=one.budget)


def explored(path, one, simulator=None, optimizer=None):
    """Start or resume an exploration without rounds."""
    objective = one.make_objective([METRICS.create("distance")])
    with (
        StudyFile.open(path, readonly=False)
        if path.exists()
        else StudyFile.create(path, one.make_study_meta(objective, {})) as study
    ):
        study.writer.check_and_update_meta(one.make_study_meta(objective, {}))
        searching = fresh(one) if optimizer is None else optimizer
        return AsynchronousExplorer(one, simulator or Synthetic(), searching, study, objective).run()


def proposed_again(path, one):
    objective = one.make_objective([METRICS.create("distance")])
    return verify_proposals(path, one.make_study_meta(objective, {}), objective, fresh(one))


def contents(path):
    tables = ("meta", "scenarios", "courses", "results")
    with sqlite3.connect(path) as connection:
        return [connection.execute(f"SELECT * FROM {table}").fetchall() for table in tables]


def test_one_is_asked_for_as_soon_as_one_has_ended_and_all_that_runs_is_known(tmp_path):
    one, simulator = about(), Slow(4, gather=True)
    optimizer = Listening(Sobol().start(SPACE, 7))
    result = explored(tmp_path / "s.db", one, simulator, optimizer)
    assert (result.n_finished, result.reason) == (47, "the budget of 47 scenarios is used up")
    assert simulator.most == 4
    asked: list[bytes] = []
    told: list[bytes] = []
    for kind, points, more in optimizer.calls:
        keys = [point.tobytes() for point in points]
        if kind == "told":
            assert set(keys) <= set(asked) - set(told)
            told += keys
            continue
        assert [point.tobytes() for point in more] == [key for key in asked if key not in told]
        asked += keys
        # Half as many scenarios wait as are running.
        assert len(asked) - len(told) == min(6, 47 - len(told))
    assert len(told) == len(set(asked)) == 47
    with StudyFile.open(tmp_path / "s.db", readonly=True) as study:
        assert len(study.failed_rows()) > 0
        points = {row.id: row.point.tobytes() for row in study.rows()}
        order = [scenario for scenario, _ in study.result_order()]
        assert [points[scenario] for scenario in order] == told
        # Fast scenarios overtake slow ones.
        assert order != sorted(order)
        away = [10 * abs(float(row.values["a"]) - float(row.values["b"])) for row in study.finished_rows()]
        np.testing.assert_allclose(study.scores("distance"), away, atol=1e-12)


@pytest.mark.parametrize(
    "optimizer",
    at_night(["bayes", "level-set", "evolutionary:population=10", "optuna", "sobol", "grid"], {"level-set", "optuna"}),
)
def test_the_stored_order_gives_the_same_proposals_again_also_of_a_search_that_was_interrupted(optimizer, tmp_path):
    path, one = tmp_path / "s.db", about(optimizer, audit=0.1)
    if optimizer == "optuna":
        pytest.importorskip("optuna")
    interrupted = [explored(path, one, Slow(3, survives)).interrupted for survives in (14, 21, None)]
    assert interrupted == [True, True, False]
    with StudyFile.open(path, readonly=True) as study:
        # The grid has 42 points; audits come on top.
        count = 46 if optimizer == "grid" else 47
        assert len(study.rows()) == len(study.result_order()) == count
        assert len(study.finished_rows()) > 30
    again = proposed_again(path, one)
    assert (again.reproducible, again.reason) == (True, f"the same {count} scenarios were proposed again")
    if optimizer in ("sobol", "grid"):
        return
    # A different early result leads to other proposals.
    with sqlite3.connect(path) as connection:
        connection.execute("UPDATE courses SET score = 90 - score WHERE scenario < 40")
    reseal(path)
    again = proposed_again(path, one)
    assert again.reproducible is False
    assert "is proposed differently" in again.reason


@pytest.mark.slow
def test_with_one_worker_it_is_deterministic_and_goes_on_where_it_was_killed(tmp_path):
    synthetic.go_on(tmp_path / "a.db", "level-set", asynchronous=True)
    for survives in (2, 13):
        synthetic.go_on_until_killed(tmp_path / "b.db", "level-set", survives, "asynchronous")
    synthetic.go_on(tmp_path / "b.db", "level-set", asynchronous=True)
    assert contents(tmp_path / "a.db") == contents(tmp_path / "b.db")
    rounds = [row[1] for row in contents(tmp_path / "a.db")[1]]
    assert rounds == list(range(1, 48))


def test_audits_are_drawn_and_kept_from_the_search_as_in_rounds(tmp_path):
    one = about(audit=0.2)
    optimizer = Listening(Sobol().start(SPACE, 7))
    explored(tmp_path / "s.db", one, Slow(3), optimizer)
    told = {point.tobytes() for kind, points, _ in optimizer.calls if kind == "told" for point in points}
    pending = {point.tobytes() for kind, _, points in optimizer.calls if kind == "asked" for point in points}
    with StudyFile.open(tmp_path / "s.db", readonly=True) as study:
        audits = {row.point.tobytes() for row in study.rows() if study.meta.is_audit(row.id)}
    assert len(audits) == 9
    assert not audits & (told | pending)
    assert len(told) == 38


def test_patience_and_what_is_known_are_counted_in_results(tmp_path):
    result = explored(tmp_path / "s.db", about(budget=400, patience=2, batch=5), Slow(3))
    assert result.reason == "10 scenarios brought no improvement"
    with StudyFile.open(tmp_path / "s.db", readonly=True) as study:
        scores = dict(zip((row.id for row in study.finished_rows()), study.scores("distance"), strict=True))
        order = [scores.get(scenario, np.inf) for scenario, _ in study.result_order()]
        assert not [row for row in study.rows() if row.state == "pending"]
    best = np.minimum.accumulate(order)
    last_new = 1 + max(np.flatnonzero(np.diff(best) < 0), default=-1)
    # Pending scenarios have ended too.
    assert 10 <= len(order) - 1 - last_new <= 10 + 5
    stopped = explored(tmp_path / "t.db", about(budget=400, stop_when=("interval<0.4",)), Slow(3))
    assert "the critical share is known within" in stopped.reason
    assert stopped.n_finished < 200
    # A second call says so at once.
    assert explored(tmp_path / "t.db", about(budget=400, stop_when=("interval<0.4",))).n_finished == stopped.n_finished


def test_stop_criteria_end_it_like_a_search_with_rounds_of_one(tmp_path):
    rule: dict[str, Any] = {"budget": 150, "stop_when": ("unvisited(0.05)<0.06",), "optimizer": "random"}
    one_by_one = explored(tmp_path / "a.db", about(**rule))
    meta = synthetic.about(SPACE, "distance", critical=1.0, optimizer="random", seed=7)
    with StudyFile.create(tmp_path / "r.db", meta) as study:
        rounds = synthetic.explorer(study, critical=1.0, batch=1, seed=7, **rule).run()
    assert one_by_one.n_finished == rounds.n_finished < 150
    assert one_by_one.reason == rounds.reason
    # A second call ends at once, too.
    assert explored(tmp_path / "a.db", about(**rule)).n_finished == rounds.n_finished


class LastOfFiveWaits(Slow):
    """Ends the fifth scenario only when a sixth has started, so that one is pending at the second ask."""

    def __init__(self, places):
        super().__init__(places)
        self.started, self.sixth_started = 0, threading.Event()

    def run(self, concretes):
        with self.lock:
            self.started += 1
            turn = self.started
        if turn == 5:
            assert self.sixth_started.wait(120.0)
        elif turn == 6:
            self.sixth_started.set()
        yield from super().run(concretes)


class Plain(Optimizer):
    """A third-party optimizer without support for asynchronous search."""

    name = "plain"

    def prepare(self, space, seed):
        self.told = []

    def ask(self, n):
        known = np.concatenate([points for points, _ in self.told]) if self.told else np.zeros((0, 2))
        scores = np.concatenate([scores for _, scores in self.told]) if self.told else np.zeros(0)
        self.lies.append(scores[len(scores) - 5 :])
        return np.full((n, 2), 0.001 * len(known)) + 0.0001 * np.arange(n)[:, None]

    def tell(self, points, scores):
        self.told.append((points, scores))

    lies: list[Any] = []  # noqa: RUF012 - shared with copies


def test_an_optimizer_that_only_asks_and_tells_is_told_the_mean_of_what_runs(tmp_path):
    optimizer = Plain().start(SPACE, 0)
    Plain.lies.clear()
    points = np.array([[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]])
    optimizer.tell(points[:2], np.array([1.0, 3.0]))
    found = optimizer.ask_async(1, points[2:], np.array([2.0]))
    np.testing.assert_allclose(found, [[0.003, 0.003]])
    assert len(optimizer.told) == 1
    one = about(budget=12)
    explored(tmp_path / "s.db", one, LastOfFiveWaits(3), Plain().start(SPACE, 0))
    with StudyFile.open(tmp_path / "s.db", readonly=True) as study:
        order = [scenario for scenario, _ in study.result_order()]
        scores = dict(zip((row.id for row in study.finished_rows()), study.scores("distance"), strict=True))
        known = [scores[scenario] for scenario, turn in study.result_order() if turn == 2]
    assert len(order) == 12
    # At the second ask, some have ended, and the pending ones have the mean score as a pseudo-result.
    assert 1 <= len(known) <= 4
    lies = Plain.lies[2]
    assert lies[-1] == pytest.approx(np.mean(known))


class SearchWaits(Slow):
    """Ends what the optimizer proposed, near a = b = 0, only after the optimizer was asked a second time."""

    def run(self, concretes):
        if concretes[0].values["b"] < 0.01:
            until(lambda: len(Plain.lies) >= 2)
        yield from super().run(concretes)


def test_an_audit_may_end_before_anything_that_the_optimizer_proposed(tmp_path):
    Plain.lies.clear()
    result = explored(tmp_path / "s.db", about(budget=8, audit=0.5), SearchWaits(4), Plain().start(SPACE, 0))
    assert result.n_finished == 8
    # Nothing is known of those that run then.
    assert len(Plain.lies[1]) > 0
    assert np.isnan(Plain.lies[1]).all()


class Noisy(Synthetic):
    """Returns another distance each time that the same scenario is run."""

    def run(self, concretes):
        for k, found in enumerate(super().run(concretes)):
            yield (
                found
                if isinstance(found, SimulationError)
                else replace(found, x=found.x + np.array([[0.0], [float(k)]]))
            )


def test_each_scenario_is_run_several_times_and_the_median_counts(tmp_path):
    explored(tmp_path / "s.db", about(repeats=3, budget=12), Noisy())
    with StudyFile.open(tmp_path / "s.db", readonly=True) as study:
        away = [10 * abs(float(row.values["a"]) - float(row.values["b"])) for row in study.finished_rows()]
        np.testing.assert_allclose(study.scores("distance"), np.array(away) + 1.0, atol=1e-12)
        spread = study.score_range("distance")
        assert spread is not None
        np.testing.assert_allclose(spread, np.stack([away, np.array(away) + 2.0], axis=1), atol=1e-12)


def test_a_study_of_rounds_stays_one_and_is_proposed_again_too(tmp_path):
    path, one = tmp_path / "s.db", paper_experiment_config("x-intersection", budget=24, seed=1)
    explore_config(one, path)
    with sqlite3.connect(path) as connection:
        assert not connection.execute("SELECT * FROM meta WHERE key = 'asynchronous'").fetchall()
        assert not connection.execute("SELECT * FROM sqlite_master WHERE name = 'results'").fetchall()
    with pytest.raises(InputError, match=r"another mode of search \(in rounds or asynchronous\)"):
        explore_config(replace(one, asynchronous=True), path)
    options: dict[str, Any] = {"ego": one.ego, "other": one.other, "metrics": one.metrics, "budget": 24, "seed": 1}
    options["critical"] = one.critical
    before = path.read_bytes()
    again = explore(one.logical, path, **options, check_proposals=True)
    assert again.reproducible
    assert path.read_bytes() == before
    with pytest.raises(InputError, match="no such study"):
        explore(one.logical, tmp_path / "none.db", **options, check_proposals=True)
    with pytest.raises(InputError, match="another seed"):
        explore(one.logical, path, **options | {"seed": 2}, check_proposals=True)


def test_the_command_proposes_again_and_says_whether_it_is_the_same(tmp_path):
    words = [
        "explore",
        str(paper_experiment_config("x-intersection").logical.path),
        "--ego",
        "Ego",
        "--other",
        "Pedestrian",
    ]
    words += ["--space", str(paper_experiment_config("x-intersection").logical.path.with_suffix(".space.xosc"))]
    words += ["--metric", "wttc", "--optimizer", "bayes", "--budget", "24", "--duration", "15", "--asynchronous"]
    words += ["-o", str(tmp_path / "s.db")]
    assert CliRunner().invoke(app, words).exit_code == 0
    ended = CliRunner().invoke(app, [*words, "--check-proposals"])
    assert ended.exit_code == 0
    assert "the same 24 scenarios were proposed again" in " ".join(ended.output.split())
    shutil.copy(tmp_path / "s.db", tmp_path / "other.db")
    with sqlite3.connect(tmp_path / "other.db") as connection:
        ran = "UPDATE scenarios SET parameters = (SELECT parameters FROM scenarios WHERE id = 3) WHERE id = 5"
        connection.execute(ran)
    reseal(tmp_path / "other.db")
    ended = CliRunner().invoke(app, [*words[:-1], str(tmp_path / "other.db"), "--check-proposals"])
    assert ended.exit_code == 1
    assert "scenario 5 of 24 is proposed differently" in " ".join(ended.output.split())
    with sqlite3.connect(tmp_path / "s.db") as connection:
        connection.execute("UPDATE courses SET score = 9 WHERE scenario = 20")
        connection.execute("UPDATE courses SET score = 0 WHERE scenario = 21")
    reseal(tmp_path / "s.db")
    ended = CliRunner().invoke(app, [*words, "--check-proposals"])
    assert ended.exit_code == 1
    assert "is proposed differently" in " ".join(ended.output.split())


@pytest.mark.parametrize(
    "damage",
    [
        "DELETE FROM results WHERE number = 3",
        "UPDATE results SET round = 99 WHERE number = 12",
        "UPDATE results SET round = 1 WHERE number = 12",
        "UPDATE results SET scenario = 99 WHERE number = 3",
        "UPDATE scenarios SET state = 'pending' WHERE id = 4",
    ],
)
def test_an_order_that_cannot_be_is_refused_in_a_sentence(damage, tmp_path):
    explored(tmp_path / "s.db", about(budget=12))
    with sqlite3.connect(tmp_path / "s.db") as connection:
        connection.execute(damage)
    reseal(tmp_path / "s.db")
    with pytest.raises(InputError, match=r"s\.db"):
        explored(tmp_path / "s.db", about(budget=20))


@pytest.mark.parametrize(
    "name", at_night((one for one in OPTIMIZERS.names() if one != "optuna"), {"auto", "committee"})
)
def test_what_runs_is_never_proposed_and_nothing_twice(name):
    optimizer = OPTIMIZERS.create(name).start(SPACE, 3, threshold=1.0, budget=70)
    twin = OPTIMIZERS.create(name).start(SPACE, 3, threshold=1.0, budget=70)
    rng = np.random.default_rng(0)
    waiting, seen, count = np.zeros((0, 2)), 0, 30 if name in ("auto", "committee") else 50
    for _ in range(count):
        new = SPACE.snap(optimizer.ask_async(8 - len(waiting), waiting))
        np.testing.assert_array_equal(new, SPACE.snap(twin.ask_async(8 - len(waiting), waiting)))
        seen += len(new)
        waiting = np.concatenate([waiting, new])
        assert len(np.unique(waiting, axis=0)) == len(waiting)
        k = rng.integers(len(waiting))
        for one in (optimizer, twin):
            one.tell(waiting[k : k + 1], 10.0 * np.abs(waiting[k : k + 1, 0] - waiting[k : k + 1, 1]))
        waiting = np.delete(waiting, k, axis=0)
    assert seen == count + 8 - 1


def test_level_set_asks_elsewhere_than_where_it_is_run():
    points = Sobol().start(SPACE, 0).ask(60)
    nearest = []
    for knows in (True, False):
        optimizer = OPTIMIZERS.create("level-set:filling=0").start(SPACE, 3, threshold=1.0, budget=100)
        optimizer.tell(points, 10.0 * np.abs(points[:, 0] - points[:, 1]))
        pending = optimizer.ask(6)
        found = optimizer.ask_async(6, pending) if knows else optimizer.ask(6)
        nearest.append(np.linalg.norm(found[:, None] - pending, axis=2).min(axis=1).min())
    assert nearest[1] == 0.0
    assert nearest[0] > 0.02
