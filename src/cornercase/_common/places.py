"""File and line of an element, for messages."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from lxml import etree

from cornercase._common.errors import InputError

# The line number in a message, after the file name.
_LINE: Final = re.compile(r", line \d+\b")
_WITH_LINE: Final = re.compile(rf".+?{_LINE.pattern}")


Placed = Any
"""An object with a tag and a line in a file: an element (whose line has no static type) or a declaration."""


def file_of(element: etree._Element, otherwise: str) -> str:
    """Name of the file that an element was read from, or `default`."""
    return element.getroottree().docinfo.URL or otherwise


def line_of(element: etree._Element) -> int:
    """Line of an element in its file; 0 if unknown."""
    return element.sourceline if isinstance(element.sourceline, int) else 0


def place_of(element: Placed, source: str) -> str:
    """File and line of an element: ``"a.xosc, line 3"``."""
    return f"{source}, line {element.sourceline}" if element.sourceline else source


@contextmanager
def placed(element: Placed | None, source: str) -> Iterator[None]:
    """Prefix an `InputError` of the block with file, line and element, unless it names a line already."""
    try:
        yield
    except InputError as error:
        why = str(error)
        if element is None or not element.sourceline or _WITH_LINE.match(why):
            raise
        raise type(error)(f"{place_of(element, source)}: <{element.tag}>: {without_file(source, why)}") from None


def at_line(where: str, element: Placed) -> str:
    """Replace the line in `location` (file, line and road) by that of an element."""
    return _LINE.sub(f", line {element.sourceline}", where, count=1)


def of_file(path: Path | str, why: str) -> str:
    """Prefix a failure message with the file, unless it begins with it."""
    if why.startswith(str(path)):
        return why
    return f"{path}{', ' if why.startswith('line ') else ': '}{why}"


def without_file(source: str, why: str) -> str:
    """Remove the file from the beginning of a message."""
    return why.removeprefix(source).lstrip(",: ") if why.startswith((f"{source}:", f"{source},")) else why
