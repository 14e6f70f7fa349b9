"""Edit attributes of an XML file and keep the rest of its text unchanged."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final
from xml.sax.saxutils import quoteattr

from cornercase.scenario._xml import FALLBACK_ENCODING, parse_xml

# Tokens of well-formed XML without a document type declaration.
_TOKEN: Final = re.compile(
    r"<!--.*?-->|<\?.*?\?>|<!\[CDATA\[.*?\]\]>"
    r"|<(?P<close>/?)(?P<tag>[^\s/>!?]++)(?P<rest>(?:\"[^\"]*+\"|'[^']*+'|[^\"'>]++)*+)>",
    re.DOTALL,
)
_ATTRIBUTE: Final = re.compile(r"([^\s=/]+)\s*=\s*(\"[^\"]*\"|'[^']*')")


class XmlEditor:
    """Text of an XML document with pending edits; an element is identified by its index in document order."""

    def __init__(self, content: bytes, path: Path) -> None:
        info = parse_xml(content, path).getroottree().docinfo
        self._encoding = info.encoding or "utf-8"
        try:
            self._text = content.decode(self._encoding)
        except UnicodeDecodeError:
            # As `parse_xml` reads it.
            self._encoding = FALLBACK_ENCODING
            self._text = content.decode(self._encoding, errors="replace")
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

    def get_attribute(self, element_index: int, name: str) -> str:
        """Return the value of an attribute as written, without quotes."""
        return self._find_attribute(element_index, name)[2]

    def set_attribute(self, element_index: int, name: str, value: str) -> None:
        """Replace the value of an existing attribute."""
        start, end, _ = self._find_attribute(element_index, name)
        self._edits.append((start, end, quoteattr(value)))

    def insert_children(self, element_index: int, lines: list[str]) -> None:
        """Insert lines as the content of an element that has no children."""
        start, end = self._starts[element_index], self._ends.get(element_index)
        block = "".join(f"{self._newline}{self._indentation(start)}  {line}" for line in lines)
        closing_indent = self._newline + self._indentation(start)
        if end is None:
            opened = start[0][:-2].rstrip()
            self._edits.append((start.start(), start.end(), f"{opened}>{block}{closing_indent}</{start['tag']}>"))
        elif self._text[start.end() : end.start()].strip():
            self._edits.append((start.end(), start.end(), block))
        else:
            self._edits.append((start.end(), end.start(), block + closing_indent))

    def insert_sibling_lines(self, lines: list[str], element_index: int, after: bool) -> None:
        """Insert lines before or after an element, indented like the element."""
        start, end = self._starts[element_index], self._ends.get(element_index, self._starts[element_index])
        between = self._newline + self._indentation(start)
        if after:
            self._edits.append((end.end(), end.end(), "".join(between + line for line in lines)))
        else:
            self._edits.append((start.start(), start.start(), "".join(line + between for line in lines)))

    def edited_content(self) -> bytes:
        """Return the document with all edits."""
        text = self._text
        for start, end, replacement in sorted(self._edits, reverse=True):
            text = text[:start] + replacement + text[end:]
        return text.encode(self._encoding, "xmlcharrefreplace")

    def _find_attribute(self, element_index: int, name: str) -> tuple[int, int, str]:
        token = self._starts[element_index]
        for match in _ATTRIBUTE.finditer(self._text, *token.span("rest")):
            if match[1] == name:
                return match.start(2), match.end(2), match[2][1:-1]
        raise KeyError(name)

    @property
    def _newline(self) -> str:
        return "\r\n" if "\r\n" in self._text else "\n"

    def _indentation(self, token: re.Match[str]) -> str:
        """Return the white space before an element."""
        line = self._text[self._text.rfind("\n", 0, token.start()) + 1 : token.start()]
        return line[: len(line) - len(line.lstrip())]
