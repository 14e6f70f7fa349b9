"""Rows of a damaged study that are as they were written, wherever they stand in the file.

What SQLite can still read is read by it. The rest is looked for page by page: a row proves by its checksum that it is
whole, and of which table, so neither the pages that lead to it nor the description of the tables are needed.
"""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterable, Iterator
from contextlib import closing, suppress
from itertools import chain
from pathlib import Path
from typing import Any, Final

from cornercase.study.connecting import connected
from cornercase.study.damage import DamageError
from cornercase.study.pages import Pages, opened_pages
from cornercase.study.schema import TABLES
from cornercase.study.seals import is_sound

Rows = dict[Any, tuple[Any, ...]]
Stored = tuple[str, int | None, tuple[Any, ...]]

# Pages of a B-tree that hold rows: leaves of tables, leaves and others of tables without row numbers.
_TABLE_LEAF, _INDEX_LEAF, _INDEX = 0x0D, 0x0A, 0x02
_HEADER: Final = 100
_BROKEN: Final = (ValueError, IndexError, struct.error, OverflowError)
_INTEGERS: Final = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8}
# Tables whose order is that in which their rows were written.
_NUMBERED: Final = ("arrays", "elsewhere")
# A later state of a scenario counts more, where an earlier one is left in the file.
_STATES: Final = {"pending": 0, "failed": 1, "done": 2}


def salvaged(path: Path) -> dict[str, Rows]:
    """Find the rows of a study that are as they were written.

    Parameters
    ----------
    path : Path

    Returns
    -------
    dict of str to dict of tuple to tuple
        By table and key, all columns in the order of `Table.columns`; in the order in which
        they stand in the table.
    """
    # What SQLite reads counts more: what the pages hold besides may have been there before.
    found, order = _gathered(chain(_scanned(path), _read(path)))
    return {name: dict(sorted(rows.items(), key=lambda one: order[name][one[0]])) for name, rows in found.items()}


def holds_rows(path: Path) -> bool:
    """Tell whether anything in a file proves by its checksum that cornercase wrote it.

    Parameters
    ----------
    path : Path

    Returns
    -------
    bool
    """
    return any(True for _ in _scanned(path))


def tables_in_order(path: Path) -> Iterator[tuple[str, Rows]]:
    """Read the tables of a study in whose pages SQLite finds nothing wrong, and all of whose rows are sound.

    Parameters
    ----------
    path : Path

    Yields
    ------
    tuple of str and dict of tuple to tuple
        Name of a table, and its rows as `salvaged` gives them.
    """
    with suppress(sqlite3.Error, UnicodeDecodeError), closing(connected(path)) as connection:
        connection.execute("PRAGMA trusted_schema = OFF")
        for name in TABLES:
            rows = None
            with suppress(sqlite3.Error, UnicodeDecodeError, DamageError):
                # Those before 3.33 take no name, and look at the whole file.
                if connection.execute(f"PRAGMA integrity_check({name})").fetchall() == [("ok",)]:
                    rows = _gathered((name, *one) for one in _sound(connection, name))[0][name]
            if rows is not None:
                yield name, rows


def _sound(connection: sqlite3.Connection, table: str) -> Iterator[tuple[int | None, Any]]:
    for number, stored in _of_table(connection, table):
        if not is_sound(table, stored):
            raise DamageError(f"its table {table} holds a row that is not as it was written")
        yield number, stored


def _of_table(connection: sqlite3.Connection, table: str, backwards: str = "") -> Iterator[tuple[int | None, Any]]:
    """Numbers and values of the rows of a table, in the order of their keys."""
    numbered = table in _NUMBERED
    keys = ("rowid",) if numbered else TABLES[table].columns[: TABLES[table].key]
    columns = ", ".join(("rowid", *TABLES[table].stored) if numbered else TABLES[table].stored)
    order = ", ".join(key + backwards for key in keys)
    for found in connection.execute(f"SELECT {columns} FROM {table} ORDER BY {order}"):
        yield (found[0], found[1:]) if numbered else (None, found)


def _gathered(stored: Iterable[Stored]) -> tuple[dict[str, Rows], dict[str, dict[Any, Any]]]:
    """Put rows together by table and key; and what they are ordered by."""
    found: dict[str, Rows] = {name: {} for name in TABLES}
    order: dict[str, dict[Any, Any]] = {name: {} for name in TABLES}
    for table, number, values in stored:
        about = TABLES[table]
        count = len(about.light)
        row = (*values[:count], values[-1]) if about.blob else values[:count]
        key = row[: about.key] if about.key else number
        before = found[table].get(key)
        if before is None or table != "scenarios" or _STATES.get(row[4], 0) >= _STATES.get(before[4], 0):
            found[table][key] = row
            order[table][key] = number if table in _NUMBERED else key
    return found, order


