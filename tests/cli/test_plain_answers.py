"""Answers that a new user had to read twice."""

from __future__ import annotations

import re
from html import unescape
from typing import cast

import pytest
from typer.core import TyperGroup
from typer.main import get_command

from cornercase.cli import app
from cornercase.cli.command_groups import COMMANDS_BY_PURPOSE
from cornercase.metrics import METRICS
from helpers.command_line import SPACE, X, cornercase

MEASURED = ("--metric", "wttc", "--metric", "trajectory-distance")
SEARCH = ("explore", X, "--space", SPACE, "--ego", "Ego", "--other", "Pedestrian", *MEASURED, "--optimizer", "sobol")


@pytest.fixture(scope="module")
def explored(tmp_path_factory):
    study = tmp_path_factory.mktemp("explored") / "study.db"
    assert cornercase(*SEARCH, "--budget", "30", "-o", study).returncode == 0
    return study


def test_the_help_lists_each_command_once_by_what_it_is_for():
    lines = cornercase("--help").stdout.splitlines()
    listed = [name for names in COMMANDS_BY_PURPOSE.values() for name in names]
    assert sorted(listed) == sorted(cast(TyperGroup, get_command(app)).commands)
    assert [
        line.split()[0] for line in lines[lines.index("Find critical scenarios:") :] if re.match("  \\w", line)
    ] == listed
    # In the words of the page.
    assert "  report           Write the report: one page that holds everything." in lines


def test_all_options_that_are_missing_are_named_at_once_with_the_entities():
    done = cornercase("explore", X, "--budget", "5")
    assert done.returncode == 2
    assert "All that are missing: --output, --ego, --other, --metric. " in done.stderr
    assert "Entities of x_intersection.xosc: Ego, Truck, C, Pedestrian." in done.stderr
    assert "All that are missing" not in cornercase("show").stderr


@pytest.mark.parametrize(("value", "words"), [("many", "'many' is not a whole number."), ("0", "'0' is below 1.")])
def test_a_value_that_cannot_be_read_is_quoted_without_words_of_a_library(value, words):
    done = cornercase("explore", X, "--budget", value)
    assert done.returncode == 2
    assert "Input should be" not in done.stderr
    # Versions of typer before 0.20 have words of their own, which quote the value too.
    assert words in done.stderr or f"'{value}'" in done.stderr or "0 is not in the range" in done.stderr


def test_show_says_the_sentences_of_the_page(explored, tmp_path):
    shown = cornercase("show", explored)
    assert shown.returncode == 0
    lines = shown.stdout.splitlines()
    assert lines[0].startswith(
        "x_intersection. Under test: Ego, driven by normal, against Pedestrian. Simulator: builtin"
    )
    assert lines[1] == "Does it collide?"
    assert cornercase("report", explored, "-o", tmp_path / "r.html").returncode == 0
    page = unescape((tmp_path / "r.html").read_text(encoding="utf-8"))
    assert all(line.removeprefix("  ").removeprefix("- ") in page for line in lines[1:])
    assert len(cornercase("show", explored, "--all").stdout.splitlines()) > 2 * len(lines)
    assert cornercase("show", explored, "--all", "--config").returncode == 2


def test_show_has_no_heading_with_nothing_under_it(explored):
    lines = cornercase("show", explored, "--all").stdout.splitlines()
    assert "clusters: none yet; 'cornercase analyze' finds them" in lines
    headings = [k for k, line in enumerate(lines) if ":" not in line]
    assert headings
    assert not [lines[k] for k in headings if not lines[k + 1 : k + 2] or not lines[k + 1].startswith("  ")]


def test_the_table_of_clusters_fits_into_a_terminal_of_80_columns(explored, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    aspects = ("--by", "bearing", "--by", "trajectory-distance")
    table = cornercase("analyze", explored, *aspects).stdout
    assert "stability" in table
    assert "…" not in table


def test_a_folder_that_cannot_be_imported_is_named_with_what_it_lacks(tmp_path):
    given = ("--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc", "-o", tmp_path / "study.db")
    for folder, words in (
        (tmp_path / "nowhere", "there is no such folder; name the folder that holds the recordings"),
        (X, "is a file; name the folder that holds the recordings"),
        (tmp_path, "has no parameters.csv with the parameter values of each recording"),
    ):
        done = cornercase("import", folder, *given)
        assert done.returncode == 2
        assert words in done.stderr
    assert "or name another table with --parameters" in done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("sign", "words"), [(";", "semicolons"), ("\t", "tabs")])
def test_a_table_of_another_separator_is_told_so(tmp_path, sign, words):
    table = tmp_path / "parameters.csv"
    table.write_text(f"file{sign}ego_start\na.csv{sign}40,5\n")
    imported = cornercase(
        "import", tmp_path, "--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc", "-o", tmp_path / "study.db"
    )
    simulated = cornercase("simulate", X, "--parameters", table, "-o", tmp_path / "recordings")
    for done in (imported, simulated):
        assert done.returncode == 2
        assert f"separates its columns by {words}; use commas" in done.stderr


def test_tables_are_not_written_below_a_file(explored, tmp_path):
    (tmp_path / "page.html").write_text("mine")
    done = cornercase("export", explored, "-o", tmp_path / "page.html")
    assert done.returncode == 2
    assert f"-o {tmp_path / 'page.html'}: {tmp_path / 'page.html'} is a file, not a folder" in done.stderr
    assert (tmp_path / "page.html").read_text() == "mine"


def test_the_analyses_that_there_are_are_named_where_another_is_asked_for(explored, tmp_path):
    assert cornercase("analyze", explored, "--by", "bearing").returncode == 0
    done = cornercase("reduce", explored, "--by", "pet", "-o", tmp_path / "reduced")
    assert done.returncode == 2
    assert "holds no analysis by pet, only by bearing" in done.stderr
    assert "or run 'cornercase analyze' by it" in done.stderr
    assert cornercase("reduce", explored, "--by", "bearing", "-o", tmp_path / "reduced").returncode == 0


def test_names_of_metrics_are_whole_in_a_terminal_of_80_columns(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    first = {line.split()[0] for line in cornercase("metrics").stdout.splitlines() if line[1:2].strip()}
    assert set(METRICS.names()) <= first


def test_definitions_of_metrics_are_plain_text():
    assert "::" not in cornercase("metrics", "wttc").stdout
