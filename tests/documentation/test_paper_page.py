"""The page on the paper, and the verdicts on its statements."""

from __future__ import annotations

import importlib
import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "paper.md"


@pytest.fixture
def replication(monkeypatch):
    """Modules of the benchmark: statements, family and verdicts."""
    monkeypatch.syspath_prepend(str(ROOT))
    before = set(sys.modules)
    names = ("statements", "family", "verdicts")
    yield {name: importlib.import_module(f"benchmarks.replication.{name}") for name in names}
    for name in set(sys.modules) - before:
        if name.startswith("benchmarks"):
            sys.modules.pop(name)


def rows_of(text: str) -> list[list[str]]:
    """Cells of the rows of tables that begin with the number of a statement."""
    rows = [[cell.strip() for cell in line.strip().strip("|").split("|")] for line in text.splitlines()]
    return [row for row in rows if re.fullmatch(r"[12]\.\d+[cna]?", row[0])]


def test_the_page_has_a_row_with_a_verdict_for_each_statement(replication):
    statements = replication["statements"].STATEMENTS
    verdicts = replication["verdicts"]
    rows = rows_of(PAGE.read_text("utf-8"))
    assert [row[0] for row in rows] == list(statements)
    for number, said, limit, verdict, _ in rows:
        one = statements[number]
        assert said == (f"{one.ego} ego: " if one.ego else "") + one.says
        assert limit == one.limit
        assert verdict in (verdicts.CONFIRMED, verdicts.SOME, verdicts.NONE)


def test_the_page_counts_the_verdicts_as_its_table_does(replication):
    verdicts = replication["verdicts"]
    text = PAGE.read_text("utf-8")
    answers = [row[3] for row in rows_of(text)]
    counts = [answers.count(one) for one in (verdicts.CONFIRMED, verdicts.SOME, verdicts.NONE)]
    stated = re.search(
        r"Of its (\d+) statements, (\d+) are confirmed, (\d+) hold for some\s[^,]*, (\d+) for none", text
    )
    assert stated is not None
    assert [int(value) for value in stated.groups()] == [len(answers), *counts]


def test_each_reconstruction_of_the_family_is_on_the_page(replication):
    family, text = replication["family"], PAGE.read_text("utf-8")
    for one in (*family.RUNS, *family.READINGS):
        assert one.says in text


def test_a_statement_is_confirmed_by_default_only_and_with_enough_seeds(replication):
    verdicts = replication["verdicts"]
    yes, no = {"figures": {}, "holds": True}, {"figures": {}, "holds": False}
    cases = {
        verdicts.CONFIRMED: {"example-x": [yes] * 8 + [no] * 2, "corner": [no] * 10},
        verdicts.SOME: {"example-x": [yes] * 7 + [no] * 3, "corner": [yes] * 10},
        verdicts.NONE: {"example-x": [yes] * 7 + [no] * 3, "corner": [yes] * 7 + [no] * 3},
    }
    for answer, cells in cases.items():
        results = {("1.1", runs, "automatic"): answers for runs, answers in cells.items()}
        assert verdicts.verdict("1.1", results)[0] == answer


def test_the_table_gives_median_and_range_and_where_it_holds(replication):
    verdicts = replication["verdicts"]
    default = [{"figures": {"kept": value}, "holds": False} for value in (1.0, 17.0, 48.0)]
    other = [{"figures": {"kept": 32.0}, "holds": True}] * 3
    results = {("1.10", "example-x", "automatic"): default, ("1.10", "corner", "by hand"): other}
    (row,) = rows_of("\n".join(verdicts.table(results)))
    assert row[3] == verdicts.SOME
    assert row[4] == "*example-x*, automatic: kept 17 (1 to 48), 0 of 3; *corner*, by hand: kept 32, 3 of 3"


def test_a_changed_reconstruction_of_a_scenario_differs_from_the_example_as_it_says(replication, tmp_path):
    (corner,) = (one for one in replication["family"].RUNS if one.name == "corner")
    config = corner.config("", 0, 5, tmp_path)
    ranges = {one.name: (one.low, one.high) for one in config.logical.space.parameters}
    assert ranges["pedestrian_wait"] == (4.0, 15.0)
    text = config.logical.path.read_text("utf-8")
    assert all(old not in text and new in text for old, new in corner.changes)


@pytest.mark.slow
def test_the_benchmark_runs_with_few_scenarios(replication, tmp_path, monkeypatch, capsys):
    rows = tmp_path / "rows.json"
    monkeypatch.setattr(sys, "argv", ["paper.py", "--quick", "--seeds", "1", "--json", str(rows)])
    importlib.import_module("benchmarks.paper").main()
    assert "answers are yes" in capsys.readouterr().out
    assert {row["scenario"] for row in json.loads(rows.read_text())} == {
        "X",
        "T, cautious",
        "T, normal",
        "T, aggressive",
    }


def test_a_judgement_by_other_rules_of_fault_is_not_used_again(replication, tmp_path, monkeypatch):
    verdicts, statements = replication["verdicts"], replication["statements"].STATEMENTS
    (runs,) = (one for one in replication["family"].RUNS if one.name == "example-t")
    asked = [statements["2.2n"], statements["2.4n"]]
    monkeypatch.setattr(verdicts, "rules_state", lambda roads: "earlier rules")
    verdicts._cells(runs, "normal", 0, tmp_path, asked, 20, progress=False)
    (known,) = tmp_path.glob("*.json")
    stored = json.loads(known.read_text())
    for cell in stored["cells"].values():
        cell["figures"] = {"stale": 1.0}
    known.write_text(json.dumps(stored))
    monkeypatch.setattr(verdicts, "rules_state", lambda roads: "rules of today")
    cells = verdicts._cells(runs, "normal", 0, tmp_path, asked, 20, progress=False)
    assert cells["2.2n", "automatic"]["figures"] == {"stale": 1.0}
    assert cells["2.4n", "automatic"]["figures"] != {"stale": 1.0}


def test_settings_are_the_centre_of_the_largest_region(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    centre = importlib.import_module("benchmarks.replication.experiments").centre_of_the_largest_region
    cells = np.zeros((9, 9), dtype=bool)
    cells[0, 0] = cells[2:7, 3:8] = True
    assert centre(cells) == (4, 5)
