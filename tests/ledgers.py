"""A ledger held against the schema of its format."""

from __future__ import annotations

from pathlib import Path

from cornercase._common.ledger import Entry, Ledger, Status
from schemas import Schema


def gaps(ledger: Ledger, schema: Path, *roots: str) -> list[str]:
    """Elements and attributes of a schema that a ledger says nothing about."""
    found = []
    for path, attributes in sorted(_places(ledger, schema, *roots).items()):
        if ledger.entry(path) is None:
            found.append("/".join(path))
        else:
            found += [f"{'/'.join(path)} @{name}" for name in sorted(attributes) if ledger.entry(path, name) is None]
    return found


def strangers(ledger: Ledger, schema: Path, *roots: str) -> list[Entry]:
    """Entries of a ledger that name nothing of a schema, or nothing that another entry does not name better."""
    named = set()
    for path, attributes in _places(ledger, schema, *roots).items():
        named |= {ledger.entry(path), *(ledger.entry(path, name) for name in attributes)}
    return [entry for entry in ledger.entries if entry not in named]


def _places(ledger: Ledger, schema: Path, *roots: str) -> dict[tuple[str, ...], set[str]]:
    def ends(path: tuple[str, ...]) -> bool:
        entry = ledger.entry(path)
        return entry is not None and entry.status is not Status.USED

    return Schema(schema).places(*roots, ends=ends)
