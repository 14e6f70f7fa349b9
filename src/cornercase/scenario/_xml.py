"""Parse untrusted XML files."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.io.files import read_file
from cornercase._common.io.tracked_xml import make_tracking_parser, note_adaptation
from cornercase._common.text.element_locations import format_location
from cornercase.scenario._normalize import normalize_openscenario
from cornercase.scenario._other_formats import describe_non_xml_format

FALLBACK_ENCODING: Final = "cp1252"
"""Encoding in which a file is read if neither the declared encoding nor UTF-8 fits."""
_MAX_NESTING: Final = 200
# XML declaration, with misplaced white space and comments before it.
_XML_DECLARATION: Final = re.compile(r"((?>\s+|<!--(?:(?!-->).)*-->)*)<\?xml\s[^>]*\?>", re.DOTALL)

# Allowed content before a document type declaration.
_XML_PROLOGUE: Final = re.compile(r"(?>\ufeff|\s+|<!--.*?-->|<\?.*?\?>)*", re.DOTALL)


def read_xml(path: Path | str) -> etree._Element:
    """Parse an XML file of at most 200 MB; see `parse_xml`."""
    return parse_xml(read_file(path), path)


def parse_xml(data: bytes, path: Path | str) -> etree._Element:
    """Parse XML without resolving entities or fetching anything; `path` is for messages.

    Raises `InputError` for malformed XML, document type declarations, and nesting of more than 200 levels.
    """
    try:
        root = _parse_strictly(data, path)
    except etree.XMLSyntaxError as error:
        if description := describe_non_xml_format(data):
            raise InputError(f"{path}: {description}.") from error
        mended = _parse_leniently(data, path)
        if mended is None:
            raise InputError(f"{path}, line {error.lineno or 1}: is not well-formed XML ({error.msg}).") from error
        root = mended
    if root.getroottree().docinfo.internalDTD is not None:
        text = data.decode(root.getroottree().docinfo.encoding or "utf-8", errors="replace")
        prologue = _XML_PROLOGUE.match(text)
        assert prologue is not None, "it may be empty"
        line = prologue[0].count("\n") + 1
        raise InputError(
            f"{path}, line {line}: has a document type declaration, which is not read; remove <!DOCTYPE …>."
        )
    depth = 0
    for event, element in etree.iterwalk(root, events=("start", "end")):
        depth += 1 if event == "start" else -1
        if depth > _MAX_NESTING:
            raise InputError(
                f"{format_location(element, str(path))}: elements are nested more than {_MAX_NESTING} deep."
            )
    return root


def _parse_strictly(data: bytes, path: Path | str) -> etree._Element:
    parser = make_tracking_parser(
        resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False, remove_comments=False
    )
    # The base URL records the file of each element; nothing is fetched.
    return etree.fromstring(data, parser, base_url=str(path))


def _parse_leniently(data: bytes, path: Path | str) -> etree._Element | None:
    """Parse XML whose only errors are in the XML declaration, the encoding or comments.

    Return None if the XML has other errors.
    """
    try:
        text, encoding = data.decode("utf-8-sig"), "UTF-8"
    except UnicodeDecodeError:
        text, encoding = data.decode(FALLBACK_ENCODING, errors="replace"), "Windows-1252"
    faults = []
    declaration = _XML_DECLARATION.match(text)
    if declaration is not None:
        # Keep what comes before, so that line numbers stay correct.
        text = declaration[1] + text[declaration.end() :]
        if declaration[1]:
            faults.append(
                ("XML declaration", "it is read as if it stood at the beginning", "it stands at the beginning")
            )
    mended = _replace_double_hyphens(text)
    if mended != text:
        faults.append(("comments that hold '--'", "they are read as comments", "a comment holds no '--'"))
    try:
        root = _parse_strictly(mended.encode("utf-8"), path)
    except etree.XMLSyntaxError:
        return None
    if not faults or encoding != "UTF-8":
        faults.append(("encoding", f"the file is read as {encoding}", "the declaration names the encoding"))
    for subject, effect, rule in faults:
        note_adaptation(root, subject, effect, f"{rule} (XML 1.0)")
    return root


def _replace_double_hyphens(text: str) -> str:
    """Replace double hyphens inside comments, where XML forbids them; a comment ends at the first "-->"."""
    pieces, position = [], 0
    while (start := text.find("<!--", position)) >= 0 and (end := text.find("-->", start + 4)) >= 0:
        comment = text[start + 4 : end].replace("--", "__")
        pieces += [text[position : start + 4], comment[:-1] + "_" if comment.endswith("-") else comment]
        position = end
    return "".join((*pieces, text[position:]))


class XmlFileCache:
    """Cache of XML files that belong together; each file is read and parsed once, when it is first needed.

    Parsing and checksum use the same content, even if the file changes in between. Elements record which of their
    attributes were read; a `SupportTable` reports the other attributes.
    """

    def __init__(self) -> None:
        self._data: dict[Path, bytes] = {}
        self._roots: dict[Path, etree._Element] = {}
        self._elements: dict[Path, list[etree._Element]] = {}

    def sha256(self, path: Path) -> bytes:
        """Return the SHA-256 of a file's content."""
        return hashlib.sha256(self.read_bytes(path)).digest()

    def get_root(self, path: Path) -> etree._Element:
        """Return the root element of a file, with violations of the standard corrected.

        Do not change it, since all callers share the same object.
        """
        if path not in self._roots:
            self._roots[path] = root = parse_xml(self.read_bytes(path), path)
            # lxml elements lose their records when they are garbage-collected, so keep them.
            self._elements[path] = list(root.iter())
            normalize_openscenario(root)
        return self._roots[path]

    def update(self, other: XmlFileCache) -> None:
        """Add the files of another cache."""
        self._data |= other._data
        self._roots |= other._roots
        self._elements |= other._elements

    def parsed_roots(self) -> dict[Path, etree._Element]:
        """Return the root elements of the files that were parsed, by path."""
        return dict(self._roots)

    def read_bytes(self, path: Path) -> bytes:
        """Return the content of a file as it was first read."""
        if path not in self._data:
            self._data[path] = read_file(path)
        return self._data[path]
