"""Suites run again: from the command line to verdicts, comparison and JUnit."""

from __future__ import annotations

import html
import json
import re
import shutil
import sqlite3
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lxml import etree
from markdown_it import MarkdownIt
from typer.testing import CliRunner

import cornercase as cc
from conftest import at_night, moving, private, same_recording, scenario_file, speed_action, teleport
from cornercase.cli import app
from cornercase.exploration import examples_folder
from cornercase.scenario import ParameterSpace
from cornercase.study import StudyFile
from cornercase.suite import RecordingDifference, ScenarioResult, SuiteResult, Verdict
from cornercase.suite._baseline import find_changed_driver
from cornercase.suite._judge import judge_study
from cornercase.suite._junit import write_junit
from cornercase.suite._markdown import write_markdown_summary
from cornercase.suite._recording_difference import compare_recording_pair
from helpers.command_line import cornercase
from helpers.synthetic_study import about as described
from helpers.two_cars import met

SCHEMA = etree.XMLSchema(etree.parse(str(Path(__file__).parents[1] / "data" / "junit.xsd")))


def differences(result: SuiteResult) -> list[RecordingDifference]:
    """All of them; none may be missing."""
    found = [one.difference for one in result.scenarios if one.difference is not None]
    assert len(found) == len(result.scenarios)
    return found


def stored(path):
    """What a study holds of its scenarios, byte for byte."""
    with sqlite3.connect(path) as connection:
        tables = ("SELECT * FROM scenarios ORDER BY id", "SELECT * FROM courses ORDER BY scenario, metric")
        return [connection.execute(table).fetchall() for table in tables]


def test_the_suite_of_a_study_gives_its_recordings_byte_for_byte(explored, ran):
    assert len(ran.scenarios) == 6
    assert all(one.same and one.distance == 0.0 for one in differences(ran))
    with (
        StudyFile.open(explored / "study.db", readonly=True) as study,
        StudyFile.open(ran.study, readonly=True) as again,
    ):
        for one in ran.scenarios:
            assert same_recording(study.recording(one.origin), again.recording(one.id))
            assert study.scenario_scores(one.origin) == one.scores
        collide = {row.id for row in again.finished_rows() if again.recording(row.id).collisions}
        assert again.space == study.space
        assert {one.id: list(one.verdicts) for one in ran.scenarios} == judge_study(again)
    assert 0 < len(collide) < 6
    assert {one.id for one in ran.scenarios if one.state == "failed"} == collide
    assert "6 of 6 recordings are identical" in ran.comparison_summary


def test_the_command_fails_with_those_that_collide_and_passes_a_cautious_ego(reduced, ran, tmp_path):
    options = ("--require", "no collision", "--junit", tmp_path / "out.xml", "-o")
    daring = cornercase("test", reduced, "--driver", "Ego=aggressive", *options, tmp_path / "run.db")
    assert daring.returncode == 1, daring.stderr
    assert ran.summary in daring.stdout
    document = etree.parse(str(tmp_path / "out.xml"))
    SCHEMA.assertValid(document)
    failed = {case.get("name") for case in document.iter("testcase") if case.find("failure") is not None}
    assert failed == {Path(one.file).stem for one in ran.scenarios if one.state == "failed"}
    careful = CliRunner().invoke(
        app, [str(one) for one in ("test", reduced, "--driver", "Ego=cautious", *options, tmp_path / "c.db", "--json")]
    )
    assert careful.exit_code == 0, careful.output
    told = json.loads(careful.stdout)
    assert (told["passed"], told["failed"], told["errors"]) == (6, 0, 0)
    assert all(one["difference"]["distance"] > 0.1 for one in told["scenarios"])


def test_any_command_reads_the_run(ran):
    for command in ("show", "analyze"):
        result = CliRunner().invoke(app, [command, str(ran.study), *(["--by", "ttc"] if command == "analyze" else [])])
        assert result.exit_code == 0, result.output


def test_its_report_draws_the_road_and_names_the_command(explored, ran, tmp_path):
    page = cc.write_report(ran.study, tmp_path / "report.html").read_text(encoding="utf-8")
    assert "6 scenarios were run, of a suite" in page
    assert "cornercase test reduced --ego Ego --other C" in page
    assert "The road is not drawn" not in page


