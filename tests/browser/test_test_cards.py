"""Test cards print one to a page of A4, whatever the study holds, and everybody can read them."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
from axe_playwright_python.sync_playwright import Axe  # type: ignore[import-untyped]

from conftest import at_night
from cornercase.report import write_test_cards
from cornercase.report.cards._meeting import find_meeting

CUT_OFF = """() => [...document.querySelectorAll(".sheet")].filter(
  (sheet) => sheet.scrollHeight > sheet.clientHeight + 1 || sheet.scrollWidth > sheet.clientWidth + 1,
).length"""
# Texts of tables that end with dots.
SHORTENED = """() => [...document.querySelectorAll("th, td")].filter((cell) => cell.scrollWidth > cell.clientWidth + 1)
  .map((cell) => cell.textContent)"""
# Texts of a drawing that lie outside of it.
OUTSIDE = """() => [...document.querySelectorAll("svg text")].filter((text) => {
  const [a, b] = [text.getBoundingClientRect(), text.ownerSVGElement.getBoundingClientRect()];
  return a.left < b.left - 1 || a.right > b.right + 1 || a.top < b.top - 1 || a.bottom > b.bottom + 1;
}).map((text) => text.textContent)"""


@pytest.mark.parametrize(
    "name", at_night(["plain", "hostile", "four", "failed", "pareto"], {"plain", "four", "pareto"})
)
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


@pytest.mark.parametrize(
    "full", at_night(["", "parameters", "conditions", "verdict", "parameters, verdict"], {"", "parameters", "verdict"})
)
def test_a_card_that_is_full_is_still_a_page(tab, studies, tmp_path, monkeypatch, full):
    """Everything that a card may hold at once: as many rows as there may be, and long texts in each."""
    from cornercase.report.cards import _card_contents, _movements, _start_poses

    text = "a condition of the storyboard that goes on and on, " * 4
    moves = [
        _movements.Movement("Pedestrian on the left 12", text[:60], text[:100], ("Pedestrian",)),
        _movements.Movement("A", text[:160], text[:160], ("A",)),
    ] * 3
    name = "a pedestrian of 26 letters"
    contacts = tuple((f"{name[:-2]}{k}", 12.34) for k in range(9))
    long_parameter = ["a_parameter_with_a_name_of_40_characters", "x" * 64, "y" * 64, "none", "tolerance to be agreed"]
    parameter = ["a_parameter_22_letters", "123.456 km/h", "123 km/h (34.17 m/s)", "none", "tolerance to be agreed"]
    verdict = f"ROUNDING CHANGES THE OUTCOME: {'contact with one and another, ' * 10}".strip()
    poses, results = _start_poses.list_start_poses, _card_contents._result_rows

    def meet(*arguments):
        return replace(find_meeting(*arguments), further_contacts=contacts[:5], unmeasured_contacts=contacts)

    monkeypatch.setattr("cornercase.report.cards._rounded_runs.find_meeting", meet)
    monkeypatch.setattr(_card_contents, "list_movements", lambda *_: moves)
    monkeypatch.setattr(_card_contents, "list_start_poses", lambda *given: poses(*given) * 5)
    monkeypatch.setattr(_card_contents, "_result_rows", lambda *given: (results(*given) + results(*given)[3:])[:14])
    monkeypatch.setattr(_card_contents, "_fixed_parameters", lambda *_: "z" * 150)
    if "parameters" in full:
        monkeypatch.setattr(_card_contents, "_parameter_rows", lambda *_: [long_parameter, *[parameter] * 11])
    if "conditions" in full:
        # Those of a suite, which has no parameters.
        monkeypatch.setattr(_card_contents, "_parameter_rows", lambda *_: [])
        monkeypatch.setattr(
            _card_contents, "_list_pass_conditions", lambda *_: ["Requirement: no more than th" * 4][:110] * 4
        )
    if "verdict" in full:
        monkeypatch.setattr(
            _card_contents, "_describe_rounded_outcome", lambda *_: {"kind": "changed", "text": verdict}
        )
    page = write_test_cards(studies("plain"), tmp_path / "cards.html", ids=[1])
    tab.page.goto(page.as_uri())
    assert tab.page.evaluate(CUT_OFF) == 0
    assert tab.page.evaluate(OUTSIDE) == []
    assert tab.page.evaluate(SHORTENED) == []
    if "parameters" in full:
        assert tab.page.content().count("123 km/h (34.17 m/s)") == 11, "each parameter has its value on the card"
    assert "and 4 more (not measured in the study)" in tab.page.content() or "verdict" in full


def test_cards_are_read_on_a_phone_and_by_a_screen_reader(tab, studies, tmp_path):
    page = write_test_cards(studies("plain"), tmp_path / "cards.html")
    tab.page.goto(page.as_uri())
    found = Axe().run(tab.page).response["violations"]
    assert [one["id"] for one in found if one["impact"] in ("serious", "critical", "moderate")] == []
    tab.page.set_viewport_size({"width": 400, "height": 900})
    assert tab.page.evaluate("() => document.documentElement.scrollWidth <= innerWidth")
