"""Metrics with the same score in all scenarios: a warning if the metric is searched, otherwise a note."""

from __future__ import annotations

import json
from pathlib import Path

from helpers.command_line import SPACE, X, cornercase


def search(study: Path, *options: object) -> str:
    """The final output of `explore` in one line."""
    done = cornercase(
        "explore", X, "--space", SPACE, "--ego", "Ego", "--other", "Pedestrian", "--optimizer", "sobol",
        *options, "-o", study,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return " ".join(done.stdout.split())


def notes(study: Path) -> dict[str, str]:
    shown = json.loads(cornercase("show", study, "--json").stdout)
    return {name: one["note"] for name, one in shown["metrics"].items() if "note" in one}


def test_42_12_of_a_metric_that_is_not_searched_it_is_a_note_said_once(tmp_path):
    study, both = tmp_path / "s.db", ("--metric", "wttc", "--metric", "ttce")
    assert "score" not in search(study, *both, "--budget", "8")
    # It becomes true here ...
    assert search(study, *both, "--budget", "12").endswith("Note: All 12 scenarios have the same ttce score (0 s).")
    # ... and is not repeated in later runs.
    for budget in ("12", "16"):
        assert "score" not in search(study, *both, "--budget", budget)
    assert notes(study) == {"ttce": "All 16 scenarios have the same ttce score (0 s)."}


def test_42_12_of_the_metric_that_is_searched_it_stays_a_warning(tmp_path):
    study = tmp_path / "s.db"
    warning = (
        "All 12 scenarios have the same ttce score (0 s), so the search has no gradient to follow. Choose another metric"
        " or widen the ranges."
    )
    for _ in range(2):
        told = search(study, "--metric", "ttce", "--metric", "wttc", "--budget", "12")
        assert told.endswith(warning)
    assert notes(study) == {"ttce": warning}


def test_42_12_of_one_of_several_that_are_searched_it_says_what_is_left(tmp_path):
    told = search(tmp_path / "s.db", "--metric", "wttc", "--metric", "ttce", "--weight", "wttc=1", "--weight", "ttce=1",
                  "--budget", "12")  # fmt: skip
    assert told.endswith(
        "All 12 scenarios have the same ttce score (0 s), so the search has only the other metrics to follow. Leave it"
        " out or widen the ranges."
    )


def test_42_12_a_suite_is_no_search(tmp_path):
    study = tmp_path / "s.db"
    search(study, "--metric", "ttce", "--metric", "wttc", "--budget", "24")
    for words in (
        ("analyze", study, "--by", "wttc"),
        ("reduce", study, "--by", "wttc", "--size", "12", "-o", tmp_path / "set"),
    ):
        assert cornercase(*words).returncode == 0
    for _ in range(2):
        done = cornercase("test", tmp_path / "set", "-o", tmp_path / "t.db")
        assert "ttce score" not in done.stdout + done.stderr
    assert notes(tmp_path / "t.db") == {"ttce": "All 12 scenarios have the same ttce score (0 s)."}
