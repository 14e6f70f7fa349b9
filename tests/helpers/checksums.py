"""Studies changed by one who knows how checksums are made: what they hold is refused for what it is."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

from cornercase.study._checksums import insert_rows
from cornercase.study._schema import CREATE_STATEMENTS, TABLES


def reseal(path: Path) -> None:
    """Give each row the checksum of what it holds now."""
    with closing(sqlite3.connect(path)) as connection:
        there = dict(connection.execute("SELECT name, sql FROM sqlite_master WHERE type = 'table'").fetchall())
        plain = [name for name in TABLES if there.get(name) == CREATE_STATEMENTS[name] and name != "tallies"]
        if "tallies" not in there:
            return
        with connection:
            held = {
                name: connection.execute(f"SELECT {', '.join(TABLES[name].columns)} FROM {name}").fetchall()
                for name in plain
            }
            for name in (*plain, "tallies"):
                connection.execute(f"DELETE FROM {name}")
            for name, rows in held.items():
                insert_rows(connection, name, rows)


def changed(path: Path, *statements: str | tuple[str, tuple[object, ...]]) -> None:
    """Change a study as one who does not use cornercase, but makes its checksums: SQL, or (SQL, values)."""
    with closing(sqlite3.connect(path)) as connection, connection:
        for one in statements:
            connection.execute(*((one,) if isinstance(one, str) else one))
    reseal(path)
