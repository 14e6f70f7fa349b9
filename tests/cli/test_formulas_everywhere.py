"""A formula is a metric for every command, in spite of blanks, brackets and colons in its name."""

from __future__ import annotations

import csv

import pytest
from typer.testing import CliRunner

from cornercase.cli import app
from helpers.command_line import SPACE, X, cornercase

# Names of files can hold none of < and >, so these two would have the same.
NAMES = ["stl:always[0:9] (clearance > 2)", "stl:always[0:9] (clearance < 2)"]


def run(*arguments):
    done = CliRunner().invoke(app, list(map(str, arguments)))
    assert done.exit_code == 0, done.output
    return done.output


@pytest.mark.slow
def test_a_formula_goes_all_the_way_to_the_report(tmp_path):
    study = tmp_path / "study.db"
    run("explore", X, "--space", SPACE, "--ego", "Ego", "--other", "Pedestrian", "--metric", NAMES[0], "--metric", NAMES[1],
        "--optimizer", "sobol", "--budget", 16, "--seed", 1, "-o", study)  # fmt: skip
    assert NAMES[0] in run("show", study)
    run("analyze", study, "--by", NAMES[0])
    run("reduce", study, "--by", NAMES[0], "-o", tmp_path / "reduced")
    run("export", study, "-o", tmp_path / "tables")
    with (tmp_path / "tables" / "scenarios.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    holds, violated = ("_".join(name.split()) for name in NAMES)
    # Where one holds by a margin, the other is violated by as much or more.
    assert all(float(row[holds]) <= -float(row[violated]) for row in rows)
    assert len({row[holds] for row in rows}) > 8
    page = tmp_path / "report.html"
    run("report", study, "--figures", "-o", page)
    assert "always[0:9] (clearance &gt; 2)" in page.read_text(encoding="utf-8")
    figures = {file.name for file in (tmp_path / "report-figures").iterdir()}
    assert "criticality-stl-always[0-9] (clearance - 2).png" in figures
    assert "criticality-stl-always[0-9] (clearance - 2)-2.png" in figures


def test_a_formula_that_is_none_is_refused_in_one_sentence(tmp_path):
    done = cornercase(
        "explore", X, "--space", SPACE, "--ego", "Ego", "--other", "Pedestrian", "--metric",
        "stl:always(clearence > 0.5)", "-o", tmp_path / "s.db",
    )  # fmt: skip
    assert done.returncode == 2
    assert (
        "there is no signal 'clearence'; did you mean 'clearance'?\n    always(clearence > 0.5)\n           ^\n"
        in done.stderr
    )
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "s.db").exists()
