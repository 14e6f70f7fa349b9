"""The tables of a study file, and which columns their checksums cover."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

SCHEMA_VERSION: Final = 1

APPLICATION: Final = 0x434F524E
"""SQLite's application id of a study: "CORN"."""


@dataclass(frozen=True)
class Table:
    """A table of a study, whose rows have checksums; `columns` are without these, the blob last.

    `n_key_columns` is the number of leading columns that identify a row, 0 if rows are identified by their order. The
    blob has a checksum of its own, so that a row can be read without it. `float_column` is the index of the column of
    floats. `has_totals` tables have their row count and XOR of checksums in `tallies`; `is_required` marks tables that
    each study has.
    """

    statement: str
    columns: tuple[str, ...]
    key: int
    blob: bool = False
    real: int | None = None
    tallied: bool = True
    always: bool = True

    @property
    def light(self) -> tuple[str, ...]:
        """Columns without the blob."""
        return self.columns[:-1] if self.blob else self.columns

    @property
    def stored(self) -> tuple[str, ...]:
        """All columns in the order of the file: checksums come before a blob, which may fill many pages."""
        last = self.columns[-1]
        return (*self.light, f"{last}_checksum", "checksum", last) if self.blob else (*self.columns, "checksum")


_SCENARIO: Final = "scenario INTEGER NOT NULL REFERENCES scenarios"

TABLES: Final[dict[str, Table]] = {
    "meta": Table(
        "CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL, checksum INTEGER NOT NULL) WITHOUT ROWID",
        ("key", "value"),
        1,
    ),
    "scenarios": Table(
        "CREATE TABLE scenarios (id INTEGER PRIMARY KEY, round INTEGER NOT NULL, point BLOB NOT NULL,"
        " parameters TEXT NOT NULL, state TEXT NOT NULL CHECK (state IN ('pending', 'done', 'failed')), error TEXT,"
        " recording_checksum INTEGER, checksum INTEGER NOT NULL, recording BLOB)",
        ("id", "round", "point", "parameters", "state", "error", "recording"),
        1,
        blob=True,
    ),
    "courses": Table(
        f"CREATE TABLE courses ({_SCENARIO}, metric TEXT NOT NULL, score REAL NOT NULL,"
        " course_checksum INTEGER NOT NULL, checksum INTEGER NOT NULL, course BLOB NOT NULL,"
        " PRIMARY KEY (scenario, metric)) WITHOUT ROWID",
        ("scenario", "metric", "score", "course"),
        2,
        blob=True,
        real=2,
    ),
    "repeats": Table(
        f"CREATE TABLE repeats ({_SCENARIO}, metric TEXT NOT NULL, scores TEXT NOT NULL,"
        " checksum INTEGER NOT NULL, PRIMARY KEY (scenario, metric)) WITHOUT ROWID",
        ("scenario", "metric", "scores"),
        2,
    ),
    "outcomes": Table(
        "CREATE TABLE outcomes (scenario INTEGER PRIMARY KEY REFERENCES scenarios, outcome TEXT NOT NULL,"
        " checksum INTEGER NOT NULL)",
        ("scenario", "outcome"),
        1,
    ),
    "notes": Table(
        "CREATE TABLE notes (scenario INTEGER PRIMARY KEY REFERENCES scenarios, note TEXT NOT NULL,"
        " checksum INTEGER NOT NULL)",
        ("scenario", "note"),
        1,
    ),
    "analyses": Table(
        "CREATE TABLE analyses (name TEXT PRIMARY KEY, info TEXT NOT NULL, checksum INTEGER NOT NULL) WITHOUT ROWID",
        ("name", "info"),
        1,
    ),
    "arrays": Table(
        "CREATE TABLE arrays (analysis TEXT NOT NULL REFERENCES analyses, name TEXT NOT NULL, part INTEGER NOT NULL,"
        " data_checksum INTEGER NOT NULL, checksum INTEGER NOT NULL, data BLOB NOT NULL,"
        " UNIQUE (analysis, name, part))",
        ("analysis", "name", "part", "data"),
        3,
        blob=True,
    ),
    "elapsed": Table(
        "CREATE TABLE elapsed (stage TEXT PRIMARY KEY, seconds REAL NOT NULL, checksum INTEGER NOT NULL) WITHOUT ROWID",
        ("stage", "seconds"),
        1,
        real=1,
        # Its rows depend on the clock, and no other table does.
        tallied=False,
    ),
    "against": Table(
        f"CREATE TABLE against ({_SCENARIO}, metric TEXT NOT NULL, other TEXT,"
        " checksum INTEGER NOT NULL, PRIMARY KEY (scenario, metric)) WITHOUT ROWID",
        ("scenario", "metric", "other"),
        2,
        always=False,
    ),
    "results": Table(
        "CREATE TABLE results (number INTEGER PRIMARY KEY, scenario INTEGER NOT NULL UNIQUE REFERENCES scenarios,"
        " round INTEGER NOT NULL, checksum INTEGER NOT NULL)",
        ("number", "scenario", "round"),
        1,
        always=False,
    ),
    "elsewhere": Table(
        "CREATE TABLE elsewhere (point BLOB NOT NULL, score REAL NOT NULL, checksum INTEGER NOT NULL)",
        ("point", "score"),
        0,
        real=1,
        always=False,
    ),
    "tallies": Table(
        "CREATE TABLE tallies (name TEXT PRIMARY KEY, rows INTEGER NOT NULL, checksums INTEGER NOT NULL,"
        " checksum INTEGER NOT NULL) WITHOUT ROWID",
        ("name", "rows", "checksums"),
        1,
        tallied=False,
    ),
}
"""Tables whose rows have checksums; those that refer to others come after them."""

LEASE: Final = (
    "CREATE TABLE lease (token TEXT NOT NULL, host TEXT NOT NULL, machine TEXT NOT NULL, pid INTEGER NOT NULL,"
    " began REAL NOT NULL, beat REAL NOT NULL)"
)
"""Creates the table with the process that may write to the study, if there is one."""

STATEMENTS: Final = {name: table.statement for name, table in TABLES.items()} | {"lease": LEASE}
"""SQL that creates each table, as SQLite stores it."""

ALWAYS: Final = (*(name for name, table in TABLES.items() if table.always), "lease")
"""Tables that each study has."""
