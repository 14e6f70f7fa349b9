"""The way from the schema of an earlier version of a study to that of today.

Version 6 has checksums, and a lease in place of a lock beside the file. Version 5 has notes. Version 4 says which
share of the scenarios are audits. Version 3 holds the arrays of an analysis in pieces, and of the distances one half.
Version 2 holds each array as one value, and judges the bounds of clusters by the scenarios that they were found from.
Version 1 has fewer tables and grew over time: a file of it may lack what its first releases did not know.
"""

from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Callable, Iterator
from typing import Any, Final

import numpy as np

from cornercase._common.typing import IntArray
from cornercase.metrics import METRICS
from cornercase.study.arrays import packed_pieces
from cornercase.study.codec import pack_arrays, unpack_arrays
from cornercase.study.schema import ALWAYS, SCHEMA_VERSION, STATEMENTS, TABLES
from cornercase.study.seals import put

# Tables of version 5, which none before it has otherwise unless it is said below.
_SCHEMA_OF_5: Final = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE scenarios (
    id INTEGER PRIMARY KEY, round INTEGER NOT NULL, point BLOB NOT NULL, parameters TEXT NOT NULL,
    state TEXT NOT NULL CHECK (state IN ('pending', 'done', 'failed')), error TEXT, recording BLOB);
CREATE TABLE courses (
    scenario INTEGER NOT NULL REFERENCES scenarios, metric TEXT NOT NULL, score REAL NOT NULL,
    course BLOB NOT NULL, PRIMARY KEY (scenario, metric)) WITHOUT ROWID;
CREATE TABLE repeats (
    scenario INTEGER NOT NULL REFERENCES scenarios, metric TEXT NOT NULL, scores TEXT NOT NULL,
    PRIMARY KEY (scenario, metric)) WITHOUT ROWID;
