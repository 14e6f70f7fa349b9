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
_LINE_PATTERN: Final = re.compile(r", line \d+\b")
_STARTS_WITH_LINE: Final = re.compile(rf".+?{_LINE_PATTERN.pattern}")


HasLine = Any
"""An object with a tag and a line in a file: an element (whose line has no static type) or a declaration."""


def file_name_of_element(element: etree._Element, default: str) -> str:
    """Name of the file that an element was read from, or `default`."""
    return element.getroottree().docinfo.URL or default


def line_number(element: etree._Element) -> int:
    """Line of an element in its file; 0 if unknown."""
    return element.sourceline if isinstance(element.sourceline, int) else 0


def format_location(element: HasLine, source: str) -> str:
    """File and line of an element: ``"a.xosc, line 3"``."""
    return f"{source}, line {element.sourceline}" if element.sourceline else source


@contextmanager
def locate_input_errors(element: HasLine | None, source: str) -> Iterator[None]:
    """Prefix an `InputError` of the block with file, line and element, unless it names a line already."""
    try:
        yield
    except InputError as error:
        why = str(error)
        if element is None or not element.sourceline or _STARTS_WITH_LINE.match(why):
            raise
        raise type(error)(
            f"{format_location(element, source)}: <{element.tag}>: {remove_file_prefix(source, why)}"
        ) from None


def replace_line(location: str, element: HasLine) -> str:
    """Replace the line in `location` (file, line and road) by that of an element."""
    return _LINE_PATTERN.sub(f", line {element.sourceline}", location, count=1)


def prefix_file(path: Path | str, message: str) -> str:
    """Prefix a failure message with the file, unless it begins with it."""
    if message.startswith(str(path)):
        return message
    return f"{path}{', ' if message.startswith('line ') else ': '}{message}"


def remove_file_prefix(source: str, message: str) -> str:
    """Remove the file from the beginning of a message."""
    return message.removeprefix(source).lstrip(",: ") if message.startswith((f"{source}:", f"{source},")) else message
