"""Metrics that say the same of all scenarios are named."""

from __future__ import annotations

import json

from command_line import SPACE, X, cornercase


def test_a_metric_by_which_all_scenarios_are_alike_is_named_at_the_end_and_in_show(tmp_path):
    study = tmp_path / "s.db"
    found = cornercase(
        "explore", X, "--space", SPACE, "--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc", "--metric", "ttce",
        "--optimizer", "sobol", "--budget", "12", "-o", study,
    )  # fmt: skip
    assert found.returncode == 0, found.stderr
    told = " ".join(found.stdout.split())
    assert told.count("All 12 scenarios score 0 s by ttce") == 1
    assert "by wttc" not in told
    shown = json.loads(cornercase("show", study, "--json").stdout)
    assert "All 12 scenarios score 0 s by ttce" in shown["metrics"]["ttce"]["note"]
    assert "note" not in shown["metrics"]["wttc"]
