"""The page of a replay alone, as `cornercase replay` writes it."""

from __future__ import annotations

import numpy as np

import cornercase as cc
from browser.studies import ENTITY, HOSTILE
from cornercase.report.replays._interpolation import interpolate_motion, is_visible
from cornercase.study import StudyFile

# What the scene draws from at some times, of the entities of that slot.
BOXES = """(times) => {
  const { recording } = cornercase.replay.panel.panes.selected;
  return times.map((time) => boxesAt(recording, time).map((box) => box && [box.x, box.y, box.heading]));
}"""
# The second recording is read a while after the first one is shown.
SLOW_SECOND = """
const read = Response.prototype.arrayBuffer;
let count = 0;
Response.prototype.arrayBuffer = async function () {
  const bytes = await read.call(this);
  if (++count > 1) await new Promise((resolve) => setTimeout(resolve, 300));
  return bytes;
};
"""
SEEN = """(times) => {
  const { recording, ego, other } = cornercase.replay.panel.panes.selected;
  return times.map((time) => sees(boxesAt(recording, time), ego, other));
}"""


def most_critical(study):
    with StudyFile.open(study, readonly=True) as opened:
        scores = opened.scores(opened.meta.metrics[0])
        return opened.finished_rows()[int(np.argmin(scores))].id


def test_it_shows_what_was_recorded_also_between_instants(tab, studies, tmp_path):
    one = most_critical(studies("plain"))
    page = tab.open(cc.replay(studies("plain"), one, tmp_path / "run.html").as_uri())
    with StudyFile.open(studies("plain"), readonly=True) as opened:
        recording = opened.recording(one)
    times = np.concatenate([recording.time, 0.5 * (recording.time[1:] + recording.time[:-1])])
    moved = interpolate_motion(recording, times)
    found = np.array(page.evaluate(BOXES, times.tolist()), dtype=float)
    assert np.abs(found[..., 0].T - moved.x).max() < 2e-3
    assert np.abs(found[..., 1].T - moved.y).max() < 2e-3
    ego, other = recording.entity_index("Ego"), recording.entity_index("Pedestrian")
    seen = [is_visible(moved, ego, other, k) for k in range(len(recording.time))]
    drawn = page.evaluate(SEEN, recording.time.tolist())
    # The page holds places to a millimetre.
    assert np.mean(np.array(seen) != np.array(drawn)) < 0.02
    assert True in seen
    assert False in seen


def test_two_play_on_one_clock_with_the_keyboard(tab, studies, tmp_path):
    page = tab.open(cc.replay(studies("plain"), 2, tmp_path / "run.html", beside=5).as_uri())
    times = "() => [...document.querySelectorAll('[data-replay]')].map((one) => Number(one.dataset.time))"
    page.locator("[data-replay=selected] canvas").focus()
    page.keyboard.press("Home")
    tab.settle()
    assert page.evaluate(times) == [0.0, 0.0]
    page.keyboard.press("ArrowRight")
    tab.settle()
    first, second = page.evaluate(times)
    assert first == second > 0.0
    page.locator("#speed").select_option("4")
    page.locator("[data-replay=beside] canvas").focus()
    page.keyboard.press("Space")
    page.wait_for_function("() => Number(document.querySelector('[data-replay]').dataset.time) > 1.0")
    page.keyboard.press("Space")
    tab.settle()
    stopped = page.evaluate(times)
    page.wait_for_timeout(120)
    assert page.evaluate(times) == stopped
    page.keyboard.press("End")
    tab.settle()
    with StudyFile.open(studies("plain"), readonly=True) as opened:
        ends = [float(opened.recording(one).time[-1]) for one in (2, 5)]
    assert np.allclose(page.evaluate(times), ends, atol=1e-3)


def test_it_draws_one_recording_while_the_other_is_read(tab, studies, tmp_path):
    tab.page.add_init_script(SLOW_SECOND)
    page = tab.open(cc.replay(studies("plain"), 2, tmp_path / "run.html", beside=5).as_uri())
    page.wait_for_timeout(400)
    tab.settle()
    assert page.locator("[data-replay=beside] canvas").is_visible()


def test_names_are_shown_as_they_are(tab, studies, tmp_path):
    page = tab.open(cc.replay(studies("hostile"), 1, tmp_path / "run.html").as_uri())
    assert page.locator("#replay th[data-role=other]").text_content() == ENTITY
    assert HOSTILE in (page.locator("h1").text_content() or "")
    assert page.title() != "run"
