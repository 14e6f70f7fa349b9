"""What README, docs and docstrings say, tried: code runs, commands and names exist."""

from __future__ import annotations

import doctest
import importlib
import itertools
import pkgutil
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import typer
from markdown_it import MarkdownIt
from markdown_it.token import Token
from typer.testing import CliRunner

import cornercase
from conftest import EXAMPLES
from cornercase.cli import app
from cornercase.clustering import ASPECTS
from cornercase.drivers import DRIVERS, SENSORS
from cornercase.metrics import FEATURES, METRICS, registered_features
from cornercase.optimizers import OPTIMIZERS
from cornercase.simulators import SIMULATORS

ROOT = Path(__file__).parents[2]
# What is made by `make docs` is not ours to look at.
MADE = {"_build", "gallery", "api"}
PAGES = sorted(
    page
    for page in [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
    if not MADE & set(page.parts) and page.name not in ("commands.md", "options.md")
)
# They need nothing but the examples, or what one of them has written, and take less than a second.
CHEAP = ("check", "convert", "measure", "metrics", "simulate", "simulators")
# Options of other programs, and names that are no module's: files, and a property in OpenSCENARIO.
EXTERNAL = {"--frameRate", "--csv_logger", "--dashboard-address", "--fcd-output", "--nthreads", "--resources"}
NO_MODULES = {
    "cornercase.aspects",
    "cornercase.db",
    "cornercase.driver",
    "cornercase.features",
    "cornercase.lock",
    "cornercase.log",
    "cornercase.sensors",
    "cornercase.vehicles",
    "cornercase.xosc",
}


class Block(NamedTuple):
    page: Path
    line: int
    language: str
    text: str

    @property
    def place(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"


@cache
def tokens_of(page: Path) -> list[Token]:
    return MarkdownIt().enable("table").parse(page.read_text(encoding="utf-8"))


def blocks_of(page: Path) -> Iterator[Block]:
    """Code between fences, and indented code, for which the language is empty."""
    for token in tokens_of(page):
        if token.type in ("fence", "code_block") and token.map is not None:
            first = token.map[0] + (2 if token.type == "fence" else 1)
            yield Block(page, first, token.info, token.content)


def inline_code_of(page: Path) -> Iterator[str]:
    for token in tokens_of(page):
        yield from (child.content for child in token.children or () if child.type == "code_inline")


BLOCKS = [block for page in PAGES for block in blocks_of(page)]
# Pages for users build on what they did before: test_pages_in_order.py runs them as a whole.
IN_ORDER = {"start", "guide", "howto"}
# Their code reads a study: test_pages_with_files.py has one.
WITH_FILES = {"compare.md", "recordings.md", "mutants.md", "study-format.md"}
PYTHON = [
    block
    for block in BLOCKS
    if block.language == "python" and block.page.parent.name not in IN_ORDER and block.page.name not in WITH_FILES
]
COMMANDS = [
    (block, line)
    for block in BLOCKS
    if block.language in ("", "sh")
    for line in block.text.replace("\\\n", " ").splitlines()
    if line.startswith("cornercase ") and not line.startswith("cornercase -")
]


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A folder of its own with the examples in it, as in the root of the repository."""
    shutil.copytree(EXAMPLES, tmp_path / "examples")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("block", PYTHON, ids=lambda block: block.place)
def test_the_code_runs(block, checkout):
    if block.page.name == "README.md":
        # What is pasted from there into a file has to run in whatever folder a user is.
        shutil.rmtree("examples")
        # A quarter of the scenarios that users run.
        text = block.text.replace("budget=60", "budget=16")
        assert text != block.text
        Path("script.py").write_text(text)
        ended = subprocess.run([sys.executable, "script.py"], capture_output=True, text=True, timeout=600)
        assert ended.returncode == 0, ended.stderr
        return
    code = compile("\n" * (block.line - 1) + block.text, str(block.page), "exec")
    exec(code, {"__name__": "__main__"})


def modules() -> list[str]:
    """All modules, without importing those below the rooms."""
    return [module.name for module in pkgutil.walk_packages(cornercase.__path__, "cornercase.")]


def source_of(module: str) -> str:
    path = ROOT / "src" / Path(*module.split("."))
    return next(file for file in (path / "__init__.py", path.with_suffix(".py")) if file.exists()).read_text("utf-8")


@pytest.mark.parametrize("module", [module for module in modules() if ">>>" in source_of(module)])
def test_the_examples_of_docstrings_give_what_they_say(module, checkout):
    found = doctest.testmod(importlib.import_module(module), optionflags=doctest.NORMALIZE_WHITESPACE)
    assert found.attempted
    assert not found.failed


@cache
def command_line() -> Any:
    """All commands, as typer or click has them."""
    return typer.main.get_command(app)


def parsed(line: str) -> dict[str, Any]:
    """Arguments and options of the command that a line calls."""
    words = itertools.takewhile(lambda word: word != ">", shlex.split(line, comments=True)[1:])
    name, *given = [word for word in words if word != "…"]
    command = command_line().commands[name]
    try:
        return dict(command.make_context(name, given).params)
    except typer.exceptions.TyperException as error:
        if "…" in line and "Missing" in str(error):
            return {}
        raise


def unknown_names(line: str) -> list[str]:
    """Metrics, searches and simulators of a command that there are none of."""
    given = parsed(line)
    unknown = []
    for option, registry in (("metric", METRICS), ("optimizer", OPTIMIZERS), ("simulator", SIMULATORS)):
        names = given.get(option) or ()
        named = [name.partition(":")[0] for name in ([names] if isinstance(names, str) else names)]
        unknown += [name for name in named if name not in registry.names()]
    return unknown


def test_the_command_line_takes_the_commands(tmp_path, monkeypatch):
    refused = {}
    for page in {block.page: None for block, _ in COMMANDS}:
        (folder := tmp_path / "-".join(page.parts[1:])).mkdir()
        monkeypatch.chdir(folder)
        for block in blocks_of(page):
            if block.language == "toml" and block.text.startswith("scenario"):
                (folder / "study.toml").write_text(block.text, encoding="utf-8")
        for block, line in COMMANDS:
            if block.page == page:
                try:
                    unknown = unknown_names(line)
                except Exception as error:
                    refused[f"{block.place}: {line}"] = [str(error)]
                else:
                    if unknown:
                        refused[f"{block.place}: {line}"] = unknown
    assert refused == {}


def is_cheap(line: str) -> bool:
    return shlex.split(line)[1] in CHEAP and "…" not in line


@pytest.mark.parametrize(
    "page", sorted({block.page for block, line in COMMANDS if is_cheap(line)}), ids=lambda page: page.name
)
def test_the_cheap_commands_run_where_their_files_are(page, checkout):
    (checkout / "my_module.py").write_text("from cornercase.drivers import SimpleDriver as MyDriver\n")
    for block, line in COMMANDS:
        if block.page == page and is_cheap(line):
            given = [value for name, value in parsed(line).items() if name != "output"]
            several = [one for value in given if isinstance(value, list | tuple) for one in value]
            files = [value for value in (*given, *several) if isinstance(value, Path)]
            if all(file.exists() for file in files):
                result = CliRunner().invoke(app, shlex.split(line)[1:])
                assert result.exit_code == 0, f"{block.place}: {result.output}"


def test_the_options_that_are_named_exist():
    group = command_line()
    commands = group.commands
    known = {name for command in (group, *commands.values()) for one in command.params for name in one.opts} | EXTERNAL
    wrong = []
    for page, code in [(one, code) for one in PAGES for code in inline_code_of(one)]:
        if (benchmark := re.match(r"python (benchmarks/\w+\.py)", code)) is not None:
            here = (ROOT / benchmark[1]).read_text("utf-8")
            right = all(f'"{option}"' in here for option in re.findall(r"--[\w-]+", code))
        else:
            options = re.findall(r"(?<![\w-])--[\w-]+", code) if code.startswith(("--", "cornercase ")) else ()
            command = re.match(r"cornercase (?:--\w+ )*([a-z][a-z-]*)", code)
            right = set(options) <= known and (command is None or command[1] in commands)
        if not right:
            wrong.append((page.name, code))
    assert wrong == []


def names_in(text: str) -> Iterator[str]:
    """Names such as cornercase.metrics.METRICS."""
    return (match[0] for match in re.finditer(r"(?<![\w/.@-])cornercase(?:\.[A-Za-z_]\w*)+", text))


def exists(name: str) -> bool:
    try:
        pkgutil.resolve_name(name)
    except (ImportError, AttributeError):
        return False
    return True


def test_the_names_that_are_named_exist():
    files = (*PAGES, *sorted((ROOT / "src").rglob("*.py")))
    named = {file: set(names_in(file.read_text("utf-8"))) - NO_MODULES for file in files}
    unknown = {name for name in set().union(*named.values()) if not exists(name)}
    assert unknown == set(), [str(file) for file, names in named.items() if names & unknown]


def own_names(registry: Any) -> list[str]:
    """Names of what is cornercase's own; other tests register parts of theirs."""
    factories = {name: registry.get_factory(name) for name in registry.names()}
    return [name for name, one in factories.items() if getattr(one, "func", one).__module__.startswith("cornercase.")]


@pytest.mark.parametrize(
    ("registry", "page"),
    [
        (METRICS, "metrics.md"),
        (FEATURES, "metrics.md"),
        (OPTIMIZERS, "exploration.md"),
        (DRIVERS, "drivers.md"),
        (SENSORS, "sensors.md"),
        (ASPECTS, "reduction.md"),
    ],
)
def test_all_that_has_a_name_is_described(registry, page):
    described = set(inline_code_of(ROOT / "docs" / page))
    assert own_names(registry)
    assert [name for name in own_names(registry) if name not in described] == []


def test_every_feature_is_described():
    described = set(inline_code_of(ROOT / "docs" / "metrics.md"))
    assert [one.name for one in registered_features() if one.name not in described] == []


def test_every_simulator_has_a_page():
    pages = {page.stem for page in (ROOT / "docs" / "simulators").glob("*.md")} | {"builtin"}
    assert own_names(SIMULATORS)
    assert [name for name in own_names(SIMULATORS) if name not in pages] == []


def test_the_files_that_are_named_exist():
    """Relative to the repository, to the package, or to the builtin simulator."""
    places = (ROOT, ROOT / "src", ROOT / "src" / "cornercase", ROOT / "src" / "cornercase" / "simulators" / "builtin")
    files = [
        (page.name, code)
        for page in PAGES
        for code in inline_code_of(page)
        if re.fullmatch(r"(src|tests|docs|benchmarks|[a-z_]+)/[\w/]*(\.py|\.pyi|\.md)?", code)
        # Elements of road files are called by those above them.
        and (page.name != "opendrive.md" or "." in code)
    ]
    assert files
    lost = [one for one in files if "NAME" not in one[1] and not any((place / one[1]).exists() for place in places)]
    assert lost == []


def test_who_cites_names_the_version_that_is_there():
    assert f"version: {cornercase.__version__}\n" in (ROOT / "CITATION.cff").read_text("utf-8")
