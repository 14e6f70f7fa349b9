"""Extra runs of scenarios while it is undecided whether they are critical."""

from __future__ import annotations

import json
import signal
import sqlite3
from collections import Counter
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom
from typer.testing import CliRunner

from cornercase._common.errors import InputError, SimulationError
from cornercase.cli import app
from cornercase.exploration import explore
from cornercase.exploration._asynchronous import AsynchronousExplorer
from cornercase.exploration._config import ExplorationConfig, config_from_study
from cornercase.exploration._explorer import ScenarioExplorer
from cornercase.exploration._paper_examples import paper_experiment_config
from cornercase.optimizers import OPTIMIZERS
from cornercase.recordings import Recording
from cornercase.report import summarize, write_report
from cornercase.report._repeat_command import format_toml_study_file
from cornercase.scenario import LogicalScenario, ParameterSpace
from cornercase.simulators import Simulator
from cornercase.study import StudyFile
from cornercase.study._criterion import Criterion
from cornercase.study._critical_run_rates import MIN_DECISIVE_RUNS, is_criticality_undecided

SPACE = ParameterSpace.from_ranges(["often=0:1"])
LOGICAL = LogicalScenario(Path("synthetic.xosc"), SPACE, "0")
THRESHOLD, REPEATS, MOST = 30.0, 5, 17


def distance(often, run):
    """Distance in a run of a scenario that is critical with the probability of its parameter; None if it fails."""
    draw, where = np.random.default_rng([int(often * 2**40), run]).random(2)
    if 0.2 < often < 0.3 and where < 0.5:
        return None
    return 30.0 * where if draw < often else 30.0 + 30.0 * (1.0 - where)


class Wavering(Simulator):
    """Returns another distance for each run of a scenario, but the same sequence for each instance."""

    name = "wavering"

    def __init__(self, interrupts=None):
        self.settings, self.left = {}, interrupts
        self.batches: list[list[float]] = []
        self.ran = Counter[float]()

    def run(self, concretes):
        self.batches.append([concrete.values["often"] for concrete in concretes])
        for often in self.batches[-1]:
            if self.left == 0:
                signal.raise_signal(signal.SIGINT)
            self.left = None if self.left is None else self.left - 1
            found = distance(often, self.ran[often])
            self.ran[often] += 1
            still = np.zeros((2, 3))
            yield (
                SimulationError("it cannot be")
                if found is None or often < 0.05
                else Recording(
                    time=np.arange(3) * 0.1,
                    names=("Ego", "B"),
                    object_types=("car",) * 2,
                    x=np.array([[0.0] * 3, [found] * 3]),
                    y=still,
                    heading=still,
                    speed=still,
                    acceleration=still,
                    # Too small to touch.
                    length=np.full(2, 1e-6),
                    width=np.full(2, 1e-6),
                    center_x=np.zeros(2),
                )
            )


def about(**more):
    given = {"critical": THRESHOLD, "budget": 24, "batch": 8, "repeats": REPEATS, "max_repeats": MOST} | more
    return ExplorationConfig(
        LOGICAL, ego="Ego", other="B", metrics=("distance",), optimizer="sobol", simulator="wavering", seed=3, **given
    )


def explored(path, one, simulator):
    meta = one.make_study_meta(one.make_objective(), {})
    optimizer = OPTIMIZERS.create("sobol").start(SPACE, 3, threshold=THRESHOLD, budget=one.budget)
    kind = AsynchronousExplorer if one.asynchronous else ScenarioExplorer
    with StudyFile.open(path, readonly=False) if path.exists() else StudyFile.create(path, meta) as study:
        study.writer.check_and_update_meta(meta)
        return kind(one, simulator, optimizer, study).run()


def contents(path):
    with sqlite3.connect(path) as connection:
        tables = ("meta", "scenarios", "courses", "repeats")
        return [connection.execute(f"SELECT * FROM {table}").fetchall() for table in tables]


def runs_by(rule, often):
    """Simulate the runs of a scenario with a stopping rule on the number of critical runs."""
    runs: list[float | None] = []
    while True:
        runs += [distance(often, len(runs) + k) for k in range(min(REPEATS, MOST - len(runs)))]
        ended = [one for one in runs if one is not None]
        if len(runs) == MOST or rule(sum(one <= THRESHOLD for one in ended), len(ended)):
            return ended


