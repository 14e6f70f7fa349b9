"""No command and no function writes over what it reads, or into what it may only read."""

from __future__ import annotations

import shutil

import pytest

import cornercase as cc
from cornercase.study import StudyFile
from helpers.command_line import X, cornercase
from helpers.synthetic_study import explorer, opened


@pytest.fixture
def scenario(tmp_path):
    shutil.copytree(X.parent, tmp_path / "x")
    return tmp_path / "x" / X.name


@pytest.mark.parametrize(
    ("command", "options"),
    [("simulate", ()), ("convert", ("--ego", "Ego")), ("vary", ("--all",))],
)
def test_a_scenario_is_not_written_over(command, options, scenario):
    before = scenario.read_bytes()
    result = cornercase(command, scenario, *options, "-o", scenario.parent / "." / scenario.name)
    assert result.returncode == 2
    assert "-o" in result.stderr
    assert "is the input file" in result.stderr
    assert scenario.read_bytes() == before


def test_a_recording_is_not_written_over(scenario, tmp_path):
    path = tmp_path / "r.csv"
    cc.simulate(scenario, duration=1.0).to_csv(path)
    before = path.read_bytes()
    result = cornercase("measure", path, "--ego", "Ego", "--other", "C", "--metric", "ttc", "-o", path)
    assert (result.returncode, path.read_bytes()) == (2, before)


def test_a_study_is_not_written_over_by_its_report(tmp_path):
    with opened(tmp_path / "s.db") as study:
        explorer(study, budget=4).run()
    with pytest.raises(cc.InputError, match="is the input file"):
        cc.write_report(tmp_path / "s.db", tmp_path / "s.db")
    for beside in ("s.db-wal", "s.db-shm", "s.db.lock"):
        with pytest.raises(cc.InputError, match="is a file that SQLite keeps beside the input"):
            cc.write_report(tmp_path / "s.db", tmp_path / beside)
    with StudyFile.open(tmp_path / "s.db", readonly=True) as study:
        assert len(study.rows()) == 4


def test_a_study_that_is_open_for_reading_is_not_analysed_or_reduced(tmp_path):
    with opened(tmp_path / "s.db") as study:
        explorer(study, metrics=("distance", "wttc"), budget=10).run()
    cc.analyze(tmp_path / "s.db")
    with StudyFile.open(tmp_path / "s.db", readonly=True) as study:
        for function, rest in ((cc.analyze, ()), (cc.reduce, (tmp_path / "reduced",))):
            with pytest.raises(cc.InputError, match="open for reading only"):
                function(study, *rest)
    assert not (tmp_path / "reduced").exists()


def test_clusters_that_are_kept_take_no_settings(tmp_path):
    with opened(tmp_path / "s.db") as study:
        explorer(study, metrics=("distance", "wttc"), budget=10).run()
    cc.analyze(tmp_path / "s.db", "distance")
    with pytest.raises(cc.InputError, match="`keep_clusters`"):
        cc.analyze(tmp_path / "s.db", "distance", gamma=4.0, keep_clusters=True)


def test_an_entity_is_not_measured_against_itself(scenario):
    recording = cc.simulate(scenario, duration=1.0)
    with pytest.raises(cc.InputError, match="`other` Ego: this is the ego itself"):
        cc.measure(recording, "Ego", "Ego", "wttc")