def test_its_report_tells_the_verdicts_of_each_scenario(explored, ran, tmp_path):
    page = cc.write_report(ran.study, tmp_path / "report.html").read_text(encoding="utf-8")
    failed = [one for one in ran.scenarios if one.state == "failed"]
    assert f"{6 - len(failed)} passed, {len(failed)} failed of 6 scenarios" in page
    for one in failed:
        assert f"{one.file} (scenario {one.id}): {one.reason}; required: no collision." in html.unescape(page)
    questions = re.findall("<h3>(.*?)</h3>", page.partition('<section id="verdicts"')[0])
    # Only if somebody analysed the run, as a test above does.
    assert [one for one in questions if one != "Which kinds are there?"] == [
        "Did it pass?", "Does it collide?", "What do I fix?", "What next?", "How sure is that?", "What could not be run?",
    ]  # fmt: skip
    cells = [
        re.findall("<td class=text.*?>(.*?)</td>", row) for row in re.findall("<tr data-verdict=.*?>(.*?)</tr>", page)
    ]
    for one in ran.scenarios:
        file = f"<a href='#id={one.id}'>{one.file}</a>"
        row = [html.unescape(cell) for cell in next(each for each in cells if file in each)]
        assert row[:4] == [one.state, file, one.reason, "no collision"]
        assert row[-2:] == [one.kind, str(one.id)]


def test_of_several_others_it_is_told_whom_each_score_is_against(ran, tmp_path):
    folder, junit = tmp_path / "files", tmp_path / "out.xml"
    folder.mkdir()
    for kind in ("xosc", "xodr"):
        shutil.copy(examples_folder() / "x_intersection" / f"x_intersection.{kind}", folder)
    result = cc.run_suite(folder, tmp_path / "run.db", ego="Ego", other="*", metrics=["wttc"], junit=junit)
    with StudyFile.open(result.study, readonly=True) as study:
        assert len(study.meta.others) > 1
        whom = study.score_sources("wttc")[1]
    assert whom is not None
    (one,) = result.scenarios
    assert one.others == result.to_json()["scenarios"][0]["others"] == {"wttc": whom}
    (named,) = etree.parse(str(junit)).iterfind(".//property[@name='score wttc against']")
    assert named.get("value") == whom
    assert not any(one.others for one in ran.scenarios)


def test_requirements_of_a_kind_are_those_of_its_scenarios(explored, ran, tmp_path):
    kind = next(one.kind for one in ran.scenarios if one.state == "failed")
    shutil.copy(ran.study, tmp_path / "run.db")
    found = cc.run_suite(
        explored / "reduced", tmp_path / "run.db", require=[f"for kind {json.dumps(kind)}: no collision"]
    )
    assert {len(one.verdicts) for one in found.scenarios} == {0, 1}
    assert {one.id for one in found.scenarios if one.verdicts} == {one.id for one in ran.scenarios if one.kind == kind}
    with StudyFile.open(tmp_path / "run.db", readonly=True) as study:
        assert {key: value for key, value in judge_study(study).items() if value} == {
            one.id: list(one.verdicts) for one in found.scenarios if one.verdicts
        }


def test_a_run_is_compared_with_the_study_that_was_reduced(explored, ran):
    found = cc.compare(explored / "study.db", ran.study)
    assert not found
    assert [one.ids for one in found.pairs] == sorted((one.origin, one.id) for one in ran.scenarios)
    assert found.count_pairs("the same") == 6


@pytest.mark.slow
def test_workers_change_nothing(explored, ran, tmp_path):
    cc.run_suite(explored / "reduced", tmp_path / "run.db", require=["no collision"], workers=2)
    assert stored(tmp_path / "run.db") == stored(ran.study)


