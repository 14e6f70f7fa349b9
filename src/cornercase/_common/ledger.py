"""A ledger of a file format: what happens with each of its elements and attributes."""

from __future__ import annotations

import csv
import sys
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from importlib import resources
from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common.errors import InputError, NoticeWarning, suggestion
from cornercase._common.places import line_of
from cornercase._common.recorded_xml import adaptations, asked_attributes, below, children, was_read

# More lines, and more things, than this are counted, not named.
_MOST_LINES: Final = 5
_MOST_NAMES: Final = 8

UNKNOWN: Final = "is not known here"
"""Why something has no effect that no ledger knows."""

# Attributes of XML itself, such as where a schema lies.
_XML: Final = "{http://www.w3.org/"


class Status(StrEnum):
    """What happens with a part of a file."""

    USED = "used"
    WITHOUT_EFFECT = "without effect"
    REFUSED = "refused"


@dataclass(frozen=True)
class Entry:
    """What happens with an element, or with an attribute.

    Attributes
    ----------
    element : str
        Name of the element; where one name means different things, with those above it: ``"Init/Actions"``.
    attribute : str
        Empty for the element itself.
    status : Status
    unless : tuple of str
        Values of the attribute that change nothing, so that nothing is said about them; numbers count as equal
        however they are written. With ``"*"`` nothing is ever said: what has no effect is not meant to have one, and
        what is used need not be.
    values : tuple of str
        Those that the attribute may have, where they are a few words; any other is refused.
    note : str
        What happens instead, or what to do instead: without a capital at its beginning or a full stop at its end.
    matters : bool
        Whether a simulator that used it could give other positions, speeds or verdicts; of what is used, whether that
        holds where nobody reads it.
    """

    element: str
    attribute: str
    status: Status
    unless: tuple[str, ...]
    note: str
    values: tuple[str, ...] = ()
    matters: bool = True

    def is_silent(self, value: str) -> bool:
        """Whether a value of the attribute changes nothing."""
        return any(one in ("*", value) or _same_number(value, one) for one in self.unless)


class Label(StrEnum):
    """What a notice says of parts of a file."""

    WITHOUT_EFFECT = "without effect"
    ADAPTED = "adapted"


@dataclass(frozen=True)
class Notice:
    """Parts of a file that have no effect, or are not read as they stand there, all for one reason.

    Attributes
    ----------
    what : tuple of str
        Elements, and attributes with their elements: ``("<Axles>", "mass of <Vehicle>")``.
    why : str
        What happens instead, in plain words; without a capital at its beginning or a full stop at its end.
    file : Path
    lines : tuple of int
        Where they stand, in order.
    label : Label
    rule : str
        What the standard says of parts that are adapted; empty for others.
    matters : bool
        Whether a simulator that used the parts could give other positions, speeds or verdicts.
    """

    what: tuple[str, ...]
    why: str
    file: Path
    lines: tuple[int, ...]
    label: Label = Label.WITHOUT_EFFECT
    rule: str = ""
    matters: bool = True

    @property
    def sentence(self) -> str:
        """The notice with its label, without a full stop."""
        return f"{self.label}: {self}"

    def __str__(self) -> str:
        named = ", ".join(map(str, self.lines[:_MOST_LINES]))
        more = len(self.lines) - _MOST_LINES
        named += f" and {more} more" if more > 0 else ""
        place = f"{self.file.name}, line{'s' if len(self.lines) > 1 else ''} {named}" if self.lines else self.file.name
        what = ", ".join(self.what[:_MOST_NAMES])
        others = len(self.what) - _MOST_NAMES
        what += f" and {others} more" if others > 0 else ""
        return f"{what} ({place}): {self.why}"


def merged(notices: Iterable[Notice]) -> tuple[Notice, ...]:
    """Notices of which those of one file and for one reason are one."""
    found: dict[tuple[Path, str, Label, str, bool], tuple[dict[str, None], set[int]]] = {}
    for notice in notices:
        key = (notice.file, notice.why, notice.label, notice.rule, notice.matters)
        names, lines = found.setdefault(key, ({}, set()))
        names.update(dict.fromkeys(notice.what))
        lines.update(notice.lines)
    return tuple(
        Notice(tuple(names), why, file, tuple(sorted(lines)), label, rule, matters)
        for (file, why, label, rule, matters), (names, lines) in found.items()
    )


def distinct(notices: Iterable[Notice]) -> tuple[Notice, ...]:
    """Notices of which those of the same parts for one reason are one, that of the first file."""
    found: dict[tuple[tuple[str, ...], str], Notice] = {}
    for notice in notices:
        found.setdefault((notice.what, notice.why), notice)
    return tuple(found.values())


