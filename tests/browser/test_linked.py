"""Views that follow each other, filters, addresses, and what can be done without a mouse."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from cornercase.study import StudyFile

SHOWN = "() => cornercase.store.contents.scenarios.id.filter((id, row) => cornercase.store.shown[row])"


# The ids of what has the focus and of all around it, and whether that is seen; nothing where the page has been left.
FOCUSED = """() => {
  const one = document.activeElement;
  if (one === document.body) return null;
  const style = getComputedStyle(one);
  const seen = (style.outlineStyle !== "none" && parseFloat(style.outlineWidth) > 0) || style.boxShadow !== "none";
  const within = [];
  for (let each = one; each; each = each.parentElement) if (each.id) within.push(each.id);
  return [within, seen];
}"""


def table_of(path):
    with StudyFile.open(path, readonly=True) as study:
        return study.table()


def shown(page):
    return set(page.evaluate(SHOWN))


def counted(page):
    """What the page says of how many it shows."""
    count, of, _ = page.locator("#shown-count").inner_text().replace(" of", "").split()
    return int(count), int(of)


def pictures(page, *names):
    """What views look like, by name; only what is drawn, so that a caption alone is no answer."""
    found = {}
    for name in names:
        drawing = page.locator(f"#view-{name} canvas").first
        found[name] = hashlib.sha256(drawing.evaluate("(one) => one.toDataURL()").encode()).hexdigest()
    return found


def drag(page, start, end):
    """From one share of the plot of the parameter space to another; x goes to the right and y down."""
    plot = page.locator("#view-space .plot")
    plot.scroll_into_view_if_needed()
    box = plot.bounding_box()
    page.mouse.move(box["x"] + start[0] * box["width"], box["y"] + start[1] * box["height"])
    page.mouse.down()
    for share in (0.3, 0.7, 1.0):
        at = [a + share * (b - a) for a, b in zip(start, end, strict=True)]
        page.mouse.move(box["x"] + at[0] * box["width"], box["y"] + at[1] * box["height"])
    page.mouse.up()


def test_views_follow_a_brush(tab, reports, studies):
    page = tab.open(reports("plain"))
    # High enough for all of them to be on the screen, where they are drawn.
    page.set_viewport_size({"width": 1600, "height": 5000})
    tab.settle()
    followers = ("courses", "histogram")
    before = pictures(page, *followers)
    rows = int(page.locator("#view-table [role=grid]").get_attribute("aria-rowcount"))
    drag(page, (0.3, 0.2), (0.6, 0.7))
    tab.settle()
    table = table_of(studies("plain"))
    kept = np.ones(len(table), dtype=bool)
    ranges = page.evaluate("() => [...cornercase.store.ranges]")
    assert len(ranges) == 2
    for column, (low, high) in ranges:
        values = table[column.removeprefix("parameter ")]
        assert values.min() < low < high < values.max()
        kept &= (values >= low) & (values <= high)
    assert 0 < kept.sum() < len(table)
    assert shown(page) == set(table.index[kept])
    assert counted(page) == (kept.sum(), len(table))
    after = pictures(page, *followers)
    assert all(before[name] != after[name] for name in followers)
    now = int(page.locator("#view-table [role=grid]").get_attribute("aria-rowcount"))
    assert rows - now == len(table) - kept.sum()
    page.locator("#reset-filters").click()
    tab.settle()
    assert counted(page) == (len(table), len(table))
    assert pictures(page, *followers) == before


def test_a_click_on_a_point_shows_its_scenario(tab, reports):
    page = tab.open(reports("plain"))
    plot = page.locator("#view-space .plot")
    plot.scroll_into_view_if_needed()
    for row in (7, 31):
        box = plot.bounding_box()
        x, y = page.evaluate("(row) => cornercase.views.get('space').plot.placeOf(row)", row)
        # Neighbours may be nearer than a pixel is wide: what is asked for is the scenario of the point on top.
        page.mouse.click(box["x"] + x, box["y"] + y)
        tab.settle()
        chosen = page.evaluate("() => cornercase.store.selected")
        other = page.evaluate(
            "(id) => cornercase.views.get('space').plot.placeOf(cornercase.store.rows.get(id))", chosen
        )
        assert np.hypot(other[0] - x, other[1] - y) < 1.0
        assert f"Scenario {chosen}" in page.locator("#filter-state").inner_text()


def test_filters_show_what_the_study_says(tab, reports, studies):
    page = tab.open(reports("plain"))
    table = table_of(studies("plain"))
    with StudyFile.open(studies("plain"), readonly=True) as study:
        found, _ = study.read_analysis("wttc", "ids", "labels")
        labels = dict(zip(found["ids"].tolist(), found["labels"].tolist(), strict=True))
        outcomes = study.outcomes()
    page.select_option("#aspect", "wttc")
    label = min(set(labels.values()) - {-1}, key=list(labels.values()).count)
    page.select_option("#filter-kind", str(label))
    assert shown(page) == {one for one, each in labels.items() if each == label} != set(labels)
    page.locator("#reset-filters").click()
    outcome = outcomes[1]
    page.select_option("#filter-outcome", outcome)
    assert shown(page) == {one for one, each in outcomes.items() if each == outcome}
    page.locator("#reset-filters").click()
    page.select_option("#filter-kept", "1")
    assert counted(page)[0] == 8
    page.locator("#reset-filters").click()
    page.select_option("#metric", "trajectory-distance")
    middle = float(table["trajectory-distance"].median())
    page.fill("#filter-score-high", f"{middle}")
    page.locator("#filter-score-high").press("Enter")
    assert shown(page) == set(table.index[table["trajectory-distance"] <= middle])


def test_a_scenario_that_an_answer_names_is_replayed(tab, reports):
    page = tab.open(reports("plain"))
    page.locator("#more-answers").click()
    links = page.locator("#answers a[href^='#id=']")
    names = links.all_inner_texts()
    assert len(names) > 3
    link = links.nth(len(names) - 1)
    link.click()
    number = int(names[-1].split()[-1])
    assert page.evaluate("() => cornercase.store.selected") == number
    assert page.locator("#replay .pane-title").first.inner_text() == f"Scenario {number}"


def test_who_is_at_fault_can_be_picked(tab, reports, studies):
    page = tab.open(reports("plain"))
    with StudyFile.open(studies("plain"), readonly=True) as study:
        impacts = {scenario: found for scenario, found in study.impacts().items() if found}
    faults = {scenario: max(found, key=lambda one: one.speed).fault for scenario, found in impacts.items()}
    assert all(fault is not None and fault.who == "other" for fault in faults.values())
    page.select_option("#filter-culprit", "Pedestrian")
    assert shown(page) == set(faults)
    page.wait_for_timeout(500)
    again = tab.open(page.url)
    assert shown(again) == set(faults)


def test_what_failed_can_be_picked(tab, reports, studies):
    page = tab.open(reports("failed"))
    with StudyFile.open(studies("failed"), readonly=True) as study:
        failed = {row.id for row in study.failed_rows()}
    page.select_option("#filter-failed", "1")
    assert failed
    assert shown(page) == failed


def test_an_address_holds_what_was_chosen(tab, reports):
    address = f"{reports('plain')}#id=12&beside=3&metric=trajectory-distance&colour=outcome&score=:9&kept=0"
    page = tab.open(address)
    assert page.evaluate("() => [cornercase.store.selected, cornercase.store.beside]") == [12, 3]
    assert [page.input_value(f"#{name}") for name in ("metric", "colour", "filter-kept")] == [
        "trajectory-distance",
        "outcome",
        "0",
    ]
    before = shown(page)
    assert 0 < len(before) < 60
    page.select_option("#filter-kept", "")
    page.wait_for_function("() => !location.hash.includes('kept=')")
    sent = page.url
    assert len(shown(page)) > len(before)
    page.go_back()
    page.wait_for_function("() => cornercase.bar.values.kept === '0'")
    assert shown(page) == before
    # Who gets the address sees the same.
    page.goto("about:blank")
    again = tab.open(sent)
    assert again.evaluate("() => [cornercase.store.selected, cornercase.store.beside]") == [12, 3]
    assert len(shown(again)) > len(before)


def test_an_address_of_another_study_is_no_error(tab, reports):
    page = tab.open(f"{reports('plain')}#id=x&kind=77&aspect=constructor&score=b:a")
    assert counted(page)[1] == 60
    for fragment in ("id=999999", "%E0%A4%A", "range.=1:2&x=y", "aspect=toString&metric=__proto__"):
        page.evaluate("(fragment) => { location.hash = fragment; }", fragment)
        tab.settle()
        assert counted(page)[1] == 60


def test_the_keyboard_is_enough(tab, reports):
    page = tab.open(reports("plain"))
    page.wait_for_function("() => document.querySelectorAll('figure.view .drawing:empty').length === 0")
    reached: list[tuple[list[str], bool]] = []
    while len(reached) < 200:
        page.keyboard.press("Tab")
        if (found := page.evaluate(FOCUSED)) is None:
            break
        reached.append(found)
    for name in ("theme", "metric", "aspect", "colour", "filter-kind", "filter-score-low", "view-space", "view-table"):
        assert any(name in within for within, _ in reached), name
    assert [within for within, seen in reached if not seen] == []
    # In a view, arrows go from scenario to scenario, and say which; Enter selects.
    page.locator("#view-space .plot").focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    told = page.locator("#told").inner_text()
    assert "scenario" in told.lower()
    page.keyboard.press("Enter")
    chosen = page.evaluate("() => cornercase.store.selected")
    assert str(chosen) in told
    page.locator("#filter-kept").focus()
    page.keyboard.type("kept")
    page.keyboard.press("Enter")
    assert counted(page)[0] == 8


def test_an_answer_is_the_same_bytes_each_time(reports, studies, tmp_path):
    import cornercase as cc

    again = cc.write_report(studies("plain"), tmp_path / "again.html")
    assert again.read_bytes() == Path(reports("plain").removeprefix("file://")).read_bytes()


def test_a_pair_at_the_boundary_is_played_side_by_side(tab, reports):
    page = tab.open(reports("plain"))
    page.locator("[data-part='boundary'] summary").click()
    link = page.locator("[data-part='boundary'] a").first
    first, second = map(int, link.inner_text().split(" beside "))
    link.click()
    page.wait_for_function(
        "ids => cornercase.store.selected === ids[0] && cornercase.store.beside === ids[1]", arg=[first, second]
    )
    tab.settle()
    outcome = "id => cornercase.store.contents.scenarios.outcome[cornercase.store.rows.get(id)]"
    assert page.evaluate(outcome, first) != page.evaluate(outcome, second)
    assert page.locator("#replay").bounding_box()["y"] < 900