def is_clear(met, ended):
    """Whether a fair coin would give a count this extreme in less than one of twenty cases."""
    return binom.sf(met - 1, ended, 0.5) <= 0.05 or binom.cdf(met, ended, 0.5) <= 0.05


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    path, simulator = tmp_path_factory.mktemp("most_repeats") / "s.db", Wavering()
    explored(path, about(), simulator)
    return path, simulator


def test_scenarios_are_run_until_it_is_clear_on_which_side_they_are(study):
    path, simulator = study
    with StudyFile.open(path) as opened:
        assert opened.failed_rows()[0].error == "it cannot be"
        rows, table = opened.finished_rows(), opened.table().query("state == 'done'")
        expected = [runs_by(is_clear, row.values["often"]) for row in rows]
        assert {len(one) for one in expected} >= {REPEATS, 2 * REPEATS, MOST}
        assert table["runs"].tolist() == [len(one) for one in expected]
        middle = [sorted(one)[(len(one) - 1) // 2] for one in expected]
        np.testing.assert_allclose(opened.scores("distance"), middle, atol=1e-5)
        for row, score in zip(rows, middle, strict=True):
            assert opened.recording(row.id).x[1, 0] == pytest.approx(score)
        shares = opened.critical_run_rates()
        assert shares is not None
        met = [sum(run <= THRESHOLD for run in one) for one in expected]
        np.testing.assert_allclose(shares[:, 0], [a / len(b) for a, b in zip(met, expected, strict=True)])
        still_open = (shares[:, 1] <= 0.5) & (shares[:, 2] >= 0.5)
        assert all(simulator.ran[row.values["often"]] == MOST for row, one in zip(rows, still_open, strict=True) if one)
        lost = [row.values["often"] for row in opened.failed_rows()]
    # A scenario that always fails gets no extra runs.
    assert lost
    assert all(simulator.ran[one] == REPEATS for one in lost)


def test_what_is_open_in_a_round_is_run_again_in_one_batch(tmp_path):
    simulator = Wavering()
    explored(tmp_path / "s.db", about(budget=8), simulator)
    first, *later = simulator.batches
    assert [len(set(first)), len(first)] == [8, 8 * REPEATS]
    # They get three more batches, the last one up to the limit.
    assert [Counter(Counter(batch).values()).keys() for batch in later] == [{REPEATS}, {REPEATS}, {MOST - 3 * REPEATS}]
    assert set(later[0]) < set(first)
    for before, after in pairwise(simulator.batches):
        assert set(after) <= set(before)
        assert after == sorted(after, key=before.index)


def test_how_often_repeated_looks_mislead_is_as_the_documentation_says():
    def ends(probability):
        """Probability to end as uncritical and as critical, and mean number of runs, with 5 to 50 runs."""
        met, sides, mean = {0: 1.0}, [0.0, 0.0], 0.0
        for ran in range(5, 51, 5):
            mean += 5 * sum(met.values())
            more = dict.fromkeys(range(51), 0.0)
            for before, chance in met.items():
                for k in range(6):
                    more[before + k] += chance * binom.pmf(k, 5, probability)
            is_still_open = {
                k: is_criticality_undecided([0.0] * k + [1.0] * (ran - k), Criterion(0.5)) for k in more if k <= ran
            }
            for k, chance in more.items():
                if k <= ran and not is_still_open[k]:
                    sides[2 * k > ran] += chance
            met = {k: chance for k, chance in more.items() if is_still_open.get(k)}
        return *sides, mean

    assert sum(ends(0.5)[:2]) == pytest.approx(0.22, abs=0.005)
    assert [ends(one)[1] for one in (0.4, 0.3)] == pytest.approx([0.016, 0.003], abs=0.0005)
    assert [ends(one)[2] for one in (0.5, 0.3, 0.1)] == pytest.approx([43.8, 24.0, 8.4], abs=0.05)
    assert [
        all(is_criticality_undecided([0.0] * k + [1.0] * (n - k), Criterion(0.5)) for k in range(n + 1))
        for n in (4, MIN_DECISIVE_RUNS)
    ] == [
        True,
        False,
    ]


@pytest.mark.parametrize(("survives", "ended"), [(20, 1), (47, 3), (61, 3)])
def test_a_search_that_was_ended_in_between_goes_on_with_the_same_bytes(study, tmp_path, survives, ended):
    found = explored(tmp_path / "s.db", about(), Wavering(interrupts=survives))
    # Eight scenarios have 40 first runs; the open ones then wait for their last run.
    assert (found.interrupted, found.n_finished) == (True, ended)
    explored(tmp_path / "s.db", about(), Wavering())
    assert contents(tmp_path / "s.db") == contents(study[0])


def test_without_rounds_each_scenario_is_run_as_often(study, tmp_path):
    explored(tmp_path / "s.db", about(asynchronous=True), Wavering())
    with StudyFile.open(study[0]) as one, StudyFile.open(tmp_path / "s.db") as other:
        columns = ["often", "distance", "runs", "critical runs", "critical runs to"]
        tables = [each.table()[columns].sort_values("often").reset_index(drop=True) for each in (one, other)]
    assert tables[0].equals(tables[1])


def test_as_many_as_each_is_run_is_as_if_nothing_was_given(tmp_path):
    plain, same = about(max_repeats=None), about(max_repeats=REPEATS)
    assert plain == same
    explored(tmp_path / "s.db", same, Wavering())
    with StudyFile.open(tmp_path / "s.db") as opened:
        assert "most_repeats" not in opened.meta.to_json()
        assert "runs" not in opened.table()
    with pytest.raises(InputError, match="belongs to another largest number of repeats"):
        explored(tmp_path / "s.db", about(), Wavering())


def test_it_is_said_wherever_the_repeats_are(study, tmp_path):
    path, _ = study
    with StudyFile.open(path) as opened:
        assert opened.meta.most_repeats == MOST
        write_report(opened, tmp_path / "r.html")
        assert summarize(opened).meta.repeats_text == "5 to 17"
        opened.export(tmp_path / "csv")
    assert "Each was run 5 to 17 times" in (tmp_path / "r.html").read_text(encoding="utf-8")
    assert "max-repeats = 17\n" in format_toml_study_file(path)
    shown = CliRunner().invoke(app, ["show", str(path), "--json"])
    assert json.loads(shown.stdout)["metrics"]["distance"]["runs_of_each_at_most"] == MOST
    head = (tmp_path / "csv" / "scenarios.csv").read_text().splitlines()[0]
    assert ",critical_runs_to,runs," in head


def test_a_study_is_run_again_as_it_was(tmp_path):
    one = replace(
        paper_experiment_config("t-intersection", budget=2, seed=1), optimizer="sobol", repeats=2, max_repeats=5
    )
    path = tmp_path / "s.db"
    given: dict[str, Any] = {
        "ego": one.ego,
        "other": one.other,
        "metrics": one.metrics,
        "optimizer": "sobol",
        "seed": 1,
    }
    explore(one.logical, path, budget=2, repeats=2, max_repeats=5, critical=1.0, **given)
    with StudyFile.open(path) as opened:
        again = config_from_study(opened, path, one.logical.path, None, {})
        # With equal results, they are open after two and after four runs.
        assert opened.table()["runs"].tolist() == [5, 5]
    assert (again.repeats, again.max_repeats) == (2, 5)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"max_repeats": 3}, "`max_repeats` 3: is less than `repeats` 5"),
        ({"repeats": 1}, "`max_repeats` 17: .* set `repeats` to 2 or more"),
        ({"repeats": 3, "max_repeats": 4}, "`max_repeats` 4: fewer than 5 runs never show if a scenario is critical"),
        ({"critical": None}, "no default threshold; give one with `critical`"),
        ({"critical": None, "critical_if": "collision", "repeats": 1}, "leave `max_repeats` out"),
        ({"critical": None, "weights": {"distance": 1.0}}, "leave out `weights`"),
        ({"critical": None, "metrics": ("distance", "wttc"), "pareto": True}, "leave out `pareto`"),
    ],
)
def test_what_makes_no_sense_is_refused_before_there_is_a_study(tmp_path, given, words):
    one = paper_experiment_config("t-intersection")
    options: dict[str, Any] = {
        "ego": "Ego",
        "other": "C",
        "metrics": ("distance",),
        "optimizer": "evolutionary",
        "budget": 2,
    }
    options |= {"critical": THRESHOLD, "repeats": REPEATS, "max_repeats": MOST} | given
    with pytest.raises(InputError, match=words):
        explore(one.logical, tmp_path / "s.db", **options)
    assert not list(tmp_path.iterdir())


def test_the_command_names_its_options():
    scenario = paper_experiment_config("t-intersection").logical.path
    words = ["explore", scenario, "--space", scenario.with_suffix(".space.xosc"), "--ego", "Ego", "--other", "C"]
    words += ["--metric", "wttc", "--max-repeats", "9", "-o", "never.db"]
    ended = CliRunner().invoke(app, [str(one) for one in words])
    assert isinstance(ended.exception, InputError)
    assert "`max_repeats` 9" in str(ended.exception)