def ranked(notices: Iterable[Notice]) -> tuple[Notice, ...]:
    """Notices of what is read otherwise first, then of what can change the result, then the rest; else in order."""
    return tuple(sorted(notices, key=lambda one: (one.label is not Label.ADAPTED, not one.matters)))


def adapted(element: etree._Element, file: Path | str) -> tuple[Notice, ...]:
    """Name what breaks the standard and was read all the same: in an element, below and above, once the file was read.

    Parameters
    ----------
    element : lxml element
    file : path

    Returns
    -------
    tuple of Notice
    """
    return merged(
        Notice((what,), why, Path(file), (line_of(one),), Label.ADAPTED, rule)
        for one in (*element.iterancestors(), *below(element))
        for what, why, rule in adaptations(one)
    )


def warn_of(notices: Iterable[Notice]) -> None:
    """Give the notices that matter as a `NoticeWarning` each of whoever called cornercase, and count the others.

    With ``--verbose`` each is given.
    """
    # It loads rich, which takes a while.
    from cornercase._common.progress import loudness

    every = ranked(notices)
    given = every if loudness.get() == "verbose" else [one for one in every if one.matters]
    for notice in given:
        warn(notice.sentence)
    if count := sum(len(one.what) for one in every) - sum(len(one.what) for one in given):
        more, parts = " more" if given else "", "parts" if count > 1 else "part"
        what = f"{count}{more} {parts}, which change{'' if count > 1 else 's'} no position or speed"
        warn(f"{Label.WITHOUT_EFFECT}: {what}; `check` and -v list {'them' if count > 1 else 'it'}")


def warn(sentence: str) -> None:
    """Give a sentence as a `NoticeWarning` of whoever called cornercase.

    Parameters
    ----------
    sentence : str
        Without a full stop.
    """
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith("cornercase."):
        level, frame = level + 1, frame.f_back
    warnings.warn(sentence, NoticeWarning, stacklevel=level)


