"""Studies of recordings that were made elsewhere."""

from __future__ import annotations

import errno
import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cornercase import InputError
from cornercase.clustering import analyze
from cornercase.recordings import read_recording
from cornercase.study import ImportResult, StudyFile, import_recordings
from cornercase.study import _import_recordings as import_recordings_module
from helpers import foreign_recordings as foreign
from helpers.command_line import SPACE, X, cornercase
from helpers.two_cars import met

EXPLORED = ["--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc"]


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """A study of 40 scenarios, and its recordings as files with a table, as if they were another tool's."""
    folder = tmp_path_factory.mktemp("elsewhere")
    study = folder / "first.db"
    done = cornercase("explore", X, "--space", SPACE, *EXPLORED, "--optimizer", "sobol", "--budget", "40", "-o", study)
    assert done.returncode == 0, done.stderr
    runs = folder / "runs"
    runs.mkdir()
    with StudyFile.open(study, readonly=True) as opened:
        rows = opened.finished_rows()
        names = list(rows[0].values)
        lines = [",".join(["file", *names, "kind"])]
        for row in rows:
            opened.recording(row.id).to_csv(runs / f"run{row.id}.csv")
            kind = "early" if row.id % 2 else "late"
            lines.append(",".join([f"run{row.id}.csv", *(str(row.values[name]) for name in names), kind]))
    (runs / "parameters.csv").write_text("\n".join(lines) + "\n")
    return folder


@pytest.mark.slow
def test_clusters_and_reduces_what_others_ran(exported, tmp_path):
    study = tmp_path / "s.db"
    done = cornercase("import", exported / "runs", *EXPLORED, "-o", study)
    assert done.returncode == 0, done.stderr
    assert "40 scenarios" in done.stdout
    with StudyFile.open(study, readonly=True) as here, StudyFile.open(exported / "first.db", readonly=True) as there:
        np.testing.assert_allclose(here.scores("wttc"), there.scores("wttc"), atol=1e-5)
        assert here.space.names == (*there.space.names, "kind")
        assert here.space.parameters[-1].choices == ("early", "late")
        assert here.points().min() >= 0.0
        assert here.points().max() <= 1.0
    for command in (["analyze", study], ["reduce", study, "-o", tmp_path / "reduced"], ["show", study]):
        done = cornercase(*command)
        assert done.returncode == 0, done.stderr
    manifest = json.loads((tmp_path / "reduced" / "manifest.json").read_text())
    assert manifest["kept"] == 4
    assert all((exported / "runs" / one["file"]).is_file() for one in manifest["scenarios"])
    assert [path.name for path in (tmp_path / "reduced").iterdir()] == ["manifest.json"]
    done = cornercase("report", study, "-o", tmp_path / "r.html")
    assert done.returncode == 0, done.stderr


def test_a_broken_disk_fails_the_import_and_not_the_recording(exported, tmp_path, monkeypatch):
    study, reads = tmp_path / "s.db", 0

    def fails_once(file):
        nonlocal reads
        reads += 1
        # The first one is read before there is a study.
        if reads == 5:
            raise InputError(f"{file}: cannot be read.") from OSError(errno.EIO, "Input/output error")
        return read_recording(file)

    monkeypatch.setattr(import_recordings_module, "read_recording", fails_once)
    command = ("import", exported / "runs", *EXPLORED, "-o", study)
    assert cornercase(*command).returncode == 2
    with StudyFile.open(study, readonly=True) as opened:
        assert 0 < len(opened.finished_rows()) < 40
        assert not opened.failed_rows()
    assert cornercase(*command).returncode == 0
    with StudyFile.open(study, readonly=True) as opened:
        assert (len(opened.finished_rows()), len(opened.failed_rows())) == (40, 0)


def test_the_same_again_goes_on_and_something_else_is_refused(exported, tmp_path):
    study = tmp_path / "s.db"
    assert cornercase("import", exported / "runs", *EXPLORED, "-o", study).returncode == 0
    before = study.read_bytes()
    assert cornercase("import", exported / "runs", *EXPLORED, "-o", study).returncode == 0
    with StudyFile.open(study, readonly=True) as opened:
        assert len(opened.finished_rows()) == 40
    done = cornercase("import", exported / "runs", *EXPLORED[:-1], "ttc", "-o", study)
    assert done.returncode == 2
    assert "belongs to other metrics (wttc in the study, ttc given); name another study with -o" in done.stderr
    assert len(before) > 1000


