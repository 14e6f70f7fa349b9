"""Light and dark, wide and narrow, and what a screen reader meets."""

from __future__ import annotations

import pytest
from axe_playwright_python.sync_playwright import Axe  # type: ignore[import-untyped]

from conftest import at_night

LOOKS = [("dark", 1280), ("light", 1280), ("light", 400)]
BACKGROUND = "() => getComputedStyle(document.body).backgroundColor"


def brightness(colour):
    red, green, blue = (int(one) for one in colour.strip("rgb()").split(","))
    return (red + green + blue) / 765


def views_on_the_screen(page, tab):
    """Scrolled through, so that all is drawn."""
    for figure in page.locator("figure.view").all():
        figure.scroll_into_view_if_needed()
        tab.settle()


def test_the_page_is_dark_where_the_machine_is(tab, reports):
    tab.page.emulate_media(color_scheme="dark")
    page = tab.open(reports("plain"))
    assert brightness(page.evaluate(BACKGROUND)) < 0.2
    # What is drawn follows too: most of a canvas is its background.
    middle = page.locator("#view-space canvas").first.evaluate(
        """(one) => {
          const g = one.getContext("2d");
          const { data } = g.getImageData(0, 0, one.width, one.height);
          let light = 0;
          let seen = 0;
          for (let k = 0; k < data.length; k += 4) {
            if (data[k + 3] < 128) continue;
            seen += 1;
            if (data[k] + data[k + 1] + data[k + 2] > 600) light += 1;
          }
          return [light, seen, data.length / 4];
        }"""
    )
    assert middle[1] > 0
    assert middle[0] < 0.2 * middle[2]


def test_the_theme_is_chosen_and_remembered(tab, reports):
    tab.page.emulate_media(color_scheme="light")
    page = tab.open(reports("plain"))
    assert brightness(page.evaluate(BACKGROUND)) > 0.8
    for _ in range(3):
        page.locator("#theme").click()
        if brightness(page.evaluate(BACKGROUND)) < 0.2:
            break
    assert brightness(page.evaluate(BACKGROUND)) < 0.2
    page.reload()
    page.wait_for_selector("html[data-ready]")
    assert brightness(page.evaluate(BACKGROUND)) < 0.2


@pytest.mark.parametrize("name", at_night(["hostile", "four"], {"four"}))
def test_a_phone_shows_all_without_scrolling_sideways(tab, reports, name):
    tab.page.set_viewport_size({"width": 400, "height": 800})
    page = tab.open(reports(name))
    views_on_the_screen(page, tab)
    for one in page.locator("#details details").all():
        one.evaluate("(one) => { one.open = true; }")
    wide = page.evaluate(
        "() => [document.documentElement.scrollWidth, innerWidth, [...document.querySelectorAll('body *')]"
        ".filter((one) => one.getBoundingClientRect().right > innerWidth + 1 && !one.closest('.wide, [role=grid], #views *'))"
        ".slice(0, 5).map((one) => one.outerHTML.slice(0, 120))]"
    )
    assert wide[0] <= wide[1] == 400, wide[2]


@pytest.mark.parametrize("looks", at_night(LOOKS, LOOKS[1:]))
def test_axe_finds_no_serious_violation(tab, reports, looks):
    page = tab.open(f"{reports('plain')}#id=12&beside=3&kept=0")
    for one in page.locator("#details details").all():
        one.evaluate("(one) => { one.open = true; }")
    scheme, width = looks
    page.emulate_media(color_scheme=scheme)
    page.set_viewport_size({"width": width, "height": 900})
    views_on_the_screen(page, tab)
    found = Axe().run(page).response["violations"]
    serious = [one for one in found if one["impact"] in ("serious", "critical")]
    told = [(one["id"], one["help"], [node["html"][:200] for node in one["nodes"][:4]]) for one in serious]
    assert told == []


def test_all_is_there_in_print(tab, reports):
    page = tab.open(reports("plain"))
    page.emulate_media(media="print", color_scheme="dark")
    page.evaluate("() => dispatchEvent(new Event('beforeprint'))")
    tab.settle()
    assert brightness(page.evaluate(BACKGROUND)) > 0.8 or page.evaluate(BACKGROUND) == "rgba(0, 0, 0, 0)"
    assert page.locator("#details details:not([open])").count() == 0
    undrawn = page.locator("figure.view").evaluate_all(
        "(all) => all.filter((one) => !one.querySelector('canvas, svg, table, [role=grid]')).map((one) => one.id)"
    )
    assert undrawn == []
    shown = page.evaluate("() => cornercase.store.shownCount")
    assert page.locator("#view-table .body .row").count() == min(shown, 100)
    page.evaluate("() => dispatchEvent(new Event('afterprint'))")
    assert page.locator("#view-table .body .row").count() < min(shown, 100)
