"""Row checksums: computed when a row is written, and checked when it is read.

Each row has the CRC-32 of its table's name and its values, a blob one of its own. The table ``tallies`` stores the row
count and the XOR of the checksums of each table, so that a lost row is noticed too.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from functools import reduce
from operator import xor
from typing import Any
from zlib import crc32

from cornercase.study.damage import DamageError
from cornercase.study.schema import TABLES, Table


def checksum_of(table: str, values: Sequence[Any]) -> int:
    """CRC-32 of a row with the values that SQLite gives back; a blob is replaced by its checksum."""
    # The same on all platforms and versions of Python, and much faster than hashing each value.
    return crc32(ascii((table, *values)).encode("ascii"))


def sealed(table: str, row: Sequence[Any]) -> tuple[Any, ...]:
    """Add the checksums to a row, in the column order of the file."""
    definition = TABLES[table]
    values: list[Any] = [float(value) if isinstance(value, float) else value for value in row]
    if definition.real is not None:
        # SQLite has no negative zero.
        values[definition.real] = float(values[definition.real]) + 0.0
    if not definition.blob:
        return (*values, checksum_of(table, values))
    blob = values[-1]
    values[-1] = None if blob is None else crc32(blob)
    return (*values, checksum_of(table, values), blob)


def is_sound(table: str, stored: Sequence[Any]) -> bool:
    """Tell whether a stored row has valid checksums; its blob may be left out."""
    definition = TABLES[table]
    count = len(definition.columns)
    if checksum_of(table, stored[:count]) != stored[count]:
        return False
    if not definition.blob or len(stored) == count + 1:
        return True
    blob = stored[-1]
    return bool(stored[count - 1] == (crc32(blob) if isinstance(blob, bytes) else None))


def put(connection: sqlite3.Connection, table: str, rows: Iterable[Sequence[Any]], *, replace: bool = True) -> None:
    """Insert rows within a transaction; `replace` overwrites rows with the same key."""
    definition = TABLES[table]
    columns = ", ".join(definition.stored)
    insert = (
        f"INSERT{' OR REPLACE' * replace} INTO {table} ({columns}) VALUES ({', '.join('?' * len(definition.stored))})"
    )
    query = f"SELECT checksum FROM {table} WHERE {_keys(definition)}"
    added, sums = 0, 0
    for row in rows:
        stored = sealed(table, row)
        previous = (
            connection.execute(query, stored[: definition.key]).fetchone() if replace and definition.key else None
        )
        connection.execute(insert, stored)
        added += previous is None
        sums ^= stored[len(definition.columns)] ^ (0 if previous is None else _number(table, previous[0]))
    _tally(connection, table, added, sums)


def remove(connection: sqlite3.Connection, table: str, where: str = "1", *values: Any) -> None:
    """Delete rows within a transaction; all of them without a condition."""
    checksums = connection.execute(f"SELECT checksum FROM {table} WHERE {where}", values).fetchall()
    if checksums:
        connection.execute(f"DELETE FROM {table} WHERE {where}", values)
        _tally(connection, table, -len(checksums), reduce(xor, (_number(table, checksum) for (checksum,) in checksums)))


def _number(table: str, checksum: Any) -> int:
    if not isinstance(checksum, int):
        raise DamageError(f"its table {table} has a row without a checksum")
    return checksum


def read_rows(
    connection: sqlite3.Connection, table: str, where: str = "1", *values: Any, blob: bool = False
) -> Iterator[tuple[Any, ...]]:
    """Yield rows without checksums in the order of their keys; raises `DamageError` at an invalid checksum."""
    definition = TABLES[table]
    columns = definition.stored if blob or not definition.blob else definition.stored[:-1]
    order = ", ".join(definition.columns[: definition.key]) or "rowid"
    count = len(definition.light)
    query = f"SELECT {', '.join(columns)} FROM {table} WHERE {where} ORDER BY {order}"
    for stored in connection.execute(query, values):
        if not is_sound(table, stored):
            raise DamageError(f"its table {table} has a wrong checksum for {name_of(table, stored)}")
        yield (*stored[:count], stored[-1]) if blob and definition.blob else stored[:count]


def require_tally(connection: sqlite3.Connection, table: str) -> None:
    """Raise `DamageError` if row count or XOR of checksums of a table differ from what is stored."""
    if not TABLES[table].tallied:
        return
    checksums = [checksum for (checksum,) in connection.execute(f"SELECT checksum FROM {table}")]
    if not all(isinstance(checksum, int) for checksum in checksums) or _come_to(checksums) != known_tally(
        connection, table
    ):
        raise DamageError(f"its table {table} has missing or extra rows")


def _come_to(checksums: Sequence[int]) -> tuple[int, int]:
    return len(checksums), reduce(xor, checksums, 0)


def known_tally(connection: sqlite3.Connection, table: str) -> tuple[int, int]:
    """Stored row count and XOR of checksums of a table; raises `DamageError` if they are damaged."""
    row = connection.execute("SELECT * FROM tallies WHERE name = ?", (table,)).fetchone()
    if row is None:
        return 0, 0
    if not is_sound("tallies", row):
        raise DamageError(f"the row count of its table {table} has a wrong checksum")
    return int(row[1]), int(row[2])


def name_of(table: str, stored: Sequence[Any]) -> str:
    """Key columns and values of a row, in words."""
    definition = TABLES[table]
    keys = zip(definition.columns[: definition.key], stored, strict=False)
    return ", ".join(f"{name} {str(value)[:60]!r}" for name, value in keys) or "a row"


def _tally(connection: sqlite3.Connection, table: str, added: int, sums: int) -> None:
    if not TABLES[table].tallied or not (added or sums):
        return
    rows, checksums = known_tally(connection, table)
    stored = sealed("tallies", (table, rows + added, checksums ^ sums))
    connection.execute("INSERT OR REPLACE INTO tallies VALUES (?, ?, ?, ?)", stored)


def _keys(about: Table) -> str:
    return " AND ".join(f"{name} = ?" for name in about.columns[: about.key])
