"""Scenarios that a user chose by their ids, as files that run on their own."""

from __future__ import annotations

import json

import pytest

import cornercase as cc
from conftest import EXAMPLES
from cornercase.study import StudyFile
from helpers.command_line import cornercase

X = EXAMPLES / "x_intersection" / "x_intersection.xosc"


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    path = tmp_path_factory.mktemp("chosen") / "study.db"
    ranges = ["ego_start=30:80", "pedestrian_wait=0:6"]
    cc.explore(X, path, ego="Ego", other="Pedestrian", metrics=["wttc"], ranges=ranges, optimizer="sobol", budget=12)
    return path


def test_chosen_scenarios_run_as_a_suite_to_the_same_recordings(study, tmp_path):
    before = study.read_bytes()
    done = cornercase("reduce", study, "--ids", "3,7-9,8", "-o", tmp_path / "chosen")
    assert done.returncode == 0, done.stderr
    assert "4 scenarios written" in done.stdout
    assert study.read_bytes() == before
    manifest = json.loads((tmp_path / "chosen" / "manifest.json").read_text(encoding="utf-8"))
    assert [(one["id"], one["role"]) for one in manifest["scenarios"]] == [(k, "chosen") for k in (3, 7, 8, 9)]
    ran = cornercase("test", tmp_path / "chosen", "-o", tmp_path / "run.db")
    assert ran.returncode == 0, ran.stderr
    with StudyFile.open(study, readonly=True) as old, StudyFile.open(tmp_path / "run.db", readonly=True) as new:
        for k, number in enumerate((3, 7, 8, 9)):
            np_old, np_new = old.recording(number), new.recording(k + 1)
            assert (np_old.x == np_new.x).all()


def test_a_folder_with_something_else_is_left_alone(study, tmp_path):
    (tmp_path / "x_intersection-00003.xosc").write_text("mine", encoding="utf-8")
    done = cornercase("reduce", study, "--ids", "3", "-o", tmp_path)
    assert done.returncode == 2
    assert "choose another folder" in done.stderr
    assert (tmp_path / "x_intersection-00003.xosc").read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--ids", "3,99"], "--ids 99: study.db has no such scenario; it has the ids 1 to 12"),
        (["--ids", "5-100"], "--ids 13, 14, 15, 16, 17 and 83 more"),
        (["--ids", "9-3"], "--ids 9-3: the range goes backwards; write it as 3-9"),
        (["--ids", "three"], "--ids three: give ids and ranges of ids, such as 3,17-20"),
        (["--ids", ""], "give ids and ranges of ids"),
        (["--ids", "0"], "give ids and ranges of ids"),
        (["--ids", "1-999999999999"], "names more than 100,000 scenarios"),
        (["--ids", "3", "--size", "2"], "--ids, --size: give only one of them"),
        (["--ids", "3", "--kill-mutants", "2"], "--ids, --kill-mutants: give only one of them"),
    ],
)
def test_what_cannot_be_written_is_told_in_a_sentence(study, tmp_path, words, told):
    done = cornercase("reduce", "study.db", *words, "-o", tmp_path / "chosen", cwd=study.parent)
    assert done.returncode == 2
    assert told in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "chosen").exists()


def test_a_run_of_a_suite_has_files_already(study, tmp_path):
    cornercase("reduce", study, "--ids", "3,4", "-o", tmp_path / "chosen")
    cornercase("test", tmp_path / "chosen", "-o", tmp_path / "run.db")
    done = cornercase("reduce", tmp_path / "run.db", "--ids", "1", "-o", tmp_path / "again")
    assert done.returncode == 2
    assert "is the run of a suite, whose scenarios are files already" in done.stderr
