"""A ledger held against the schema of its format."""

from __future__ import annotations

import re
from pathlib import Path

from cornercase._common.io.support_table import SupportEntry, SupportStatus, SupportTable
from helpers.xml_schemas import Schema


def gaps(ledger: SupportTable, schema: Path, *roots: str) -> list[str]:
    """Elements and attributes of a schema that a ledger says nothing about."""
    found = []
    for path, attributes in sorted(_places(ledger, schema, *roots).items()):
        if ledger.find_entry(path) is None:
            found.append("/".join(path))
        else:
            found += [
                f"{'/'.join(path)} @{name}" for name in sorted(attributes) if ledger.find_entry(path, name) is None
            ]
    return found


def strangers(ledger: SupportTable, schema: Path, *roots: str) -> list[SupportEntry]:
    """Entries of a ledger that name nothing of a schema, or nothing that another entry does not name better."""
    named = set()
    for path, attributes in _places(ledger, schema, *roots).items():
        named |= {ledger.find_entry(path), *(ledger.find_entry(path, name) for name in attributes)}
    return [entry for entry in ledger.entries if entry not in named]


def _places(ledger: SupportTable, schema: Path, *roots: str) -> dict[tuple[str, ...], set[str]]:
    def ends(path: tuple[str, ...]) -> bool:
        entry = ledger.find_entry(path)
        return entry is not None and entry.status is not SupportStatus.USED

    return Schema(schema).places(*roots, ends=ends)


def page(ledger: SupportTable, head: str) -> str:
    """Markdown of a ledger, below a text that says what it is about."""
    lines = [head.strip(), ""]
    for status, title in _TITLES.items():
        entries = [entry for entry in ledger.entries if entry.status is status]
        lines += [f"## {title}", ""]
        if status is SupportStatus.USED:
            lines += [f"{_sentence(entries)}", "", *_noted([one for one in entries if one.note])]
        else:
            lines += _noted(entries, judged=status is SupportStatus.WITHOUT_EFFECT)
    return "\n".join(lines).rstrip() + "\n"


_ELEMENT, _CODE = re.compile(r"(<[^>]+>)"), r"`\1`"

_TITLES = {
    SupportStatus.REFUSED: "Refused",
    SupportStatus.WITHOUT_EFFECT: "Without effect",
    SupportStatus.USED: "Used",
}


def _noted(entries: list[SupportEntry], judged: bool = False) -> list[str]:
    """Table of entries; those with one note are one row."""
    rows: dict[tuple[str, tuple[str, ...], bool], dict[str, list[str]]] = {}
    for entry in entries:
        key = (entry.note, entry.ignored_values, entry.affects_result and judged)
        rows.setdefault(key, {}).setdefault(entry.element, []).append(entry.attribute)
    head, under = "| what | why, and what to do instead | no notice if it is |", "| --- | --- | --- |"
    lines = [head + (" could change the result |" if judged else ""), under + (" --- |" if judged else "")]
    for (note, unless, matters), names in rows.items():
        never = "anything" if unless == ("*",) else ", ".join(f"`{one}`" for one in unless)
        whats = (
            ", ".join(f"`{one}`" for one in attributes if one) + (" of " if any(attributes) else "") + f"`{element}`"
            for element, attributes in names.items()
        )
        judgement = f" {'yes' if matters else 'no'} |" if judged else ""
        lines.append(f"| {', '.join(whats)} | {_ELEMENT.sub(_CODE, note)} | {never} |{judgement}")
    return [*lines, ""]


def _sentence(entries: list[SupportEntry]) -> str:
    by_element: dict[str, list[str]] = {}
    for entry in entries:
        by_element.setdefault(entry.element, [])
        if entry.attribute:
            by_element[entry.element].append(entry.attribute)
    return "; ".join(
        f"`{element}`" + (f" ({', '.join(attributes)})" if attributes else "")
        for element, attributes in sorted(by_element.items())
    )
