"""Recover intact rows from a damaged study file.

SQLite reads what it can. The rest is searched page by page: the checksum of a row proves that it is complete, and to
which table it belongs, so neither the pages that lead to it nor the schema are needed.
"""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager, suppress
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO, Final

from cornercase.study.connecting import connected
from cornercase.study.damage import DamageError
from cornercase.study.schema import TABLES
from cornercase.study.seals import is_sound

Rows = dict[Any, tuple[Any, ...]]
Stored = tuple[str, int | None, tuple[Any, ...]]

# Types of B-tree pages with rows: table leaves; leaves and inner pages of WITHOUT ROWID tables.
_TABLE_LEAF, _INDEX_LEAF, _INDEX = 0x0D, 0x0A, 0x02
_HEADER: Final = 100
_BROKEN: Final = (ValueError, IndexError, struct.error, OverflowError)
_INTEGERS: Final = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8}
# Tables that are ordered by row number.
_NUMBERED: Final = ("arrays", "elsewhere")
# The latest state counts if the file still holds earlier ones.
_STATES: Final = {"pending": 0, "failed": 1, "done": 2}

_PAGE: Final = 4096
# A recording fills several pages, mostly adjacent.
_REMEMBERED: Final = 256


class Pages:
    """Pages of an SQLite file; `size` is the number of bytes of a page, `length` that of the file."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.length = file.seek(0, 2)
        file.seek(16)
        size = int.from_bytes(file.read(2), "big")
        size = 65536 if size == 1 else size
        # An invalid page size is damaged.
        self.size = size if size >= 512 and not size & (size - 1) else _PAGE
        self.page = lru_cache(_REMEMBERED)(self._page)

    def __len__(self) -> int:
        return -(-self.length // self.size)

    def _page(self, number: int) -> bytes:
        """Read a page, numbered from 1; it is shorter if the file ends within it."""
        if number < 1:
            raise ValueError("a page before the first")
        self._file.seek((number - 1) * self.size)
        return self._file.read(self.size)


@contextmanager
def opened_pages(path: Path) -> Iterator[Pages]:
    """Open the pages of a study for as long as the block lasts."""
    with path.open("rb") as file:
        yield Pages(file)


def salvaged(path: Path) -> dict[str, Rows]:
    """Recover the intact rows of a study, by table and key, in the order of the table."""
    # Rows that SQLite reads override others, which may be remains of deleted rows.
    tables, order = _gathered(chain(_scanned(path), _read(path)))
    return {name: dict(sorted(rows.items(), key=lambda item: order[name][item[0]])) for name, rows in tables.items()}


def holds_rows(path: Path) -> bool:
    """Tell whether any row in a file has a valid checksum, so that cornercase wrote it."""
    return any(True for _ in _scanned(path))


def tables_in_order(path: Path) -> Iterator[tuple[str, Rows]]:
    """Yield name and rows of each table whose pages and rows are all intact."""
    with suppress(sqlite3.Error, UnicodeDecodeError), closing(connected(path)) as connection:
        connection.execute("PRAGMA trusted_schema = OFF")
        for name in TABLES:
            rows = None
            with suppress(sqlite3.Error, UnicodeDecodeError, DamageError):
                # SQLite before 3.33 ignores the name and checks the whole file.
                if connection.execute(f"PRAGMA integrity_check({name})").fetchall() == [("ok",)]:
                    rows = _gathered((name, *row) for row in _sound(connection, name))[0][name]
            if rows is not None:
                yield name, rows


def _sound(connection: sqlite3.Connection, table: str) -> Iterator[tuple[int | None, Any]]:
    for number, stored in _of_table(connection, table):
        if not is_sound(table, stored):
            raise DamageError(f"its table {table} has a row with a wrong checksum")
        yield number, stored


def _of_table(connection: sqlite3.Connection, table: str, backwards: str = "") -> Iterator[tuple[int | None, Any]]:
    """Yield row numbers and values of a table in the order of its keys."""
    numbered = table in _NUMBERED
    keys = ("rowid",) if numbered else TABLES[table].columns[: TABLES[table].key]
    columns = ", ".join(("rowid", *TABLES[table].stored) if numbered else TABLES[table].stored)
    order = ", ".join(key + backwards for key in keys)
    for row in connection.execute(f"SELECT {columns} FROM {table} ORDER BY {order}"):
        yield (row[0], row[1:]) if numbered else (None, row)


def _gathered(stored: Iterable[Stored]) -> tuple[dict[str, Rows], dict[str, dict[Any, Any]]]:
    """Group rows by table and key; also return what each table is ordered by."""
    tables: dict[str, Rows] = {name: {} for name in TABLES}
    order: dict[str, dict[Any, Any]] = {name: {} for name in TABLES}
    for table, number, values in stored:
        definition = TABLES[table]
        n_columns = len(definition.light)
        row = (*values[:n_columns], values[-1]) if definition.blob else values[:n_columns]
        key = row[: definition.key] if definition.key else number
        earlier = tables[table].get(key)
        if earlier is None or table != "scenarios" or _STATES.get(row[4], 0) >= _STATES.get(earlier[4], 0):
            tables[table][key] = row
            order[table][key] = number if table in _NUMBERED else key
    return tables, order


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
    """Search all pages of a file for rows."""
    with opened_pages(path) as pages:
        for number in range(1, len(pages) + 1):
            with suppress(*_BROKEN):
                for values in _records(pages, number):
                    yield from _of_tables(values)


def _of_tables(values: tuple[int | None, list[Any]]) -> Iterator[Stored]:
    """Yield a record for each table that it fits with a valid checksum."""
    number, record = values
    for table, definition in TABLES.items():
        if len(record) != len(definition.stored):
            continue
        stored = list(record)
        # An INTEGER PRIMARY KEY is stored as the row number only.
        if number is not None and stored[0] is None:
            stored[0] = number
        if definition.real is not None and isinstance(stored[definition.real], int):
            stored[definition.real] = float(stored[definition.real])
        if is_sound(table, stored):
            yield table, number, tuple(stored)


def _records(pages: Pages, number: int) -> Iterator[tuple[int | None, list[Any]]]:
    """Yield row numbers and values of the rows of a page."""
    page = pages.page(number)
    header_size = _HEADER if number == 1 else 0
    page_type = page[header_size]
    if page_type not in (_TABLE_LEAF, _INDEX_LEAF, _INDEX):
        return
    first_pointer = header_size + (12 if page_type == _INDEX else 8)
    # The stored number of cells may be damaged, so it is not used.
    for k in range((pages.size - first_pointer) // 2):
        with suppress(*_BROKEN):
            start = int.from_bytes(page[first_pointer + 2 * k : first_pointer + 2 * k + 2], "big")
            if not first_pointer <= start < pages.size:
                break
            offset = start + (4 if page_type == _INDEX else 0)
            length, offset = _varint(page, offset)
            row = None
            if page_type == _TABLE_LEAF:
                row, offset = _varint(page, offset)
            yield row, _values(_payload(pages, page, offset, length, page_type == _TABLE_LEAF))


def _payload(pages: Pages, page: bytes, at: int, length: int, of_table: bool) -> bytes:
    """Bytes of a row, which may continue on overflow pages."""
    size = pages.size
    if length > pages.length:
        raise ValueError("a row that is longer than the file")
    max_local = size - 35 if of_table else (size - 12) * 64 // 255 - 23
    if length <= max_local:
        return page[at : at + length]
    min_local = (size - 12) * 32 // 255 - 23
    local = min_local + (length - min_local) % (size - 4)
    local = local if local <= max_local else min_local
    parts, n_read = [page[at : at + local]], local
    next_page = int.from_bytes(page[at + local : at + local + 4], "big")
    while n_read < length:
        page = pages.page(next_page)
        if not page:
            raise ValueError("a row without its next page")
        parts.append(page[4 : 4 + min(length - n_read, size - 4)])
        n_read += size - 4
        next_page = int.from_bytes(page[:4], "big")
    return b"".join(parts)


def _values(payload: bytes) -> list[Any]:
    """Decode the values of a row."""
    end, offset = _varint(payload, 0)
    types = []
    while offset < end:
        type_code, offset = _varint(payload, offset)
        types.append(type_code)
    values = []
    for type_code in types:
        value, offset = _value(payload, offset, type_code)
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
