"""A part of the page's details."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from markupsafe import Markup


@dataclass(frozen=True)
class Part:
    """A part of the page's details, which opens when its title is clicked.

    Attributes
    ----------
    name : str
        For addresses and tests.
    title : str
        Plain text.
    html : Markup
        HTML in which all texts are escaped.
    """

    name: str
    title: str
    html: Markup


def make_part(name: str, title: str, lines: Iterable[str]) -> Part:
    """Make a part of lines of HTML.

    Parameters
    ----------
    name, title : str
        Plain texts.
    lines : iterable of str
        HTML in which all texts are escaped.

    Returns
    -------
    Part
        The lines one after the other.
    """
    return Part(name, title, Markup("\n".join(lines)))
