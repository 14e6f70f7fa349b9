"""Studies in notebooks."""

from __future__ import annotations

import numpy as np
import pytest
from lxml import etree

import cornercase as cc
from cornercase.report import _notebook as notebook
from cornercase.study import StudyFile
from helpers.untrusted_files import whole_study


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return whole_study(tmp_path_factory.mktemp("whole"))


def shown_by_ipython(study):
    """What a notebook gets, by IPython's protocol of display."""
    formatters = pytest.importorskip("IPython.core.formatters", reason="IPython is not installed")
    html = formatters.HTMLFormatter()
    return html(study)


def test_a_study_is_shown_as_its_page(whole, tmp_path):
    with cc.Study.open(whole, readonly=True) as study:
        page = study._repr_html_()
        before = study.elapsed_by_stage()
    (frame,) = etree.HTML(page).iter("iframe")
    # It reaches nothing of the notebook: neither its origin nor its top.
    assert frame.get("sandbox") == "allow-scripts allow-downloads"
    assert "height: 700px" in str(frame.get("style"))
    cc.write_report(whole, tmp_path / "r.html")
    assert frame.get("srcdoc") == (tmp_path / "r.html").read_text(encoding="utf-8")
    # To be looked at is nothing that a study notes.
    with cc.Study.open(whole, readonly=False) as study:
        assert study._repr_html_() == page
        assert study.elapsed_by_stage() == before


def test_ipython_asks_for_it(whole):
    with cc.Study.open(whole, readonly=True) as study:
        assert shown_by_ipython(study) == study._repr_html_()


def test_what_was_not_run_or_is_too_large_is_shown_as_a_table(whole, tmp_path):
    with cc.Study.open(whole, readonly=True) as study:
        meta, points = study.meta, np.array([row.point for row in study.rows()])
        values = [row.values for row in study.rows()]
    assert "<iframe" in str(notebook.render_notebook_report(whole, max_scenarios=len(points)))
    assert notebook.render_notebook_report(whole, max_scenarios=len(points) - 1) is None
    with StudyFile.create(tmp_path / "new.db", meta) as study:
        assert "<iframe" not in study._repr_html_()
        assert "<table" in study._repr_html_()
        study.writer.add_pending(1, points, values)
        assert "<iframe" not in study._repr_html_()


def test_repr_draws_no_page(whole, monkeypatch):
    monkeypatch.setattr(notebook, "render_notebook_report", None)
    with cc.Study.open(whole, readonly=True) as study:
        assert repr(study).startswith("<Study ")
