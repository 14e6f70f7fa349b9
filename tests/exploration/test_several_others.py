"""One scenario with three others, from the search to verdicts and the page."""

from __future__ import annotations

import sqlite3
from typing import Any

import numpy as np
import pytest

from conftest import car, moving, scenario_file
from cornercase import InputError, compare
from cornercase import run_suite as run_scenarios
from cornercase.clustering import analyze
from cornercase.exploration import explore
from cornercase.metrics import METRICS
from cornercase.metrics._measure import evaluate_metrics
from cornercase.reduction import reduce
from cornercase.report import summarize
from cornercase.report._report_data import read_report_data
from cornercase.report._report_payload import page_payload
from cornercase.report.text._summary_dict import summary_to_dict
from cornercase.study import StudyFile
from helpers.command_line import cornercase

METRICS_OF = ("clearance", "ttc", "traffic-quality")
NAMES = ("Ego", "Oncoming", "Slow", "Parked")


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    """Ego drives at constant speed towards a slower car and a parked one behind it; a third one is oncoming."""
    folder = tmp_path_factory.mktemp("several")
    starts = [moving("10", "$v"), moving("$from", "10", "Oncoming", "1")]
    starts += [moving("40", "8", "Slow"), moving("110", "0", "Parked")]
    declared = "".join(
        f'<ParameterDeclaration name="{name}" parameterType="double" value="{value}"/>'
        for name, value in (("v", 10), ("from", 60))
    )
    return scenario_file(folder, init="".join(starts), parameters=declared, entities="".join(map(car, NAMES)))


def explored(scenario, study, other, **options):
    ranges = ["v=8:20", "from=30:90"]
    given: dict[str, Any] = {"metrics": METRICS_OF, "optimizer": "sobol", "budget": 12, "duration": 6.0} | options
    return explore(scenario, study, ego="Ego", other=other, ranges=ranges, **given)


@pytest.fixture(scope="module")
def study(scenario, tmp_path_factory):
    path = tmp_path_factory.mktemp("studies") / "two.db"
    explored(scenario, path, ["Slow", "Oncoming"])
    return path


def touched(study, name):
    recordings = [study.recording(row.id) for row in study.finished_rows()]
    return [one.first_collision("Ego", name) is not None for one in recordings]


def test_a_study_holds_the_most_critical_and_whom_it_is_against(study):
    with StudyFile.open(study, readonly=True) as opened:
        assert opened.meta.other == opened.meta.others == ("Slow", "Oncoming")
        table, made = opened.table(), [METRICS.create(name) for name in METRICS_OF]
        for k, row in enumerate(opened.finished_rows()):
            recording = opened.recording(row.id)
            alone = [evaluate_metrics(made, recording, "Ego", name) for name in opened.meta.others]
            for metric in made:
                scores = [one[metric.name].score for one in alone]
                worst = (min if metric.lower_is_critical else max)(scores)
                assert opened.scores(metric.name)[k] == worst
                whom = opened.score_sources(metric.name)[row.id]
                assert (
                    whom
                    == table[f"other by {metric.name}"][row.id]
                    == opened.scenario_score_sources(row.id)[metric.name]
                )
                if whom is not None:
                    assert scores[opened.meta.others.index(whom)] == worst
        assert set(opened.score_sources("clearance").values()) == {"Slow", "Oncoming"}
        # The ego collides with none of them otherwise.
        assert None in opened.score_sources("traffic-quality").values()


def test_collisions_with_one_that_is_not_measured_against_are_told(study):
    with StudyFile.open(study, readonly=True) as opened:
        with_slow, with_parked = (sum(touched(opened, name)) for name in ("Slow", "Parked"))
        rows = opened.finished_rows()
        page = page_payload(read_report_data(opened))
        whom = {row.id: opened.scenario_score_sources(row.id) for row in rows}
    assert 0 < with_parked < with_slow
    summary = summarize(study)
    assert (summary.n_collisions, summary.unmeasured_collisions) == (with_slow, {"Parked": with_parked})
    words = summary_to_dict(summary)
    assert words["other"] == ["Slow", "Oncoming"]
    assert words["collisions_not_measured_against"] == {"Parked": with_parked}
    assert f"Ego touches Parked in {with_parked} of {len(rows)} scenarios" in words["note"]
    assert sum(words["metrics"]["clearance"]["scenarios_against"].values()) == len(rows)
    assert words["note"] in page["about"]
    assert "against Slow and Oncoming; the most critical counts" in page["about"]
    for scenario, places in zip(page["scenarios"]["id"], page["scenarios"]["against"], strict=True):
        found = [None if place is None else page["other"][place] for place in places]
        assert found == [whom[scenario][name] for name in METRICS_OF]


