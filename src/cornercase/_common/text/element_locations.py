"""File and line of an XML element, for messages."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from lxml import etree

from cornercase._common.errors import InputError

# The line number in a message, after the file name.
_LINE_PATTERN: Final = re.compile(r", line \d+\b")
_STARTS_WITH_LINE: Final = re.compile(rf".+?{_LINE_PATTERN.pattern}")


HasLine = Any
"""An object with a tag and a line in a file: an element (whose line has no static type) or a declaration."""


def file_name_of_element(element: etree._Element, default: str) -> str:
    """Return the name of the file that an element was read from; `default` if it is unknown."""
    return element.getroottree().docinfo.URL or default


def line_number(element: etree._Element) -> int:
    """Return the line of an element in its file; 0 if it is unknown."""
    return element.sourceline if isinstance(element.sourceline, int) else 0


def format_location(element: HasLine, source: str) -> str:
    """Return file and line of an element as text: ``"a.xosc, line 3"``."""
    return f"{source}, line {element.sourceline}" if element.sourceline else source


@contextmanager
def add_location_to_input_errors(element: HasLine | None, source: str) -> Iterator[None]:
    """Put file, line and tag before the message of an `InputError` in the block, unless the message names a line."""
    try:
        yield
    except InputError as error:
        why = str(error)
        if element is None or not element.sourceline or _STARTS_WITH_LINE.match(why):
            raise
        raise type(error)(
            f"{format_location(element, source)}: <{element.tag}>: {remove_file_prefix(source, why)}"
        ) from None


def replace_line_number(location: str, element: HasLine) -> str:
    """Return `location`, a text such as ``"a.xodr, line 3, road 1"``, with the line number of another element."""
    return _LINE_PATTERN.sub(f", line {element.sourceline}", location, count=1)


def prefix_file(path: Path | str, message: str) -> str:
    """Put the name of the file before a message, unless the message begins with it."""
    if message.startswith(str(path)):
        return message
    return f"{path}{', ' if message.startswith('line ') else ': '}{message}"


def remove_file_prefix(source: str, message: str) -> str:
    """Remove the name of the file from the beginning of a message."""
    return message.removeprefix(source).lstrip(",: ") if message.startswith((f"{source}:", f"{source},")) else message