KILLING = """
import os, signal, sqlite3
from pathlib import Path
from cornercase.drivers import SimpleDriver

class Killing(SimpleDriver):
    def acceleration(self, situation):
        # Drivers of all files are started before the study is there, so it dies when some of it is stored.
        if "KILL" in os.environ and Path("killed.db").exists():
            with sqlite3.connect("killed.db") as study:
                if study.execute("SELECT count(*) FROM scenarios WHERE state = 'done'").fetchone()[0] > 0:
                    os.kill(int(os.environ["KILL"]), signal.SIGKILL)
        return super().acceleration(situation)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_a_killed_run_goes_on_as_if_undisturbed(reduced, tmp_path, monkeypatch):
    (tmp_path / "killing.py").write_text(KILLING)
    monkeypatch.chdir(tmp_path)
    arguments = ["test", str(reduced), "--driver", "Ego=killing:Killing", "-o"]
    # The driver has a process of its own.
    program = "import os; from cornercase.cli import main; os.environ['KILL'] = str(os.getpid()); main()"
    killed = subprocess.run(
        [sys.executable, "-c", program, *arguments, "killed.db"], capture_output=True, timeout=120, check=False
    )
    assert killed.returncode == -9
    with StudyFile.open(tmp_path / "killed.db", readonly=True) as study:
        assert 0 < len(study.finished_rows()) < 6
    with pytest.raises(cc.InputError, match=r"killed\.db: \d of its 6 scenarios have not been run yet"):
        cc.compare(reduced.parent / "study.db", tmp_path / "killed.db")
    for name in ("killed.db", "whole.db"):
        assert CliRunner().invoke(app, [*arguments, name]).exit_code == 0
    assert stored(tmp_path / "killed.db") == stored(tmp_path / "whole.db")
    again = CliRunner().invoke(app, [*arguments, "whole.db"])
    assert "6 of them were already in whole.db and were not run again" in again.output


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_a_new_version_of_a_driver_is_not_judged_by_what_the_old_one_did(reduced, tmp_path):
    (tmp_path / "mine.py").write_text(KILLING.replace("Killing", "Mine"))
    command = ["test", reduced, "--driver", "Ego=mine:Mine", "-o", "run.db"]
    assert cornercase(*command, cwd=tmp_path).returncode == 0
    (tmp_path / "mine.py").write_text(KILLING.replace("Killing", "Mine") + "\n# mended")
    said = cornercase(*command, cwd=tmp_path)
    assert (
        said.returncode,
        "the file of the driver of Ego has changed since the study was made (mine:Mine" in said.stderr,
    ) == (2, True)


def test_what_has_run_is_judged_anew_by_other_requirements(explored, tmp_path):
    path = tmp_path / "run.db"
    cc.run_suite(explored / "reduced", path)
    before = stored(path)
    with StudyFile.open(path, readonly=True) as study:
        assert judge_study(study) == {}
        spent = study.elapsed_by_stage()["simulate"]
    result = cc.run_suite(explored / "reduced", path, require=["ego.speed <= 1 m/s", "for *-0000?.xosc: no collision"])
    assert all(one.verdicts[0].state == "failed" for one in result.scenarios)
    assert all(len(one.verdicts) == 1 + ((one.origin or 0) < 10) for one in result.scenarios)
    assert stored(path) == before
    with StudyFile.open(path, readonly=True) as study:
        assert study.elapsed_by_stage()["simulate"] == spent
        assert study.meta.requirements == result.requirements
    with pytest.raises(
        cc.InputError, match=r"other simulator settings \(driver of Ego: that of the scenario file in the study"
    ):
        cc.run_suite(explored / "reduced", path, drivers={"Ego": "cautious"})


def test_a_run_is_compared_with_an_earlier_run(explored, ran, tmp_path):
    result = cc.run_suite(explored / "reduced", tmp_path / "r.db", drivers={"Ego": "cautious"}, against=ran.study)
    assert result.against == ran.study
    assert not any(one.same for one in differences(result))


@pytest.mark.parametrize(
    ("before", "now", "differ"),
    [
        ({"driver": "my_drv:A", "sha256": "0" * 64}, {"driver": "my_drv:B", "sha256": "0" * 64}, True),
        ({"driver": "my_drv:A", "options": {"gain": 1}}, {"driver": "my_drv:A", "options": {"gain": 2}}, False),
        ({"driver": "my_drv:A", "options": {"gain": 1}}, "my_drv:A:gain=2", False),
        ("exec:./planner-1", "exec:./planner-2", False),
        ("normal", "cautious", True),
    ],
)
def test_two_classes_of_one_module_are_different_drivers(before, now, differ, tmp_path):
    space = ParameterSpace.from_ranges(["a=0:1"])
    metas = [described(space, "distance", settings={"drivers": {"Ego": driver}}) for driver in (before, now)]
    paths = [tmp_path / "before.db", tmp_path / "now.db"]
    for path, meta in zip(paths, metas, strict=True):
        StudyFile.create(path, meta).close()
    with StudyFile.open(paths[1]) as study:
        assert (find_changed_driver(paths[0], study) is not None) == differ


def test_a_folder_of_files_is_run_with_what_differs_as_parameters(reduced, ran, tmp_path):
    (reduced / "manifest.json").unlink()
    with pytest.raises(cc.InputError, match="does not say which entity this is; name an entity"):
        cc.run_suite(reduced, tmp_path / "run.db")
    about: dict[str, Any] = {"ego": "Ego", "other": "C", "metrics": ["ttc"], "on_collision": "stop"}
    result = cc.run_suite(reduced, tmp_path / "run.db", **about, against=ran.study)
    assert all(one.same for one in differences(result))
    by_file = {one.file: one.values for one in ran.scenarios}
    assert {one.file: one.values for one in result.scenarios} == by_file
    # Where nothing that the files declare differs, it is the file that does.
    plain = tmp_path / "plain"
    plain.mkdir()
    for name, speed in (("slow", "5"), ("fast", "20")):
        scenario_file(plain, init=moving(speed=speed) + moving(s="90", speed="0", entity="Van"), name=f"{name}.xosc",
                      entities=two("Van"))  # fmt: skip
    result = cc.run_suite(plain, tmp_path / "plain.db", ego="Ego", other="Van", duration=4.0, require=["no collision"])
    assert [(one.values, one.state) for one in result.scenarios] == [
        ({"file": "fast.xosc"}, "failed"),
        ({"file": "slow.xosc"}, "passed"),
    ]


def test_without_a_manifest_too_what_has_run_is_judged_anew(tmp_path):
    folder, path = tmp_path / "files", tmp_path / "run.db"
    folder.mkdir()
    scenario_file(folder, init=moving(speed="5") + moving(s="90", speed="0", entity="Van"), entities=two("Van"))
    about: dict[str, Any] = {"ego": "Ego", "other": "Van", "duration": 2.0}
    cc.run_suite(folder, path, require=["ttc > 0.1"], **about)
    result = cc.run_suite(folder, path, require=["no collision", "clearance > 1"], **about)
    assert [[one.state for one in scenario.verdicts] for scenario in result.scenarios] == [["passed", "passed"]]
    assert result.n_ran_before == 1


def two(name):
    from conftest import car

    return car("Ego") + car(name)


def test_a_scenario_that_cannot_be_run_is_an_error_and_the_others_count(tmp_path):
    folder = tmp_path / "files"
    folder.mkdir()
    for name, lane in (("good", "-1"), ("bad", "-7")):
        away = private("Ego", teleport("50", lane), speed_action("10"))
        scenario_file(folder, init=away + moving(s="200", entity="Van"), name=f"{name}.xosc", entities=two("Van"))
    about = ("test", folder, "--ego", "Ego", "--other", "Van", "--duration", "2", "--junit", tmp_path / "out.xml")
    ended = cornercase(*about, "--require", "no collision", "-o", tmp_path / "run.db")
    assert ended.returncode == 1, ended.stderr
    assert "1 passed, 1 not run of 2 scenarios" in ended.stdout
    document = etree.parse(str(tmp_path / "out.xml"))
    SCHEMA.assertValid(document)
    assert [case.get("name") for case in document.iter("testcase") if case.find("error") is not None] == ["bad"]
    (folder / "good.xosc").unlink()
    ended = cornercase(*about, "-o", tmp_path / "none.db")
    assert ended.returncode == 2
    assert "None of the 1 scenarios" in ended.stderr.splitlines()[-1]


def test_what_is_inconclusive_fails_only_where_that_is_asked_for(explored, tmp_path):
    arguments = ["test", str(explored / "reduced"), "--require", "reach 0,0 within 600", "-o", str(tmp_path / "r.db")]
    assert CliRunner().invoke(app, arguments).exit_code == 0
    assert CliRunner().invoke(app, [*arguments, "--strict"]).exit_code == 1


def test_every_state_is_valid_junit(tmp_path):
    states: Any = ("passed", "failed", "inconclusive", "error")
    scenarios = tuple(
        ScenarioResult(
            k, f"a-{k}\x01.xosc", state, {"v": 0.1, "text": "<&>"}, {"ttc": 1.5}, None if state == "error" else 2.0,
            (Verdict("inconclusive" if state == "error" else state, "ttc > 1 \ufffe", "why \x00 not"),), why="a < b",
        )
        for k, state in enumerate(states, start=1)
    )  # fmt: skip
    result = SuiteResult(tmp_path / "run.db", tmp_path, "builtin", ("ttc > 1",), scenarios)
    write_junit(result, tmp_path / "out.xml")
    document = etree.parse(str(tmp_path / "out.xml"))
    SCHEMA.assertValid(document)
    root = document.getroot()
    assert [root.get(name) for name in ("tests", "failures", "errors")] == ["4", "1", "1"]
    counts = [[each.get(name) for name in ("tests", "failures", "errors", "skipped")] for each in root]
    assert counts == [list("1000"), list("1100"), list("1001"), list("1010")]
    facts = {one.get("name"): one.get("value") for one in root[0].iter("property")}
    known = ("scenario", "parameter v", "parameter text", "score ttc", "why", "simulator", "requirement 1")
    assert [facts[name] for name in known] == ["1", "0.1", "<&>", "1.5", "a < b", "builtin", "ttc > 1"]
    assert not result.has_passed()
    assert not result
    passed = SuiteResult(tmp_path, tmp_path, "builtin", (), scenarios[::2])
    assert passed.has_passed()
    assert passed
    assert not SuiteResult(tmp_path, tmp_path, "builtin", (), scenarios[::2]).has_passed(strict=True)


def test_the_summary_is_one_table_whatever_names_there_are(tmp_path):
    signs = "a|b <i>*c*</i>\n_d_ `e` [f](g) # \\ | ~~h~~ &amp; @i $j$ ![k](l)\x1b"
    states: Any = [("failed", signs), ("error", "")]
    results = tuple(
        ScenarioResult(
            k, f"{k}{signs}.xosc", state, {}, {}, 1.0, (Verdict("failed", "ttc > 1", signs),), kind=kind,
            difference=RecordingDifference(k == 1, 0.25, 1.5, (1.0, 1.0), {}),
        )
        for k, (state, kind) in enumerate(states, start=1)
    )  # fmt: skip
    write_markdown_summary(
        SuiteResult(tmp_path / "run.db", tmp_path, "builtin", (), results, tmp_path / "old|1.db"), tmp_path / "s.md"
    )
    tokens = MarkdownIt().enable("table").parse((tmp_path / "s.md").read_text("utf-8"))
    assert [one.type for one in tokens].count("table_open") == 1
    texts = [one for one in tokens if one.type == "inline"]
    assert {child.type for one in texts for child in one.children or ()} <= {"text", "text_special"}
    read = ["".join(child.content for child in one.children or ()) for one in texts]
    plain = " ".join(signs.replace("\x1b", "\\x1b").split())
    assert read[0] == "1 failed, 1 not run of 2 scenarios"
    assert read[1:6] == ["scenario", "kind", "verdict", "why", "against old|1.db"]
    assert read[6:11] == [f"1{plain}.xosc", plain, "failed", plain, "the same"]
    assert read[11:16] == [
        f"2{plain}.xosc",
        "",
        "not run",
        plain,
        "the ego moves differently from 1.5 s on, by up to 0.25 m",
    ]


def test_a_difference_is_the_largest_distance_at_the_same_instants():
    x, still = np.arange(6) * 1.0, (np.full(6, 50.0), 0.0, 0.0, 0.0)
    before = met((x, 0.0, 0.0, 10.0), still)
    swerves = met((x, [0.0, 0.0, 0.0, 0.5, 2.0, 1.0], 0.0, 10.0), still)
    found = compare_recording_pair(before, swerves, "Ego")
    assert (found.same, found.distance) == (False, 2.0)
    assert found.time == pytest.approx(0.3)
    # Twice as many instants of the same motion: elsewhere nowhere, and yet not the same.
    finer = met((np.arange(11) * 0.5, 0.0, 0.0, 10.0), (np.full(11, 50.0), 0.0, 0.0, 0.0), step=0.05)
    found = compare_recording_pair(before, finer, "Ego")
    assert (found.same, found.time) == (False, None)
    assert found.distance == pytest.approx(0.0, abs=1e-12)


def test_long_names_leave_room_for_verdicts(reduced, tmp_path):
    (reduced / "manifest.json").unlink()
    for one in list(reduced.glob("*.xosc"))[2:]:
        one.unlink()
    for one in list(reduced.glob("*.xosc")):
        one.rename(one.with_name(f"{'a-name-' * 14}{one.name}"))
    given = ["--ego", "Ego", "--other", "C", "--metric", "ttc", "--require", "no collision"]
    # Into a pipe, so that the table has the 80 columns of one.
    said = cornercase("test", reduced, *given, "-o", tmp_path / "run.db").stdout
    assert "passed" in said or "failed" in said


@pytest.mark.parametrize(
    ("name", "content"),
    [
        (
            "r.toml",
            'require = ["no collision"]\n[for]\n"*-00001.xosc" = ["ttc > 0.1"]\n[kind]\n"Ego *" = ["pet > 1"]\n',
        ),
        ("r.yaml", 'require: [no collision]\nkind:\n  "Ego *": [pet > 1]\nfor:\n  "*-00001.xosc": ["ttc > 0.1"]\n'),
    ],
)
def test_requirements_come_from_files(name, content, tmp_path):
    from cornercase.suite._requirement_files import read_requirements

    if name.endswith("yaml"):
        pytest.importorskip("yaml")
    (tmp_path / name).write_text(content)
    found = ["no collision", "for *-00001.xosc: ttc > 0.1", 'for kind "Ego *": pet > 1']
    assert [one.text for one in read_requirements(tmp_path / name)] == found


@pytest.mark.parametrize("simulator", at_night(["esmini:undriven=true", "sumo"], {"esmini:undriven=true", "sumo"}))
def test_it_runs_on_other_simulators_and_says_where_they_differ(simulator, explored, tmp_path):
    from cornercase.simulators import list_simulators

    if missing := list_simulators()[simulator.partition(":")[0]].problem:
        pytest.skip(missing)
    result = cc.run_suite(explored / "reduced", tmp_path / "run.db", simulator=simulator)
    assert result.count_scenarios("passed") == 6
    # Both go by the storyboard until the ego is left to its driver, which esmini does not have.
    assert all((one.time or 0.0) > 1.0 and (one.distance or 0.0) > 0.1 for one in differences(result))


def test_a_collision_that_a_reference_prevents_fails_and_any_other_does_not(explored, tmp_path):
    path = tmp_path / "run.db"
    asked = ["no collision unless cautious collides", "no collision unless aggressive collides"]
    result = cc.run_suite(explored / "reduced", path, require=["no collision"])
    collide = {one.id for one in result.scenarios if one.state == "failed"}
    with sqlite3.connect(path) as connection:
        begun = connection.execute("SELECT * FROM scenarios").fetchall()
    result = cc.run_suite(explored / "reduced", path, require=[*asked, "no collision unless cc-human collides"])
    with sqlite3.connect(path) as connection:
        assert connection.execute("SELECT * FROM scenarios").fetchall() == begun
    for one in result.scenarios:
        by_cautious, by_aggressive, by_human = one.verdicts
        if one.id not in collide:
            assert [verdict.state for verdict in one.verdicts] == ["passed"] * 3
            assert "does not collide" in by_cautious.reason
            continue
        # The driver of the files is the aggressive one, which collides a second time as it did the first.
        assert (by_cautious.state, by_aggressive.state) == ("failed", "passed")
        assert by_cautious.reason.endswith("; cautious prevents it")
        assert (
            f"; aggressive does not prevent it either, and collides at {by_cautious.time:.6g} s" in by_aggressive.reason
        )
        # The regulation does not cover vehicles that turn into a road at a junction.
        assert (by_human.state == "inconclusive") == ("cc-human does not cover this scenario" in by_human.reason)
    told = cc.summarize(path).references["cautious"]
    assert (told.n_prevented, told.n_colliding, told.n_not_applicable) == (len(collide), 0, 0)
