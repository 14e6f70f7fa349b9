"""Events and courses below the replay."""

from __future__ import annotations

import json

import numpy as np
import pytest

import cornercase as cc
from cornercase._common.geometry.boxes import box_corners, box_distance
from cornercase.study import StudyFile

CLOCK = "() => cornercase.replay.clock.time"
# Where the chart draws a time, in pixels of the window; the first line of events is at the top.
PLACE = """(time) => {
  const { canvas } = cornercase.replay.panel.chart;
  const { left, top } = canvas.getBoundingClientRect();
  return [left + cornercase.replay.panel.chart.across(time), top + COURSE_EDGES.top + EVENTS_HEIGHT / 2];
}"""
GAPS = """() => {
  const { recording, ego, other } = cornercase.replay.panel.panes.selected;
  return Array.from(gapsOf(recording, ego, other));
}"""
PANELS = "() => cornercase.replay.panel.chart.panels.map((one) => [one.title, one.courses.map((each) => each.slot)])"


def a_collision(study):
    with StudyFile.open(study, readonly=True) as opened:
        return next(scenario for scenario, hits in opened.impacts().items() if hits)


@pytest.fixture
def played(tab, studies, tmp_path):
    scenario = a_collision(studies("plain"))
    page = tab.open(cc.replay(studies("plain"), scenario, tmp_path / "run.html", beside=1).as_uri())
    events = json.loads(page.locator("#contents").text_content())["events"]
    return page, events[str(scenario)], events["1"], scenario


def test_a_click_on_an_event_moves_the_clock_there(tab, played):
    page, events, _, _ = played
    for name in ("sees", "brakes", "contact"):
        page.locator(f"[data-slot=selected] [data-event={name}]").click()
        tab.settle()
        assert page.evaluate(CLOCK) == pytest.approx(events[name])
        assert not page.evaluate("() => cornercase.replay.clock.playing")


def test_a_click_on_a_mark_above_the_courses_goes_to_its_event(tab, played):
    page, events, _, _ = played
    page.locator("canvas.course").scroll_into_view_if_needed()
    x, y = page.evaluate(PLACE, events["brakes"])
    page.mouse.click(x + 2, y)
    tab.settle()
    assert page.evaluate(CLOCK) == pytest.approx(events["brakes"])
    # Beside all marks it is the time under the mouse.
    middle = 0.5 * events["sees"]
    x, y = page.evaluate(PLACE, middle)
    page.mouse.click(x, y + 60)
    tab.settle()
    assert page.evaluate(CLOCK) == pytest.approx(middle, abs=0.05)


def test_each_scenario_has_its_events_and_all_have_the_same_courses(played):
    page, events, other_events, scenario = played
    lines = page.locator(".events-line")
    assert lines.evaluate_all("(all) => all.map((one) => one.dataset.slot)") == ["selected", "beside"]
    assert f"scenario {scenario}" in lines.first.text_content()
    assert "contact with Pedestrian" in lines.first.text_content()
    assert "at fault" in lines.first.text_content()
    assert ("contact" in other_events) == ("contact" in lines.last.text_content())
    panels = page.evaluate(PANELS)
    assert [title for title, _ in panels] == [
        "speed of Ego [m/s]", "acceleration of Ego [m/s²]", "gap to Pedestrian [m]", "wttc [s]",
    ]  # fmt: skip
    assert all(slots == ["selected", "beside"] for _, slots in panels)
    assert events["sees"] <= events["brakes"] <= events["contact"]


def test_the_gap_is_that_of_the_boxes(played, studies):
    page, _, _, scenario = played
    with StudyFile.open(studies("plain"), readonly=True) as opened:
        recording = opened.recording(scenario)
    boxes = []
    for name in ("Ego", "Pedestrian"):
        k, center = recording.entity_index(name), recording.box_center(name)
        x, y = center.T
        boxes.append(box_corners(x, y, recording.heading[k], recording.length[k], recording.width[k]))
    # The page holds places to a millimetre, and headings to 0.1 mrad.
    assert np.abs(np.array(page.evaluate(GAPS)) - box_distance(*boxes)).max() < 5e-3


def test_a_report_has_events_of_each_recording_and_says_what_to_fix(tab, studies, reports):
    page = tab.open(reports("plain"))
    contents = page.evaluate("() => cornercase.store.contents")
    assert contents["events"].keys() == {str(one) for one in contents["recordings"]}
    assert page.locator(".replay-events .event").count() > 1
    assert "braking" in page.locator("[data-question=fix]").text_content().lower()


def test_without_events_the_courses_are_there(tab, studies, tmp_path):
    path = cc.replay(studies("plain"), 2, tmp_path / "run.html")
    page = tab.open(path.as_uri())
    page.evaluate("() => { cornercase.store.contents.events = undefined; cornercase.replay.panel.choose(); }")
    tab.settle()
    assert page.locator(".replay-events").is_hidden()
    assert len(page.evaluate(PANELS)) == 4
