"""The page of a suite's run: verdicts, and the expected run beside each."""

from __future__ import annotations

import warnings

import pytest
from axe_playwright_python.sync_playwright import Axe  # type: ignore[import-untyped]

import cornercase as cc
from conftest import EXAMPLES
from cornercase.study import StudyFile

X = EXAMPLES / "x_intersection"
SHOWN = """() => Object.fromEntries(["selected", "beside"].map(
  (slot) => [slot, cornercase.replay.panel.panes[slot].title.textContent]))"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Four scenarios of a slow ego."""
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
    return folder


@pytest.fixture(scope="module")
def report(folder):
    """The scenarios, run with a normal ego."""
    cc.run_suite(folder / "reduced", folder / "run.db", require=["no collision"], drivers={"Ego": "normal"})
    return cc.write_report(folder / "run.db", folder / "run.html").as_uri()


@pytest.fixture(scope="module")
def mixed(folder, report):
    """The same, of which some fail a bound and the others pass it."""
    with StudyFile.open(folder / "run.db") as study:
        scores = sorted(study.scores("wttc").tolist())
    bound = (scores[0] + scores[-1]) / 2.0
    cc.run_suite(folder / "reduced", folder / "mixed.db", require=[f"wttc > {bound:.6g}"], drivers={"Ego": "normal"})
    return cc.write_report(folder / "mixed.db", folder / "mixed.html").as_uri()


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
    # All passed, so no neighbour is offered that did not.
    assert page.locator("#neighbour").is_disabled()
    assert page.locator("#neighbour").inner_text() == "Neighbour: all passed"
    page.locator("#expected").click()
    page.locator("[data-replay=selected] canvas").focus()
    page.keyboard.press("n")
    tab.settle()
    assert page.evaluate(SHOWN)["beside"].startswith("Expected: ")


def test_the_neighbour_has_another_verdict_and_gives_the_expected_run_back(tab, mixed):
    page = tab.open(mixed)
    states = dict(page.locator("#verdicts tr[data-verdict]").evaluate_all(
        "(rows) => rows.map((row) => [row.lastElementChild.textContent, row.dataset.verdict])"
    ))  # fmt: skip
    assert set(states.values()) == {"passed", "failed"}
    page.locator("#verdicts tr[data-verdict=failed] a").first.click()
    tab.settle()
    page.locator("#neighbour").click()
    tab.settle()
    shown = page.evaluate(SHOWN)
    numbers = [shown[slot].removeprefix("Scenario ") for slot in ("selected", "beside")]
    assert [states[number] for number in numbers] == ["failed", "passed"]
    page.locator("#neighbour").click()
    tab.settle()
    assert page.evaluate(SHOWN)["beside"].startswith("Expected: ")


@pytest.mark.parametrize("width", [400, 1280])
def test_no_verdict_is_cut_off(tab, mixed, width):
    tab.page.set_viewport_size({"width": width, "height": 900})
    page = tab.open(mixed)
    assert page.evaluate("() => document.documentElement.scrollWidth") <= width
    assert page.locator("#verdicts td").evaluate_all(
        "(cells) => cells.filter((cell) => cell.textContent && cell.getBoundingClientRect().right > innerWidth).length"
    ) == 0  # fmt: skip
    # What failed is named above the table, and leads to its replay.
    link = page.locator("#verdicts .fixes a").first
    number = link.inner_text().removeprefix("Scenario ")
    link.click()
    tab.settle()
    assert page.evaluate(SHOWN)["selected"] == f"Scenario {number}"


@pytest.mark.parametrize(("scheme", "width"), [pytest.param("light", 1280, marks=pytest.mark.slow), ("dark", 400)])
def test_axe_finds_no_serious_violation(tab, mixed, scheme, width):
    page = tab.open(mixed)
    page.emulate_media(color_scheme=scheme)
    page.set_viewport_size({"width": width, "height": 900})
    found = Axe().run(page).response["violations"]
    told = [(one["id"], one["nodes"][0]["html"][:200]) for one in found if one["impact"] in ("serious", "critical")]
    assert told == []
