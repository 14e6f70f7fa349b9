"""An index of the studies in a folder: a row for each, and a sentence for each file that is none."""

from __future__ import annotations

import re
import shutil
import time

import pytest

from cornercase.report import write_report
from cornercase.study import StudyFile
from helpers.command_line import cornercase
from helpers.synthetic_study import SPACE, about, explorer


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A study with a threshold."""
    path = tmp_path_factory.mktemp("made") / "s.db"
    with StudyFile.create(path, about(SPACE, "distance", critical=1.0, optimizer="sobol", seed=7)) as study:
        explorer(study, metrics=("distance",), optimizer="sobol", budget=40).run()
    return path


def rows_of(page):
    text = page.read_text(encoding="utf-8")
    cells = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in re.findall(r"<tr>(.*?)</tr>", text)]
    return [row for row in cells if row]


def test_a_row_tells_what_the_study_and_its_report_tell(made, tmp_path):
    (tmp_path / "b").mkdir()
    shutil.copy(made, tmp_path / "a.db")
    shutil.copy(made, tmp_path / "b" / "s.db")
    write_report(tmp_path / "b" / "s.db", tmp_path / "b" / "its report.html")
    page = tmp_path / "index.html"
    told = cornercase("report", tmp_path, "-o", page)
    assert told.returncode == 0, told.stderr
    first, second = rows_of(page)
    with StudyFile.open(made) as study:
        done, critical = len(study.finished_rows()), int(study.critical_mask().sum())
        failed = len(study.failed_rows())
    for row, name in ((first, "a.db"), (second, "b/s.db")):
        assert row[0] == name
        assert row[4] == f"{done} ({failed} failed)"
        assert row[6] == str(critical)
    assert first[7] == first[10] == "–"
    assert re.fullmatch(r"[\d.]+ % \([\d.]+ % to [\d.]+ %\)", second[7])
    assert 'href="./b/its%20report.html"' in second[10]


def test_a_report_of_an_earlier_state_is_not_taken(made, tmp_path):
    path = tmp_path / "s.db"
    with StudyFile.create(path, about(SPACE, "distance", critical=1.0, optimizer="sobol", seed=7)) as study:
        explorer(study, metrics=("distance",), optimizer="sobol", budget=20).run()
    write_report(path, tmp_path / "r.html")
    shutil.copy(made, path)
    cornercase("report", tmp_path, "-o", tmp_path / "index.html")
    assert rows_of(tmp_path / "index.html")[0][10] == "–"


def test_broken_and_foreign_files_are_told_in_a_sentence(made, tmp_path):
    shutil.copy(made, tmp_path / "good.db")
    (tmp_path / "broken.db").write_bytes(made.read_bytes()[:30_000])
    (tmp_path / "foreign.db").write_text("no study", encoding="utf-8")
    told = cornercase("report", tmp_path, "-o", tmp_path / "index.html")
    assert told.returncode == 0
    text = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "One study; 2 files could not be read." in text
    assert re.search(r"<li>broken.db: .*</li>", text)
    assert re.search(r"<li>foreign.db: .*</li>", text)
    assert str(tmp_path) not in text


def test_an_index_of_forty_studies_is_quick(made, tmp_path):
    for k in range(40):
        shutil.copy(made, tmp_path / f"{k:02}.db")
    begin = time.process_time()
    cornercase("report", tmp_path, "-o", tmp_path / "index.html")
    assert time.process_time() - begin < 10.0
    assert len(rows_of(tmp_path / "index.html")) == 40


@pytest.mark.parametrize("option", ["--one-page", "--figures", "--critical=1"])
def test_options_of_one_study_are_refused(made, tmp_path, option):
    shutil.copy(made, tmp_path / "s.db")
    told = cornercase("report", tmp_path, option, "-o", tmp_path / "index.html")
    assert told.returncode == 2
    assert "is a folder" in told.stderr


def test_a_folder_without_studies_is_refused(tmp_path):
    told = cornercase("report", tmp_path, "-o", tmp_path / "index.html")
    assert told.returncode == 2
    assert "has no studies" in told.stderr


def test_a_run_of_a_suite_has_no_share_of_a_space(tmp_path):
    path = tmp_path / "run.db"
    meta = about(SPACE, "distance", critical=1.0, suite="0", files=tuple(f"{k}.xosc" for k in range(1, 41)))
    with StudyFile.create(path, meta) as study:
        explorer(study, metrics=("distance",), optimizer="sobol", budget=40).run()
    write_report(path, tmp_path / "run.html")
    cornercase("report", tmp_path, "-o", tmp_path / "index.html")
    (row,) = rows_of(tmp_path / "index.html")
    assert row[7] == "–"
    assert 'href="./run.html"' in row[10]
