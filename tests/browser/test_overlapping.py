"""Nothing lies over something else, however wide the window and wherever one has scrolled to."""

from __future__ import annotations

import pytest

import cornercase as cc
from conftest import at_night

# Parts of the page of which two overlap, and what stays in place while the page moves behind it but lets it through.
OVERLAPPING = """() => {
  const visible = (element) => element.checkVisibility() && element.getBoundingClientRect().height > 0;
  const parts = [...document.querySelectorAll("body > header, main section")].filter(visible);
  const found = [];
  parts.forEach((one, k) => {
    for (const other of parts.slice(k + 1)) {
      if (one.contains(other)) continue;
      const [a, b] = [one.getBoundingClientRect(), other.getBoundingClientRect()];
      const wide = Math.min(a.right, b.right) - Math.max(a.left, b.left);
      const high = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
      if (wide > 1 && high > 1) found.push(`${one.id} and ${other.id} by ${wide.toFixed()} x ${high.toFixed()}`);
    }
  });
  const alpha = (colour) => Number(/^rgba\\(.*, ([\\d.]+)\\)$/.exec(colour)?.[1] ?? 1);
  for (const element of document.querySelectorAll("body *")) {
    const { position, backgroundColor } = getComputedStyle(element);
    const stays = position === "sticky" || position === "fixed";
    if (stays && visible(element) && alpha(backgroundColor) < 1) found.push(`${element.id || element.className} is transparent`);
  }
  if (document.documentElement.scrollWidth > innerWidth) found.push("the page is wider than the window");
  return found;
}"""


SIZES = [(1280, 900), (1600, 900), (400, 800), (1024, 768), (1920, 1080), (1280, 400)]


def overlapping(page, tab):
    """What overlaps, by the share of the page that one has scrolled past."""
    found = {}
    for share in (0.0, 0.5, 0.8, 1.0):
        page.evaluate("(share) => scrollTo(0, share * (document.documentElement.scrollHeight - innerHeight))", share)
        tab.settle()
        if some := page.evaluate(OVERLAPPING):
            found[share] = some
    return found


@pytest.mark.parametrize("size", at_night(SIZES, [SIZES[0], *SIZES[3:]]), ids=lambda size: "x".join(map(str, size)))
def test_42_15_the_replay_lies_over_nothing(tab, reports, size):
    width, height = size
    tab.page.set_viewport_size({"width": width, "height": height})
    page = tab.open(reports("plain"))
    assert overlapping(page, tab) == {}
    page.evaluate("() => setTheme('dark', cornercase.store)")
    assert page.evaluate(OVERLAPPING) == []


def test_42_15_the_replay_stays_in_sight_beside_the_views_only(tab, reports):
    page = tab.open(reports("plain"))
    top = "(name) => document.querySelector(name).getBoundingClientRect().top"
    page.evaluate("() => document.querySelector('#view-histogram').scrollIntoView()")
    tab.settle()
    assert page.evaluate(top, "#replay") == 0.0
    page.evaluate("() => document.querySelector('#provenance').scrollIntoView()")
    tab.settle()
    assert page.evaluate(top, "#replay") < 0.0


def test_42_15_nor_on_the_page_of_a_replay_alone(tab, studies, tmp_path):
    page = tab.open(cc.replay(studies("plain"), 2, tmp_path / "run.html", beside=5).as_uri())
    assert overlapping(page, tab) == {}
