"""The summary for whoever decides prints on one page of A4, whatever the study holds."""

from __future__ import annotations

import re

from helpers.command_line import cornercase


def test_a_summary_prints_on_one_page(tab, each, studies, tmp_path):
    page = tmp_path / "summary.html"
    assert cornercase("report", studies(each), "--one-page", "-o", page).returncode == 0
    tab.page.goto(page.as_uri())
    sheets = tab.page.pdf(prefer_css_page_size=True)
    assert len(re.findall(rb"/Type\s*/Page\b(?!s)", sheets)) == 1
    assert b"/MediaBox [0 0 594.9" in sheets or b"/MediaBox [0 0 595" in sheets, "not A4"
    # Nothing is cut off at the right, on paper or on a phone.
    for width in (688, 400):
        tab.page.set_viewport_size({"width": width, "height": 900})
        assert tab.page.evaluate("() => document.documentElement.scrollWidth <= innerWidth")


def test_a_summary_tells_what_the_report_tells(tab, studies, tmp_path):
    page = tmp_path / "summary.html"
    first = cornercase("report", studies("plain"), "--one-page", "-o", page)
    assert "The summary is" in first.stdout
    written = page.read_bytes()
    cornercase("report", studies("plain"), "--one-page", "-o", page)
    assert page.read_bytes() == written
    text = written.decode()
    for question in ("Does it collide?", "How much of the space is critical?", "What may be missed?"):
        assert question in text
    for heading in ("What was tested", "What was not tested", "What to keep", "Where the numbers come from"):
        assert heading in text
    assert "cornercase explore x_intersection.xosc" in text
    tab.page.goto(page.as_uri())
    assert tab.page.locator("tbody tr").count() == 8
    assert tab.page.locator("svg .kept").count() == 8


def test_a_summary_has_no_figures(studies, tmp_path):
    told = cornercase("report", studies("plain"), "--one-page", "--figures", "-o", tmp_path / "s.html")
    assert told.returncode == 2
    assert "leave --figures" in told.stderr
