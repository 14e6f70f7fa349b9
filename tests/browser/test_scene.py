"""What the replay draws, held against the recordings of the study, to a pixel."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from cornercase.study import StudyFile

# Colours of pixels of a scene, given by places in CSS pixels, and those that stand for ego and other.
COLOURS = """([slot, points]) => {
  const canvas = document.querySelector(`#replay [data-replay=${slot}] canvas`);
  const ratio = canvas.width / canvas.clientWidth;
  const g = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", { willReadFrequently: true });
  g.drawImage(canvas, 0, 0);
  return points.map(([x, y]) => [...g.getImageData(Math.round(x * ratio - 0.5), Math.round(y * ratio - 0.5), 1, 1).data]);
}"""
MEANT = """(name) => {
  const g = new OffscreenCanvas(1, 1).getContext("2d");
  g.fillStyle = getComputedStyle(document.querySelector("#replay canvas")).getPropertyValue(`--scene-${name}`);
  g.fillRect(0, 0, 1, 1);
  return [...g.getImageData(0, 0, 1, 1).data];
}"""
PLACES = """([slot, points]) => points.map(([x, y]) => {
  const at = cornercase.replay.toPixels(slot, x, y);
  return [at.x, at.y];
})"""


def recorded(path, scenario):
    with StudyFile.open(path, readonly=True) as study:
        return next(recording for one, recording, _ in study.iter_recordings() if one == scenario)


def box_at(recording, name, k):
    """Middle of an entity's box, its heading, and half its length and width."""
    one = recording.entity_index(name)
    heading = recording.heading[one, k]
    ahead = np.array([np.cos(heading), np.sin(heading)])
    middle = np.array([recording.x[one, k], recording.y[one, k]]) + recording.center_x[one] * ahead
    return middle, ahead, recording.length[one] / 2, recording.width[one] / 2


def along_the_edge(box, beyond):
    """Points so far beyond the sides of a box, off their middles, where noses, trails and lines of sight are."""
    middle, ahead, half_length, half_width = box
    aside = np.array([-ahead[1], ahead[0]])
    shares = np.array([-0.8, -0.6, 0.6, 0.8])
    sides = [
        middle + s * half_length * ahead + sign * (half_width + beyond) * aside for s in shares[:2] for sign in (-1, 1)
    ]
    ends = [middle + s * half_width * aside + sign * (half_length + beyond) * ahead for s in shares for sign in (-1, 1)]
    return np.array(sides + ends)


def alike(colours, meant):
    return np.abs(np.asarray(colours)[:, :3] - np.asarray(meant)[:3]).sum(axis=1) < 90


def seek(page, slot, time):
    page.evaluate("(time) => cornercase.replay.seek(time)", float(time))
    page.wait_for_function(
        "([slot, time]) => Math.abs(document.querySelector(`#replay [data-replay=${slot}]`)?.dataset.time - time) < 1e-3",
        arg=[slot, float(time)],
    )


def require_drawn(page, slot, recording, k):
    """The ego's box begins and ends where it was recorded; the pedestrian's disc is there."""
    box = box_at(recording, "Ego", k)
    (origin, right) = page.evaluate(PLACES, [slot, [[0.0, 0.0], [1.0, 0.0]]])
    scale = right[0] - origin[0]
    assert scale > 3, "too small to tell"
    meant = page.evaluate(MEANT, "ego")
    # Its border is 1.2 pixels wide: a pixel beyond that it has its colour inside, and another outside.
    for beyond, there in ((-1.6, True), (1.6, False)):
        points = page.evaluate(PLACES, [slot, along_the_edge(box, beyond / scale).tolist()])
        assert (alike(page.evaluate(COLOURS, [slot, points]), meant) == there).mean() >= 0.8, (beyond, k)
    middle = box_at(recording, "Pedestrian", k)[0]
    colours = page.evaluate(COLOURS, [slot, page.evaluate(PLACES, [slot, [middle.tolist()]])])
    assert alike(colours, page.evaluate(MEANT, "other")).all()