def test_all_others_are_resolved_to_their_names(scenario, tmp_path):
    explored(scenario, tmp_path / "all.db", "*", budget=2)
    with StudyFile.open(tmp_path / "all.db", readonly=True) as opened:
        assert opened.meta.others == NAMES[1:]
    # The same others, by star or by names, resume the study; different ones do not.
    assert explored(scenario, tmp_path / "all.db", list(NAMES[1:]), budget=3).n_finished == 3
    assert explored(scenario, tmp_path / "all.db", "*", budget=3).n_finished == 3
    with pytest.raises(InputError, match="metrics against another entity"):
        explored(scenario, tmp_path / "all.db", ["Slow", "Parked"], budget=3)


def test_a_study_of_one_other_is_as_it_was(scenario, tmp_path):
    for name, other in (("text.db", "Slow"), ("list.db", ["Slow", "Slow"])):
        explored(scenario, tmp_path / name, other, budget=2)
    dumps = []
    for name in ("text.db", "list.db"):
        connection = sqlite3.connect(tmp_path / name)
        dumps.append([line for line in connection.iterdump() if "elapsed" not in line])
        connection.close()
    assert dumps[0] == dumps[1]
    assert not any("against" in line for line in dumps[0])
    assert any("'other','\"Slow\"'" in line for line in dumps[0])


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (["Slow", "Slwo"], "has no entity 'Slwo' to be the other; did you mean 'Slow'"),
        (["Slow", "Ego"], "`other` Ego: this is the ego itself"),
        ([], "`other` is empty"),
    ],
)
def test_who_cannot_be_another_is_refused(scenario, tmp_path, other, words):
    with pytest.raises(InputError) as error:
        explored(scenario, tmp_path / "no.db", other)
    assert words in str(error.value)
    assert not (tmp_path / "no.db").exists()


def test_kinds_the_kept_ones_and_their_verdicts_go_on_with_several(study, scenario, tmp_path):
    with StudyFile.open(study, readonly=False) as opened:
        analyze(opened)
        outcomes = opened.outcomes()
        hits = [
            any("Ego" in one.entities for one in opened.recording(row.id).collisions) for row in opened.finished_rows()
        ]
        reduce(opened, tmp_path / "kept", scenario=scenario, size=4)
    assert [text.endswith(" collide") for text in outcomes.values()] == hits
    requirements = ["clearance > 0.5", "ego.speed < 30", "other.speed < 9"]
    found = run_scenarios(tmp_path / "kept", tmp_path / "run.db", require=requirements, against=study)
    with StudyFile.open(tmp_path / "run.db", readonly=True) as opened:
        assert opened.meta.others == ("Slow", "Oncoming")
        for one, row in zip(found.scenarios, opened.finished_rows(), strict=True):
            assert one.difference is not None
            assert one.difference.same
            near, own, fast = one.verdicts
            recording = opened.recording(row.id)
            gaps = {
                name: float(np.nanmin(METRICS.create("clearance").course(recording, "Ego", name)))
                for name in opened.meta.others
            }
            nearest = min(gaps, key=gaps.__getitem__)
            assert near.state == ("failed" if gaps[nearest] <= 0.5 else "passed")
            assert near.reason.startswith(f"against {nearest}: clearance ")
            assert own.reason.startswith("ego.speed is")
            assert (fast.state, fast.reason[:18]) == ("failed", "against Oncoming: ")


def test_versions_are_measured_against_the_same(study, scenario, tmp_path):
    explored(scenario, tmp_path / "order.db", ["Oncoming", "Slow"])
    assert not compare(study, tmp_path / "order.db")
    explored(scenario, tmp_path / "one.db", "Slow")
    with pytest.raises(InputError, match="compare studies of the same entities"):
        compare(study, tmp_path / "one.db")


def test_the_command_line_takes_several(study, tmp_path):
    assert cornercase("export", study, "-o", tmp_path / "tables").returncode == 0
    recording = sorted((tmp_path / "tables" / "recordings").iterdir())[0]
    given = ("--metric", "clearance", "-o", tmp_path / "courses.csv")
    found = cornercase("measure", recording, "--ego", "Ego", "--other", "Slow", "--other", "Oncoming", *given)
    assert found.returncode == 0, found.stderr
    assert "against" in found.stdout
    refused = cornercase("measure", recording, "--ego", "Ego", "--other", "Slow", "--other", "Ego", *given)
    assert (refused.returncode, refused.stderr) == (
        2,
        "cornercase: --other Ego: this is the ego itself; name the entity that the ego meets.\n",
    )
