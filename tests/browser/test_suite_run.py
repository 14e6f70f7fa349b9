"""The page of a suite's run: verdicts, and the expected run beside each."""

from __future__ import annotations

import warnings

import pytest

import cornercase as cc
from conftest import EXAMPLES

X = EXAMPLES / "x_intersection"
SHOWN = """() => Object.fromEntries(["selected", "beside"].map(
  (slot) => [slot, cornercase.replay.panel.panes[slot].title.textContent]))"""


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """Four scenarios of a slow ego, run with a normal one."""
    folder = tmp_path_factory.mktemp("suite")
    logical = cc.LogicalScenario.read(X / "x_intersection.xosc", X / "x_intersection.space.xosc")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        cc.explore(
            logical, folder / "study.db", ego="Ego", other="Pedestrian", metrics=["wttc"], optimizer="sobol", budget=24,
            drivers={"Ego": "cautious"},
        )  # fmt: skip
        cc.analyze(folder / "study.db", ["wttc"])
        cc.reduce(folder / "study.db", folder / "reduced", size=4)
        cc.run_suite(folder / "reduced", folder / "run.db", require=["no collision"], drivers={"Ego": "normal"})
    return cc.write_report(folder / "run.db", folder / "run.html").as_uri()


def test_the_expected_run_is_played_beside_each_run(tab, report):
    page = tab.open(report)
    rows = page.locator("#verdicts tr[data-verdict]")
    assert rows.count() == 4
    for k in range(2):
        rows.nth(k).locator("a").click()
        tab.settle()
        page.wait_for_function("() => cornercase.replay.panel.panes.beside.recording !== null")
        number = rows.nth(k).locator("td").last.inner_text()
        shown = page.evaluate(SHOWN)
        assert shown["selected"] == f"Scenario {number}"
        assert shown["beside"].startswith("Expected: scenario ")
        assert shown["beside"].endswith(" of study.db")
    assert "the expected run" in page.locator(".replay-legend").inner_text()
    assert page.locator(".pane-facts").nth(1).inner_text().startswith("Ego driven by cautious")
    assert page.locator(".pane-facts").nth(0).inner_text().startswith(rows.nth(1).locator("td").first.inner_text())
    page.locator("#expected").click()
    tab.settle()
    assert page.locator('[data-replay="beside"]').count() == 0
    # The neighbour takes the place of the expected run, and gives it back.
    page.locator("#expected").click()
    page.locator("#neighbour").click()
    tab.settle()
    assert page.evaluate(SHOWN)["beside"].startswith("Scenario ")
    page.locator("#neighbour").click()
    tab.settle()
    assert page.evaluate(SHOWN)["beside"].startswith("Expected: ")
