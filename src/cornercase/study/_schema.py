"""Tables of a study file, and the columns that their checksums cover."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

SCHEMA_VERSION: Final = 1

APPLICATION_ID: Final = 0x434F524E
"""SQLite's application id of a study: "CORN"."""


@dataclass(frozen=True)
class StudyTable:
    """Definition of a table in a study file.

    `columns` are all columns except those of checksums. The first `n_key_columns` columns identify a row; 0 means that
    SQLite's row number identifies a row. If `has_blob`, the last column holds a blob (bytes) with a checksum of its
    own, so that the rest of a row can be read without the blob. `float_column` is the index of the column of floats, if
    there is one. If `has_totals`, row count and XOR of checksums are stored in the table ``tallies``. If `is_required`,
    every study has the table.
    """

    create_statement: str
    columns: tuple[str, ...]
    n_key_columns: int
    has_blob: bool = False
    float_column: int | None = None
    has_totals: bool = True
    is_required: bool = True

    @property
    def columns_without_blob(self) -> tuple[str, ...]:
        """Columns without checksums and without the blob."""
        return self.columns[:-1] if self.has_blob else self.columns

    @property
    def stored_columns(self) -> tuple[str, ...]:
        """All columns in the order of the file; a blob comes after the checksums, since a blob may fill many pages."""
        last = self.columns[-1]
        return (
            (*self.columns_without_blob, f"{last}_checksum", "checksum", last)
            if self.has_blob
            else (*self.columns, "checksum")
        )


_SCENARIO_COLUMN: Final = "scenario INTEGER NOT NULL REFERENCES scenarios"

TABLES: Final[dict[str, StudyTable]] = {
    "meta": StudyTable(
        "CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL, checksum INTEGER NOT NULL) WITHOUT ROWID",
        ("key", "value"),
        1,
    ),
    "scenarios": StudyTable(
        "CREATE TABLE scenarios (id INTEGER PRIMARY KEY, round INTEGER NOT NULL, point BLOB NOT NULL,"
        " parameters TEXT NOT NULL, state TEXT NOT NULL CHECK (state IN ('pending', 'done', 'failed')), error TEXT,"
        " recording_checksum INTEGER, checksum INTEGER NOT NULL, recording BLOB)",
        ("id", "round", "point", "parameters", "state", "error", "recording"),
        1,
        has_blob=True,
    ),
    "courses": StudyTable(
        f"CREATE TABLE courses ({_SCENARIO_COLUMN}, metric TEXT NOT NULL, score REAL NOT NULL,"
        " course_checksum INTEGER NOT NULL, checksum INTEGER NOT NULL, course BLOB NOT NULL,"
        " PRIMARY KEY (scenario, metric)) WITHOUT ROWID",
        ("scenario", "metric", "score", "course"),
        2,
        has_blob=True,
        float_column=2,
    ),
    "digests": StudyTable(
        "CREATE TABLE digests (scenario INTEGER PRIMARY KEY REFERENCES scenarios, facts TEXT NOT NULL,"
        " arrays_checksum INTEGER NOT NULL, checksum INTEGER NOT NULL, arrays BLOB NOT NULL)",
        ("scenario", "facts", "arrays"),
        1,
        has_blob=True,
    ),
    "repeats": StudyTable(
        f"CREATE TABLE repeats ({_SCENARIO_COLUMN}, metric TEXT NOT NULL, scores TEXT NOT NULL,"
        " checksum INTEGER NOT NULL, PRIMARY KEY (scenario, metric)) WITHOUT ROWID",
        ("scenario", "metric", "scores"),
        2,
    ),
    "outcomes": StudyTable(
        "CREATE TABLE outcomes (scenario INTEGER PRIMARY KEY REFERENCES scenarios, outcome TEXT NOT NULL,"
        " checksum INTEGER NOT NULL)",
        ("scenario", "outcome"),
        1,
    ),
    "notes": StudyTable(
        "CREATE TABLE notes (scenario INTEGER PRIMARY KEY REFERENCES scenarios, note TEXT NOT NULL,"
        " checksum INTEGER NOT NULL)",
        ("scenario", "note"),
        1,
    ),
    "analyses": StudyTable(
        "CREATE TABLE analyses (name TEXT PRIMARY KEY, info TEXT NOT NULL, checksum INTEGER NOT NULL) WITHOUT ROWID",
        ("name", "info"),
        1,
    ),
    "arrays": StudyTable(
        "CREATE TABLE arrays (analysis TEXT NOT NULL REFERENCES analyses, name TEXT NOT NULL, part INTEGER NOT NULL,"
        " data_checksum INTEGER NOT NULL, checksum INTEGER NOT NULL, data BLOB NOT NULL,"
        " UNIQUE (analysis, name, part))",
        ("analysis", "name", "part", "data"),
        3,
        has_blob=True,
    ),
    "elapsed": StudyTable(
        "CREATE TABLE elapsed (stage TEXT PRIMARY KEY, seconds REAL NOT NULL, checksum INTEGER NOT NULL) WITHOUT ROWID",
        ("stage", "seconds"),
        1,
        float_column=1,
        # Its rows depend on the clock, and no other table does.
        has_totals=False,
    ),
    "against": StudyTable(
        f"CREATE TABLE against ({_SCENARIO_COLUMN}, metric TEXT NOT NULL, other TEXT,"
        " checksum INTEGER NOT NULL, PRIMARY KEY (scenario, metric)) WITHOUT ROWID",
        ("scenario", "metric", "other"),
        2,
        is_required=False,
    ),
    "results": StudyTable(
        "CREATE TABLE results (number INTEGER PRIMARY KEY, scenario INTEGER NOT NULL UNIQUE REFERENCES scenarios,"
        " round INTEGER NOT NULL, checksum INTEGER NOT NULL)",
        ("number", "scenario", "round"),
        1,
        is_required=False,
    ),
    "elsewhere": StudyTable(
        "CREATE TABLE elsewhere (point BLOB NOT NULL, score REAL NOT NULL, checksum INTEGER NOT NULL)",
        ("point", "score"),
        0,
        float_column=1,
        is_required=False,
    ),
    "tallies": StudyTable(
        "CREATE TABLE tallies (name TEXT PRIMARY KEY, rows INTEGER NOT NULL, checksums INTEGER NOT NULL,"
        " checksum INTEGER NOT NULL) WITHOUT ROWID",
        ("name", "rows", "checksums"),
        1,
        has_totals=False,
    ),
}
"""Tables whose rows have checksums; a table comes after the tables that it refers to."""

CREATE_LEASE: Final = (
    "CREATE TABLE lease (token TEXT NOT NULL, host TEXT NOT NULL, machine TEXT NOT NULL, pid INTEGER NOT NULL,"
    " began REAL NOT NULL, beat REAL NOT NULL)"
)
"""SQL that creates the table ``lease``, which names the process that may write to the study."""

CREATE_STATEMENTS: Final = {name: table.create_statement for name, table in TABLES.items()} | {"lease": CREATE_LEASE}
"""SQL that creates each table, as SQLite stores it."""

REQUIRED_TABLES: Final = (*(name for name, table in TABLES.items() if table.is_required), "lease")
"""Tables that each study has."""
