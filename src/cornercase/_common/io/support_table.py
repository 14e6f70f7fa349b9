"""Support table of a file format, which says how each element and attribute is handled, and notices to users."""

from __future__ import annotations

import csv
import sys
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from enum import StrEnum
from importlib import resources
from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common.errors import InputError, NoticeWarning, suggest_name
from cornercase._common.io.tracked_xml import (
    is_read,
    iter_children_untracked,
    iter_descendants_untracked,
    list_adaptations,
    requested_attributes,
)
from cornercase._common.text.element_locations import line_number

# Further lines and parts are counted, not listed.
_MAX_LINES: Final = 5
_MAX_NAMES: Final = 8

_issued_notices: ContextVar[set[str] | None] = ContextVar("issued_notices", default=None)

UNKNOWN_REASON: Final = "is not known here"
"""Reason in notices about parts that the support table does not list."""

# XML's own attributes, such as the location of a schema.
_XML_NAMESPACE_PREFIX: Final = "{http://www.w3.org/"


class SupportStatus(StrEnum):
    """Status of an element or attribute of a file format: used, without effect, or refused with an error."""

    USED = "used"
    WITHOUT_EFFECT = "without effect"
    REFUSED = "refused"


@dataclass(frozen=True)
class SupportEntry:
    """Row of a `SupportTable` about one element or one attribute; `attribute` is empty for the element itself."""

    element: str  # may name parents: "Init/Actions"
    attribute: str
    status: SupportStatus
    ignored_values: tuple[
        str, ...
    ]  # values without a notice, as they change nothing; numbers compare as numbers; "*" for all
    note: str  # what happens or what to do instead, without capital and full stop
    allowed_values: tuple[str, ...] = ()  # the only values accepted, if there are few
    affects_result: bool = True  # whether the result could depend on the part, or on whether it is read

    def needs_no_notice(self, value: str) -> bool:
        """Return whether users get no notice about an attribute with this value, because the value changes nothing."""
        return any(ignored in ("*", value) or _is_same_number(value, ignored) for ignored in self.ignored_values)


class NoticeLabel(StrEnum):
    """Kind of a notice: parts of a file have no effect, or are adapted (read differently from how they are written)."""

    WITHOUT_EFFECT = "without effect"
    ADAPTED = "adapted"


@dataclass(frozen=True)
class Notice:
    """Parts of a file that have no effect or are read differently from how they are written, all for the same reason.

    Attributes
    ----------
    parts : tuple of str
        Elements, and attributes with their elements: ``("<Axles>", "mass of <Vehicle>")``.
    reason : str
        Clause that says what happens instead; begins with a small letter, and ends without a full stop.
    file : Path
    lines : tuple of int
        Line numbers in the file, sorted.
    label : NoticeLabel
    rule : str
        What the standard says about the parts, if they are adapted; otherwise empty.
    affects_result : bool
        True if a simulator that used the parts could give other positions, speeds or verdicts.
    """

    parts: tuple[str, ...]
    reason: str
    file: Path
    lines: tuple[int, ...]
    label: NoticeLabel = NoticeLabel.WITHOUT_EFFECT
    rule: str = ""
    affects_result: bool = True

    @property
    def sentence(self) -> str:
        """The notice as a sentence with its label, without a full stop."""
        return f"{self.label}: {self}"

    def __str__(self) -> str:
        lines = ", ".join(map(str, self.lines[:_MAX_LINES]))
        more = len(self.lines) - _MAX_LINES
        lines += f" and {more} more" if more > 0 else ""
        location = (
            f"{self.file.name}, line{'s' if len(self.lines) > 1 else ''} {lines}" if self.lines else self.file.name
        )
        parts = ", ".join(self.parts[:_MAX_NAMES])
        n_more = len(self.parts) - _MAX_NAMES
        parts += f" and {n_more} more" if n_more > 0 else ""
        return f"{parts} ({location}): {self.reason}"


