"""Search by a condition: cut-ins in which a reference driver would have prevented a collision."""

from __future__ import annotations

import shutil
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import cornercase as cc
from cornercase._common.errors import InputError
from cornercase.cli import app
from cornercase.drivers.references.r157._preventability import assess_preventability
from cornercase.exploration._config import ExplorationConfig
from cornercase.exploration._explorer import ScenarioExplorer
from cornercase.metrics import METRICS
from cornercase.optimizers import OPTIMIZERS
from cornercase.recordings import Recording
from cornercase.report.text._summary_dict import summary_to_dict
from cornercase.scenario import LogicalScenario
from cornercase.simulators import Builtin
from cornercase.study import StudyFile
from helpers.checksums import reseal
from helpers.synthetic_study import LOGICAL, Synthetic

pytestmark = pytest.mark.filterwarnings("ignore:without effect")

CUT_IN = Path(__file__).parents[2] / "examples" / "r157" / "cut_in.xosc"
RANGES = ["ego_kmh=110:130", "other_kmh=20:60", "gap=20:70", "lateral_speed=0.4:1.5"]
CONDITION = "collision and not reference:cc-human"
NAME = f"critical-if:{CONDITION}"
ABOUT: dict[str, Any] = {
    "ego": "Ego", "other": "Other", "metrics": ["ttc"], "drivers": {"Ego": "cautious"}, "time_step": 0.1,
    "duration": 15.0, "optimizer": "sobol", "budget": 16, "batch": 8, "seed": 2,
}  # fmt: skip


def explored(path, **options):
    logical = LogicalScenario.read(CUT_IN, ranges=RANGES)
    return cc.explore(logical, path, **{"critical_if": CONDITION} | ABOUT | options)


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    path = tmp_path_factory.mktemp("critical") / "s.db"
    explored(path)
    return path


def stored(path):
    with sqlite3.connect(path) as connection:
        # The checksum of a row includes its round.
        scenarios = "id, round, point, parameters, state, error, recording"
        tables = (f"SELECT {scenarios} FROM scenarios ORDER BY id", "SELECT * FROM courses ORDER BY scenario, metric")
        return [connection.execute(table).fetchall() for table in tables]


def test_critical_is_what_collides_and_the_reference_prevents(study):
    logical = LogicalScenario.read(CUT_IN, ranges=RANGES)
    reference = Builtin(time_step=0.1, duration=15.0, drivers={"Ego": "cc-human"})
    with StudyFile.open(study, readonly=True) as opened:
        critical, rows = set(), opened.finished_rows()
        second = reference.run([logical.concrete_scenario(row.values) for row in rows])
        for row, again in zip(rows, list(second), strict=True):
            recording = opened.recording(row.id)
            assert isinstance(again, Recording)
            outcome = assess_preventability("cc-human", again, recording, "Ego", "Other")
            collides = bool(recording.collisions)
            assert opened.reference_outcome(row.id, "cc-human") == (outcome if collides else None)
            score = opened.scenario_scores(row.id)[NAME]
            if collides and not outcome.collides:
                critical.add(row.id)
                assert score == 0.0
            else:
                assert score == 100.0 if collides else score > 0.0
        assert opened.meta.critical == 0.0
        collided = sum(bool(opened.recording(row.id).collisions) for row in opened.finished_rows())
        assert 0 < len(critical) < collided < 16
        assert set(opened.reference_outcomes("cc-human")) > critical
    told = summary_to_dict(cc.summarize(study))
    assert told["critical"]["is"] == CONDITION
    assert told["critical"]["scenarios"] == len(critical)
    shown = told["references"]["cc-human"]
    assert shown == {"prevents": len(critical), "does_not_prevent": collided - len(critical), "says_nothing_of": 0}


