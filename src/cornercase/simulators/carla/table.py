"""What ScenarioRunner 0.9.16 really does with each element and attribute of OpenSCENARIO, by its source."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from importlib import resources
from typing import Final

from lxml import etree

_FILE: Final = "scenario_runner.csv"


class Status(StrEnum):
    """What becomes of an element or attribute on its way to ScenarioRunner."""

    EXECUTED = "executed"
    """ScenarioRunner does what it says."""
    REWRITTEN = "rewritten"
    """It is put in other words that say the same."""
    APPROXIMATE = "approximate"
    """ScenarioRunner does something near; who does not react to others moves along a trajectory instead."""
    SAMPLED = "sampled"
    """ScenarioRunner cannot do it; the entity moves along a trajectory instead."""
    WITHOUT_EFFECT = "without effect"
    """It is left out."""
    REFUSED = "refused"
    """The scenario is not converted."""


@dataclass(frozen=True)
class Row:
    """What becomes of an element, or of an attribute.

    Attributes
    ----------
    element : str
        Its name, after those of elements above it where they matter: ``"CollisionCondition/ByType"``.
    attribute : str
        Empty for the element itself.
    values : tuple of str
        Of the attribute, for which this holds; for all others where empty.
    status : Status
    note : str
        Why, or what instead.
    matters : bool
        Whether what is left out could change positions, speeds or verdicts.
    """

    element: str
    attribute: str
    values: tuple[str, ...]
    status: Status
    note: str
    matters: bool = True


@dataclass(frozen=True)
class Finding:
    """An element or attribute of a file that is not simply executed.

    Attributes
    ----------
    what : str
        In words for a message.
    row : Row
    element : lxml element
    """

    what: str
    row: Row
    element: etree._Element


@cache
def table() -> dict[tuple[str, str], tuple[Row, ...]]:
    """Read the table.

    Returns
    -------
    dict
        Rows by the last name of the element and by the attribute: those with most names first, then in their order.
    """
    found: dict[tuple[str, str], list[Row]] = {}
    text = (resources.files(__package__) / _FILE).read_text(encoding="utf-8")
    for line in csv.DictReader(text.splitlines()):
        values = tuple(line["values"].split("|")) if line["values"] else ()
        matters = (line["matters"] or "yes") == "yes"
        row = Row(line["element"], line["attribute"], values, Status(line["status"]), line["note"], matters)
        found.setdefault((row.element.rpartition("/")[2], row.attribute), []).append(row)
    return {key: tuple(sorted(rows, key=lambda row: -row.element.count("/"))) for key, rows in found.items()}


def row_of(path: tuple[str, ...], attribute: str = "", value: str = "") -> Row | None:
    """Find what becomes of an element or attribute.

    Parameters
    ----------
    path : tuple of str
        Name of the element, after those above it.
    attribute : str, optional
    value : str, optional
        Of the attribute.

    Returns
    -------
    Row or None
        None where the table does not know it.
    """
    for row in table().get((path[-1], attribute), ()):
        names = tuple(row.element.split("/"))
        if path[-len(names) :] == names and (not row.values or value in row.values):
            return row
    return None


def findings(element: etree._Element) -> Iterator[Finding]:
    """Give what is not simply executed, of an element and of all that it holds.

    Below what is left out, put in other words, or done otherwise as a whole, nothing is looked at.

    Parameters
    ----------
    element : lxml element

    Yields
    ------
    Finding
        What the table does not know counts as refused.
    """
    path = tuple(str(one.tag) for one in (*reversed(list(element.iterancestors())), element))
    row = row_of(path) or _unknown(path[-1], "")
    if row.status is not Status.EXECUTED:
        yield Finding(f"<{path[-1]}>", row, element)
    if row.status not in (Status.EXECUTED, Status.APPROXIMATE):
        return
    for name, value in ((str(name), str(value)) for name, value in element.items()):
        if name.startswith("{"):
            continue
        of_attribute = row_of(path, name, value) or _unknown(path[-1], name)
        if of_attribute.status is not Status.EXECUTED:
            yield Finding(f"{name} '{value}' of <{path[-1]}>", of_attribute, element)
    for child in element.iterchildren("*"):
        yield from findings(child)


def _unknown(element: str, attribute: str) -> Row:
    return Row(element, attribute, (), Status.REFUSED, "is not in the table of what ScenarioRunner does")
