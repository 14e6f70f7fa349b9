"""Pages of the reference that are made from the program: its commands, and its public names."""

from __future__ import annotations

import ast
import importlib
import inspect
import itertools
import re
import textwrap
from collections.abc import Sequence
from pathlib import Path
from types import GenericAlias
from typing import Any

from typer.main import get_command
from typer.testing import CliRunner

from cornercase._common.registry import Registry
from cornercase.cli import app
from cornercase.exploration._explore_options import OPTIONS
from cornercase.metrics import METRICS, Metric
from cornercase.optimizers import OPTIMIZERS
from cornercase.simulators import SIMULATORS

DOCS = Path(__file__).parent

# In the order in which data goes through them.
ROOMS = (
    "scenario", "roads", "recordings", "drivers", "simulators", "metrics", "study", "evidence", "optimizers",
    "stop", "exploration", "dtw", "clustering", "reduction", "suite", "report", "api",
)  # fmt: skip

# Of the package itself.
_WITHOUT_ROOM = ("InputError", "NoticeWarning", "SimulationError", "SimulatorError")

_INTRODUCTION = """\
`Problem` says what is searched, a simulator and `Runs` how it is run, an optimizer where to look next; `Study` holds
everything that was run and has the verbs, and `Suite` runs the few again. Each command is also a function. What third
parties build on are the base classes and the registries; the rooms hold the parts."""

_EXIT_CODES = """\
# Commands

`cornercase COMMAND --help` prints what stands here. Exit codes are 0 for done; 1 where the answer is *no*, as when a
requirement was violated or versions differ; 2 where the input cannot be used, and a sentence says why; 130 after
Ctrl-C.
"""

# What to read before, or instead of, the help of a command.
GUIDES = {
    "check": "guide/scenario.md",
    "vary": "howto/vary.md",
    "explore": "guide/search.md",
    "demo": "start/first-study.md",
    "paper": "paper.md",
    "show": "start/reading-the-report.md",
    "analyze": "guide/kinds.md",
    "reduce": "guide/reduced-set.md",
    "report": "report.md",
    "watch": "report.md",
    "replay": "report.md",
    "export": "study-format.md",
    "test": "guide/suite.md",
    "compare": "guide/versions.md",
    "estimate": "guide/probability.md",
    "simulate": "simulators/recordings.md",
    "measure": "simulators/recordings.md",
    "import": "simulators/recordings.md",
    "convert": "simulators/carla.md",
    "metrics": "guide/criticality.md",
    "simulators": "support.md",
    "drivers": "drivers.md",
    "check-sut": "howto/check-your-own.md",
    "check-simulator": "howto/check-your-own.md",
    "verify": "reliability.md",
    "warm-up": "explanation/compiling.md",
}

