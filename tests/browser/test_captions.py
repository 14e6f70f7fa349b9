"""Captions are a line, and tell more on demand; the views come in the order of an engineer's questions."""

from __future__ import annotations

import pytest

from conftest import at_night

LINES = """() => [...document.querySelectorAll(".view figcaption")].map((one) => {
  const lines = one.getBoundingClientRect().height / parseFloat(getComputedStyle(one).lineHeight);
  return [one.parentElement.id, Math.round(lines)];
})"""


@pytest.mark.parametrize("width", at_night([400, 1280, 1600], {1280, 1600}))
@pytest.mark.parametrize("name", ["plain", "four", "failed"])
def test_each_caption_is_a_line(tab, reports, name, width):
    tab.page.set_viewport_size({"width": width, "height": 900})
    page = tab.open(reports(name))
    lines = page.evaluate(LINES)
    assert len(lines) > 3
    assert {view: count for view, count in lines if count != 1} == {}


def test_more_tells_what_was_found(tab, reports):
    page = tab.open(reports("plain"))
    caption = page.locator("#view-space figcaption")
    assert caption.locator("p").is_hidden()
    caption.get_by_text("More").click()
    assert "most critical" in caption.locator("p").inner_text()


def test_kernel_space_comes_after_what_engineers_ask_for(tab, reports):
    page = tab.open(reports("plain"))
    order = page.evaluate("() => [...document.querySelectorAll('.view')].map((one) => one.id.slice(5))")
    asked = ["space", "courses", "histogram", "search", "matters", "coverage"]
    assert order == [*(view for view in asked if view in order), "kernel", "table"]
    assert order[:3] == asked[:3]


def test_colours_of_kinds_are_for_kinds_only(tab, reports):
    page = tab.open(reports("plain"))
    page.evaluate("() => cornercase.views.drawAll()")
    page.wait_for_selector("#view-search .js-plotly-plot", state="attached", timeout=60_000)
    used = page.evaluate(
        """() => [...document.querySelectorAll(".js-plotly-plot")].flatMap((plot) =>
          plot.data.flatMap((trace) => [trace.line?.color, trace.marker?.color])).filter(Boolean)"""
    )
    assert used
    assert not set(used) & set(page.evaluate("() => KIND_COLOURS[isDark() ? 'dark' : 'light'].slice(0, 6)"))
