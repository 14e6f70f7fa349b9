"""What the page of a suite's run shows: verdicts first, and the runs that the suite was made from beside these."""

from __future__ import annotations

import json
import re
import shutil

import pytest

import cornercase as cc
from cornercase._common.errors import InputError, SimulationError
from cornercase.reduction import read_reduction
from cornercase.reduction._write_files import write_chosen_scenarios
from cornercase.simulators import Builtin
from cornercase.study import StudyFile
from helpers.command_line import cornercase


def page_and_contents(study, folder, **options):
    page = cc.write_report(study, folder / "run.html", **options).read_text(encoding="utf-8")
    (text,) = re.findall(r'<script type="application/json" id="contents">(.*?)</script>', page, re.DOTALL)
    return page, json.loads(text)


def test_the_expected_run_is_on_the_page_of_a_run(explored, ran, tmp_path):
    page, contents = page_and_contents(ran.study, tmp_path)
    with StudyFile.open(explored / "study.db") as study:
        reduced = read_reduction(study)
    assert reduced is not None
    kept = reduced.ids
    runs = contents["expected"]["runs"]
    assert [runs[str(k)]["called"] for k in range(1, 7)] == [f"Expected: scenario {one} of study.db" for one in kept]
    assert all(run["facts"].startswith("Ego driven by aggressive") for run in runs.values())
    assert contents["recordings"][6:] == [-k for k in range(1, 7)] or set(contents["recordings"]) == {
        *range(1, 7),
        *(-k for k in range(1, 7)),
    }
    assert all(f'data-id="-{k}"' in page for k in range(1, 7))
    # The same numbers, as the driver is the same.
    texts = dict(re.findall(r'class="recordings" data-id="(-?\d+)">(.*?)<', page))
    assert all(texts[str(k)] == texts[str(-k)] for k in range(1, 7))
    assert page == page_and_contents(ran.study, tmp_path)[0]


def test_without_that_study_the_page_says_what_is_missing_and_how_to_get_it(explored, ran, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    alone = shutil.copy(ran.study, tmp_path / "run.db")
    _, contents = page_and_contents(alone, tmp_path)
    assert contents["expected"] == {
        "runs": {},
        "missing": "The expected runs are not shown beside these: the suite reduced was not found as it was run beside"
        " run.db. Name the study that the suite was made from: cornercase report run.db --against STUDY.db",
    }
    shutil.copytree(explored / "reduced", tmp_path / "reduced")
    _, contents = page_and_contents(alone, tmp_path)
    assert "study.db was not found unchanged and readable beside the manifest" in contents["expected"]["missing"]
    done = cornercase("report", alone, "--against", explored / "study.db", "-o", tmp_path / "r.html")
    assert done.returncode == 0, done.stderr
    assert "Expected: scenario" in (tmp_path / "r.html").read_text(encoding="utf-8")
    # An earlier run of the suite is as good.
    _, contents = page_and_contents(alone, tmp_path, against=ran.study)
    assert contents["expected"]["runs"]["2"]["called"] == "Expected: scenario 2 of run.db"
    with pytest.raises(InputError, match="is no run of a suite"):
        cc.write_report(explored / "study.db", tmp_path / "no.html", against=ran.study)


class NeverLate(Builtin):
    """The builtin simulator, which gives up scenarios whose pedestrian waits for long."""

    def run(self, concretes):
        for concrete, result in zip(concretes, super().run(concretes), strict=True):
            yield SimulationError("it broke") if concrete.values["pedestrian_wait"] > 6.0 else result


def test_scenarios_that_failed_in_their_study_have_a_report_without_expected_runs(x_intersection, tmp_path):
    cc.explore(
        x_intersection, tmp_path / "s.db", simulator=NeverLate(), ego="Ego", other="Pedestrian", metrics=["wttc"],
        optimizer="sobol", budget=8,
    )  # fmt: skip
    with StudyFile.open(tmp_path / "s.db", readonly=True) as study:
        failed = [row.id for row in study.failed_rows()]
        write_chosen_scenarios(study, tmp_path / "chosen", failed)
    cc.run_suite(tmp_path / "chosen", tmp_path / "run.db")
    page, contents = page_and_contents(tmp_path / "run.db", tmp_path)
    assert contents["expected"] == {
        "runs": {},
        "missing": "The expected runs are not shown beside these: none of these scenarios ran in s.db.",
    }
    assert f"{8 - len(failed)} of the {8 - len(failed)} scenarios of s.db" in page
    with pytest.raises(InputError, match="has no run of the scenarios of"):
        cc.write_report(tmp_path / "run.db", tmp_path / "no.html", against=tmp_path / "s.db")


def test_verdicts_come_first_and_lead_to_the_replay(ran, tmp_path):
    page, contents = page_and_contents(ran.study, tmp_path)
    assert page.index('id="verdicts"') < page.index('id="scenarios"')
    rows = re.findall(
        r"<tr data-verdict='(\w+)'><td class=text>\1</td><td class=text><a href='#id=(\d+)'>(.*?)</a>", page
    )
    states = [state for state, _, _ in rows]
    assert len(rows) == 6
    assert states == sorted(states, key=["failed", "inconclusive", "passed"].index)
    assert {(k, file) for _, k, file in rows} == {(str(one.id), one.file) for one in ran.scenarios}
    assert contents["verdicts"][rows[0][1]]["state"] == states[0]
    assert contents["verdicts"][rows[0][1]]["why"] in page


def test_with_another_driver_a_sentence_replaces_the_column(explored, tmp_path):
    run = ("test", explored / "reduced", "--require", "no collision")
    same = cornercase(*run, "-o", tmp_path / "same.db", "--summary", tmp_path / "same.md")
    assert "against study.db" in same.stdout.replace("\n", " ")
    assert "against study.db" in (tmp_path / "same.md").read_text()
    other = cornercase(
        *run, "--driver", "Ego=cautious", "-o", tmp_path / "other.db", "--summary", tmp_path / "other.md"
    )
    text = " ".join(other.stdout.split())
    for said in (text, (tmp_path / "other.md").read_text()):
        assert "moves differently" not in said
        assert "The ego was driven by aggressive in study.db and by cautious here, so runs differ" in said
