"""The index of a folder of studies is sorted by a click."""

from __future__ import annotations

import shutil

from helpers.command_line import cornercase


def test_a_click_sorts_the_studies(tab, studies, tmp_path):
    for k, name in enumerate(("plain", "four", "one")):
        shutil.copy(studies(name), tmp_path / f"{k}.db")
    assert cornercase("report", tmp_path, "-o", tmp_path / "index.html").returncode == 0
    page = tab.page
    page.goto((tmp_path / "index.html").as_uri())
    run = "() => [...document.querySelectorAll('tbody tr')].map((row) => Number(row.cells[4].textContent))"
    assert page.evaluate(run) == [60, 48, 1]
    head = page.get_by_role("button", name="run")
    head.click()
    assert page.evaluate(run) == [60, 48, 1]
    head.click()
    assert page.evaluate(run) == [1, 48, 60]
    assert page.locator("th[aria-sort=ascending]").inner_text().startswith("run")
    for width in (1600, 400):
        page.set_viewport_size({"width": width, "height": 900})
        assert page.evaluate("() => document.documentElement.scrollWidth <= innerWidth")
