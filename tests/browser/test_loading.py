"""A report opens: without errors, without asking anything of anybody, whatever the names in the study."""

from __future__ import annotations

from browser.studies import ENTITY, HOSTILE


def test_a_report_opens_without_errors_or_outside_requests(tab, reports, each):
    page = tab.open(reports(each))
    assert page.locator("h1").inner_text() in page.title()
    # What is further down is drawn when it gets on the screen.
    for figure in page.locator("figure.view").all():
        figure.scroll_into_view_if_needed()
        tab.settle()


def test_numbers_far_from_zero_are_told_apart(tab, reports):
    page = tab.open(reports("one"))
    said = page.evaluate(
        "() => [5400000.001, 5400000.002, -3.14159, 40.0841].map((x, k) => formatInSteps(x, k < 2 ? 5e-6 : 0.06))"
    )
    assert said == ["5400000.001", "5400000.002", "−3.142", "40.08"]


def test_names_are_text_and_nothing_else(tab, reports):
    page = tab.open(reports("hostile"))
    assert HOSTILE in page.title()
    assert HOSTILE in page.locator("h1").inner_text()
    assert ENTITY in page.locator("body").inner_text()
    for figure in page.locator("figure.view").all():
        figure.scroll_into_view_if_needed()
        tab.settle()
    assert page.locator("img[src=x]").count() == 0
    assert page.title() != "run"