def merge_notices(notices: Iterable[Notice]) -> tuple[Notice, ...]:
    """Merge notices that differ only in their parts and lines."""
    groups: dict[tuple[Path, str, NoticeLabel, str, bool], tuple[dict[str, None], set[int]]] = {}
    for notice in notices:
        key = (notice.file, notice.reason, notice.label, notice.rule, notice.affects_result)
        names, lines = groups.setdefault(key, ({}, set()))
        names.update(dict.fromkeys(notice.parts))
        lines.update(notice.lines)
    return tuple(
        Notice(tuple(names), why, file, tuple(sorted(lines)), label, rule, matters)
        for (file, why, label, rule, matters), (names, lines) in groups.items()
    )


def deduplicate_notices(notices: Iterable[Notice]) -> tuple[Notice, ...]:
    """Remove notices whose parts and reason are those of an earlier notice, even if it is about another file."""
    notices_by_key: dict[tuple[tuple[str, ...], str], Notice] = {}
    for notice in notices:
        notices_by_key.setdefault((notice.parts, notice.reason), notice)
    return tuple(notices_by_key.values())


def sort_notices(notices: Iterable[Notice]) -> tuple[Notice, ...]:
    """Sort notices: first adapted parts, then parts that can change the result, then the rest."""
    return tuple(
        sorted(notices, key=lambda notice: (notice.label is not NoticeLabel.ADAPTED, not notice.affects_result))
    )


def list_adaptation_notices(element: etree._Element, file: Path | str) -> tuple[Notice, ...]:
    """Return notices about parts of an XML element that violate the standard but could be read.

    The notices also cover the element's descendants and ancestors.
    """
    return merge_notices(
        Notice((what,), why, Path(file), (line_number(part),), NoticeLabel.ADAPTED, rule)
        for part in (*element.iterancestors(), *iter_descendants_untracked(element))
        for what, why, rule in list_adaptations(part)
    )


def warn_notices(notices: Iterable[Notice]) -> None:
    """Issue a `NoticeWarning` for each notice that can change the result, and one warning that counts the others.

    With ``--verbose``, each notice gets its own warning.
    """
    # Imported late, as it loads rich, which is slow.
    from cornercase._common.progress import verbosity

    sorted_notices = sort_notices(notices)
    shown = sorted_notices if verbosity.get() == "verbose" else [n for n in sorted_notices if n.affects_result]
    for notice in shown:
        issue_notice_warning(notice.sentence)
    if count := sum(len(n.parts) for n in sorted_notices) - sum(len(n.parts) for n in shown):
        more, parts = " more" if shown else "", "parts of the files are" if count > 1 else "part of the files is"
        issue_notice_warning(
            f"{count}{more} {parts} ignored, on which no position or speed depends; `check` lists"
            f" {'them' if count > 1 else 'it'}"
        )


def issue_notice_warning(sentence: str) -> None:
    """Issue a `NoticeWarning` that Python attributes to the line of the user's code that called cornercase.

    Parameters
    ----------
    sentence : str
        Without a full stop.
    """
    issued = _issued_notices.get()
    if issued is not None:
        # Text after the semicolon may differ between runs.
        subject = sentence.partition("; ")[0]
        if subject in issued:
            return
        issued.add(subject)
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and _is_inside_cornercase(frame.f_globals.get("__name__", "")):
        level, frame = level + 1, frame.f_back
    warnings.warn(sentence, NoticeWarning, stacklevel=level)


def _is_inside_cornercase(module: str) -> bool:
    """Return whether a module belongs to cornercase, or is contextlib, whose code runs in decorators of cornercase."""
    return module.startswith("cornercase.") or module == "contextlib"


@contextmanager
def issue_each_notice_once(issued: set[str]) -> Iterator[None]:
    """Within the block, issue only notices that are not in `issued`, and add them to `issued`."""
    token = _issued_notices.set(issued)
    try:
        yield
    finally:
        _issued_notices.reset(token)


