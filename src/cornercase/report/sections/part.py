"""Section of the page's details."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from markupsafe import Markup


@dataclass(frozen=True)
class Part:
    """Section of the page's details that opens when its title is clicked."""

    name: str  # for addresses and tests
    title: str  # plain text
    html: Markup  # all texts are escaped


def make_part(name: str, title: str, lines: Iterable[str]) -> Part:
    """Join lines of HTML (texts already escaped) into a section."""
    return Part(name, title, Markup("\n".join(lines)))
