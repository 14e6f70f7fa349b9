"""Metrics by name: their options, those of other packages, and the list of them."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from cornercase._common.errors import InputError
from cornercase.cli import app
from cornercase.metrics import METRICS, Clearance, Metric, measure
from helpers.oracle import actor, recorded


def test_options_stand_behind_a_colon():
    signed: Any = METRICS.create("pet:signed=true")
    assert signed.name == "pet:signed=true"
    assert signed.signed is True
    exposure: Any = METRICS.create("tet:threshold=3,rule=samples")
    assert exposure.threshold == 3.0
    assert METRICS.create("traffic-quality-macro").name == "traffic-quality-macro"
    for name, sentence in (
        ("ttc:fast=true", "has no option 'fast'"),
        ("ttc:accelerating", "as in 'ttc:name=value'"),
        ("ttc:true", "as in 'ttc:accelerating=true'"),
        ("wtc:accelerating=true", "did you mean 'wttc'"),
        ("drac:x=1", "drac"),
        ("delta-v:masses=5", "delta-v"),
        ("rss:term=sideways", "rss has no term"),
        ("ttc:accelerating=no", "'ttc' takes true or false for 'accelerating', not 'no'"),
        ("ttc:accelerating=1", "takes true or false"),
        ("tet:threshold=true", "'tet' takes a number for 'threshold', not 'true'"),
        ("tet:threshold=three", "takes a number"),
    ):
        with pytest.raises(InputError, match=sentence):
            METRICS.create(name)


def test_a_metric_of_another_package_is_found_by_its_entry_point(monkeypatch, tmp_path):
    class HalfDistance(Clearance):
        """Half of the clearance."""

        name = "half-clearance"
        source = "nobody"

        def course(self, recording, ego, other):
            return 0.5 * super().course(recording, ego, other)

    class Entry:
        name = "half-clearance"

        def load(self):
            return HalfDistance

    def entries(*, group, name=None):
        return [Entry()] if group == "cornercase.metrics" and name in (None, "half-clearance") else []

    monkeypatch.setattr("cornercase._common.registry.entry_points", entries)
    listed = CliRunner().invoke(app, ["metrics", "--json"])
    assert listed.exit_code == 0
    rows = {row["name"]: row for row in json.loads(listed.output)}
    assert set(rows) == set(METRICS.names())
    assert rows["half-clearance"]["source"] == "nobody"
    assert rows["wttc"]["unit"] == "s"
    assert rows["wttc"]["lower_is_critical"] is True
    assert "quartic" not in rows["wttc"]["source"]
    assert rows["ttc"]["definition"].startswith("Time until the two bounding boxes")
    assert "half-clearance" in CliRunner().invoke(app, ["metrics"]).output
    recorded([actor(v=20), actor(x=34, v=10)], [0.0, 0.1]).to_csv(tmp_path / "r.csv")
    options_ = ["--ego", "0", "--other", "1", "--metric", "half-clearance", "-o", str(tmp_path / "c.csv")]
    assert CliRunner().invoke(app, ["measure", str(tmp_path / "r.csv"), *options_]).exit_code == 0
    assert (tmp_path / "c.csv").read_text().splitlines()[1] == "0.0,15.0"


def test_what_is_no_metric_is_refused(monkeypatch):
    class Unrelated:
        """Has a course, but no cap."""

    monkeypatch.setitem(METRICS._factories, "unrelated", (Unrelated, {}))
    with pytest.raises(InputError, match=r"not a subclass of cornercase\.metrics\.Metric"):
        METRICS.create("unrelated")


def test_of_a_metric_only_its_course_has_to_be_written():
    class SpeedDifference(Metric):
        """Difference of the speeds of both."""

        name, unit, lower_is_critical, cap = "speed-difference", "m/s", False, 0.0

        def course(self, recording, ego, other):
            return np.abs(recording.speed[recording.entity_index(ego)] - recording.speed[recording.entity_index(other)])

    metric = SpeedDifference()
    course = metric.course(recorded([actor(v=20), actor(x=34, v=10)], [0.0, 0.1]), "0", "1")
    assert metric.score(course) == 10.0
    np.testing.assert_array_equal(metric.clip_course(np.array([np.nan, -1.0, np.inf])), [0.0, 0.0, np.inf])
    assert (metric.bound, metric.default_threshold, metric.source) == (None, None, "")
    with pytest.raises(InputError, match="no default threshold"):
        metric.resolve_threshold()
    assert metric.resolve_threshold(3) == 3.0


def test_oriented_scores_are_lower_where_more_critical():
    scores = np.array([1.0, 2.0])
    for metric in map(METRICS.create, METRICS.names()):
        assert metric.to_minimize(scores).argmin() == (0 if metric.lower_is_critical else 1)
        np.testing.assert_array_equal(metric.to_minimize(metric.to_minimize(scores)), scores)


def test_a_recording_is_measured_from_python_as_on_the_command_line(tmp_path):
    recording = recorded([actor(v=20), actor(x=34, v=10)], [0.0, 0.1, 0.2])
    recording.to_csv(tmp_path / "r.csv")
    found = measure(tmp_path / "r.csv", "0", "1", ["ttc", "drac", "pet"])
    given = CliRunner().invoke(
        app,
        ["measure", str(tmp_path / "r.csv"), "--ego", "0", "--other", "1", "-o", str(tmp_path / "c.csv")]
        + [text for name in found.scores for text in ("--metric", name)],
    )
    printed = [line.split() for line in given.output.splitlines()]
    assert [line.split() for line in repr(found).splitlines()] == printed[: len(found.scores) + 1]
    table = found.to_dataframe()
    assert list(table.columns) == ["ttc", "drac", "pet"]
    assert table.index.name == "time"
    np.testing.assert_array_equal(table["ttc"], METRICS.create("ttc").course(recording, "0", "1"))
    # A metric with a required option cannot be measured by default.
    assert set(METRICS.names()) - set(measure(recording, "0", "1").scores) == {"critical-if", "stl"}
    with pytest.raises(InputError, match="'2'"):
        measure(recording, "0", "2", ["ttc"])