class SupportTable:
    """Table that says of each element and attribute of a file format if it is used, has no effect, or is refused.

    If an element has no effect or is refused, its entry also applies to its attributes and descendants.
    """

    def __init__(self, entries: Iterable[SupportEntry]) -> None:
        self.entries = tuple(entries)
        self._by_name: dict[tuple[str, str], list[tuple[tuple[str, ...], SupportEntry]]] = {}
        for entry in self.entries:
            *parents, name = entry.element.split("/")
            same_name = self._by_name.setdefault((name, entry.attribute), [])
            same_name.append((tuple(parents), entry))
            same_name.sort(key=lambda item: -len(item[0]))
        # Names of elements that may be refused, or that have an attribute that may be refused.
        self._refusable = tuple(
            {e.element.split("/")[-1] for e in self.entries if e.status is SupportStatus.REFUSED or e.allowed_values}
        )

    @classmethod
    def from_csv(cls, package: str, file: str) -> SupportTable:
        """Read the table from a CSV file in a package.

        Its columns hold the fields of `SupportEntry`: ``element``, ``attribute``, ``status``, ``unless`` (ignored
        values), ``values`` (allowed values), ``note``, and ``matters``, which is ``no`` for parts that do not affect
        the result and otherwise ``yes`` or empty. Bars separate several values in a cell: ``0|false``.
        """
        text = (resources.files(package) / file).read_text(encoding="utf-8")
        return cls(
            SupportEntry(
                row["element"],
                row["attribute"],
                SupportStatus(row["status"]),
                tuple(row["unless"].split("|")) if row["unless"] else (),
                row["note"],
                tuple(row["values"].split("|")) if row.get("values") else (),
                (row.get("matters") or "yes") == "yes",
            )
            for row in csv.DictReader(text.splitlines())
        )

    def find_entry(self, path: tuple[str, ...], attribute: str = "") -> SupportEntry | None:
        """Return the entry of an element or attribute; if several entries fit, the one with the most parents."""
        for parents, entry in self._by_name.get((path[-1], attribute), ()):
            if path[len(path) - 1 - len(parents) : -1] == parents:
                return entry
        return None

    def check_supported(self, element: etree._Element, file: Path | str) -> None:
        """Raise `InputError` if an element, a descendant or one of their attributes is refused."""
        if not self._refusable:
            return
        # A file has few distinct paths.
        is_covered: dict[tuple[str, ...], bool] = {}
        for descendant in iter_descendants_untracked(element, *(f"{{*}}{name}" for name in self._refusable)):
            path = _path_from_root(descendant)
            if path not in is_covered:
                is_covered[path] = any(self._covers_descendants(path[: k + 1]) for k in range(len(path) - 1))
            if is_covered[path]:
                continue
            entry = self.find_entry(path)
            if entry is not None and entry.status is SupportStatus.REFUSED:
                raise InputError(f"{file}, line {line_number(descendant)}: <{path[-1]}> cannot be used; {entry.note}.")
            for name, value in _own_attributes(descendant):
                reason = self._refusal_reason(path, name, value)
                if reason is not None:
                    raise InputError(
                        f"{file}, line {line_number(descendant)}: {name} '{value}' of <{path[-1]}> {reason}"
                    )

    def _refusal_reason(self, path: tuple[str, ...], name: str, value: str) -> str | None:
        """Return why a value of an attribute is refused, or None if it is accepted or refers to a parameter."""
        entry = self.find_entry(path, name)
        if entry is None or value.startswith("$"):
            return None
        if entry.status is SupportStatus.REFUSED and not entry.needs_no_notice(value):
            return f"cannot be used; {entry.note}."
        if entry.allowed_values and value not in entry.allowed_values:
            return f"cannot be used; {suggest_name(value, entry.allowed_values)}"
        return None

    def _covers_descendants(self, path: tuple[str, ...]) -> bool:
        entry = self.find_entry(path)
        return entry is not None and entry.status is not SupportStatus.USED

    def list_unsupported_notices(
        self, element: etree._Element, file: Path | str, is_complete: bool = True
    ) -> tuple[Notice, ...]:
        """Return notices about parts of an element and its descendants: parts without effect, unknown or not read.

        Call this method after the file was read. If reading stopped before the end of the file, pass `is_complete`
        False; then only parts without effect and unknown parts are reported.
        """
        unsupported = self._iter_unsupported(element, _path_from_root(element), is_complete)
        return merge_notices(
            Notice((what,), why, Path(file), (line,), affects_result=matters)
            for what, why, line, matters in unsupported
        )

    def _iter_unsupported(
        self, element: etree._Element, path: tuple[str, ...], read: bool
    ) -> Iterator[tuple[str, str, int, bool]]:
        entry, line = self.find_entry(path), line_number(element)
        if entry is None:
            yield _describe_element(element, path), UNKNOWN_REASON, line, True
            return
        if entry.status is SupportStatus.WITHOUT_EFFECT:
            if not entry.needs_no_notice(""):
                yield f"<{path[-1]}>", entry.note, line, entry.affects_result
            return
        if entry.status is SupportStatus.REFUSED:
            return
        if read and len(path) > 1 and not _is_anything_read(element) and not entry.needs_no_notice(""):
            yield _describe_element(element, path), _unread_reason(entry), line, entry.affects_result
            return
        read_attributes = requested_attributes(element) if read else None
        for name, value in _own_attributes(element):
            entry = self.find_entry(path, name)
            if entry is None:
                yield f"{name} of <{path[-1]}>", UNKNOWN_REASON, line, True
            elif entry.status is SupportStatus.WITHOUT_EFFECT:
                if not entry.needs_no_notice(value):
                    yield f"{name} of <{path[-1]}>", entry.note, line, entry.affects_result
            elif (
                entry.status is SupportStatus.USED
                and read_attributes is not None
                and name not in read_attributes
                and not entry.needs_no_notice(value)
            ):
                yield f"{name} of <{path[-1]}>", _unread_reason(entry), line, entry.affects_result
        for child in iter_children_untracked(element):
            yield from self._iter_unsupported(child, (*path, tag_without_namespace(child)), read)


