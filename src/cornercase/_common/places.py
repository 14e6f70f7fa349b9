"""Where in a file something stands, for messages."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from lxml import etree

from cornercase._common.errors import InputError

# A message that names a line, behind the file that it is of.
_LINE: Final = re.compile(r", line \d+\b")
_WITH_LINE: Final = re.compile(rf".+?{_LINE.pattern}")


Placed = Any
"""What has a tag and a line in a file: an element, whose line has no static type, or a declaration."""


def file_of(element: etree._Element, otherwise: str) -> str:
    """Name of the file that an element was read from, if that is known."""
    return element.getroottree().docinfo.URL or otherwise


def line_of(element: etree._Element) -> int:
    """Line of an element in its file; 0 where that is not known."""
    return element.sourceline if isinstance(element.sourceline, int) else 0


def place_of(element: Placed, source: str) -> str:
    """File and line of an element: ``"a.xosc, line 3"``."""
    return f"{source}, line {element.sourceline}" if element.sourceline else source


@contextmanager
def placed(element: Placed | None, source: str) -> Iterator[None]:
    """Name the file, line and element in an `InputError` of a block that reads it, unless the error names a line."""
    try:
        yield
    except InputError as error:
        why = str(error)
        if element is None or not element.sourceline or _WITH_LINE.match(why):
            raise
        raise type(error)(f"{place_of(element, source)}: <{element.tag}>: {without_file(source, why)}") from None


def at_line(where: str, element: Placed) -> str:
    """File, line and road of an element, where those of its road are given."""
    return _LINE.sub(f", line {element.sourceline}", where, count=1)


def of_file(path: Path | str, why: str) -> str:
    """Put the file before why a scenario of it failed, which may begin with the file, or with a line of it."""
    if why.startswith(str(path)):
        return why
    return f"{path}{', ' if why.startswith('line ') else ': '}{why}"


def without_file(source: str, why: str) -> str:
    """Leave out the file at the begin of what is wrong with it."""
    return why.removeprefix(source).lstrip(",: ") if why.startswith((f"{source}:", f"{source},")) else why