def instants(recording, first):
    """A few, some time before and until the ego and the other are nearest to each other."""
    ego, other = (recording.entity_index(name) for name in ("Ego", "Pedestrian"))
    apart = np.hypot(recording.x[ego] - recording.x[other], recording.y[ego] - recording.y[other])
    near = int(np.nanargmin(apart))
    return [max(0, near - back) for back in first]


def test_what_is_clicked_moves_as_it_was_recorded(tab, reports, studies):
    page = tab.open(reports("plain"))
    page.evaluate("() => cornercase.replay.ready")
    plot = page.locator("#view-space .plot")
    plot.scroll_into_view_if_needed()
    box = plot.bounding_box()
    x, y = page.evaluate("() => cornercase.views.get('space').plot.placeOf(7)")
    page.mouse.click(box["x"] + x, box["y"] + y)
    chosen = page.evaluate("() => cornercase.store.selected")
    pane = page.locator("#replay [data-replay=selected]")
    page.wait_for_selector(f"#replay [data-replay=selected][data-scenario='{chosen}'][data-time]")
    recording = recorded(studies("plain"), chosen)
    page.locator("#sight").click()
    for k in instants(recording, (20, 8)):
        seek(page, "selected", recording.time[k])
        assert float(pane.get_attribute("data-time")) == pytest.approx(recording.time[k], abs=1e-3)
        require_drawn(page, "selected", recording, k)


def test_two_scenarios_are_side_by_side_on_one_clock(tab, reports, studies):
    page = tab.open(f"{reports('plain')}#id=12&beside=3")
    page.wait_for_selector("#replay [data-replay=beside][data-scenario='3'][data-time]")
    page.locator("#sight").click()
    both = {"selected": recorded(studies("plain"), 12), "beside": recorded(studies("plain"), 3)}
    (k,) = instants(both["selected"], (10,))
    for slot, recording in both.items():
        assert page.locator(f"#replay [data-replay={slot}]").count() == 1
        seek(page, slot, both["selected"].time[k])
        require_drawn(page, slot, recording, k)


def test_it_plays_and_steps_and_stands_still(tab, reports):
    page = tab.open(f"{reports('plain')}#id=12")
    page.wait_for_selector("#replay [data-replay=selected][data-time]")

    def time():
        return float(page.locator("#replay [data-replay=selected]").get_attribute("data-time"))

    seek(page, "selected", 1.0)
    page.locator("#step").click()
    tab.settle()
    assert time() == pytest.approx(1.05)
    page.locator("#step-back").click()
    page.locator("#step-back").click()
    tab.settle()
    assert time() == pytest.approx(0.95)
    page.locator("#play").click()
    seen = []
    for _ in range(4):
        page.wait_for_timeout(120)
        seen.append(time())
    assert all(before < after for before, after in pairwise(seen))
    page.locator("#play").click()
    tab.settle()
    stopped = time()
    page.wait_for_timeout(200)
    assert time() == stopped
    page.locator("#scrub").focus()
    page.keyboard.press("Home")
    tab.settle()
    assert time() == 0.0


def test_a_neighbour_of_another_kind_or_outcome_is_put_beside(tab, reports):
    page = tab.open(f"{reports('plain')}#id=12")
    page.wait_for_selector("#replay [data-replay=selected][data-time]")
    page.locator("#neighbour").click()
    page.wait_for_selector("#replay [data-replay=beside][data-scenario]")
    outcome = "(id) => cornercase.store.contents.scenarios.outcome[cornercase.store.rows.get(id)]"
    other = page.evaluate("() => cornercase.store.beside")
    assert other not in (None, 12)
    assert page.evaluate(outcome, other) != page.evaluate(outcome, 12)


def test_what_failed_says_why(tab, reports, studies):
    with StudyFile.open(studies("failed"), readonly=True) as study:
        failed = study.failed_rows()[0]
    page = tab.open(f"{reports('failed')}#id={failed.id}")
    page.wait_for_selector("#replay [data-replay=selected]")
    assert failed.error in page.locator("#replay").inner_text()