CREATE TABLE outcomes (scenario INTEGER PRIMARY KEY REFERENCES scenarios, outcome TEXT NOT NULL);
CREATE TABLE notes (scenario INTEGER PRIMARY KEY REFERENCES scenarios, note TEXT NOT NULL);
CREATE TABLE analyses (name TEXT PRIMARY KEY, info TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE arrays (
    analysis TEXT NOT NULL REFERENCES analyses, name TEXT NOT NULL, part INTEGER NOT NULL, data BLOB NOT NULL,
    UNIQUE (analysis, name, part));
CREATE TABLE elapsed (stage TEXT PRIMARY KEY, seconds REAL NOT NULL) WITHOUT ROWID;
"""

OLD_TABLES: Final = tuple(name for name in TABLES if name != "tallies")
"""Tables of a study of an earlier version; those that refer to others come after them."""

_ARRAYS_OF_2: Final = """CREATE TABLE arrays (
    analysis TEXT NOT NULL REFERENCES analyses, name TEXT NOT NULL, data BLOB NOT NULL, UNIQUE (analysis, name))"""

# Bytes of an array of version 2 that is not one of all pairs.
_LARGEST_OTHERS: Final = 1 << 26

# Keys of `meta` that the first releases did not write.
_LATER: Final = ("critical", "files", "pareto", "repeats", "weights")


def schema_version(connection: sqlite3.Connection) -> int:
    """Version of the schema that a file has.

    Parameters
    ----------
    connection : sqlite3.Connection

    Returns
    -------
    int
    """
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    return int(version)


def migrate(connection: sqlite3.Connection) -> None:
    """Bring a study of an earlier version to the schema of today, wholly or not at all.

    Parameters
    ----------
    connection : sqlite3.Connection
        Of a file that may be written.
    """
    if schema_version(connection) == SCHEMA_VERSION:
        return
    connection.execute("BEGIN IMMEDIATE")
    try:
        while (version := schema_version(connection)) < SCHEMA_VERSION:
            _STEPS[version](connection)
            connection.execute(f"PRAGMA user_version = {version + 1}")
        connection.execute("COMMIT")
    except BaseException:
        connection.execute("ROLLBACK")
        raise


def _from_1(connection: sqlite3.Connection) -> None:
    """Add the tables of version 2, and what the first releases did not write."""
    before = dict(connection.execute("SELECT name, arrays FROM analyses").fetchall())
    infos = {name: json.loads(info) for name, info in connection.execute("SELECT name, info FROM analyses")}
    connection.execute("DROP TABLE analyses")
    connection.execute(_ARRAYS_OF_2)
    for statement in _SCHEMA_OF_5.split(";"):
        if statement.strip():
            connection.execute(statement.replace("CREATE TABLE", "CREATE TABLE IF NOT EXISTS"))
    connection.executemany("INSERT OR IGNORE INTO meta VALUES (?, 'null')", [(key,) for key in _LATER])
    # Which constraints the space had was not written.
    (space,) = connection.execute("SELECT value FROM meta WHERE key = 'space'").fetchone()
    parameters = [{"sets": []} | one for one in json.loads(space)]
    connection.execute(
        "UPDATE meta SET value = ? WHERE key = 'space'",
        (json.dumps({"parameters": parameters, "declarations": []}, sort_keys=True),),
    )
    for name, info in infos.items():
        arrays = unpack_arrays(before[name])
        if name == "reduction":
            whole = _whole_reduction(info, len(unpack_arrays(before[info["by"]])["ids"]))
        else:
            whole = _whole_analysis(info, arrays)
            arrays["landmarks"] = _landmarks(whole, arrays)
        connection.execute("INSERT INTO analyses VALUES (?, ?)", (name, json.dumps(whole)))
        connection.executemany(
            "INSERT INTO arrays VALUES (?, ?, ?)",
            [(name, key, pack_arrays({key: array})) for key, array in arrays.items()],
        )


def _whole_analysis(info: dict[str, Any], arrays: dict[str, Any]) -> dict[str, Any]:
    """Facts of a clustering, with what the first releases did not know of it."""
    added = {
        "method": "dbscan",
        "stability": None,
        "landmarks": 0,
        "error": 0.0,
        "fitted": arrays["ids"].tolist(),
        "profiles": [],
    }
    candidates = [{"stability": math.nan} | one for one in info["candidates"]]
    return added | info | {"candidates": candidates}


def _landmarks(info: dict[str, Any], arrays: dict[str, Any]) -> IntArray:
    """Landmarks of a clustering, which version 1 only counts: they are drawn as it did."""
    fitted = np.flatnonzero(np.isin(arrays["ids"], info["fitted"]))
    if not info["landmarks"]:
        return np.zeros(0, dtype=np.int64)
    order = np.argsort(arrays["distances"][np.ix_(fitted, fitted)].sum(axis=1), kind="stable")
    drawn = np.sort(np.random.default_rng(0).choice(order, info["landmarks"], replace=False))
    return np.asarray(fitted[drawn], dtype=np.int64)


def _whole_reduction(info: dict[str, Any], run: int) -> dict[str, Any]:
    """Facts of a reduction, with what the first releases did not know of it."""
    added = dict.fromkeys(("better_largest", "better_mean", "medoids_largest", "medoids_mean"))
    coverage = {name: added | one if one else one for name, one in info["coverage"].items()}
    return {"run": run, "shapes": [], "critical": {}} | info | {"coverage": coverage}


def _from_2(connection: sqlite3.Connection) -> None:
    """Cut arrays into pieces, and take back figures of what they were chosen with."""
    connection.execute("ALTER TABLE arrays RENAME TO whole")
    (statement,) = (one for one in _SCHEMA_OF_5.split(";") if "CREATE TABLE arrays" in one)
    connection.execute(statement)
    (scenarios,) = connection.execute("SELECT COUNT(*) FROM scenarios").fetchone()
    for rowid, analysis, name in connection.execute("SELECT rowid, analysis, name FROM whole").fetchall():
        (data,) = connection.execute("SELECT data FROM whole WHERE rowid = ?", (rowid,)).fetchone()
        array = unpack_arrays(data, _LARGEST_OTHERS + 8 * scenarios**2)[name]
        pieces = packed_pieces(connection, analysis, {name: array})
        connection.executemany("INSERT INTO arrays VALUES (?, ?, ?, ?)", pieces)
    connection.execute("DROP TABLE whole")
    for name, info in connection.execute("SELECT name, info FROM analyses").fetchall():
        stored = json.loads(info)
        judged = _judged_reduction(stored) if name == "reduction" else _judged_analysis(name, stored)
        connection.execute("UPDATE analyses SET info = ? WHERE name = ?", (json.dumps(judged), name))


def _judged_analysis(name: str, info: dict[str, Any]) -> dict[str, Any]:
    """Facts of a clustering, without what its rules were said to hold of the scenarios that they were found from.

    Version 2 has no names of clusters, and does not know how much they say of what happened.
    """

    def judged(rule: dict[str, Any]) -> dict[str, Any]:
        # What is true of all was not found from any.
        return rule if rule["text"] == "everywhere" else rule | {"covers": math.nan, "purity": math.nan}

    nameless = {"name": "", "true_of": math.nan, "true_elsewhere": math.nan, "example": None}
    profiles = [nameless | one | {"rules": [judged(rule) for rule in one["rules"]]} for one in info["profiles"]]
    # It compared the ego's trajectory and courses of metrics, all instants with all. Nobody knows the unit of a metric
    # whose package is not here.
    metric = name.partition(":")[0] in METRICS
    unit = "m" if name == "ego-trajectory" else METRICS.create(name).unit if metric else "unknown"
    return info | {"profiles": profiles, "unit": unit, "window": None, "tells": {}}


def _judged_reduction(info: dict[str, Any]) -> dict[str, Any]:
    """Facts of a reduction, without what scenarios that did not choose it say of it."""
    without = {"held_out": None}
    graded = {key: {name: one and without | one for name, one in info[key].items()} for key in ("coverage", "critical")}
    return info | graded


def _from_3(connection: sqlite3.Connection) -> None:
    """Say that no scenario is an audit."""
    connection.execute("INSERT OR IGNORE INTO meta VALUES ('audit', 'null')")


def _from_4(connection: sqlite3.Connection) -> None:
    """Add the table of notes, which the step from version 1 has added already."""
    (statement,) = (one for one in _SCHEMA_OF_5.split(";") if "CREATE TABLE notes" in one)
    connection.execute(statement.replace("CREATE TABLE", "CREATE TABLE IF NOT EXISTS"))


def _from_5(connection: sqlite3.Connection) -> None:
    """Give each row its checksum: what is there now counts as what was written."""
    # Other tables go on naming those that they refer to, and need not be told of the names in between.
    connection.execute("PRAGMA legacy_alter_table = ON")
    there = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    there &= set(OLD_TABLES)
    for name in there:
        connection.execute(f"ALTER TABLE {name} RENAME TO old_{name}")
    for name in STATEMENTS:
        if name in ALWAYS or name in there:
            connection.execute(STATEMENTS[name])
    for name in (one for one in OLD_TABLES if one in there):
        put(connection, name, _in_order(connection, name), replace=False)
        connection.execute(f"DROP TABLE old_{name}")


def _in_order(connection: sqlite3.Connection, name: str) -> Iterator[tuple[Any, ...]]:
    about = TABLES[name]
    order = ", ".join(about.columns[: about.key]) or "rowid"
    yield from connection.execute(f"SELECT {', '.join(about.columns)} FROM old_{name} ORDER BY {order}")


_STEPS: Final[dict[int, Callable[[sqlite3.Connection], None]]] = {
    1: _from_1, 2: _from_2, 3: _from_3, 4: _from_4, 5: _from_5
}  # fmt: skip
