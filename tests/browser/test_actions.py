"""What can be done with a scenario on the page: its command, its file, its recording, and notes."""

from __future__ import annotations

import csv
import json
import shlex

import pytest

from browser.studies import X
from conftest import at_night
from cornercase.recordings import read_recording
from cornercase.study import StudyFile
from helpers.command_line import cornercase

WORDS = "id => cornercase.actions.running.words(id)"
COMMAND = "id => cornercase.actions.running.command(id)"


def select(page, scenario):
    page.evaluate("id => cornercase.store.select(id)", scenario)


@pytest.mark.parametrize("name", at_night(["plain", "hostile", "together"], {"plain", "together"}))
def test_the_command_runs_the_scenario_to_the_last_bit(tab, studies, reports, name, tmp_path, monkeypatch):
    path = studies(name)
    page = tab.open(reports(name))
    with StudyFile.open(path, readonly=True) as study:
        ids = [row.id for row in study.finished_rows()][::25]
        folder = path.parent / "files" if name == "hostile" else X
        monkeypatch.chdir(folder)
        for scenario in ids:
            select(page, scenario)
            words = page.evaluate(WORDS, scenario)
            assert page.locator("#scenario-command").text_content() == page.evaluate(COMMAND, scenario)
            assert shlex.split(page.evaluate(COMMAND, scenario)) == words
            assert words[0] == "cornercase"
            done = cornercase(*words[1:-1], tmp_path / "run.csv")
            assert done.returncode == 0, done.stderr
            study.recording(scenario).to_csv(tmp_path / "study.csv")
            assert (tmp_path / "run.csv").read_bytes() == (tmp_path / "study.csv").read_bytes()


@pytest.mark.parametrize("name", at_night(["plain", "hostile", "together"], {"plain", "together"}))
def test_the_file_of_a_kept_scenario_is_the_one_that_reduce_wrote(tab, studies, reports, name, tmp_path):
    reduced = studies(name).parent / "reduced"
    page = tab.open(reports(name))
    kept = json.loads((reduced / "manifest.json").read_text(encoding="utf-8"))["scenarios"]
    assert kept
    for one in kept:
        written = (reduced / one["file"]).read_bytes().decode()
        assert page.evaluate("id => cornercase.actions.running.file(id)", one["id"]) == written
    select(page, kept[0]["id"])
    with page.expect_download() as download:
        page.click("#download-xosc")
    download.value.save_as(tmp_path / "saved.xosc")
    assert (tmp_path / "saved.xosc").read_bytes() == (reduced / kept[0]["file"]).read_bytes()


def test_numbers_are_written_as_python_writes_them(tab, reports):
    numbers = [0.1, 1e-5, 1.5e-7, 123456.789, 1e15, 1e16, 1.25e21, -0.0001, 3.0, -2.5, 1 / 3, 5e-324, 0.00012]
    page = tab.open(reports("one"))
    written = page.evaluate("all => all.map((one) => numberText(one))", numbers)
    assert written == [str(int(one)) if one.is_integer() and abs(one) < 1e15 else repr(one) for one in numbers]


def test_words_are_quoted_for_the_shell(tab, reports):
    words = ["a", "a b", "it's", "$HOME", "`id`", "-x=1", "a;b", '"', "", "*", "Fußgänger", "a\\b"]
    page = tab.open(reports("one"))
    line = page.evaluate("all => all.map((one) => shellWord(one, false)).join(' ')", words)
    assert shlex.split(line) == words


def test_the_recording_of_the_page_is_that_of_the_study_rounded(tab, studies, reports, tmp_path):
    page = tab.open(reports("hostile"))
    with StudyFile.open(studies("hostile"), readonly=True) as study:
        select(page, 3)
        with page.expect_download() as download:
            page.click("#download-csv")
        download.value.save_as(tmp_path / "page.csv")
        exact, found = study.recording(3), read_recording(tmp_path / "page.csv")
    assert found.names == exact.names
    assert found.object_types == exact.object_types
    assert abs(found.x - exact.x).max() <= 5.1e-4
    assert abs(found.heading - exact.heading).max() <= 5.1e-5
    assert [hit.entities for hit in found.collisions] == [hit.entities for hit in exact.collisions]
    with open(tmp_path / "page.csv", newline="", encoding="utf-8") as file:
        assert len(next(csv.reader(file))) == 12


def test_a_note_is_kept_by_the_browser_and_by_the_saved_page(tab, browser, reports, tmp_path):
    note = "brakes late </script><img src=x onerror=\"document.title='run'\"> 行人"
    page = tab.open(reports("plain"))
    select(page, 5)
    page.fill("#note", note)
    page.locator("#note").blur()
    page.reload()
    page.wait_for_selector("html[data-ready]")
    select(page, 5)
    assert page.input_value("#note") == note
    select(page, 6)
    assert page.input_value("#note") == ""
    with page.expect_download() as download:
        page.click("#save-page")
    download.value.save_as(tmp_path / "saved.html")
    # A browser that has never seen it.
    with browser.new_context() as context:
        other = context.new_page()
        other.goto((tmp_path / "saved.html").as_uri())
        other.wait_for_selector("html[data-ready]")
        select(other, 5)
        assert other.input_value("#note") == note
        assert other.title() == page.title()
        # What was saved once can be saved again, without the note.
        other.fill("#note", "")
        with other.expect_download() as download:
            other.click("#save-page")
        download.value.save_as(tmp_path / "again.html")
    with browser.new_context() as context:
        last = context.new_page()
        last.goto((tmp_path / "again.html").as_uri())
        last.wait_for_selector("html[data-ready]")
        assert last.evaluate("cornercase.store.notes.size") == 0


def test_where_no_command_can_run_it_the_page_says_why(tab, reports):
    page = tab.open(reports("pareto"))
    page.evaluate("cornercase.store.select(cornercase.store.contents.scenarios.id[0])")
    assert page.locator("#copy-command").is_disabled()
    assert page.locator("#download-xosc").is_disabled()
    assert "was not found" in page.locator("#scenario-actions").inner_text()