def _read(path: Path) -> Iterator[Stored]:
    """Read what SQLite can, from both ends of each table."""
    with suppress(sqlite3.Error, UnicodeDecodeError), closing(connected(path)) as connection:
        connection.execute("PRAGMA trusted_schema = OFF")
        for table in TABLES:
            for backwards in ("", " DESC"):
                with suppress(sqlite3.Error, UnicodeDecodeError):
                    for number, stored in _of_table(connection, table, backwards):
                        if is_sound(table, stored):
                            yield table, number, stored


def _scanned(path: Path) -> Iterator[Stored]:
    """Look for rows in all pages of a file."""
    with opened_pages(path) as pages:
        for number in range(1, len(pages) + 1):
            with suppress(*_BROKEN):
                for values in _records(pages, number):
                    yield from _of_tables(values)


def _of_tables(values: tuple[int | None, list[Any]]) -> Iterator[Stored]:
    number, record = values
    for table, about in TABLES.items():
        if len(record) != len(about.stored):
            continue
        stored = list(record)
        # A column that is the number of the row is not stored in it.
        if number is not None and stored[0] is None:
            stored[0] = number
        if about.real is not None and isinstance(stored[about.real], int):
            stored[about.real] = float(stored[about.real])
        if is_sound(table, stored):
            yield table, number, tuple(stored)


def _records(pages: Pages, number: int) -> Iterator[tuple[int | None, list[Any]]]:
    """Numbers and values of the rows of a page."""
    page = pages.page(number)
    head = _HEADER if number == 1 else 0
    kind = page[head]
    if kind not in (_TABLE_LEAF, _INDEX_LEAF, _INDEX):
        return
    first = head + (12 if kind == _INDEX else 8)
    # How many there are may be damaged, too.
    for k in range((pages.size - first) // 2):
        with suppress(*_BROKEN):
            cell = int.from_bytes(page[first + 2 * k : first + 2 * k + 2], "big")
            if not first <= cell < pages.size:
                break
            at = cell + (4 if kind == _INDEX else 0)
            length, at = _varint(page, at)
            row = None
            if kind == _TABLE_LEAF:
                row, at = _varint(page, at)
            yield row, _values(_payload(pages, page, at, length, kind == _TABLE_LEAF))


def _payload(pages: Pages, page: bytes, at: int, length: int, of_table: bool) -> bytes:
    """Bytes of a row, which may go on in other pages."""
    size = pages.size
    if length > pages.length:
        raise ValueError("a row that is longer than the file")
    most = size - 35 if of_table else (size - 12) * 64 // 255 - 23
    if length <= most:
        return page[at : at + length]
    least = (size - 12) * 32 // 255 - 23
    local = least + (length - least) % (size - 4)
    local = local if local <= most else least
    parts, known = [page[at : at + local]], local
    following = int.from_bytes(page[at + local : at + local + 4], "big")
    while known < length:
        page = pages.page(following)
        if not page:
            raise ValueError("a row that goes on nowhere")
        parts.append(page[4 : 4 + min(length - known, size - 4)])
        known += size - 4
        following = int.from_bytes(page[:4], "big")
    return b"".join(parts)


def _values(payload: bytes) -> list[Any]:
    """Take a row apart."""
    end, at = _varint(payload, 0)
    kinds = []
    while at < end:
        kind, at = _varint(payload, at)
        kinds.append(kind)
    values = []
    for kind in kinds:
        value, at = _value(payload, at, kind)
        values.append(value)
    return values


def _value(payload: bytes, at: int, kind: int) -> tuple[Any, int]:
    if kind in _INTEGERS:
        end = at + _INTEGERS[kind]
        return int.from_bytes(payload[at:end], "big", signed=True), end
    if kind == 7:
        return struct.unpack(">d", payload[at : at + 8])[0], at + 8
    if kind < 12:
        return {0: None, 8: 0, 9: 1}[kind] if kind in (0, 8, 9) else None, at
    end = at + (kind - 12) // 2
    part = payload[at:end]
    return (part.decode() if kind % 2 else part), end


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for k in range(8):
        byte = data[at + k]
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value, at + k + 1
    return value << 8 | data[at + 8], at + 9
