"""What README and the pages for users say is typed, one line after the other, in a folder where nothing else is."""

from __future__ import annotations

import shlex
import shutil
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from conftest import EXAMPLES
from documentation.test_documentation import ROOT, blocks_of
from helpers.command_line import cornercase

PAGES = [
    ROOT / "README.md",
    ROOT / "docs" / "start" / "install.md",
    ROOT / "docs" / "start" / "own-function.md",
    ROOT / "docs" / "start" / "first-scenario.md",
    ROOT / "docs" / "start" / "first-study.md",
    *sorted((ROOT / "docs" / "guide").glob("*.md")),
    *sorted((ROOT / "docs" / "howto").glob("own-*.md")),
    ROOT / "docs" / "howto" / "r157.md",
    ROOT / "docs" / "howto" / "troubleshooting.md",
    ROOT / "docs" / "howto" / "vary.md",
    ROOT / "docs" / "simulators" / "recordings.md",
    ROOT / "docs" / "simulators" / "sumo.md",
    ROOT / "docs" / "warm-starts.md",
]
# Their answer may be no.
MAY_SAY_NO = ("compare", "test")
# It serves until Ctrl-C.
NEVER_ENDS = ("watch",)
SCENARIOS, SCENARIOS_OF_AN_ESTIMATE = 40, 100
# What a user has already, where a page says `my`.
MY_FUNCTION = """
import cornercase as cc


class Aeb(cc.SystemUnderTest):
    def step(self, view, dt):
        return 0.0 if view.leader is None or view.leader.gap > 20.0 else -8.0
"""


def steps_of(page: Path) -> Iterator[tuple[str, str]]:
    """Commands and Python code of a page, in order."""
    for block in blocks_of(page):
        if block.language == "python":
            yield "python", block.text
        # Euro NCAP's files have to be had from Euro NCAP.
        elif block.language in ("", "sh") and "CPNCO" not in block.text:
            for line in block.text.replace("\\\n", " ").splitlines():
                if line.startswith("cornercase "):
                    yield "sh", line


def made_short(line: str) -> list[str]:
    """The words of a command, with fewer scenarios than a user would run."""
    words = shlex.split(line)[1:]
    most = SCENARIOS_OF_AN_ESTIMATE if words[0] == "estimate" else SCENARIOS
    if words[0] == "demo":
        words += ["--budget", str(SCENARIOS)]
    return [
        str(min(int(word), most)) if before == "--budget" else word
        for before, word in zip(["", *words[:-1]], words, strict=True)
    ]


@pytest.fixture(scope="module")
def demonstration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `make demo` leaves."""
    folder: Path = tmp_path_factory.mktemp("demonstration") / "x-intersection"
    done = cornercase("demo", "x-intersection", "--budget", "60", "-o", folder)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_what_is_printed_works_when_it_is_typed(page, demonstration, tmp_path, monkeypatch):
    shutil.copytree(demonstration, tmp_path / ("x-intersection" if page.name == "README.md" else "x"))
    shutil.copy(EXAMPLES / "r157" / "deceleration.xosc", tmp_path / "my.xosc")
    shutil.copy(EXAMPLES / "r157" / "motorway.xodr", tmp_path)
    (tmp_path / "my_aeb.py").write_text(MY_FUNCTION, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "__main__"}
    for kind, text in steps_of(page):
        if kind == "python":
            exec(compile(text, str(page), "exec"), names)
        elif (words := made_short(text))[0] not in NEVER_ENDS:
            if words[:2] == ["demo", "x-intersection"]:
                # It is there already.
                continue
            done = cornercase(*words, cwd=tmp_path)
            assert done.returncode in ((0, 1) if words[0] in MAY_SAY_NO else (0,)), f"{text}\n{done.stderr}"
            for option, value in pairwise(words):
                assert option not in ("-o", "--output", "--junit") or (tmp_path / value).exists(), text


def test_the_tour_names_every_page_for_users():
    """So that none is left out of the sidebar."""
    for folder in ("start", "guide", "howto"):
        index = (ROOT / "docs" / folder / "index.md").read_text("utf-8")
        for page in (ROOT / "docs" / folder).glob("*.md"):
            assert page.stem in index or page.name == "index.md", page
