"""The table: its columns, ticks, what can be taken along, and how it scrolls."""

from __future__ import annotations

import csv
import json
import shlex

import numpy as np
import pytest

from browser.studies import X
from browser.test_linked import table_of
from helpers.command_line import cornercase

TICKED = "() => [...cornercase.views.get('table').table.ticks.ids].sort((one, other) => one - other)"


def titles(page):
    return [text.rstrip(" ↑↓") for text in page.locator(".grid .head > *").all_inner_texts()]


def boxes(page):
    return page.locator(".grid .body .row .tick input")


def test_columns_are_chosen_and_kept_in_the_address(tab, reports):
    page = tab.open(reports("plain"))
    before = titles(page)
    assert before[:3] == ["", "id", "wttc [s]"]
    page.locator("#table-columns summary").click()
    for name in ("critical", "pedestrian_wait [s]"):
        page.get_by_label(name, exact=True).uncheck()
    tab.settle()
    left = [title for title in before if title not in ("critical", "pedestrian_wait [s]")]
    assert titles(page) == left
    page.wait_for_function("() => /hidden=.*pedestrian_wait/.test(location.hash)")
    page.reload()
    page.wait_for_selector("html[data-ready]")
    tab.settle()
    assert titles(page) == left
    page.locator("#table-columns summary").click()
    page.get_by_label("critical", exact=True).check()
    tab.settle()
    assert titles(page) == [title for title in before if title != "pedestrian_wait [s]"]


def test_each_row_shows_the_course_of_the_metric(tab, reports, studies):
    page = tab.open(reports("plain"))
    page.locator("#view-table").scroll_into_view_if_needed()
    tab.settle()
    rows = page.locator(".grid .body .row")
    assert page.locator(".grid .body canvas").count() == rows.count() < 60
    told = rows.first.locator("canvas").get_attribute("aria-label")
    assert told.startswith("wttc lowest at ")
    score = table_of(studies("plain"))["wttc"].iloc[0]
    assert float(told.rpartition(": ")[2].removesuffix(" s")) == pytest.approx(score, abs=0.35)
    blank = rows.first.locator("canvas").evaluate(
        "(one) => one.getContext('2d').getImageData(0, 0, one.width, one.height).data.every((each) => each === 0)"
    )
    assert not blank
    page.select_option("#metric", "trajectory-distance")
    tab.settle()
    assert rows.first.locator("canvas").get_attribute("aria-label").startswith("trajectory-distance lowest at ")


def test_rows_are_ticked_by_mouse(tab, reports):
    page = tab.open(reports("plain"))
    boxes(page).nth(1).click()
    boxes(page).nth(4).click(modifiers=["Shift"])
    boxes(page).nth(2).click()
    assert page.evaluate(TICKED) == [2, 4, 5]
    # A tick selects no scenario.
    assert page.evaluate("() => cornercase.store.selected") not in (2, 4, 5)
    assert boxes(page).nth(3).is_checked()
    assert page.locator("#ticked-count").inner_text() == "3 ticked"
    every = page.get_by_label("Tick all shown")
    assert every.evaluate("(one) => one.indeterminate")
    page.select_option("#filter-kept", "1")
    tab.settle()
    kept = page.evaluate("() => cornercase.store.shownCount")
    page.get_by_label("Tick all shown").check()
    ids = set(page.evaluate(TICKED))
    assert {2, 4, 5} < ids or len(ids) >= kept
    page.locator("#reset-filters").click()
    tab.settle()
    assert set(page.evaluate(TICKED)) == ids
    page.locator("#untick").click()
    assert page.evaluate(TICKED) == []
    assert page.locator("#ticked-count").inner_text() == "None ticked: all 60 shown"