def test_files_of_all_kinds_and_one_that_cannot_be_read(tmp_path):
    foreign.esmini(tmp_path / "a.csv")
    foreign.erg(tmp_path / "b.erg")
    foreign.fcd(tmp_path / "c.xml")
    (tmp_path / "d.erg").write_bytes((tmp_path / "b.erg").read_bytes()[:-5])
    (tmp_path / "d.erg.info").write_text((tmp_path / "b.erg.info").read_text())
    (tmp_path / "t.csv").write_text("file,v\na.csv,1\nb.erg,2\nc.xml,3\nd.erg,4\n")
    done = cornercase(
        "import", tmp_path, "--parameters", tmp_path / "t.csv", "--ego", "Ego", "--other", "Other", "--metric", "distance",
        "-o", tmp_path / "s.db",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    said = " ".join(done.stdout.split())
    assert said.startswith("1 scenarios in")
    assert "3 recordings could not be read or measured; the first:" in said
    assert "The recording has no entity 'Other'" in said
    with StudyFile.open(tmp_path / "s.db", readonly=True) as study:
        assert [row.state for row in study.rows()] == ["done", "failed", "failed", "failed"]
        errors = [str(row.error) for row in study.failed_rows()]
    assert "Other" in errors[0]
    assert "cut in the middle of record 41" in errors[2]


def test_the_function_says_what_it_made(exported, tmp_path):
    result = import_recordings(
        exported / "runs", tmp_path / "s.db", ego="Ego", other="Pedestrian", metrics=["wttc"], critical=0.7
    )
    assert result == ImportResult(tmp_path / "s.db", 40, 0)
    assert "40 recordings measured, in" in repr(result)
    assert "could not" not in repr(result)
    with StudyFile.open(tmp_path / "s.db", readonly=True) as study:
        assert study.meta.critical == 0.7


def test_the_result_says_what_failed_and_why(exported, tmp_path):
    (tmp_path / "runs").mkdir()
    for name in ("run1.csv", "run2.csv"):
        (tmp_path / "runs" / name).write_bytes((exported / "runs" / name).read_bytes())
    (tmp_path / "runs" / "odd.csv").write_text("nothing\n")
    (tmp_path / "runs" / "parameters.csv").write_text("file,v\nodd.csv,1\nrun1.csv,2\nrun2.csv,3\n")
    result = import_recordings(
        tmp_path / "runs", tmp_path / "s.db", ego="Ego", other="Pedestrian", metrics=["wttc"], critical=0.7
    )
    assert (result.done, result.failed) == (2, 1)
    assert "odd.csv" in result.reason
    assert f"1 could not be read or measured, the first: {result.reason}" in repr(result)


def test_a_name_that_no_recording_has_leaves_no_study_in_the_way(exported, tmp_path):
    study = tmp_path / "s.db"
    done = cornercase("import", exported / "runs", "--ego", "Nope", *EXPLORED[2:], "-o", study)
    assert done.returncode == 2
    said = " ".join(done.stderr.split())
    assert "None of the 40 recordings can be read and measured; the error of the first:" in said
    assert "has no entity 'Nope'" in said
    assert not study.exists()
    assert cornercase("import", exported / "runs", *EXPLORED, "-o", study).returncode == 0


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (None, "has no parameters.csv with the parameter values of each recording"),
        ("a,b\n1,2\n", "needs a header with 'file'"),
        ("file\na.csv\nb.csv\n", "needs a header"),
        ("file,v\na.csv,1\n", "at least 2"),
        ("file,v\na.csv,1\nz.csv,2\n", "line 3: there is no file"),
        ("file,v\na.csv,1\na.csv,2\n", "a second time"),
        ("file,v\na.csv,1\na.csv\n", "line 3: has an extra or an empty field"),
    ],
)
def test_tables_that_cannot_be_used(tmp_path, table, words):
    (tmp_path / "a.csv").write_text("x")
    if table is not None:
        (tmp_path / "parameters.csv").write_text(table)
    done = cornercase("import", tmp_path, "--ego", "Ego", "--other", "B", "--metric", "ttc", "-o", tmp_path / "s.db")
    assert done.returncode == 2
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "s.db").exists()


def test_recordings_may_lack_some_of_several_others(tmp_path):
    lines = ["file,gap"]
    for k, name in enumerate(("A", "B", "A", "B", "A")):
        drives, gap = np.arange(6) * 1.0, 20.0 - k
        pair = met((drives, 0.0, 0.0, 10.0), (drives + gap, 0.0, 0.0, 10.0))
        replace(pair, names=("Ego", name)).to_csv(tmp_path / f"{k}.csv")
        lines.append(f"{k}.csv,{gap}")
    (tmp_path / "parameters.csv").write_text("\n".join(lines) + "\n")
    given: dict[str, Any] = {"ego": "Ego", "metrics": ["clearance"]}
    with pytest.raises(InputError, match=r"`other` C: none of the recordings has an entity of this name"):
        import_recordings(tmp_path, tmp_path / "s.db", other=["A", "C"], **given)
    assert import_recordings(tmp_path, tmp_path / "s.db", other="*", **given).done == 5
    with StudyFile.open(tmp_path / "s.db", readonly=False) as study:
        assert study.meta.others == ("A", "B")
        assert list(study.score_sources("clearance").values()) == ["A", "B", "A", "B", "A"]
        np.testing.assert_allclose(study.scores("clearance"), [16.0, 15.0, 14.0, 13.0, 12.0])
        analyze(study)
        # The main other is the one that most scores are against.
        assert list(study.outcomes().values()) == [
            "A ahead",
            "A is never there",
            "A ahead",
            "A is never there",
            "A ahead",
        ]
