"""What the page says in words: answers, details, how it was made."""

from __future__ import annotations

import pytest

from conftest import at_night

PLACES = """() => [...document.querySelectorAll("#answers .answer")].map((one) => {
  const { left, right, top, bottom } = one.getBoundingClientRect();
  const within = document.getElementById("answers").getBoundingClientRect();
  return left >= 0 && right <= innerWidth + 1 && top >= within.top && bottom <= within.bottom + 1;
})"""


@pytest.mark.parametrize("width", at_night([400, 1280], {1280}))
def test_all_answers_can_be_read(tab, reports, width):
    tab.page.set_viewport_size({"width": width, "height": 900})
    page = tab.open(reports("plain"))
    more = page.locator("#more-answers")
    if more.is_visible():
        more.click()
        tab.settle()
    places = page.evaluate(PLACES)
    assert len(places) >= 5
    assert all(places)


def test_details_open_by_keyboard(tab, reports):
    page = tab.open(reports("plain"))
    parts = page.locator("#details details")
    assert parts.count() > 3
    parts.first.locator("summary").focus()
    page.keyboard.press("Enter")
    assert parts.first.get_attribute("open") is not None
    assert parts.first.locator("table").first.is_visible()


def test_the_command_that_makes_the_study_again_is_there(tab, reports):
    page = tab.open(reports("plain"))
    command = page.locator("#provenance #command").inner_text()
    assert command.startswith("cornercase explore")
    for part in ("--ego Ego", "--other Pedestrian", "--optimizer level-set", "--budget 60", "--audit 0.2"):
        assert part in command
