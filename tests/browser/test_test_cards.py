"""Test cards print one to a page of A4, whatever the study holds, and everybody can read them."""

from __future__ import annotations

import re

import pytest
from axe_playwright_python.sync_playwright import Axe  # type: ignore[import-untyped]

from cornercase.report import write_test_cards

CUT_OFF = """() => [...document.querySelectorAll(".sheet")].filter(
  (sheet) => sheet.scrollHeight > sheet.clientHeight + 1 || sheet.scrollWidth > sheet.clientWidth + 1,
).length"""
# Texts of a drawing that lie outside of it.
OUTSIDE = """() => [...document.querySelectorAll("svg text")].filter((text) => {
  const [a, b] = [text.getBoundingClientRect(), text.ownerSVGElement.getBoundingClientRect()];
  return a.left < b.left - 1 || a.right > b.right + 1 || a.top < b.top - 1 || a.bottom > b.bottom + 1;
}).map((text) => text.textContent)"""


@pytest.mark.parametrize("name", ["plain", "hostile", "four", "failed", "pareto"])
def test_each_card_prints_on_a_page(tab, studies, tmp_path, name):
    ids = None if name in ("plain", "hostile") else [1, 2, 3]
    page = write_test_cards(studies(name), tmp_path / "cards.html", ids=ids)
    tab.page.goto(page.as_uri())
    n_cards = tab.page.locator(".sheet").count()
    assert n_cards == (8 if ids is None else 3)
    assert tab.page.evaluate(CUT_OFF) == 0
    assert tab.page.evaluate(OUTSIDE) == []
    sheets = tab.page.pdf(prefer_css_page_size=True)
    assert len(re.findall(rb"/Type\s*/Page\b(?!s)", sheets)) == n_cards
    assert b"/MediaBox [0 0 594.9" in sheets or b"/MediaBox [0 0 595" in sheets, "not A4"
    assert tab.page.title().startswith("cornercase: ")


def test_a_card_that_is_full_is_still_a_page(tab, studies, tmp_path, monkeypatch):
    """Everything that a card may hold at once: as many rows as there may be, and long texts in each."""
    from cornercase.report.cards import _card, _sketch

    def fill(study, source, scenario, quantities):
        card = original(study, source, scenario, quantities)
        text = "a condition of the storyboard that goes on and on, " * 4
        triggers = [("Pedestrian on the left 12", text[:60], text[:100]), ("A", text[:160], text[:160])] * 3
        parameters = [["a_parameter_with_a_long_name_30", "123.456 km/h", "123 km/h (34.17 m/s)", "none", "agreed"]] * 7
        parties = (card["parties"] * 4)[:4]
        shown, height = _card._fit(parameters, parties, triggers, 3)
        run, meta = source.run, study.meta
        drawing = (run.recording, meta.ego, run.meeting, None)
        return card | {
            "triggers": shown, "parameters": parameters, "parties": parties, "more_parties": 3,
            "more_parameters": 3, "trigger_note": "And 3 more, which the scenario file lists.",
            "course": _sketch.draw_course(*drawing, 128.0, height), "meeting": _sketch.draw_meeting(*drawing, 52.0, height),
            "results": (card["results"] * 2)[:11],
        }  # fmt: skip

    original = _card.fill_card
    monkeypatch.setattr("cornercase.report.cards._test_cards.fill_card", fill)
    page = write_test_cards(studies("plain"), tmp_path / "cards.html", ids=[1])
    tab.page.goto(page.as_uri())
    assert tab.page.evaluate(CUT_OFF) == 0


def test_cards_are_read_on_a_phone_and_by_a_screen_reader(tab, studies, tmp_path):
    page = write_test_cards(studies("plain"), tmp_path / "cards.html")
    tab.page.goto(page.as_uri())
    found = Axe().run(tab.page).response["violations"]
    assert [one["id"] for one in found if one["impact"] in ("serious", "critical", "moderate")] == []
    tab.page.set_viewport_size({"width": 400, "height": 900})
    assert tab.page.evaluate("() => document.documentElement.scrollWidth <= innerWidth")
