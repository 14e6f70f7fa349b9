"""Reading XML of unknown origin."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.files import read_file
from cornercase._common.places import place_of
from cornercase._common.recorded_xml import adapt, recording_parser
from cornercase.scenario.adapting import adapt_openscenario
from cornercase.scenario.dialects import other_language

_DEEPEST: Final = 200
# The declaration of XML, which should stand first, with the white space and comments before it.
_DECLARATION: Final = re.compile(r"((?>\s+|<!--(?:(?!-->).)*-->)*)<\?xml\s[^>]*\?>", re.DOTALL)

# What may stand before a document type declaration.
_PROLOGUE: Final = re.compile(r"(?>\ufeff|\s+|<!--.*?-->|<\?.*?\?>)*", re.DOTALL)


def read_xml(path: Path | str) -> etree._Element:
    """Root of an XML file; entities are never resolved and nothing is fetched.

    Parameters
    ----------
    path : path
        At most 200 MB, nested at most 200 deep.

    Returns
    -------
    lxml element

    Raises
    ------
    InputError
        The file cannot be read, is no XML, has a document type declaration, or is too large or too deep.
    """
    return parse_xml(read_file(path), path)


def parse_xml(data: bytes, path: Path | str) -> etree._Element:
    """Root of an XML document; entities are never resolved and nothing is fetched.

    Parameters
    ----------
    data : bytes
    path : path
        Where it comes from, for messages.

    Returns
    -------
    lxml element

    Raises
    ------
    InputError
        It is no XML, has a document type declaration, or is nested more than 200 deep.
    """
    try:
        root = _parsed(data, path)
    except etree.XMLSyntaxError as error:
        if other := other_language(data):
            raise InputError(f"{path}: {other}.") from error
        mended = _parsed_leniently(data, path)
        if mended is None:
            raise InputError(f"{path}, line {error.lineno or 1}: is not well-formed XML ({error.msg}).") from error
        root = mended
    if root.getroottree().docinfo.internalDTD is not None:
        text = data.decode(root.getroottree().docinfo.encoding or "utf-8", errors="replace")
        prologue = _PROLOGUE.match(text)
        assert prologue is not None, "it may be empty"
        line = prologue[0].count("\n") + 1
        raise InputError(
            f"{path}, line {line}: has a document type declaration, which is not read; remove <!DOCTYPE …>."
        )
    depth = 0
    for event, element in etree.iterwalk(root, events=("start", "end")):
        depth += 1 if event == "start" else -1
        if depth > _DEEPEST:
            raise InputError(f"{place_of(element, str(path))}: elements are nested more than {_DEEPEST} deep.")
    return root


def _parsed(data: bytes, path: Path | str) -> etree._Element:
    parser = recording_parser(
        resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False, remove_comments=False
    )
    # Elements know their file by it; nothing is fetched from there.
    return etree.fromstring(data, parser, base_url=str(path))


def _parsed_leniently(data: bytes, path: Path | str) -> etree._Element | None:
    """Root of a document whose declaration, encoding or comments alone break the rules; None where other things do."""
    try:
        text, encoding = data.decode("utf-8-sig"), "UTF-8"
    except UnicodeDecodeError:
        text, encoding = data.decode("cp1252", errors="replace"), "Windows-1252"
    faults = []
    declaration = _DECLARATION.match(text)
    if declaration is not None:
        # What stands before it stays, so that lines are what they were.
        text = declaration[1] + text[declaration.end() :]
        if declaration[1]:
            faults.append(
                ("XML declaration", "it is read as if it stood at the beginning", "it stands at the beginning")
            )
    mended = _with_mended_comments(text)
    if mended != text:
        faults.append(("comments that hold '--'", "they are read as comments", "a comment holds no '--'"))
    try:
        root = _parsed(mended.encode("utf-8"), path)
    except etree.XMLSyntaxError:
        return None
    if not faults or encoding != "UTF-8":
        faults.append(("encoding", f"the file is read as {encoding}", "the declaration names the encoding"))
    for what, why, rule in faults:
        adapt(root, what, why, f"{rule} (XML 1.0)")
    return root


def _with_mended_comments(text: str) -> str:
    """Document whose comments, each of which ends at its first "-->", hold no two hyphens in a row."""
    pieces, place = [], 0
    while (begin := text.find("<!--", place)) >= 0 and (end := text.find("-->", begin + 4)) >= 0:
        comment = text[begin + 4 : end].replace("--", "__")
        pieces += [text[place : begin + 4], comment[:-1] + "_" if comment.endswith("-") else comment]
        place = end
    return "".join((*pieces, text[place:]))


class XmlFiles:
    """Files that belong together, each read once and parsed once, when it is first asked for.

    Their elements remember what was read of them; a `Ledger` then names what was not.

    What is parsed later is what was there when the file was read, so that it fits its digest.
    """

    def __init__(self) -> None:
        self._data: dict[Path, bytes] = {}
        self._roots: dict[Path, etree._Element] = {}
        self._elements: dict[Path, list[etree._Element]] = {}

    def digest(self, path: Path) -> bytes:
        """SHA-256 of a file's content; raises an `InputError` where it cannot be read."""
        return hashlib.sha256(self.content(path)).digest()

    def root(self, path: Path) -> etree._Element:
        """Root of a file, as in `read_xml`; the same object each time, which is not to be changed."""
        if path not in self._roots:
            self._roots[path] = root = parse_xml(self.content(path), path)
            # Elements remember what was read of them, and how, as long as somebody holds them.
            self._elements[path] = list(root.iter())
            adapt_openscenario(root)
        return self._roots[path]

    def update(self, other: XmlFiles) -> None:
        """Keep other files too."""
        self._data |= other._data
        self._roots |= other._roots
        self._elements |= other._elements

    def parsed(self) -> dict[Path, etree._Element]:
        """Roots of the files that were asked for, by their path."""
        return dict(self._roots)

    def content(self, path: Path) -> bytes:
        """Content of a file; raises an `InputError` where it cannot be read."""
        if path not in self._data:
            self._data[path] = read_file(path)
        return self._data[path]
