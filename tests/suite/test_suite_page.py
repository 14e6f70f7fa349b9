"""What the page of a suite's run answers: what to fix, what passed narrowly, and what was not tested."""

from __future__ import annotations

import re
import shutil
from html import unescape
from typing import cast

import pytest

import cornercase as cc
from cornercase.study import StudyFile
from cornercase.suite import Requirement
from cornercase.suite._judge import compute_margin


@pytest.fixture(scope="module")
def run(explored, tmp_path_factory):
    """The suite, run with a bound that some of its scenarios miss."""
    path = tmp_path_factory.mktemp("page") / "run.db"
    cc.run_suite(explored / "reduced", path, require=["ttc > 0.5", "no collision"])
    return path


def page_of(study, folder, **options):
    return cc.write_report(study, folder / "run.html", **options).read_text(encoding="utf-8")


def section_of(page, name):
    return unescape(re.sub(r"<[^>]*>", "", page.partition(f'<section id="{name}"')[2].partition("</section>")[0]))


def verdict_rows(page):
    table = page.partition('<section id="verdicts"')[2].partition("</section>")[0]
    head = re.findall(r"<th scope=col class=text>(.*?)</th>", table)
    return [
        dict(
            zip(
                head,
                (unescape(re.sub(r"<[^>]*>", "", cell)) for cell in re.findall(r"<td.*?>(.*?)</td>", row)),
                strict=True,
            )
        )
        for row in re.findall(r"<tr data-verdict=.*?>(.*?)</tr>", table)
    ]


def test_each_requirement_says_by_how_much_it_is_missed_or_met_worst_first(run, explored, tmp_path):
    rows = [row for row in verdict_rows(page_of(run, tmp_path)) if row["requirement"] == "ttc > 0.5"]
    assert rows
    with StudyFile.open(run) as study:
        for row in rows:
            recording = study.recording(int(row["scenario"]))
            margin = compute_margin(Requirement.parse("ttc > 0.5"), recording, "Ego", study.meta.others)
            assert margin is not None
            assert row["margin"] == f"{'missed' if margin < 0.0 else 'met'} by {abs(margin):.3g} s"
            assert row["verdict"] == ("failed" if margin < 0.0 else "passed")
    for state in ("failed", "passed"):
        sizes = [float(row["margin"].split()[2]) for row in rows if row["verdict"] == state]
        assert sizes == sorted(sizes, reverse=state == "failed")


def test_what_failed_comes_first_with_file_reason_and_command(run, tmp_path):
    page = page_of(run, tmp_path)
    failed = [row for row in verdict_rows(page) if row["verdict"] == "failed"]
    assert failed
    text = section_of(page, "verdicts")
    assert text.index("What to fix") < text.index(failed[0]["file"])
    first = failed[0]
    assert f"Scenario {first['scenario']} ({first['file']}): “{first['requirement']}” " in text
    assert f", as {first['why']}" in text
    assert f"cornercase replay run.db {first['scenario']} -o run-{first['scenario']}.html" in text
    assert "cornercase compare run.db study.db" in text
    assert f"<a href='#id={first['scenario']}'>Scenario {first['scenario']}</a>" in page


def test_critical_ones_that_passed_are_named_with_how_near_they_came(explored, tmp_path):
    run = tmp_path / "cautious.db"
    cc.run_suite(explored / "reduced", run, require=["ttc > 0"], drivers={"Ego": "cautious"})
    with StudyFile.open(run) as study:
        scores = study.scores(study.meta.metrics[0])
        ids = [row.id for row in study.finished_rows()]
    # With this threshold some that passed are critical.
    page = page_of(run, tmp_path, critical=float(sorted(scores)[-1]))
    rows = verdict_rows(page)
    passed = {int(row["scenario"]) for row in rows if row["verdict"] == "passed"}
    assert passed
    text = section_of(page, "verdicts")
    assert f"Passed, but critical: {len(passed)} of {len(passed)} that passed" in text
    order = [int(one) for one in re.findall(r"Scenario (\d+) \(", text.partition("Passed, but critical")[2])]
    score_of = dict(zip(ids, scores.tolist(), strict=True))
    assert order[:1] == [min(passed, key=lambda one: (score_of[one], one))]
    assert re.search(r"nearest [\d.]+ m from \w+ at [\d.]+ s", text)
    # Without any, that is said.
    text = section_of(page_of(run, tmp_path, critical=-1.0), "verdicts")
    assert "scenarios that passed is critical" in text


def test_what_the_suite_leaves_out_of_its_study_is_said(run, explored, tmp_path):
    text = section_of(page_of(run, tmp_path, against=explored / "study.db"), "not-tested")
    with StudyFile.open(explored / "study.db") as study, StudyFile.open(run) as ran:
        n_all, n_run = len(study.finished_rows()), len(ran.finished_rows())
        kinds = set(ran.meta.kinds)
    assert f"{n_all - n_run} of the {n_all} scenarios of study.db: " in text
    assert " critical there, " in text
    assert "none is left out" in text or "that no scenario of the suite is of" in text
    assert kinds


def test_a_kind_without_a_scenario_in_the_suite_is_named(explored, tmp_path):
    shutil.copy(explored / "study.db", tmp_path / "study.db")
    from cornercase.clustering import read_analyses
    from cornercase.report._suite_gaps import describe_suite_gaps

    with StudyFile.open(tmp_path / "study.db") as study:
        analysis = next(one for one in read_analyses(study).values() if len({*one.labels.tolist()} - {-1}) > 1)
        profile = next(one for one in analysis.profiles if one.cluster >= 0)
        sources = analysis.ids[analysis.labels == profile.cluster].tolist()
        others = [one.label for one in analysis.profiles if one.cluster >= 0 and one.label != profile.label]

        class OneKind:
            """A run of scenarios of one kind alone."""

            meta = type("Meta", (), {"kinds": (profile.label,) * len(sources)})

        text = "\n".join(describe_suite_gaps(cast(StudyFile, OneKind()), study, sources))
    assert all(f"“{label}” (" in text for label in others)
    assert f"“{profile.label}”" not in text


def test_without_its_study_the_page_says_that_what_is_left_out_is_not_known(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    alone = shutil.copy(run, tmp_path / "alone.db")
    assert "is not known here" in section_of(page_of(alone, tmp_path), "not-tested")
