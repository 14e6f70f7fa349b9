"""The first notebook: run as it is, and the same on the command line, which gives the same bytes."""

from __future__ import annotations

import json
import re
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from cornercase.exploration import examples_folder
from helpers.command_line import cornercase

pytestmark = pytest.mark.filterwarnings("ignore::cornercase.NoticeWarning")

NOTEBOOK = Path(__file__).parents[2] / "docs" / "start" / "first-study.ipynb"
FILES = examples_folder() / "x_intersection"
COMMANDS = (
    f"explore {FILES / 'x_intersection.xosc'} --space {FILES / 'x_intersection.space.xosc'} --ego Ego"
    " --other Pedestrian --metric wttc --critical 0.2 --driver Ego=cautious --optimizer level-set --budget 60 --seed 1"
    " -o study.db",
    "analyze study.db --by interaction --by wttc",
    f"reduce study.db --size 12 --scenario {FILES / 'x_intersection.xosc'} -o reduced",
    f"report study.db --scenario {FILES / 'x_intersection.xosc'} -o report.html",
)
TEST = ("test", "reduced", "--require", "no collision", "--junit", "out.xml", "-o", "reduced.run.db")
# Durations differ between any two runs.
SECONDS = re.compile(r"(?<=<td class=text>)(time to [^<]*\[s\]</td><td class=text>)[^<]*")


def code_cells() -> list[str]:
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]


def rows_of(study: Path) -> dict[str, list[tuple[object, ...]]]:
    """All rows of a study but those with durations."""
    with closing(sqlite3.connect(study)) as connection:
        names = [name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        kept = sorted(name for name in names if name not in ("elapsed", "tallies"))
        return {name: sorted(connection.execute(f"SELECT * FROM {name}").fetchall(), key=repr) for name in kept}


def test_the_notebook_is_stored_without_output_and_has_at_most_twelve_lines():
    lines = [line for cell in code_cells() for line in cell.splitlines() if line.strip()]
    assert len(lines) <= 12
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    assert all(cell["outputs"] == [] for cell in cells if cell["cell_type"] == "code")


@pytest.fixture(scope="module")
def folders(tmp_path_factory) -> tuple[Path, Path, list[str]]:
    """Folder of the notebook and that of the commands, and what each cell shows."""
    interactive = pytest.importorskip("IPython.core.interactiveshell")
    notebook, commands = tmp_path_factory.mktemp("notebook"), tmp_path_factory.mktemp("commands")
    shell, pages = interactive.InteractiveShell.instance(), []
    patch = pytest.MonkeyPatch()
    try:
        patch.chdir(notebook)
        for cell in code_cells():
            result = shell.run_cell(cell)
            result.raise_error()
            formats, _ = shell.display_formatter.format(result.result)
            pages.append(formats.get("text/html", formats["text/plain"]))
    finally:
        patch.undo()
        interactive.InteractiveShell.clear_instance()
    for words in (*(command.split() for command in COMMANDS), TEST):
        done = cornercase(*words, cwd=commands)
        assert done.returncode in ((0, 1) if words is TEST else (0,)), done.stderr
    return notebook, commands, pages


def test_each_cell_shows_what_it_made(folders):
    _, _, (problem, result, reduced, report, _) = folders
    assert "critical if wttc &lt;= 0.2 s" in problem
    assert "60 scenarios done" in result
    assert reduced.count("<tr") == 14
    assert report.startswith("<iframe srcdoc=")
    assert 'sandbox="allow-scripts allow-downloads"' in report


@pytest.mark.parametrize("study", ["study.db", "reduced.run.db"])
def test_both_store_the_same_rows(folders, study):
    notebook, commands, _ = folders
    rows = rows_of(notebook / study)
    assert rows == rows_of(commands / study)
    assert len(rows["scenarios"]) == (60 if study == "study.db" else 12)


def test_both_write_the_same_files(folders):
    notebook, commands, _ = folders
    assert {path.name for path in notebook.iterdir()} == {path.name for path in commands.iterdir()}
    names = sorted(path.relative_to(notebook) for path in (notebook / "reduced").rglob("*") if path.is_file())
    for name in (*names, Path("out.xml")):
        assert (notebook / name).read_bytes() == (commands / name).read_bytes(), name


def test_both_write_the_same_report_but_for_durations(folders):
    pages = [SECONDS.sub("", (folder / "report.html").read_text(encoding="utf-8")) for folder in folders[:2]]
    assert pages[0] == pages[1]
