"""Support table of ScenarioRunner: how it handles each element and attribute of OpenSCENARIO.

The table was made from ScenarioRunner's sources. Its notes are about version 0.9.16; its last columns say which
versions handle an element or attribute at all.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from importlib import resources
from typing import Final

from lxml import etree

VERSIONS: Final = ("0.9.13", "0.9.15", "0.9.16")
"""Versions of ScenarioRunner; CARLA 0.9.14 came without one."""

_TABLE_FILE: Final = "scenario_runner.csv"


class HandlingStatus(StrEnum):
    """Kind of treatment that an element or attribute gets in the conversion for ScenarioRunner."""

    EXECUTED = "executed"
    # Replaced by something equivalent.
    REWRITTEN = "rewritten"
    # ScenarioRunner does something similar; entities that do not react to an agent move along a trajectory instead.
    APPROXIMATE = "approximate"
    # ScenarioRunner cannot do it; the entity moves along a trajectory instead.
    SAMPLED = "sampled"
    # Left out.
    WITHOUT_EFFECT = "without effect"
    # The scenario is not converted.
    REFUSED = "refused"


@dataclass(frozen=True)
class SupportRow:
    """A row of the support table: how ScenarioRunner handles an element or attribute.

    `element`: name of the element, with parents if they matter (``"CollisionCondition/ByType"``). `attribute`: name of
    the attribute; empty if the row is about the element. `values`: attribute values that the row is about; empty if
    the row is about all values without a row of their own. `note`: reason, or what replaces the content. `matters`:
    whether leaving the content out can change positions, speeds or verdicts. `versions`: versions of ScenarioRunner
    that handle the content; all others ignore the content or stop at it.
    """

    element: str
    attribute: str
    values: tuple[str, ...]
    status: HandlingStatus
    note: str
    matters: bool = True
    versions: tuple[str, ...] = VERSIONS


@dataclass(frozen=True)
class SupportFinding:
    """An element or attribute that ScenarioRunner does not execute unchanged, and its description in messages."""

    description: str
    row: SupportRow
    element: etree._Element


@cache
def load_support_table() -> dict[tuple[str, str], tuple[SupportRow, ...]]:
    """Read the rows of the support table, by name of the element (without its parents) and name of the attribute.

    Among the rows with the same names, rows whose elements have more parents come first.
    """
    rows_by_name: dict[tuple[str, str], list[SupportRow]] = {}
    text = (resources.files(__package__) / _TABLE_FILE).read_text(encoding="utf-8")
    for line in csv.DictReader(text.splitlines()):
        values = tuple(line["values"].split("|")) if line["values"] else ()
        matters = (line["matters"] or "yes") == "yes"
        row = SupportRow(
            line["element"], line["attribute"], values, HandlingStatus(line["status"]), line["note"], matters,
            tuple(version for version in VERSIONS if line[version] == "yes"),
        )  # fmt: skip
        rows_by_name.setdefault((row.element.rpartition("/")[2], row.attribute), []).append(row)
    return {key: tuple(sorted(rows, key=lambda row: -row.element.count("/"))) for key, rows in rows_by_name.items()}


def find_support_row(path: tuple[str, ...], attribute: str = "", value: str = "") -> SupportRow | None:
    """Return the row of the table for an element (as a path of names) or its attribute; None without a row."""
    for row in load_support_table().get((path[-1], attribute), ()):
        names = tuple(row.element.split("/"))
        if path[-len(names) :] == names and (not row.values or value in row.values):
            return row
    return None


def find_unsupported(element: etree._Element) -> Iterator[SupportFinding]:
    """Yield the elements and attributes that ScenarioRunner does not execute unchanged.

    `element` itself and all elements below it are checked. Unknown content counts as refused. If an element is left
    out, rewritten or replaced, its children are skipped.
    """
    path = tuple(str(ancestor.tag) for ancestor in (*reversed(list(element.iterancestors())), element))
    row = find_support_row(path) or _unknown_row(path[-1], "")
    if row.status is not HandlingStatus.EXECUTED:
        yield SupportFinding(f"<{path[-1]}>", row, element)
    if row.status not in (HandlingStatus.EXECUTED, HandlingStatus.APPROXIMATE):
        return
    for name, value in ((str(name), str(value)) for name, value in element.items()):
        if name.startswith("{"):
            continue
        attribute_row = find_support_row(path, name, value) or _unknown_row(path[-1], name)
        if attribute_row.status is not HandlingStatus.EXECUTED:
            yield SupportFinding(f"{name} '{value}' of <{path[-1]}>", attribute_row, element)
    for child in element.iterchildren("*"):
        yield from find_unsupported(child)


def find_version_gaps(element: etree._Element) -> dict[str, tuple[str, ...]]:
    """Return the elements that some versions of ScenarioRunner lack, with the versions that have them.

    `element` itself and all elements below it are checked.
    """
    gaps: dict[str, tuple[str, ...]] = {}
    for child in element.iter("*"):
        path = tuple(str(ancestor.tag) for ancestor in (*reversed(list(child.iterancestors())), child))
        row = find_support_row(path)
        if row is not None and 0 < len(row.versions) < len(VERSIONS):
            gaps[f"<{child.tag}>"] = row.versions
    return gaps


def describe_version_gap(name: str, versions: tuple[str, ...]) -> str:
    """Return a sentence, without full stop, on which versions of ScenarioRunner lack an element and which have it."""
    lacking = " and ".join(version for version in VERSIONS if version not in versions)
    return f"ScenarioRunner {lacking} has no {name}; use {' or '.join(versions)}"


def _unknown_row(element: str, attribute: str) -> SupportRow:
    return SupportRow(element, attribute, (), HandlingStatus.REFUSED, "is not in the table of what ScenarioRunner does")
