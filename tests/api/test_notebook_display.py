"""What notebooks show: pages that cannot reach the notebook, and tables whose cells are escaped."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lxml import etree

import cornercase as cc
from cornercase.api import Page
from cornercase.exploration import ExplorationResult
from cornercase.scenario import ParameterSpace
from cornercase.study import StudyFile
from helpers.synthetic_study import about
from helpers.untrusted_files import whole_study


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    path: Path = whole_study(tmp_path_factory.mktemp("whole"))
    return path


def test_a_report_is_shown_in_a_frame_that_reaches_nothing(whole, tmp_path):
    page = cc.Study.open(whole).report(tmp_path / "r.html")
    (frame,) = etree.HTML(page._repr_html_()).iter("iframe")
    # Neither the origin of the notebook nor its top.
    assert frame.get("sandbox") == "allow-scripts allow-downloads"
    assert frame.get("srcdoc") == Path(page).read_text(encoding="utf-8")


def test_what_is_no_page_is_named(tmp_path):
    film = Page(tmp_path / "<b>.gif")
    assert film._repr_html_() == f"<p>{tmp_path}/&lt;b&gt;.gif</p>"
    assert "was removed" in Page(tmp_path / "r.html")._repr_html_()


def test_a_study_shows_its_most_critical_scenarios_with_names_escaped(tmp_path):
    space = ParameterSpace.from_ranges(["<b>=0:1"])
    points = np.linspace(0.02, 0.98, 12)[:, None]
    with StudyFile.create(tmp_path / "s.db", about(space, "distance", ego="<i>Ego</i>")) as study:
        study.writer.add_pending(1, points, space.values(points))
        study.writer.record_failure(1, cc.SimulationError("<script>alert()</script>"))
    text = cc.Study.open(tmp_path / "s.db")._repr_html_()
    assert "1 failed, 11 pending" in text
    assert "and 2 more" in text
    assert "&lt;i&gt;Ego" in text
    assert "&lt;script&gt;" in text
    assert "<i>" not in text
    assert "<script>" not in text
    assert "<b>" not in text


def test_the_end_of_a_search_says_why_scenarios_failed():
    ended = ExplorationResult(Path("<s>.db"), 3, 2, "the budget is used up", failure_counts={"<b> is no road": 2})
    text = ended._repr_html_()
    assert "3 scenarios done, 2 failed in &lt;s&gt;.db; the budget is used up" in text
    assert "<p>2 failed: &lt;b&gt; is no road</p>" in text


def test_every_result_shows_itself(whole):
    study = cc.Study.open(whole)
    summary = study.summary()
    results: list[Any] = [
        study,
        summary,
        *summary.analyses.values(),
        summary.reduced_set,
        study.sensitivity(),
        study.critical_set(threshold=1.0),
    ]
    for result in results:
        page = result._repr_html_()
        assert etree.HTML(page) is not None
        assert len(page) < 20_000
