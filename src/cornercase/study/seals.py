"""Checksums of what a study holds: made where a row is written, and looked at where it is read.

Each row has the CRC-32 of what it holds and of the table it stands in, a blob one of its own. How many rows a table
has, and the exclusive or of their checksums, stands in ``tallies``, so that a row that is gone is missed too.
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
    """CRC-32 of a row.

    Parameters
    ----------
    table : str
        Where it stands.
    values : sequence of object
        What it holds, as SQLite gives it back; the checksum of a blob in its place.

    Returns
    -------
    int
    """
    # The same on each platform and in each version of Python, and several times as fast as taking them one by one.
    return crc32(ascii((table, *values)).encode("ascii"))


def sealed(table: str, row: Sequence[Any]) -> tuple[Any, ...]:
    """Give a row as it is stored.

    Parameters
    ----------
    table : str
    row : sequence of object
        A value for each column.

    Returns
    -------
    tuple
        With its checksums, in the order of the file.
    """
    about = TABLES[table]
    values: list[Any] = [float(one) if isinstance(one, float) else one for one in row]
    if about.real is not None:
        # SQLite knows no negative zero.
        values[about.real] = float(values[about.real]) + 0.0
    if not about.blob:
        return (*values, checksum_of(table, values))
    blob = values[-1]
    values[-1] = None if blob is None else crc32(blob)
    return (*values, checksum_of(table, values), blob)


def is_sound(table: str, stored: Sequence[Any]) -> bool:
    """Tell whether a row is as it was written.

    Parameters
    ----------
    table : str
    stored : sequence of object
        Values in the order of the file; a blob may be left out.

    Returns
    -------
    bool
    """
    about = TABLES[table]
    count = len(about.columns)
    if checksum_of(table, stored[:count]) != stored[count]:
        return False
    if not about.blob or len(stored) == count + 1:
        return True
    blob = stored[-1]
    return bool(stored[count - 1] == (crc32(blob) if isinstance(blob, bytes) else None))


def put(connection: sqlite3.Connection, table: str, rows: Iterable[Sequence[Any]], *, replace: bool = True) -> None:
    """Write rows; within a transaction.

    Parameters
    ----------
    connection : sqlite3.Connection
    table : str
    rows : iterable of sequence
        A value for each column.
    replace : bool, default True
        Whether a row takes the place of one with the same key; otherwise there may be none.
    """
    about = TABLES[table]
    columns = ", ".join(about.stored)
    write = f"INSERT{' OR REPLACE' * replace} INTO {table} ({columns}) VALUES ({', '.join('?' * len(about.stored))})"
    known = f"SELECT checksum FROM {table} WHERE {_keys(about)}"
    added, sums = 0, 0
    for row in rows:
        stored = sealed(table, row)
        before = connection.execute(known, stored[: about.key]).fetchone() if replace and about.key else None
        connection.execute(write, stored)
        added += before is None
        sums ^= stored[len(about.columns)] ^ (0 if before is None else _number(table, before[0]))
    _tally(connection, table, added, sums)


def remove(connection: sqlite3.Connection, table: str, where: str = "1", *values: Any) -> None:
    """Remove rows; within a transaction.

    Parameters
    ----------
    connection : sqlite3.Connection
    table : str
    where : str, optional
        Condition in SQL; by default all are removed.
    *values : object
        For its question marks.
    """
    found = connection.execute(f"SELECT checksum FROM {table} WHERE {where}", values).fetchall()
    if found:
        connection.execute(f"DELETE FROM {table} WHERE {where}", values)
        _tally(connection, table, -len(found), reduce(xor, (_number(table, one) for (one,) in found)))


def _number(table: str, checksum: Any) -> int:
    if not isinstance(checksum, int):
        raise DamageError(f"its table {table} has a row without a checksum")
    return checksum


def read_rows(
    connection: sqlite3.Connection, table: str, where: str = "1", *values: Any, blob: bool = False
) -> Iterator[tuple[Any, ...]]:
    """Read rows, each of which is as it was written.

    Parameters
    ----------
    connection : sqlite3.Connection
    table : str
    where : str, optional
        Condition in SQL; by default all are read.
    *values : object
        For its question marks.
    blob : bool, default False
        Whether the blob of each is read too.

    Yields
    ------
    tuple
        Their columns, without checksums, in the order of their keys.

    Raises
    ------
    DamageError
        A row is not as it was written.
    """
    about = TABLES[table]
    wanted = about.stored if blob or not about.blob else about.stored[:-1]
    order = ", ".join(about.columns[: about.key]) or "rowid"
    count = len(about.light)
    question = f"SELECT {', '.join(wanted)} FROM {table} WHERE {where} ORDER BY {order}"
    for stored in connection.execute(question, values):
        if not is_sound(table, stored):
            raise DamageError(f"its table {table} does not hold {name_of(table, stored)} as it was written")
        yield (*stored[:count], stored[-1]) if blob and about.blob else stored[:count]


def require_tally(connection: sqlite3.Connection, table: str) -> None:
    """Refuse a table of which rows are missing.

    Parameters
    ----------
    connection : sqlite3.Connection
    table : str

    Raises
    ------
    DamageError
        It has other rows than were written.
    """
    if not TABLES[table].tallied:
        return
    found = [one for (one,) in connection.execute(f"SELECT checksum FROM {table}")]
    if not all(isinstance(one, int) for one in found) or _come_to(found) != known_tally(connection, table):
        raise DamageError(f"its table {table} does not hold the rows that were written")


def _come_to(checksums: Sequence[int]) -> tuple[int, int]:
    return len(checksums), reduce(xor, checksums, 0)


def known_tally(connection: sqlite3.Connection, table: str) -> tuple[int, int]:
    """Tell how many rows a table has, and what their checksums come to, as it is written down.

    Parameters
    ----------
    connection : sqlite3.Connection
    table : str

    Returns
    -------
    tuple of (int, int)

    Raises
    ------
    DamageError
        What is written down is damaged.
    """
    found = connection.execute("SELECT * FROM tallies WHERE name = ?", (table,)).fetchone()
    if found is None:
        return 0, 0
    if not is_sound("tallies", found):
        raise DamageError(f"how many rows its table {table} has is not as it was written")
    return int(found[1]), int(found[2])


def name_of(table: str, stored: Sequence[Any]) -> str:
    """Name a row for people.

    Parameters
    ----------
    table : str
    stored : sequence of object
        Its values.

    Returns
    -------
    str
    """
    about = TABLES[table]
    keys = zip(about.columns[: about.key], stored, strict=False)
    return ", ".join(f"{name} {str(value)[:60]!r}" for name, value in keys) or "a row"


def _tally(connection: sqlite3.Connection, table: str, added: int, sums: int) -> None:
    if not TABLES[table].tallied or not (added or sums):
        return
    rows, checksums = known_tally(connection, table)
    stored = sealed("tallies", (table, rows + added, checksums ^ sums))
    connection.execute("INSERT OR REPLACE INTO tallies VALUES (?, ?, ?, ?)", stored)


def _keys(about: Table) -> str:
    return " AND ".join(f"{name} = ?" for name in about.columns[: about.key])
