"""Recover intact rows from a damaged study file.

SQLite reads what it can. The remaining pages are searched one by one. The checksum of a row proves that the row is
complete, and shows which table it belongs to. So neither the schema nor the index pages are needed.
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

from cornercase.study._checksums import is_checksum_valid
from cornercase.study._connection import open_connection
from cornercase.study._damage import DamageError
from cornercase.study._schema import TABLES

RowsByKey = dict[Any, tuple[Any, ...]]
StoredRow = tuple[str, int | None, tuple[Any, ...]]

# Types of B-tree pages with rows: table leaves; leaves and inner pages of WITHOUT ROWID tables.
_TABLE_LEAF, _INDEX_LEAF, _INDEX = 0x0D, 0x0A, 0x02
_FILE_HEADER_SIZE: Final = 100
_DECODE_ERRORS: Final = (ValueError, IndexError, struct.error, OverflowError)
_INTEGER_SIZES: Final = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8}
# Tables that are ordered by row number.
_ROWID_TABLES: Final = ("arrays", "elsewhere")
# The latest state counts if the file still holds earlier ones.
_STATE_RANKS: Final = {"pending": 0, "failed": 1, "done": 2}

_DEFAULT_PAGE_SIZE: Final = 4096
# A recording fills several pages, mostly adjacent.
_PAGE_CACHE_SIZE: Final = 256


class PageReader:
    """Reader of the pages of an SQLite file; `page_size` and `file_size` are in bytes, `len` is the number of pages."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.file_size = file.seek(0, 2)
        file.seek(16)
        size = int.from_bytes(file.read(2), "big")
        size = 65536 if size == 1 else size
        # An invalid page size in the file is damaged, so the default is used.
        self.page_size = size if size >= 512 and not size & (size - 1) else _DEFAULT_PAGE_SIZE
        self.read_page = lru_cache(_PAGE_CACHE_SIZE)(self._read_page)

    def __len__(self) -> int:
        return -(-self.file_size // self.page_size)

    def _read_page(self, number: int) -> bytes:
        """Read a page, numbered from 1; the last page may be cut off by the end of the file."""
        if number < 1:
            raise ValueError("a page before the first")
        self._file.seek((number - 1) * self.page_size)
        return self._file.read(self.page_size)


@contextmanager
def open_pages(path: Path) -> Iterator[PageReader]:
    """Open a study file within the block, and yield a reader of its pages."""
    with path.open("rb") as file:
        yield PageReader(file)


def recover_rows(path: Path) -> dict[str, RowsByKey]:
    """Return the intact rows of a study: for each table, the rows by key, sorted as in the table."""
    # Rows that SQLite reads override others, which may be remains of deleted rows.
    tables, order = _group_rows_by_key(chain(_scan_pages(path), _iter_rows_with_sqlite(path)))
    return {name: dict(sorted(rows.items(), key=lambda item: order[name][item[0]])) for name, rows in tables.items()}


def has_intact_rows(path: Path) -> bool:
    """Return whether any row in a file has a valid checksum, which proves that cornercase wrote the file."""
    return any(True for _ in _scan_pages(path))


def iter_intact_tables(path: Path) -> Iterator[tuple[str, RowsByKey]]:
    """Yield name and rows of each table that has only intact pages and intact rows."""
    with suppress(sqlite3.Error, UnicodeDecodeError), closing(open_connection(path)) as connection:
        connection.execute("PRAGMA trusted_schema = OFF")
        for name in TABLES:
            rows = None
            with suppress(sqlite3.Error, UnicodeDecodeError, DamageError):
                # SQLite before 3.33 ignores the name and checks the whole file.
                if connection.execute(f"PRAGMA integrity_check({name})").fetchall() == [("ok",)]:
                    rows = _group_rows_by_key((name, *row) for row in _iter_checked_rows(connection, name))[0][name]
            if rows is not None:
                yield name, rows


def _iter_checked_rows(connection: sqlite3.Connection, table: str) -> Iterator[tuple[int | None, Any]]:
    for number, stored in _iter_table_rows(connection, table):
        if not is_checksum_valid(table, stored):
            raise DamageError(f"its table {table} has a row with a wrong checksum")
        yield number, stored


def _iter_table_rows(
    connection: sqlite3.Connection, table: str, order_suffix: str = ""
) -> Iterator[tuple[int | None, Any]]:
    """Yield number and values of each row of a table.

    Rows of `_ROWID_TABLES` are sorted by number. Rows of other tables are sorted by key, and their number is None.
    """
    numbered = table in _ROWID_TABLES
    keys = ("rowid",) if numbered else TABLES[table].columns[: TABLES[table].n_key_columns]
    columns = ", ".join(("rowid", *TABLES[table].stored_columns) if numbered else TABLES[table].stored_columns)
    order = ", ".join(key + order_suffix for key in keys)
    for row in connection.execute(f"SELECT {columns} FROM {table} ORDER BY {order}"):
        yield (row[0], row[1:]) if numbered else (None, row)


def _group_rows_by_key(stored_rows: Iterable[StoredRow]) -> tuple[dict[str, RowsByKey], dict[str, dict[Any, Any]]]:
    """Group rows by table and key; the second result has the sort key of each row, also by table and key."""
    tables: dict[str, RowsByKey] = {name: {} for name in TABLES}
    order: dict[str, dict[Any, Any]] = {name: {} for name in TABLES}
    for table, number, values in stored_rows:
        definition = TABLES[table]
        n_columns = len(definition.columns_without_blob)
        row = (*values[:n_columns], values[-1]) if definition.has_blob else values[:n_columns]
        key = row[: definition.n_key_columns] if definition.n_key_columns else number
        earlier = tables[table].get(key)
        if earlier is None or table != "scenarios" or _STATE_RANKS.get(row[4], 0) >= _STATE_RANKS.get(earlier[4], 0):
            tables[table][key] = row
            order[table][key] = number if table in _ROWID_TABLES else key
    return tables, order


def _iter_rows_with_sqlite(path: Path) -> Iterator[StoredRow]:
    """Yield the rows that SQLite can read, from the beginning and from the end of each table."""
    with suppress(sqlite3.Error, UnicodeDecodeError), closing(open_connection(path)) as connection:
        connection.execute("PRAGMA trusted_schema = OFF")
        for table in TABLES:
            for backwards in ("", " DESC"):
                with suppress(sqlite3.Error, UnicodeDecodeError):
                    for number, stored in _iter_table_rows(connection, table, backwards):
                        if is_checksum_valid(table, stored):
                            yield table, number, stored


def _scan_pages(path: Path) -> Iterator[StoredRow]:
    """Search all pages of a file for rows."""
    with open_pages(path) as pages:
        for number in range(1, len(pages) + 1):
            with suppress(*_DECODE_ERRORS):
                for values in _iter_page_records(pages, number):
                    yield from _match_record_to_tables(values)


def _match_record_to_tables(rowid_and_record: tuple[int | None, list[Any]]) -> Iterator[StoredRow]:
    """Yield the record for each table in which it has a valid checksum."""
    number, record = rowid_and_record
    for table, definition in TABLES.items():
        if len(record) != len(definition.stored_columns):
            continue
        stored = list(record)
        # An INTEGER PRIMARY KEY is stored as the row number only.
        if number is not None and stored[0] is None:
            stored[0] = number
        if definition.float_column is not None and isinstance(stored[definition.float_column], int):
            stored[definition.float_column] = float(stored[definition.float_column])
        if is_checksum_valid(table, stored):
            yield table, number, tuple(stored)


def _iter_page_records(pages: PageReader, page_number: int) -> Iterator[tuple[int | None, list[Any]]]:
    """Yield row numbers and values of the rows on a page."""
    page = pages.read_page(page_number)
    header_size = _FILE_HEADER_SIZE if page_number == 1 else 0
    page_type = page[header_size]
    if page_type not in (_TABLE_LEAF, _INDEX_LEAF, _INDEX):
        return
    first_pointer = header_size + (12 if page_type == _INDEX else 8)
    # The stored number of cells may be damaged, so it is not used.
    for k in range((pages.page_size - first_pointer) // 2):
        with suppress(*_DECODE_ERRORS):
            start = int.from_bytes(page[first_pointer + 2 * k : first_pointer + 2 * k + 2], "big")
            if not first_pointer <= start < pages.page_size:
                break
            offset = start + (4 if page_type == _INDEX else 0)
            length, offset = _decode_varint(page, offset)
            row = None
            if page_type == _TABLE_LEAF:
                row, offset = _decode_varint(page, offset)
            yield row, _decode_record(_read_payload(pages, page, offset, length, page_type == _TABLE_LEAF))


def _read_payload(pages: PageReader, page: bytes, offset: int, length: int, is_table_leaf: bool) -> bytes:
    """Read the bytes of a row, which may continue on overflow pages."""
    size = pages.page_size
    if length > pages.file_size:
        raise ValueError("a row that is longer than the file")
    max_local = size - 35 if is_table_leaf else (size - 12) * 64 // 255 - 23
    if length <= max_local:
        return page[offset : offset + length]
    min_local = (size - 12) * 32 // 255 - 23
    local = min_local + (length - min_local) % (size - 4)
    local = local if local <= max_local else min_local
    parts, n_read = [page[offset : offset + local]], local
    next_page = int.from_bytes(page[offset + local : offset + local + 4], "big")
    while n_read < length:
        page = pages.read_page(next_page)
        if not page:
            raise ValueError("a row without its next page")
        parts.append(page[4 : 4 + min(length - n_read, size - 4)])
        n_read += size - 4
        next_page = int.from_bytes(page[:4], "big")
    return b"".join(parts)


def _decode_record(payload: bytes) -> list[Any]:
    """Decode the values of a row from SQLite's record format."""
    end, offset = _decode_varint(payload, 0)
    types = []
    while offset < end:
        type_code, offset = _decode_varint(payload, offset)
        types.append(type_code)
    values = []
    for type_code in types:
        value, offset = _decode_value(payload, offset, type_code)
        values.append(value)
    return values


def _decode_value(payload: bytes, offset: int, type_code: int) -> tuple[Any, int]:
    if type_code in _INTEGER_SIZES:
        end = offset + _INTEGER_SIZES[type_code]
        return int.from_bytes(payload[offset:end], "big", signed=True), end
    if type_code == 7:
        return struct.unpack(">d", payload[offset : offset + 8])[0], offset + 8
    if type_code < 12:
        return {0: None, 8: 0, 9: 1}[type_code] if type_code in (0, 8, 9) else None, offset
    end = offset + (type_code - 12) // 2
    part = payload[offset:end]
    return (part.decode() if type_code % 2 else part), end


def _decode_varint(data: bytes, offset: int) -> tuple[int, int]:
    value = 0
    for k in range(8):
        byte = data[offset + k]
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value, offset + k + 1
    return value << 8 | data[offset + 8], offset + 9
