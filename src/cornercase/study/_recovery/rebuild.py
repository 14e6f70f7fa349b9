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
from cornercase._common.text.sanitize import parse_json
from cornercase.study._checksums import insert_rows, with_checksums
from cornercase.study._connection import require_single_hard_link
from cornercase.study._damage import reraise_read_errors
from cornercase.study._database import create_tables
from cornercase.study._meta import StudyMeta
from cornercase.study._recovery.recover_rows import RowsByKey, iter_intact_tables, recover_rows
from cornercase.study._schema import TABLES

# Tables that `analyze` writes; all are kept or none, as they belong together.
_ANALYSIS_TABLES = ("outcomes", "analyses", "arrays")
_SCENARIO_TABLES = ("courses", "repeats", "against")


@dataclass(frozen=True)
class RecoveredStudy:
    """Description of the recovered and of the lost content of a damaged study.

    `rounds` maps the id of each scenario to its round, 0 if unknown. `to_rerun` are the ids of scenarios that have to
    be run again. `lost` describes in words the content that no run of a scenario can restore. `checksum_totals` maps a
    table to its row count and XOR of checksums, if these are known. `is_count_known` is True if the original number of
    scenarios is known.
    """

    meta: StudyMeta
    rounds: dict[int, int]
    to_rerun: tuple[int, ...]
    lost: tuple[str, ...]
    checksum_totals: dict[str, tuple[int, int]]
    is_count_known: bool


def rebuild_study(damaged: Path, output: Path) -> RecoveredStudy:
    """Create a study at `output` from the intact rows of the study at `damaged`; the damaged file stays as it is.

    Scenarios that have to be run again are pending (not run yet) in the new study; those whose row is lost, and lost
    digests, are not in the new study. Raises `InputError` if the description of the damaged study is lost, or if the
    damaged file has several hard links.
    """
    require_single_hard_link(damaged)
    rows = recover_rows(damaged)
    tallies = _recover_checksum_totals(damaged, rows)
    with reraise_read_errors(damaged):
        try:
            meta = StudyMeta.from_json({key: parse_json(value) for key, value in rows["meta"].values()})
        except (LookupError, ValueError, TypeError, AttributeError, OverflowError):
            meta = None
    if meta is None or tallies.get("meta", _compute_checksum_totals("meta", rows["meta"])) != _compute_checksum_totals(
        "meta", rows["meta"]
    ):
        raise InputError(
            f"{damaged}: its description (the table meta) is damaged and cannot be restored; run `explore` again,"
            " into another study."
        )
    lost = []
    if any(tallies.get(name) != _compute_checksum_totals(name, rows[name]) for name in _ANALYSIS_TABLES):
        if_any = "" if set(_ANALYSIS_TABLES) <= set(tallies) else ", if it had any"
        lost.append(f"its clusters and its reduced set{if_any}; `analyze` and `reduce` make them again")
        for name in _ANALYSIS_TABLES:
            rows[name] = {}
    if "notes" not in tallies:
        lost.append("notes on scenarios, if there were more")
    elif missing := tallies["notes"][0] - len(rows["notes"]):
        lost.append(f"{missing} notes on scenarios")
    rounds = _recover_rounds(rows, tallies)
    for name in (*_SCENARIO_TABLES, "notes", "outcomes"):
        rows[name] = {key: values for key, values in rows[name].items() if values[0] in rounds}
    to_rerun = _reset_incomplete_scenarios(rows, meta, rounds)
    with closing(sqlite3.connect(output)) as connection:
        create_tables(
            connection,
            *(
                name
                for name, definition in TABLES.items()
                if not definition.is_required and _has_optional_table(meta, name)
            ),
        )
        for name in TABLES:
            if name != "tallies" and (TABLES[name].is_required or _has_optional_table(meta, name)):
                insert_rows(connection, name, rows[name].values(), replace=False)
        connection.commit()
    return RecoveredStudy(meta, rounds, to_rerun, tuple(lost), tallies, "scenarios" in tallies)


def _recover_checksum_totals(damaged: Path, rows_by_table: dict[str, RowsByKey]) -> dict[str, tuple[int, int]]:
    """Return row count and XOR of checksums of each table for which they are known.

    Both values are known if they were stored, or if all pages of the table are intact. In `rows_by_table`, the rows
    that SQLite reads from an intact table replace the recovered rows, which may include deleted rows, unless these rows
    contradict the stored values.
    """
    tallies = {str(name): (int(rows), int(sums)) for name, rows, sums in rows_by_table["tallies"].values()}
    intact = set()
    for name, rows in iter_intact_tables(damaged):
        intact.add(name)
        tally = _compute_checksum_totals(name, rows)
        if TABLES[name].has_totals and tallies.setdefault(name, tally) == tally:
            rows_by_table[name] = rows
    for name in (name for name, definition in TABLES.items() if definition.has_totals and "tallies" in intact):
        if name not in tallies:
            # The table never had rows.
            tallies[name], rows_by_table[name] = (0, 0), {}
    return tallies


def _has_optional_table(meta: StudyMeta, table: str) -> bool:
    """Return whether a study with this description has an optional table."""
    return {"against": len(meta.others) > 1, "results": meta.asynchronous, "elsewhere": bool(meta.elsewhere)}[table]


def _compute_checksum_totals(table: str, rows: RowsByKey) -> tuple[int, int]:
    count = len(TABLES[table].columns)
    sums = [int(with_checksums(table, row)[count]) for row in rows.values()]
    return len(sums), reduce(xor, sums, 0)


def _recover_rounds(rows_by_table: dict[str, RowsByKey], checksum_totals: dict[str, tuple[int, int]]) -> dict[int, int]:
    """Return the round of each scenario by id, also for scenarios whose row is lost: these have the round 0."""
    rounds = {int(row[0]): int(row[1]) for row in rows_by_table["scenarios"].values()}
    if "scenarios" in checksum_totals:
        last = max([checksum_totals["scenarios"][0], *rounds])
    else:
        last = max([0, *rounds, *(int(row[0]) for name in _SCENARIO_TABLES for row in rows_by_table[name].values())])
    return {number: rounds.get(number, 0) for number in range(1, last + 1)}


def _reset_incomplete_scenarios(
    rows_by_table: dict[str, RowsByKey], meta: StudyMeta, rounds: dict[int, int]
) -> tuple[int, ...]:
    """Make scenarios pending if a part of their results is lost; return ids of all scenarios that have to be run."""
    metrics: dict[str, dict[int, set[str]]] = {name: defaultdict(set) for name in _SCENARIO_TABLES}
    for name in _SCENARIO_TABLES:
        for stored in rows_by_table[name].values():
            metrics[name][stored[0]].add(stored[1])
    is_required = {"courses": True, "repeats": meta.repeats > 1, "against": len(meta.others) > 1}
    to_rerun = []
    for number in rounds:
        row = rows_by_table["scenarios"].get((number,))
        is_complete = row is not None and row[4] != "pending"
        if row is not None and row[4] == "done":
            is_complete = all(
                metrics[name][number] >= set(meta.metrics) for name, needed in is_required.items() if needed
            )
        if is_complete:
            continue
        to_rerun.append(number)
        for name in _SCENARIO_TABLES:
            rows_by_table[name] = {key: values for key, values in rows_by_table[name].items() if values[0] != number}
        if row is not None:
            rows_by_table["scenarios"][number,] = (*row[:4], "pending", None, None)
    done = {int(row[0]) for row in rows_by_table["scenarios"].values() if row[4] == "done"}
    rows_by_table["digests"] = {key: values for key, values in rows_by_table["digests"].items() if values[0] in done}
    return tuple(to_rerun)
