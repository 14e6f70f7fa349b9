"""Metrics by name: their options, those of other packages, and the list of them."""

from __future__ import annotations

import json
from typing import Any

import pytest
from typer.testing import CliRunner

from cornercase._common.errors import InputError
from cornercase.cli import app
from cornercase.metrics import METRICS, Clearance
from oracle import actor, recorded


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
        ("wtc:accelerating=true", "did you mean 'wttc'"),
        ("drac:x=1", "drac"),
        ("delta-v:masses=5", "delta-v"),
        ("rss:term=sideways", "rss has no term"),
    ):
        with pytest.raises(InputError, match=sentence):
            METRICS.create(name)


def test_a_metric_of_another_package_is_found_by_its_entry_point(monkeypatch, tmp_path):
    class HalfDistance(Clearance):
        """Half of the clearance."""

        name = "half-clearance"
        source = "nobody"

        def _course(self, recording, ego, other):
            return 0.5 * super()._course(recording, ego, other)

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
