"""A study made anew of what is left of a damaged one."""

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

# What `analyze` makes again; all of it or none, as its parts belong together.
_ANALYSES = ("outcomes", "analyses", "arrays")
_OF_SCENARIOS = ("courses", "repeats", "against")


@dataclass(frozen=True)
class Remains:
    """What is left of a study, and what of it has to be run again.

    Attributes
    ----------
    meta : StudyMeta
    rounds : dict of int to int
        Round of each scenario, by id; 0 where it is not known.
    again : tuple of int
        Scenarios that are to be run again.
    lost : tuple of str
        What cannot be brought back by running scenarios, in words.
    tallies : dict of str to tuple of (int, int)
        How many rows each table had, and what their checksums come to, where that is known.
    counted : bool
        Whether it is known how many scenarios it had.
    """

    meta: StudyMeta
    rounds: dict[int, int]
    again: tuple[int, ...]
    lost: tuple[str, ...]
    tallies: dict[str, tuple[int, int]]
    counted: bool


def rebuild(damaged: Path, made: Path) -> Remains:
    """Make a study of what is left of a damaged one; scenarios that are to be run again are pending in it.

    Parameters
    ----------
    damaged : Path
        It is only read.
    made : Path
        Where the new one is to be.

    Returns
    -------
    Remains

    Raises
    ------
    InputError
        What the study is about is lost, or the file has several names.
    """
    require_one_name(damaged)
    found = salvaged(damaged)
    tallies = _known_tallies(damaged, found)
    with damage_told(damaged):
        try:
            meta = StudyMeta.from_json({key: loaded_json(value) for key, value in found["meta"].values()})
        except (LookupError, ValueError, TypeError, AttributeError, OverflowError):
            meta = None
    if meta is None or tallies.get("meta", _tally("meta", found["meta"])) != _tally("meta", found["meta"]):
        raise InputError(
            f"{damaged}: its description (the table meta) is damaged and cannot be restored; run `explore` again,"
            " into another study."
        )
    lost = []
    if any(tallies.get(name) != _tally(name, found[name]) for name in _ANALYSES):
        some = "" if set(_ANALYSES) <= set(tallies) else ", if it had any"
        lost.append(f"its clusters and its reduced set{some}; `analyze` and `reduce` make them again")
        for name in _ANALYSES:
            found[name] = {}
    if "notes" not in tallies:
        lost.append("notes on scenarios, if there were more")
    elif missing := tallies["notes"][0] - len(found["notes"]):
        lost.append(f"{missing} notes on scenarios")
    rounds = _rounds_of(found, tallies)
    again = _sort_out(found, meta, rounds)
    with closing(sqlite3.connect(made)) as connection:
        make_tables(connection, *(name for name, about in TABLES.items() if not about.always and _has(meta, name)))
        for name in TABLES:
            if name != "tallies" and (TABLES[name].always or _has(meta, name)):
                put(connection, name, found[name].values(), replace=False)
        connection.commit()
    return Remains(meta, rounds, again, tuple(lost), tallies, "scenarios" in tallies)


def _known_tallies(damaged: Path, found: dict[str, Rows]) -> dict[str, tuple[int, int]]:
    """How many rows each table had: as it is written down, or as they are where the pages of the table are in order.

    Of a table that is in order, only what stands in it is left in `found`, and nothing that was removed before.
    """
    tallies = {str(name): (int(rows), int(sums)) for name, rows, sums in found["tallies"].values()}
    whole = set()
    for name, rows in tables_in_order(damaged):
        whole.add(name)
        tally = _tally(name, rows)
        if TABLES[name].tallied and tallies.setdefault(name, tally) == tally:
            found[name] = rows
    for name in (name for name, about in TABLES.items() if about.tallied and "tallies" in whole):
        if name not in tallies:
            # It never had rows.
            tallies[name], found[name] = (0, 0), {}
    return tallies


def _has(meta: StudyMeta, table: str) -> bool:
    """Whether a study has a table that not every one has."""
    return {"against": len(meta.others) > 1, "results": meta.asynchronous, "elsewhere": bool(meta.elsewhere)}[table]


def _tally(table: str, rows: Rows) -> tuple[int, int]:
    count = len(TABLES[table].columns)
    sums = [int(sealed(table, row)[count]) for row in rows.values()]
    return len(sums), reduce(xor, sums, 0)


def _rounds_of(found: dict[str, Rows], tallies: dict[str, tuple[int, int]]) -> dict[int, int]:
    """Rounds of all scenarios that the study had."""
    known = {int(row[0]): int(row[1]) for row in found["scenarios"].values()}
    last = tallies["scenarios"][0] if "scenarios" in tallies else 0
    last = max([last, *known, *(int(row[0]) for name in _OF_SCENARIOS for row in found[name].values())])
    return {one: known.get(one, 0) for one in range(1, last + 1)}


def _sort_out(found: dict[str, Rows], meta: StudyMeta, rounds: dict[int, int]) -> tuple[int, ...]:
    """Make scenarios pending of which something is lost; return their ids."""
    there: dict[str, dict[int, set[str]]] = {name: defaultdict(set) for name in _OF_SCENARIOS}
    for name in _OF_SCENARIOS:
        for one in found[name].values():
            there[name][one[0]].add(one[1])
    wanted = {"courses": True, "repeats": meta.repeats > 1, "against": len(meta.others) > 1}
    again = []
    for number in rounds:
        row = found["scenarios"].get((number,))
        whole = row is not None and row[4] != "pending"
        if row is not None and row[4] == "done":
            whole = all(there[name][number] >= set(meta.metrics) for name, asked in wanted.items() if asked)
        if whole:
            continue
        again.append(number)
        for name in _OF_SCENARIOS:
            found[name] = {key: each for key, each in found[name].items() if each[0] != number}
        if row is not None:
            found["scenarios"][number,] = (*row[:4], "pending", None, None)
    return tuple(again)