_OPTIONS = """\
# Options of a search

What `cornercase explore` takes on the command line, `cornercase.explore` in Python, and a study file (`explore --config
study.toml`) under the name of the command line without the dashes. A study file names no code, no programs and nowhere
to write, so that one that somebody sent can be used. `cornercase show study.db --config` prints the file of a study.
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
        title = (DOCS / GUIDES[name]).read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")
        parts.append(f"## {name}\n\nGuide: [{title}](../{GUIDES[name]})\n\n```text\n{shown.stdout.strip()}\n```\n")
    page.write_text("\n".join(parts), encoding="utf-8")


def write_options(page: Path) -> None:
    """Write the options of an exploration: their names on the command line, in study files and in Python.

    Parameters
    ----------
    page : Path
        Markdown file to write.
    """
    parts = [_OPTIONS]
    for panel, options in itertools.groupby(OPTIONS.values(), key=lambda option: option.panel):
        parts.append(
            f"\n## {panel}\n\n| command line | Python | default | in a file | |\n| --- | --- | --- | --- | --- |"
        )
        for option in options:
            shown = f"{option.flag} {option.metavar or ''}".rstrip().replace("|", "\\|")
            default = (
                "required" if option.default is ... else "" if option.is_empty_by_default else f"`{option.default}`"
            )
            file = "yes" if option.in_file else "no"
            parts.append(f"| `{shown}` | `{option.name}` | {default} | {file} | {option.help.replace('*', '&#42;')} |")
    page.write_text("\n".join(parts) + "\n", encoding="utf-8")


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


def describe_registration(cls: type) -> str:
    """Say which texts name a class in arguments and on the command line, and from which score a metric is critical.

    Parameters
    ----------
    cls : type
        Any class.

    Returns
    -------
    str
        Empty if the class is not registered.
    """
    registries: tuple[Registry[Any], ...] = (METRICS, OPTIMIZERS, SIMULATORS)
    names = [name for registry in registries for name in registry.names() if registry.get_class(name) is cls]
    if not names:
        return ""
    sentence = f"As text: {', '.join(f'``{name}``' for name in names)}."
    if not issubclass(cls, Metric):
        return sentence
    if cls.default_threshold is None:
        return f"{sentence} Without a default threshold."
    # Of a formula, options decide on the unit.
    unit = f" {cls.unit}" if isinstance(cls.unit, str) and cls.unit != "1" else ""
    return f"{sentence} Default threshold: {cls.default_threshold:g}{unit}."


def add_registration(_app: Any, kind: str, _name: str, shown: Any, _options: Any, lines: list[str]) -> None:
    """Add what `describe_registration` says to the docstring of a class, below its first paragraph; for Sphinx.

    Parameters
    ----------
    kind : str
        What is documented: ``"class"``.
    shown : object
        The class.
    lines : list of str
        Its docstring; is changed.
    """
    sentence = describe_registration(shown) if kind == "class" else ""
    if sentence:
        end = lines.index("") if "" in lines else len(lines)
        lines[end:end] = ["", sentence]


def _first_lines() -> str:
    """List what the package shows: each name stands on the page of its room, so here is a link and its first line.

    Modules that it shows have a page each.
    """
    package = importlib.import_module("cornercase")
    lines = [".. list-table::", "   :widths: 30 70", ""]
    for name in dir(package):
        shown = getattr(package, name)
        if name.startswith("_") or name in _WITHOUT_ROOM:
            continue
        if inspect.ismodule(shown):
            room = shown.__name__.removeprefix("cornercase.")
            if room in ROOMS:
                first = (inspect.getdoc(shown) or "").partition("\n")[0]
                lines += [f"   * - :doc:`cornercase.{name} <api/{room}>`", f"     - {first}"]
            continue
        # Public objects that stand on those of a room have the same name.
        room = next(one for one in ("api", *ROOMS) if name in dir(importlib.import_module(f"cornercase.{one}")))
        first = _about(f"cornercase.{room}", name).partition("\n")[0]
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
    values = [name for name in shown if _is_value(getattr(package, name))]
    lines = "\n".join(f"   {name}" for name in shown if name not in values)
    table = f".. autosummary::\n   :toctree: {folder}\n   :nosignatures:\n\n{lines}\n"
    described = "\n".join(_describe(module, name) for name in values)
    return f".. currentmodule:: {module}\n\n{table}" + (
        f"\nValues and types\n----------------\n\n{described}" if values else ""
    )


def _is_value(shown: object) -> bool:
    """Whether something has no docstring of its own: a constant, a registry, or a type that others make up."""
    return not (inspect.isclass(shown) or inspect.isroutine(shown))


def _describe(module: str, name: str) -> str:
    shown = getattr(importlib.import_module(module), name)
    value = f"   :value: {shown!r}\n" if isinstance(shown, str | float | int) else ""
    return f".. py:data:: {name}\n{value}\n" + textwrap.indent(_about(module, name), "   ") + "\n"


def _about(module: str, name: str) -> str:
    """Return a docstring; that of a value stands below it in the source."""
    package = importlib.import_module(module)
    if not _is_value(getattr(package, name)):
        return inspect.getdoc(getattr(package, name)) or ""
    stub = Path(inspect.getfile(package)).with_suffix(".pyi").read_text(encoding="utf-8")
    source = re.search(rf"^from \.([\w.]+) import {name} as {name}$", stub, re.MULTILINE)
    if source is None:
        raise ValueError(f"{module}: says nowhere where {name} comes from")
    origin = importlib.import_module(f"{module}.{source[1]}")
    statements = ast.parse(inspect.getsource(origin)).body
    for before, after in itertools.pairwise(statements):
        targets = before.targets if isinstance(before, ast.Assign) else [getattr(before, "target", None)]
        if any(isinstance(one, ast.Name) and one.id == name for one in targets) and (
            isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) and isinstance(after.value.value, str)
        ):
            return inspect.cleandoc(after.value.value)
    raise ValueError(f"{module}.{name}: has no docstring below it")
