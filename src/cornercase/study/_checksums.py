"""Checksums of rows, computed when a row is written and checked when it is read.

Each row has the CRC-32 of its table's name and its values; a blob (a value of bytes) has a checksum of its own. To
detect missing rows, the table ``tallies`` stores the row count and the XOR of all checksums of each table.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from functools import reduce
from operator import xor
from typing import Any
from zlib import crc32

from cornercase.study._damage import DamageError
from cornercase.study._schema import TABLES, StudyTable


def compute_row_checksum(table: str, values: Sequence[Any]) -> int:
    """Return the CRC-32 of a table's name and the values of a row, with the checksum of a blob in place of the blob.

    Use the values as SQLite returns them: their types may differ from the types of the inserted values.
    """
    # The same on all platforms and versions of Python, and much faster than hashing each value.
    return crc32(ascii((table, *values)).encode("ascii"))


def with_checksums(table: str, row: Sequence[Any]) -> tuple[Any, ...]:
    """Return a row with its checksums added, in the column order of the file."""
    definition = TABLES[table]
    values: list[Any] = [float(value) if isinstance(value, float) else value for value in row]
    if definition.float_column is not None:
        # SQLite has no negative zero.
        values[definition.float_column] = float(values[definition.float_column]) + 0.0
    if not definition.has_blob:
        return (*values, compute_row_checksum(table, values))
    blob = values[-1]
    values[-1] = None if blob is None else crc32(blob)
    return (*values, compute_row_checksum(table, values), blob)


def is_checksum_valid(table: str, stored_row: Sequence[Any]) -> bool:
    """Return whether a row from the file has valid checksums; the row may lack its blob."""
    definition = TABLES[table]
    count = len(definition.columns)
    if compute_row_checksum(table, stored_row[:count]) != stored_row[count]:
        return False
    if not definition.has_blob or len(stored_row) == count + 1:
        return True
    blob = stored_row[-1]
    return bool(stored_row[count - 1] == (crc32(blob) if isinstance(blob, bytes) else None))


def insert_rows(
    connection: sqlite3.Connection, table: str, rows: Iterable[Sequence[Any]], *, replace: bool = True
) -> None:
    """Insert rows and their checksums; call it within a transaction. `replace` overwrites rows with the same key."""
    definition = TABLES[table]
    columns = ", ".join(definition.stored_columns)
    insert = (
        f"INSERT{' OR REPLACE' * replace} INTO {table} ({columns}) VALUES"
        f" ({', '.join('?' * len(definition.stored_columns))})"
    )
    query = f"SELECT checksum FROM {table} WHERE {_key_condition(definition)}"
    added, sums = 0, 0
    for row in rows:
        stored = with_checksums(table, row)
        previous = (
            connection.execute(query, stored[: definition.n_key_columns]).fetchone()
            if replace and definition.n_key_columns
            else None
        )
        connection.execute(insert, stored)
        added += previous is None
        sums ^= stored[len(definition.columns)] ^ (0 if previous is None else _require_int_checksum(table, previous[0]))
    _update_checksum_totals(connection, table, added, sums)


def delete_rows(connection: sqlite3.Connection, table: str, condition: str = "1", *values: Any) -> None:
    """Delete the rows that fit the SQL `condition`, by default all; call it within a transaction."""
    checksums = connection.execute(f"SELECT checksum FROM {table} WHERE {condition}", values).fetchall()
    if checksums:
        connection.execute(f"DELETE FROM {table} WHERE {condition}", values)
        _update_checksum_totals(
            connection,
            table,
            -len(checksums),
            reduce(xor, (_require_int_checksum(table, checksum) for (checksum,) in checksums)),
        )


def _require_int_checksum(table: str, checksum: Any) -> int:
    if not isinstance(checksum, int):
        raise DamageError(f"its table {table} has a row without a checksum")
    return checksum


def read_rows(
    connection: sqlite3.Connection, table: str, condition: str = "1", *values: Any, with_blob: bool = False
) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of a table without checksums, sorted by key; `DamageError` at the first invalid checksum."""
    definition = TABLES[table]
    columns = definition.stored_columns if with_blob or not definition.has_blob else definition.stored_columns[:-1]
    order = ", ".join(definition.columns[: definition.n_key_columns]) or "rowid"
    count = len(definition.columns_without_blob)
    query = f"SELECT {', '.join(columns)} FROM {table} WHERE {condition} ORDER BY {order}"
    for stored in connection.execute(query, values):
        if not is_checksum_valid(table, stored):
            raise DamageError(f"its table {table} has a wrong checksum for {describe_row_key(table, stored)}")
        yield (*stored[:count], stored[-1]) if with_blob and definition.has_blob else stored[:count]


def require_checksum_totals(connection: sqlite3.Connection, table: str) -> None:
    """Raise `DamageError` if the row count or the XOR of checksums of a table differs from the stored value."""
    if not TABLES[table].has_totals:
        return
    checksums = [checksum for (checksum,) in connection.execute(f"SELECT checksum FROM {table}")]
    if not all(isinstance(checksum, int) for checksum in checksums) or _compute_totals(
        checksums
    ) != read_checksum_totals(connection, table):
        raise DamageError(f"its table {table} has missing or extra rows")


def _compute_totals(checksums: Sequence[int]) -> tuple[int, int]:
    return len(checksums), reduce(xor, checksums, 0)


def read_checksum_totals(connection: sqlite3.Connection, table: str) -> tuple[int, int]:
    """Return the stored row count and XOR of checksums of a table; `DamageError` if these two numbers are damaged."""
    row = connection.execute("SELECT * FROM tallies WHERE name = ?", (table,)).fetchone()
    if row is None:
        return 0, 0
    if not is_checksum_valid("tallies", row):
        raise DamageError(f"the row count of its table {table} has a wrong checksum")
    return int(row[1]), int(row[2])


def describe_row_key(table: str, stored_row: Sequence[Any]) -> str:
    """Describe the key of a row in words: column names and values."""
    definition = TABLES[table]
    keys = zip(definition.columns[: definition.n_key_columns], stored_row, strict=False)
    return ", ".join(f"{name} {str(value)[:60]!r}" for name, value in keys) or "a row"


def _update_checksum_totals(connection: sqlite3.Connection, table: str, n_added: int, checksum_xor: int) -> None:
    if not TABLES[table].has_totals or not (n_added or checksum_xor):
        return
    rows, checksums = read_checksum_totals(connection, table)
    stored = with_checksums("tallies", (table, rows + n_added, checksums ^ checksum_xor))
    connection.execute("INSERT OR REPLACE INTO tallies VALUES (?, ?, ?, ?)", stored)


def _key_condition(definition: StudyTable) -> str:
    return " AND ".join(f"{name} = ?" for name in definition.columns[: definition.n_key_columns])
