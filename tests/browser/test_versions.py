"""The page of a comparison, as `cornercase compare -o` writes it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe  # type: ignore[import-untyped]

import cornercase as cc
from browser.studies import ENTITY, HOSTILE
from cornercase import SimulationError
from cornercase.recordings import Collision, Recording
from cornercase.report import write_comparison
from cornercase.scenario import ParameterSpace
from cornercase.study import StudyFile
from helpers.synthetic_study import about

POINTS = np.array([[0.1, 0.1], [0.9, 0.1], [0.5, 0.9], [0.2, 0.7]])


@pytest.fixture(scope="module")
def versions(tmp_path_factory):
    """Two versions with names that a page must not take for HTML: one collides in the new one, one fails there."""
    folder, found = tmp_path_factory.mktemp("versions"), []
    space = ParameterSpace.from_ranges(["a=0:1", "b=0:1"])
    meta = replace(about(space, "distance", critical=1.0, simulator="builtin"), other=ENTITY)
    one, still = np.full(2, 1.0), np.zeros((2, 5))
    for version in (0, 1):
        path = folder / f"{version} {HOSTILE}.db"
        with StudyFile.create(path, meta) as study:
            for k, row in enumerate(study.writer.add_pending(1, POINTS, space.values(POINTS))):
                if version and k == 1:
                    study.writer.record_failure(row.id, SimulationError(HOSTILE))
                    continue
                gap = 10.0 - 3.0 * k * version
                hit = (Collision(2.0, ("Ego", ENTITY)),) if version and k == 2 else ()
                recording = Recording(
                    time=np.arange(5.0), names=("Ego", ENTITY), object_types=("car", "car"),
                    x=np.stack([np.zeros(5), np.full(5, gap)]), y=still, heading=still, speed=still, acceleration=still,
                    length=one, width=one, center_x=0.0 * one, collisions=hit,
                )  # fmt: skip
                study.writer.record_result(row.id, recording, {"distance": (np.full(5, gap), gap)})
        found.append(path)
    return found


def page_of(versions, path) -> Path:
    old, new = versions
    return write_comparison(cc.compare(old, new), old, new, path)


def test_old_and_new_are_played_side_by_side(tab, versions, tmp_path):
    found = cc.compare(*versions)
    page = tab.open(page_of(versions, tmp_path / "page.html").as_uri())
    assert [one.pair.ids for one in found.examples] == [(2, 2), (3, 3), (4, 4)]
    titles = page.locator(".pane-title")
    assert page.title().startswith("cornercase: ")
    # The one that failed is told of beside the one that ran.
    assert titles.nth(0).inner_text() == f"Old: scenario 2 of {versions[0].name}"
    assert "failed, so there is nothing to replay" in page.locator(".pane-message").nth(1).inner_text()
    page.locator("#telling button").nth(1).click()
    tab.settle()
    assert page.locator("#telling button[aria-pressed=true]").count() == 1
    assert titles.nth(1).inner_text() == f"New: scenario 3 of {versions[1].name}"
    boxes = page.evaluate(
        "() => ['selected', 'beside'].map((slot) => boxesAt(cornercase.replay.panel.panes[slot].recording, 1)[1].x)"
    )
    assert boxes == pytest.approx([10.0, 4.0], abs=1e-3)
    # Scenarios that the verdict names are played where they are chosen there.
    assert page.locator("#answer h2").inner_text() == "Worse: nothing is better"
    assert page.locator("#answer .worse li").first.inner_text().startswith("1 new collision: 3")
    page.get_by_title("Play scenario 4").first.click()
    tab.settle()
    assert titles.nth(0).inner_text() == f"Old: scenario 4 of {versions[0].name}"
    page.get_by_title("Play scenario 3").first.click()
    tab.settle()
    # The neighbour's key would take the new version away.
    page.locator("[data-replay=selected] canvas").focus()
    page.keyboard.press("n")
    tab.settle()
    assert page.locator("[data-replay=beside]").count() == 1


def test_each_link_plays_both_versions_at_the_instant_of_their_difference(tab, versions, tmp_path):
    page = tab.open(page_of(versions, tmp_path / "page.html").as_uri())
    titles = page.locator(".pane-title")
    # Of a sentence at the top: the new version collides at 2 s.
    page.locator("#answer .changes a").first.click()
    tab.settle()
    assert [titles.nth(k).inner_text().split(" of ")[0] for k in range(2)] == ["Old: scenario 3", "New: scenario 3"]
    assert page.evaluate("() => cornercase.replay.clock.time") == pytest.approx(2.0)
    assert "Shown is 2 s, when the new version collides" in page.locator("#difference").inner_text()
    # Of a chart, and of a table.
    page.locator("circle[data-old]").last.dispatch_event("click")
    tab.settle()
    assert titles.nth(0).inner_text().startswith("Old: scenario ")
    page.locator("#scores-2 a.pair-link, .figures a.pair-link").first.click()
    tab.settle()
    chosen = page.locator(".figures a.pair-link").first.inner_text()
    assert titles.nth(1).inner_text() == f"New: scenario {chosen} of {versions[1].name}"
    # An address with a scenario opens that one.
    again = tab.open(page_of(versions, tmp_path / "page.html").as_uri() + "#pair=4,4")
    assert again.locator(".pane-title").nth(0).inner_text() == f"Old: scenario 4 of {versions[0].name}"


def test_it_fits_a_phone(tab, versions, tmp_path):
    tab.page.set_viewport_size({"width": 380, "height": 800})
    page = tab.open(page_of(versions, tmp_path / "page.html").as_uri())
    assert page.evaluate("() => document.documentElement.scrollWidth") <= 380


@pytest.mark.parametrize(
    ("scheme", "width"),
    [
        pytest.param("light", 1280, marks=pytest.mark.slow),
        pytest.param("dark", 1280, marks=pytest.mark.slow),
        ("light", 400),
    ],
)
def test_axe_finds_no_serious_violation(tab, versions, tmp_path, scheme, width):
    page = tab.open(page_of(versions, tmp_path / "page.html").as_uri())
    page.emulate_media(color_scheme=scheme)
    page.set_viewport_size({"width": width, "height": 900})
    found = Axe().run(page).response["violations"]
    told = [(one["id"], one["nodes"][0]["html"][:200]) for one in found if one["impact"] in ("serious", "critical")]
    assert told == []