def test_rows_are_ticked_by_keyboard(tab, reports):
    page = tab.open(reports("plain"))
    page.locator(".grid").focus()
    page.evaluate("() => cornercase.store.select(null)")
    page.keyboard.press("Home")
    page.keyboard.press("Space")
    assert "Scenario 1 is ticked, 1 in all" in page.locator("#told").inner_text()
    for _ in range(3):
        page.keyboard.press("ArrowDown")
    page.keyboard.press("Shift+Space")
    assert page.evaluate(TICKED) == [1, 2, 3, 4]
    page.keyboard.press("Enter")
    assert page.evaluate("() => cornercase.store.selected") == 4
    assert page.evaluate(TICKED) == [1, 2, 3, 4]


def test_what_is_ticked_is_saved_with_all_digits(tab, reports, studies, tmp_path):
    page = tab.open(reports("plain"))
    for k in (0, 3):
        boxes(page).nth(k).click()
    with page.expect_download() as download:
        page.click("#table-csv")
    download.value.save_as(tmp_path / "some.csv")
    with (tmp_path / "some.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["id"] for row in rows] == ["1", "4"]
    table = table_of(studies("plain"))
    for row in rows:
        one = table.loc[int(row["id"])]
        assert float(row["ego_start [m]"]) == one["ego_start"]
        assert float(row["wttc [s]"]) == pytest.approx(one["wttc"], rel=1e-5)
    page.locator("#untick").click()
    with page.expect_download() as download:
        page.click("#table-csv")
    download.value.save_as(tmp_path / "all.csv")
    with (tmp_path / "all.csv").open(encoding="utf-8", newline="") as file:
        assert len(list(csv.reader(file))) == 61


def test_the_command_writes_the_ticked_scenarios(tab, reports, studies, tmp_path, monkeypatch):
    page = tab.open(reports("plain"))
    assert page.locator("#files-command").is_hidden()
    for k in (1, 2, 3, 7):
        boxes(page).nth(k).click()
    command = page.locator("#files-command").text_content()
    assert command == "cornercase reduce study.db --ids 2-4,8 -o x_intersection-chosen"
    monkeypatch.chdir(X)
    words = shlex.split(command)
    words[2], words[-1] = str(studies("plain")), str(tmp_path / "chosen")
    done = cornercase(*words[1:])
    assert done.returncode == 0, done.stderr
    manifest = json.loads((tmp_path / "chosen" / "manifest.json").read_text(encoding="utf-8"))
    assert [one["id"] for one in manifest["scenarios"]] == [2, 3, 4, 8]


def test_without_a_scenario_file_there_is_no_command(tab, reports):
    page = tab.open(reports("plain"))
    page.evaluate("() => { cornercase.store.contents.rerun.has_scenario = false; }")
    boxes(page).nth(1).click()
    assert page.locator("#copy-files-command").is_disabled()
    assert "imported recordings have none" in page.locator("#view-table .note[role=status]").inner_text()


def test_the_wheel_scrolls_the_page_until_the_table_has_the_focus(tab, reports):
    page = tab.open(reports("plain"))
    grid = page.locator(".grid")
    grid.scroll_into_view_if_needed()
    page.evaluate("() => { scrollTo(0, scrollY - 200); }")

    def scrolled(delta):
        box = grid.bounding_box()
        page.mouse.move(box["x"] + 100.0, box["y"] + 60.0)
        before = page.evaluate("() => [scrollY, document.querySelector('.grid').scrollTop]")
        page.mouse.wheel(0.0, delta)
        page.wait_for_function(
            "(before) => scrollY !== before[0] || document.querySelector('.grid').scrollTop !== before[1]", arg=before
        )
        after = page.evaluate("() => [scrollY, document.querySelector('.grid').scrollTop]")
        return np.array(after) - before

    assert scrolled(60.0).tolist() == [60.0, 0.0]
    grid.evaluate("(one) => { one.scrollTop = 100; }")
    assert grid.evaluate("(one) => one.scrollTop") == 100
    grid.focus()
    page.evaluate("() => { scrollTo(0, scrollY - 60); }")
    moved = scrolled(60.0)
    assert moved[0] == 0.0
    assert moved[1] > 0.0