class Ledger:
    """What happens with each element and attribute of a file format.

    An element that is without effect, or refused, says so for all that it holds: its attributes and what lies below
    it need no entries.

    Parameters
    ----------
    entries : iterable of Entry
    """

    def __init__(self, entries: Iterable[Entry]) -> None:
        self.entries = tuple(entries)
        self._by_name: dict[tuple[str, str], list[tuple[tuple[str, ...], Entry]]] = {}
        for entry in self.entries:
            *above, name = entry.element.split("/")
            known = self._by_name.setdefault((name, entry.attribute), [])
            known.append((tuple(above), entry))
            known.sort(key=lambda one: -len(one[0]))
        # Elements of which something may be refused.
        self._refusable = tuple(
            {e.element.split("/")[-1] for e in self.entries if e.status is Status.REFUSED or e.values}
        )

    @classmethod
    def read(cls, package: str, file: str) -> Ledger:
        """Read a ledger that ships with a package.

        It is a CSV with the columns element, attribute, status, unless, values, note and matters. What stands in unless
        and in values is parted by bars: ``0|false``. All that is without effect says in matters whether a simulator
        that used it could give another result: yes or no; what is used may leave it out, which is yes.
        """
        text = (resources.files(package) / file).read_text(encoding="utf-8")
        return cls(
            Entry(
                row["element"],
                row["attribute"],
                Status(row["status"]),
                tuple(row["unless"].split("|")) if row["unless"] else (),
                row["note"],
                tuple(row["values"].split("|")) if row.get("values") else (),
                (row.get("matters") or "yes") == "yes",
            )
            for row in csv.DictReader(text.splitlines())
        )

    def entry(self, path: tuple[str, ...], attribute: str = "") -> Entry | None:
        """Find the entry of an element or attribute: the one that names most of what stands above it.

        Parameters
        ----------
        path : tuple of str
            Names of the elements from the root on.
        attribute : str, optional

        Returns
        -------
        Entry or None
            None where the ledger does not know it.
        """
        for above, entry in self._by_name.get((path[-1], attribute), ()):
            if path[len(path) - 1 - len(above) : -1] == above:
                return entry
        return None

    def refuse(self, element: etree._Element, file: Path | str) -> None:
        """Refuse what cannot be used, below an element and in it.

        Parameters
        ----------
        element : lxml element
        file : path
            For the message.

        Raises
        ------
        InputError
            Names the first such element or attribute, its line, and what to do instead.
        """
        if not self._refusable:
            return
        # A file has few different paths.
        ended: dict[tuple[str, ...], bool] = {}
        for one in below(element, *(f"{{*}}{name}" for name in self._refusable)):
            path = _path(one)
            if path not in ended:
                ended[path] = any(self._ends(path[: k + 1]) for k in range(len(path) - 1))
            if ended[path]:
                continue
            entry = self.entry(path)
            if entry is not None and entry.status is Status.REFUSED:
                raise InputError(f"{file}, line {line_of(one)}: <{path[-1]}> cannot be used; {entry.note}.")
            for name, value in _attributes(one):
                why = self._objection(path, name, value)
                if why is not None:
                    raise InputError(f"{file}, line {line_of(one)}: {name} '{value}' of <{path[-1]}> {why}")

    def _objection(self, path: tuple[str, ...], name: str, value: str) -> str | None:
        """Why a value of an attribute cannot be used; that of a parameter is not known here."""
        entry = self.entry(path, name)
        if entry is None or value.startswith("$"):
            return None
        if entry.status is Status.REFUSED and not entry.is_silent(value):
            return f"cannot be used; {entry.note}."
        if entry.values and value not in entry.values:
            return f"cannot be used; {suggestion(value, entry.values)}"
        return None

    def _ends(self, path: tuple[str, ...]) -> bool:
        entry = self.entry(path)
        return entry is not None and entry.status is not Status.USED

    def notices(self, element: etree._Element, file: Path | str, read: bool = True) -> tuple[Notice, ...]:
        """Name what has no effect, below an element and in it, after the file was read.

        Parameters
        ----------
        element : lxml element
        file : path
        read : bool, default True
            Whether the file was read to its end; otherwise it is not said what nobody read.

        Returns
        -------
        tuple of Notice
            Parts without effect by the ledger, parts that the ledger does not know, and parts that it calls used but
            that nobody read; one for each reason.
        """
        silent = self._silent(element, _path(element), read)
        return merged(Notice((what,), why, Path(file), (line,), matters=matters) for what, why, line, matters in silent)

    def _silent(
        self, element: etree._Element, path: tuple[str, ...], read: bool
    ) -> Iterator[tuple[str, str, int, bool]]:
        entry, line = self.entry(path), line_of(element)
        if entry is None:
            yield _called(element, path), UNKNOWN, line, True
            return
        if entry.status is Status.WITHOUT_EFFECT:
            if not entry.is_silent(""):
                yield f"<{path[-1]}>", entry.note, line, entry.matters
            return
        if entry.status is Status.REFUSED:
            return
        if read and len(path) > 1 and not _anything_read(element) and not entry.is_silent(""):
            yield _called(element, path), _unread(entry), line, entry.matters
            return
        asked = asked_attributes(element) if read else None
        for name, value in _attributes(element):
            entry = self.entry(path, name)
            if entry is None:
                yield f"{name} of <{path[-1]}>", UNKNOWN, line, True
            elif entry.status is Status.WITHOUT_EFFECT:
                if not entry.is_silent(value):
                    yield f"{name} of <{path[-1]}>", entry.note, line, entry.matters
            elif entry.status is Status.USED and asked is not None and name not in asked and not entry.is_silent(value):
                yield f"{name} of <{path[-1]}>", _unread(entry), line, entry.matters
        for child in children(element):
            yield from self._silent(child, (*path, local_name(child)), read)


def _called(element: etree._Element, path: tuple[str, ...]) -> str:
    """Tag of an element, with its name or with the element that holds it."""
    name = element.attrib.get("name")
    if name:
        return f"<{path[-1]} {name}>"
    return f"<{path[-1]}> in <{path[-2]}>" if len(path) > 1 else f"<{path[-1]}>"


def _unread(entry: Entry) -> str:
    return f"nothing reads it here; {entry.note}" if entry.note else "nothing reads it here"


def local_name(element: etree._Element) -> str:
    """Name of an element without its namespace."""
    return str(element.tag).rpartition("}")[2]


def _attributes(element: etree._Element) -> list[tuple[str, str]]:
    """Names and values of the attributes, without those of XML itself."""
    pairs = ((str(name), str(value)) for name, value in element.items())
    return [(name, value) for name, value in pairs if not name.startswith(_XML)]


def _path(element: etree._Element) -> tuple[str, ...]:
    names = [local_name(element)]
    above = element.getparent()
    while above is not None:
        names.append(local_name(above))
        above = above.getparent()
    return tuple(reversed(names))


def _anything_read(element: etree._Element) -> bool:
    return was_read(element) or any(_anything_read(child) for child in children(element))


def _same_number(one: str, two: str) -> bool:
    try:
        return float(one) == float(two)
    except ValueError:
        return False