@pytest.mark.slow
def test_what_follows_counts_critical_by_the_condition(study, tmp_path):
    path = tmp_path / "s.db"
    shutil.copy(study, path)
    cc.analyze(path, [NAME])
    cc.write_report(path, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    count = summary_to_dict(cc.summarize(path))["critical"]["scenarios"]
    assert f"{count} of the 16 scenarios that were run" in page
    assert "with cc-human at the wheel" in page
    assert f"--critical-if &#x27;{CONDITION}&#x27;" in page or f"--critical-if '{CONDITION}'" in page
    cc.reduce(path, tmp_path / "reduced", size=6, scenario=CUT_IN)
    result = cc.run_suite(
        tmp_path / "reduced", tmp_path / "run.db", drivers={"Ego": "cautious"}, require=["no collision"]
    )
    assert set(result.scenarios[0].scores) == {"ttc"}
    with pytest.raises(InputError, match=r"s\.db: its condition, .*, needs runs of reference drivers"):
        cc.estimate(path, tmp_path / "estimate.db", scenario=CUT_IN, drivers={"Ego": "cautious"})


@pytest.fixture(scope="module")
def by_collisions(tmp_path_factory):
    path = tmp_path_factory.mktemp("collisions") / "s.db"
    explored(path, critical_if="collision")
    return path


@pytest.mark.slow
def test_a_condition_without_references_can_be_estimated(by_collisions, tmp_path):
    estimation = cc.estimate(by_collisions, tmp_path / "estimate.db", scenario=CUT_IN, budget=100)
    assert estimation.critical.met > 0
    assert estimation.critical == estimation.collision


def test_who_estimates_a_condition_gives_no_threshold(by_collisions, tmp_path):
    with pytest.raises(
        InputError, match=r"s\.db: its condition, collision, says what is critical; leave `critical` out"
    ):
        cc.estimate(by_collisions, tmp_path / "other.db", critical=0.5, scenario=CUT_IN)


@pytest.mark.slow
def test_a_killed_search_goes_on_with_the_same_bytes(study, tmp_path):
    path = tmp_path / "killed.db"
    shutil.copy(study, path)
    with sqlite3.connect(path) as connection:
        lost = "(4, 8, 14, 15, 16)"
        connection.execute(f"DELETE FROM courses WHERE scenario IN {lost}")
        connection.execute(f"UPDATE scenarios SET state = 'pending', recording = NULL WHERE id IN {lost}")
    reseal(path)
    assert stored(path) != stored(study)
    explored(path)
    assert stored(path) == stored(study)


@pytest.mark.slow
def test_workers_decide_the_same(study, tmp_path):
    explored(tmp_path / "workers.db", workers=2)
    assert stored(tmp_path / "workers.db") == stored(study)


def test_a_study_belongs_to_its_condition(study):
    for options in ({"critical_if": "collision"}, {"critical_if": None}):
        with pytest.raises(InputError, match="another condition of what is critical"):
            explored(study, **options)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"critical": 1.0}, "leave `critical` out"),
        ({"weights": {"ttc": 1.0}}, "leave `weights` out"),
        ({"metrics": ["ttc", "drac"], "pareto": True}, "leave `pareto` out"),
        ({"repeats": 3}, "leave `repeats` out"),
        ({"critical_if": "collision and not reference:cc-humn"}, "reference:cc-humn: There is no driver"),
        ({"critical_if": "colision"}, "did you mean 'collision'"),
        ({"metrics": ["critical-if:collision"], "critical_if": None}, "`critical_if`"),
        ({"critical_if": "stl:always(ttc<1) > 0"}, "write the formula itself, in brackets"),
    ],
)
def test_what_cannot_be_is_refused_before_there_is_a_study(tmp_path, options, words):
    with pytest.raises(InputError) as refused:
        explored(tmp_path / "s.db", **options)
    assert words in str(refused.value)
    assert not (tmp_path / "s.db").exists()


def test_the_command_takes_a_condition_and_names_what_is_misspelt(tmp_path):
    about = ["explore", CUT_IN, *(word for one in RANGES for word in ("--range", one)), "--ego", "Ego"]
    about += ["--other", "Other", "--metric", "ttc", "--driver", "Ego=cautious", "--duration", "2", "--budget", "4"]

    def ended(condition):
        words = [*about, "--critical-if", condition, "-o", tmp_path / "s.db"]
        return CliRunner().invoke(app, [str(one) for one in words])

    assert "did you mean 'cautious'" in str(ended("collision and reference:cautios").exception)
    assert ended("collision and not reference:fsm").exit_code == 0
    with StudyFile.open(tmp_path / "s.db", readonly=True) as opened:
        assert opened.meta.metrics[0] == "critical-if:collision and not reference:fsm"


@pytest.mark.slow
def test_without_rounds_the_same_is_decided(study, tmp_path):
    explored(tmp_path / "s.db", asynchronous=True)
    (scenarios, courses), (others, their) = stored(study), stored(tmp_path / "s.db")
    assert courses == their
    # Everything except the number of the round.
    assert [row[:1] + row[2:] for row in scenarios] == [row[:1] + row[2:] for row in others]


class Failing(Synthetic):
    """A simulator in which nothing can be run a second time."""

    def run(self, concretes):
        yield from (cc.SimulationError("out of order") for _ in concretes)


def test_where_the_second_run_fails_the_scenario_does(tmp_path):
    about = ExplorationConfig(
        LOGICAL, ego="Ego", other="B", metrics=("distance",), critical_if="reference:cautious", budget=4, batch=4
    )
    objective = about.make_objective()
    path = tmp_path / "s.db"
    with StudyFile.create(path, about.make_study_meta(objective, {})) as opened:
        optimizer = OPTIMIZERS.create("sobol").start(LOGICAL.space, 0)
        with pytest.raises(InputError, match="add a simulator in which cautious drives the ego"):
            ScenarioExplorer(about, Synthetic(), optimizer, opened, objective)
        references = {"cautious": Failing()}
        ScenarioExplorer(about, Synthetic(), optimizer, opened, objective, references).run()
        assert not opened.finished_rows()
        assert "run again with reference:cautious: out of order" in {row.error for row in opened.failed_rows()}


def test_metrics_of_a_condition_are_not_searched_by_their_own_thresholds(study):
    with StudyFile.open(study, readonly=True) as opened:
        assert opened.meta.metrics == (NAME, "ttc")
        ttc = METRICS.create("ttc")
        own = (ttc.to_minimize(opened.scores("ttc")) <= ttc.to_minimize(1.5)).sum()
        assert own != (opened.scores(NAME) <= 0.0).sum()
        assert np.isfinite(opened.course(1, NAME)).all()
