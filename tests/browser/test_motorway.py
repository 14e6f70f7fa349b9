"""The replay of a cut-in: the two fill its box, and stay in it, as they drive along."""

from __future__ import annotations

import pytest

import cornercase as cc
from conftest import EXAMPLES

CUT_IN = EXAMPLES / "suite" / "scenario"


@pytest.fixture(scope="module")
def cut_in(tmp_path_factory):
    """The page of a few cut-ins, beside the road that they are on."""
    folder = tmp_path_factory.mktemp("motorway")
    logical = cc.LogicalScenario.read(CUT_IN / "cut_in.xosc", CUT_IN / "cut_in.space.xosc")
    path = folder / "study.db"
    cc.explore(
        logical, path, ego="Ego", other="Other", metrics=["ttc"], optimizer="sobol", budget=16, seed=1, critical=1.5
    )
    return cc.write_report(path, folder / "study.html", scenario=CUT_IN / "cut_in.xosc").as_uri()


def places(page):
    """The box's size, and where ego and other are in it, in pixels."""
    return page.evaluate(
        """() => {
          const pane = cornercase.replay.panel.panes.selected;
          const boxes = boxesAt(pane.recording, pane.timeOf(cornercase.replay.clock.time));
          const scale = pane.toPixels(1, 0).x - pane.toPixels(0, 0).x;
          return { ...pane.size(), scale, at: [pane.ego, pane.other].map((k) => pane.toPixels(boxes[k].x, boxes[k].y)) };
        }"""
    )


def test_a_cut_in_fills_its_box(tab, cut_in):
    page = tab.open(cut_in)
    page.wait_for_selector("#replay [data-replay=selected][data-time]")
    seen = places(page)
    # Two lanes of 3.5 m take at least a third of the height; a vehicle is longer than 30 pixels.
    assert 7.0 * seen["scale"] > seen["height"] / 3
    assert 4.5 * seen["scale"] > 30
    critical = page.evaluate("() => cornercase.replay.clock.time")
    for back in (0.0, 1.0, 2.0):
        page.evaluate("(time) => cornercase.replay.seek(time)", max(0.0, critical - back))
        tab.settle()
        for at in places(page)["at"]:
            assert 0 < at["x"] < seen["width"]
            assert 0 < at["y"] < seen["height"]


def test_the_view_stays_with_the_ego_until_it_is_let_go(tab, cut_in):
    page = tab.open(cut_in)
    page.wait_for_selector("#replay [data-replay=selected][data-time]")
    follow = page.locator("#follow")
    assert follow.get_attribute("aria-pressed") == "true"
    page.locator("#to-start").click()
    tab.settle()
    first = places(page)["at"][0]
    page.locator("#step").click()
    tab.settle()
    assert places(page)["at"][0] == pytest.approx(first, abs=0.1)
    page.locator("#zoom-in").click()
    tab.settle()
    assert follow.get_attribute("aria-pressed") == "true"
    follow.click()
    tab.settle()
    here = places(page)["at"][0]
    page.locator("#step").click()
    tab.settle()
    assert follow.get_attribute("aria-pressed") == "false"
    assert places(page)["at"][0]["x"] > here["x"] + 1.0
