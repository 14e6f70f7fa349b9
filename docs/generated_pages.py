"""Pages of the reference that are made from the program: its commands, and its public names."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Sequence
from pathlib import Path
from types import GenericAlias

from typer.main import get_command
from typer.testing import CliRunner

from cornercase.cli import app

# In the order in which data goes through them.
ROOMS = (
    "scenario", "roads", "recordings", "drivers", "simulators", "metrics", "study", "evidence", "optimizers",
    "exploration", "dtw", "clustering", "reduction", "suite", "report",
)  # fmt: skip

# Of the package itself.
_WITHOUT_ROOM = ("InputError", "NoticeWarning", "SimulationError")

_INTRODUCTION = """\
Each command is a function of the same name. What third parties build on are the base classes and the registries; the
rooms hold the parts."""

_EXIT_CODES = """\
# Commands

`cornercase COMMAND --help` prints what stands here. Exit codes are 0 for done; 1 where the answer is *no*, as when a
requirement was violated or versions differ; 2 where the input cannot be used, and a sentence says why; 130 after
Ctrl-C.
"""


def write_commands(page: Path) -> None:
    """Write the help texts of all commands.

    Parameters
    ----------
    page : Path
        Markdown file to write.
    """
    parts = [_EXIT_CODES]
    for name in get_command(app).commands:  # type: ignore[attr-defined]
        shown = CliRunner().invoke(app, [name, "--help"], env={"COLUMNS": "100"}, prog_name="cornercase")
        parts.append(f"## {name}\n\n```text\n{shown.stdout.strip()}\n```\n")
    page.write_text("\n".join(parts), encoding="utf-8")


def write_names(page: Path, folder: Path) -> None:
    """Write a page with the names that the package shows, and one for each room.

    Parameters
    ----------
    page : Path
        File to write, in reStructuredText.
    folder : Path
        For the pages of the rooms.
    """
    folder.mkdir(exist_ok=True)
    rooms = "\n".join(f"   api/{room}" for room in ROOMS)
    page.write_text(
        f"Python\n======\n\n{_INTRODUCTION}\n\n{_first_lines()}\n{_table('cornercase', _WITHOUT_ROOM, 'api/names')}\n"
        f"Rooms\n-----\n\n.. toctree::\n   :maxdepth: 1\n\n{rooms}\n",
        encoding="utf-8",
    )
    for room in ROOMS:
        name = f"cornercase.{room}"
        module = importlib.import_module(name)
        text = f"{name}\n{'=' * len(name)}\n\n{inspect.getdoc(module)}\n\n{_table(name, dir(module), 'names')}"
        (folder / f"{room}.rst").write_text(text, encoding="utf-8")


def _first_lines() -> str:
    """List what the package shows: each name stands on the page of its room, so here is a link and its first line."""
    package = importlib.import_module("cornercase")
    lines = [".. list-table::", "   :widths: 30 70", ""]
    for name in dir(package):
        shown = getattr(package, name)
        if name.startswith("_") or name in _WITHOUT_ROOM or inspect.ismodule(shown):
            continue
        room = next(one for one in ROOMS if name in dir(importlib.import_module(f"cornercase.{one}")))
        first = (inspect.getdoc(shown) or "").partition("\n")[0]
        lines += [f"   * - :py:obj:`cornercase.{name} <cornercase.{room}.{name}>`", f"     - {first}"]
    return "\n".join(lines) + "\n"


def _table(module: str, names: Sequence[str], folder: str) -> str:
    package = importlib.import_module(module)
    # Types of others have their documentation elsewhere.
    shown = [
        name
        for name in names
        if not name.startswith("_")
        and not inspect.ismodule(getattr(package, name))
        and not isinstance(getattr(package, name), GenericAlias)
    ]
    lines = "\n".join(f"   {name}" for name in shown)
    return f".. currentmodule:: {module}\n\n.. autosummary::\n   :toctree: {folder}\n   :nosignatures:\n\n{lines}\n"
