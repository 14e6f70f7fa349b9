"""The page of a study of several others: whom each score is against."""

from __future__ import annotations

import numpy as np
import pytest

import cornercase as cc
from cornercase.metrics import METRICS
from cornercase.metrics._measure import evaluate_metrics
from cornercase.recordings import Recording
from cornercase.scenario import ParameterSpace
from cornercase.study import StudyFile
from helpers.synthetic_study import about

# Where the ego looks: the name of the one that counts, and the looks of all entities.
LOOK = """() => {
  const pane = cornercase.replay.panel.panes.selected;
  const roles = [...document.querySelectorAll('th[data-role]')].map((one) => [one.textContent, one.dataset.role]);
  return [pane.recording.names[pane.other], Object.fromEntries(roles)];
}"""


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """A stands 4 m from the ego, B nearer or farther, C is not measured against."""
    folder = tmp_path_factory.mktemp("several")
    space = ParameterSpace.from_ranges(["b=0:10"])
    meta = about(space, "distance", "clearance", other=("A", "B"), simulator="builtin")
    points, still, one = np.array([[0.3], [0.7]]), np.zeros((4, 5)), np.full(4, 0.1)
    with StudyFile.create(folder / "study.db", meta) as study:
        for row in study.writer.add_pending(1, points, space.values(points)):
            places = np.array([0.0, 4.0, -float(row.values["b"]), 1.0])
            recording = Recording(
                time=np.arange(5.0), names=("Ego", "A", "B", "C"), object_types=("car",) * 4,
                x=np.tile(places[:, None], 5), y=still, heading=still, speed=still, acceleration=still,
                length=one, width=one, center_x=0.0 * one,
            )  # fmt: skip
            metrics = [METRICS.create(name) for name in meta.metrics]
            study.writer.record_result(row.id, recording, evaluate_metrics(metrics, recording, "Ego", meta.others))
    return cc.write_report(folder / "study.db", folder / "report.html").as_uri()


def test_the_page_says_whom_scores_are_against(tab, report):
    page = tab.open(report)
    assert "Under test: Ego, against A and B" in page.locator("#about").inner_text()
    titles = page.locator(".grid .head > *").all_inner_texts()
    column = next(k for k, title in enumerate(titles) if title.startswith("other by clearance"))
    rows = page.locator(".grid .body .row")
    cells = {}
    for k in range(rows.count()):
        texts = rows.nth(k).locator(":scope > *").all_inner_texts()
        cells[texts[1]] = texts[column]
    assert cells == {"1": "B", "2": "A"}
    for row, whom in ((0, "B"), (1, "A")):
        rows.nth(row).click()
        tab.settle()
        name, roles = page.evaluate(LOOK)
        assert name == whom
        assert roles == {"Ego": "ego", "A": "other", "B": "other", "C": "third"}


def test_a_press_while_the_rows_get_other_marks_is_a_click(tab, report):
    page = tab.open(report)
    rows = page.locator(".grid .body .row")
    for k in (1, 0):
        rows.nth(k).scroll_into_view_if_needed()
        box = rows.nth(k).bounding_box()
        page.mouse.move(box["x"] + 30.0, box["y"] + 10.0)
        page.mouse.down()
        page.evaluate("() => cornercase.store.hover(null)")
        tab.settle()
        page.mouse.up()
        tab.settle()
        assert rows.nth(k).get_attribute("aria-selected") == "true"
