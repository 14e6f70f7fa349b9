"""Rebuild a study from the intact rows of a damaged one."""

from __future__ import annotations

import sqlite3
from collections import defaultdict
from contextlib import closing
from dataclasses import dataclass
from functools import reduce
from operator import xor
from pathlib import Path

from cornercase._common.errors import InputError
from cornercase._common.texts import loaded_json
from cornercase.study.connecting import require_one_name
from cornercase.study.damage import damage_told
from cornercase.study.database import make_tables
from cornercase.study.meta import StudyMeta
from cornercase.study.salvaging import Rows, salvaged, tables_in_order
from cornercase.study.schema import TABLES
from cornercase.study.seals import put, sealed

# Tables that `analyze` writes; all are kept or none, as they belong together.
_ANALYSES = ("outcomes", "analyses", "arrays")
_OF_SCENARIOS = ("courses", "repeats", "against")


@dataclass(frozen=True)
class Remains:
    """What is left of a damaged study, and what has to be run again.

    `rounds` are by scenario id, 0 if unknown; `to_rerun` are ids of scenarios to run again; `lost` describes what
    cannot be restored by running scenarios. `checksum_totals` are known row counts and XORs of checksums by table;
    `is_count_known` tells whether the original number of scenarios is known.
    """

    meta: StudyMeta
    rounds: dict[int, int]
    again: tuple[int, ...]
    lost: tuple[str, ...]
    tallies: dict[str, tuple[int, int]]
    counted: bool


def rebuild(damaged: Path, made: Path) -> Remains:
    """Create a study at `output` from the intact rows of a damaged one; scenarios to run again are pending in it.

    Raises `InputError` if the description of the study is lost. The damaged file is only read.
    """
    require_one_name(damaged)
    rows = salvaged(damaged)
    tallies = _known_tallies(damaged, rows)
    with damage_told(damaged):
        try:
            meta = StudyMeta.from_json({key: loaded_json(value) for key, value in rows["meta"].values()})
        except (LookupError, ValueError, TypeError, AttributeError, OverflowError):
            meta = None
    if meta is None or tallies.get("meta", _tally("meta", rows["meta"])) != _tally("meta", rows["meta"]):
        raise InputError(
            f"{damaged}: its description (the table meta) is damaged and cannot be restored; run `explore` again,"
            " into another study."
        )
    lost = []
    if any(tallies.get(name) != _tally(name, rows[name]) for name in _ANALYSES):
        if_any = "" if set(_ANALYSES) <= set(tallies) else ", if it had any"
        lost.append(f"its clusters and its reduced set{if_any}; `analyze` and `reduce` make them again")
        for name in _ANALYSES:
            rows[name] = {}
    if "notes" not in tallies:
        lost.append("notes on scenarios, if there were more")
    elif missing := tallies["notes"][0] - len(rows["notes"]):
        lost.append(f"{missing} notes on scenarios")
    rounds = _rounds_of(rows, tallies)
    to_rerun = _sort_out(rows, meta, rounds)
    with closing(sqlite3.connect(made)) as connection:
        make_tables(
            connection, *(name for name, definition in TABLES.items() if not definition.always and _has(meta, name))
        )
        for name in TABLES:
            if name != "tallies" and (TABLES[name].always or _has(meta, name)):
                put(connection, name, rows[name].values(), replace=False)
        connection.commit()
    return Remains(meta, rounds, to_rerun, tuple(lost), tallies, "scenarios" in tallies)


def _known_tallies(damaged: Path, found: dict[str, Rows]) -> dict[str, tuple[int, int]]:
    """Row count and XOR of checksums by table: as stored, or as counted if the pages of the table are intact.

    For an intact table, rows that had been deleted before are removed from `rows_by_table`.
    """
    tallies = {str(name): (int(rows), int(sums)) for name, rows, sums in found["tallies"].values()}
    intact = set()
    for name, rows in tables_in_order(damaged):
        intact.add(name)
        tally = _tally(name, rows)
        if TABLES[name].tallied and tallies.setdefault(name, tally) == tally:
            found[name] = rows
    for name in (name for name, definition in TABLES.items() if definition.tallied and "tallies" in intact):
        if name not in tallies:
            # The table never had rows.
            tallies[name], found[name] = (0, 0), {}
    return tallies


def _has(meta: StudyMeta, table: str) -> bool:
    """Tell whether the study has an optional table."""
    return {"against": len(meta.others) > 1, "results": meta.asynchronous, "elsewhere": bool(meta.elsewhere)}[table]


def _tally(table: str, rows: Rows) -> tuple[int, int]:
    count = len(TABLES[table].columns)
    sums = [int(sealed(table, row)[count]) for row in rows.values()]
    return len(sums), reduce(xor, sums, 0)


def _rounds_of(found: dict[str, Rows], tallies: dict[str, tuple[int, int]]) -> dict[int, int]:
    """Rounds of all scenarios that the study had, by id."""
    rounds = {int(row[0]): int(row[1]) for row in found["scenarios"].values()}
    last = tallies["scenarios"][0] if "scenarios" in tallies else 0
    last = max([last, *rounds, *(int(row[0]) for name in _OF_SCENARIOS for row in found[name].values())])
    return {number: rounds.get(number, 0) for number in range(1, last + 1)}


def _sort_out(found: dict[str, Rows], meta: StudyMeta, rounds: dict[int, int]) -> tuple[int, ...]:
    """Make incomplete scenarios pending; return their ids."""
    metrics: dict[str, dict[int, set[str]]] = {name: defaultdict(set) for name in _OF_SCENARIOS}
    for name in _OF_SCENARIOS:
        for stored in found[name].values():
            metrics[name][stored[0]].add(stored[1])
    is_required = {"courses": True, "repeats": meta.repeats > 1, "against": len(meta.others) > 1}
    to_rerun = []
    for number in rounds:
        row = found["scenarios"].get((number,))
        is_complete = row is not None and row[4] != "pending"
        if row is not None and row[4] == "done":
            is_complete = all(
                metrics[name][number] >= set(meta.metrics) for name, needed in is_required.items() if needed
            )
        if is_complete:
            continue
        to_rerun.append(number)
        for name in _OF_SCENARIOS:
            found[name] = {key: values for key, values in found[name].items() if values[0] != number}
        if row is not None:
            found["scenarios"][number,] = (*row[:4], "pending", None, None)
    return tuple(to_rerun)
