"""Links between the pages, and to files of the repository, lead somewhere."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from markdown_it import MarkdownIt
from markdown_it.token import Token

ROOT = Path(__file__).parents[2]
# What `make docs` makes; the pages of the gallery come from scripts.
MADE = {"_build", "gallery", "api"}
WRITTEN_BY_SPHINX = {"reference/commands", "reference/options", "reference/api", "gallery/index"}
PAGES = [
    page
    for page in sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.md")])
    if not MADE & set(page.parts) and page.name not in ("commands.md", "options.md")
]


@cache
def tokens_of(page: Path) -> list[Token]:
    return MarkdownIt().enable("table").parse(page.read_text(encoding="utf-8"))


def inline_of(page: Path) -> Iterator[Token]:
    for token in tokens_of(page):
        yield from token.children or ()


def targets_of(page: Path) -> Iterator[str]:
    """Where the links and images of a page lead to, without those to other sites."""
    for token in inline_of(page):
        target = token.attrGet("href") or token.attrGet("src")
        if target is not None and not re.match(r"[a-z]+:", str(target)):
            yield str(target)
    # Cards and lists of pages are blocks of their own.
    text = page.read_text(encoding="utf-8")
    yield from re.findall(r"^:link: (\S+)$", text, re.MULTILINE)
    for block in re.findall(r"```\{toctree\}(.*?)```", text, re.DOTALL):
        yield from re.findall(r"^[\w./-]+$", block, re.MULTILINE)


@cache
def anchors_of(page: Path) -> set[str]:
    """Names that GitHub and Sphinx give to the headings of a page."""
    tokens = tokens_of(page)
    headings = [tokens[i + 1] for i, token in enumerate(tokens) if token.type == "heading_open"]
    texts = ["".join(child.content for child in heading.children or ()) for heading in headings]
    return {re.sub(r"[^\w\- ]", "", text.lower()).replace(" ", "-") for text in texts}


def place_of(page: Path, target: str) -> Path:
    """File that a link leads to; pages are listed without their ending."""
    place = (page.parent / target).resolve() if target else page
    return place if place.exists() else place.with_name(place.name + ".md")


def lost_links_of(page: Path) -> list[str]:
    """Links that lead to no file, or to no heading of one."""
    lost = []
    for target in targets_of(page):
        path, _, anchor = target.partition("#")
        place = place_of(page, path)
        if (place.parent.name + "/" + place.name.partition(".")[0]) in WRITTEN_BY_SPHINX:
            continue
        if not place.exists() or (anchor and anchor not in anchors_of(place)):
            lost.append(target)
    return lost


def test_links_lead_to_files_and_headings():
    assert {page: lost for page in PAGES if (lost := lost_links_of(page))} == {}


def test_there_are_links_to_look_at():
    assert sum(1 for page in PAGES for target in targets_of(page) if "#" in target) > 50


@pytest.mark.parametrize("target", ["nowhere.md", "index.md#nowhere"])
def test_what_leads_nowhere_is_found(tmp_path, target):
    (tmp_path / "index.md").write_text(f"# Somewhere\n\nSee [this]({target}).\n", encoding="utf-8")
    assert lost_links_of(tmp_path / "index.md") == [target]


def test_pages_that_the_sources_name_exist():
    files = sorted((ROOT / "src").rglob("*.py"))
    named = {name for file in files for name in re.findall(r"\bdocs/[\w/-]+\.md", file.read_text(encoding="utf-8"))}
    assert named
    assert [name for name in sorted(named) if not (ROOT / name).exists()] == []
