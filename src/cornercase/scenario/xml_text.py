"""XML as text, in which attributes are replaced and nothing else changes."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final
from xml.sax.saxutils import quoteattr

from cornercase.scenario.xml import parse_xml

# Of well-formed XML without a document type declaration.
_TOKEN: Final = re.compile(
    r"<!--.*?-->|<\?.*?\?>|<!\[CDATA\[.*?\]\]>"
    r"|<(?P<close>/?)(?P<tag>[^\s/>!?]++)(?P<rest>(?:\"[^\"]*+\"|'[^']*+'|[^\"'>]++)*+)>",
    re.DOTALL,
)
_ATTRIBUTE: Final = re.compile(r"([^\s=/]+)\s*=\s*(\"[^\"]*\"|'[^']*')")


class XmlText:
    """The text of an XML document, to be changed at a few places.

    Parameters
    ----------
    content : bytes
    path : Path
        Where it comes from, for messages.

    Raises
    ------
    InputError
        As `parse_xml`.
    """

    def __init__(self, content: bytes, path: Path) -> None:
        info = parse_xml(content, path).getroottree().docinfo
        self._encoding = info.encoding or "utf-8"
        self._text = content.decode(self._encoding)
        self._starts: list[re.Match[str]] = []
        self._ends: dict[int, re.Match[str]] = {}
        self._edits: list[tuple[int, int, str]] = []
        open_: list[int] = []
        for token in _TOKEN.finditer(self._text):
            if token["tag"] is None:
                continue
            if token["close"]:
                self._ends[open_.pop()] = token
                continue
            self._starts.append(token)
            if not token["rest"].endswith("/"):
                open_.append(len(self._starts) - 1)

    def attribute(self, element: int, name: str) -> str:
        """Give the value of an attribute as it is written, without quotes; the element is the k-th of the document."""
        return self._attribute(element, name)[2]

    def set(self, element: int, name: str, value: str) -> None:
        """Write another value of an attribute that the k-th element of the document has."""
        start, end, _ = self._attribute(element, name)
        self._edits.append((start, end, quoteattr(value)))

    def fill(self, element: int, lines: list[str]) -> None:
        """Write lines as the first ones within the k-th element, which has no other elements."""
        start, end = self._starts[element], self._ends.get(element)
        inner = "".join(f"{self._newline}{self._indent(start)}  {one}" for one in lines)
        last = self._newline + self._indent(start)
        if end is None:
            opened = start[0][:-2].rstrip()
            self._edits.append((start.start(), start.end(), f"{opened}>{inner}{last}</{start['tag']}>"))
        elif self._text[start.end() : end.start()].strip():
            self._edits.append((start.end(), start.end(), inner))
        else:
            self._edits.append((start.end(), end.start(), inner + last))

    def insert(self, lines: list[str], element: int, after: bool) -> None:
        """Write lines before or after the k-th element, indented as it is."""
        start, end = self._starts[element], self._ends.get(element, self._starts[element])
        between = self._newline + self._indent(start)
        if after:
            self._edits.append((end.end(), end.end(), "".join(between + one for one in lines)))
        else:
            self._edits.append((start.start(), start.start(), "".join(one + between for one in lines)))

    def content(self) -> bytes:
        """Give the document with all changes."""
        text = self._text
        for start, end, new in sorted(self._edits, reverse=True):
            text = text[:start] + new + text[end:]
        return text.encode(self._encoding, "xmlcharrefreplace")

    def _attribute(self, element: int, name: str) -> tuple[int, int, str]:
        token = self._starts[element]
        for match in _ATTRIBUTE.finditer(self._text, *token.span("rest")):
            if match[1] == name:
                return match.start(2), match.end(2), match[2][1:-1]
        raise KeyError(name)

    @property
    def _newline(self) -> str:
        return "\r\n" if "\r\n" in self._text else "\n"

    def _indent(self, token: re.Match[str]) -> str:
        """What the line of an element begins with."""
        line = self._text[self._text.rfind("\n", 0, token.start()) + 1 : token.start()]
        return line[: len(line) - len(line.lstrip())]