def _describe_element(element: etree._Element, path: tuple[str, ...]) -> str:
    """Return the tag of an element with its name attribute, or with its parent if it has no name."""
    name = element.attrib.get("name")
    if name:
        return f"<{path[-1]} {name}>"
    return f"<{path[-1]}> in <{path[-2]}>" if len(path) > 1 else f"<{path[-1]}>"


def _unread_reason(entry: SupportEntry) -> str:
    return f"it is not read here; {entry.note}" if entry.note else "it is not read here"


def tag_without_namespace(element: etree._Element) -> str:
    """Return the tag of an element without its namespace."""
    return str(element.tag).rpartition("}")[2]


def _own_attributes(element: etree._Element) -> list[tuple[str, str]]:
    """Return names and values of an element's attributes, without attributes of XML, such as schema locations."""
    pairs = ((str(name), str(value)) for name, value in element.items())
    return [(name, value) for name, value in pairs if not name.startswith(_XML_NAMESPACE_PREFIX)]


def _path_from_root(element: etree._Element) -> tuple[str, ...]:
    names = [tag_without_namespace(element)]
    parent = element.getparent()
    while parent is not None:
        names.append(tag_without_namespace(parent))
        parent = parent.getparent()
    return tuple(reversed(names))


def _is_anything_read(element: etree._Element) -> bool:
    return is_read(element) or any(_is_anything_read(child) for child in iter_children_untracked(element))


def _is_same_number(a: str, b: str) -> bool:
    try:
        return float(a) == float(b)
    except ValueError:
        return False
