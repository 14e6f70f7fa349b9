"""Everything that was run, in one SQLite file; its schema is in ``docs/study-format.md``."""

from __future__ import annotations

import csv
import importlib
import io
import json
import os
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from filelock import BaseFileLock

from cornercase._common.errors import InputError, SimulationError
from cornercase._common.files import written_whole
from cornercase._common.locks import taken_lock
from cornercase._common.typing import FloatArray
from cornercase.recordings import Collision, Recording, write_courses
from cornercase.scenario import Value
from cornercase.study.meta import StudyMeta

SCHEMA_VERSION: Final = 1
_APPLICATION: Final = 0x434F524E  # "CORN"

_SCHEMA: Final = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE scenarios (
    id INTEGER PRIMARY KEY, round INTEGER NOT NULL, point BLOB NOT NULL, parameters TEXT NOT NULL,
    state TEXT NOT NULL CHECK (state IN ('pending', 'done', 'failed')), error TEXT, recording BLOB);
CREATE TABLE courses (
    scenario INTEGER NOT NULL REFERENCES scenarios, metric TEXT NOT NULL, score REAL NOT NULL,
    course BLOB NOT NULL, PRIMARY KEY (scenario, metric)) WITHOUT ROWID;
CREATE TABLE analyses (name TEXT PRIMARY KEY, info TEXT NOT NULL, arrays BLOB NOT NULL) WITHOUT ROWID;
CREATE TABLE elapsed (stage TEXT PRIMARY KEY, seconds REAL NOT NULL) WITHOUT ROWID;
"""
# Only studies of repeated runs have it.
_REPEATS: Final = """
CREATE TABLE IF NOT EXISTS repeats (
    scenario INTEGER NOT NULL REFERENCES scenarios, metric TEXT NOT NULL, scores TEXT NOT NULL,
    PRIMARY KEY (scenario, metric)) WITHOUT ROWID
"""


@dataclass(frozen=True, eq=False)
class Row:
    """One concrete scenario of a study.

    Attributes
    ----------
    id, round : int
        Both from 1 on.
    point : ndarray of float64, shape (d,)
        In the unit cube.
    values : dict of str to float or str
    state : {"pending", "done", "failed"}
    error : str or None
    """

    id: int
    round: int
    point: FloatArray
    values: dict[str, Value]
    state: str
    error: str | None


class Study:
    """A study that is open; use it as a context manager.

    Readers work while an explorer writes. Make one with `create` or `open`.

    Attributes
    ----------
    path : Path
    meta : StudyMeta
        What the study is about.
    space : ParameterSpace
        What is varied.
    """

    def __init__(self, path: Path, connection: sqlite3.Connection, lock: BaseFileLock | None) -> None:
        self.path = path
        self._connection, self._lock = connection, lock
        self.meta = StudyMeta.from_json(
            {key: json.loads(value) for key, value in connection.execute("SELECT key, value FROM meta")}
        )
        self.space = self.meta.space

    @classmethod
    def create(cls, path: Path | str, meta: StudyMeta) -> Study:
        """Make a study in a new file, and open it for writing.

        Raises
        ------
        InputError
            The file exists already, or cannot be written.
        """
        path = Path(path)
        lock = _locked(path)
        try:
            # Looked for under the lock: of two explorers that begin at once, one makes the file.
            if path.exists():
                raise InputError(f"{path}: exists already; choose another name or remove it.")
            # The file appears under its name only when it is whole.
            with written_whole(path) as temporary, _sentences(path), closing(sqlite3.connect(temporary)) as connection:
                connection.executescript(_SCHEMA)
                connection.execute(f"PRAGMA application_id = {_APPLICATION}")
                connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
                connection.executemany(
                    "INSERT INTO meta VALUES (?, ?)",
                    [(key, json.dumps(value, sort_keys=True)) for key, value in sorted(meta.to_json().items())],
                )
                connection.commit()
            return cls._opened(path, lock)
        except BaseException:
            lock.release()
            raise

    @classmethod
    def open(cls, path: Path | str, readonly: bool = False) -> Study:
        """Open a study.

        Raises
        ------
        InputError
            There is none, it is none, another program writes to it, or it is of another schema version.
        """
        path = Path(path)
        if not path.is_file():
            raise InputError(f"{path}: there is no such study; make one with 'cornercase explore … -o {path}'.")
        # What is no study gets no lock beside it.
        reader = cls._opened(path, None)
        if readonly:
            return reader
        reader.close()
        lock = _locked(path)
        try:
            return cls._opened(path, lock)
        except BaseException:
            lock.release()
            raise

    @classmethod
    def _opened(cls, path: Path, lock: BaseFileLock | None) -> Study:
        """Open for writing under a lock, for reading without."""
        with _sentences(path):
            connection = _connected(path)
            try:
                (application,) = connection.execute("PRAGMA application_id").fetchone()
                (version,) = connection.execute("PRAGMA user_version").fetchone()
                if application != _APPLICATION:
                    raise InputError(f"{path}: is a database, but no cornercase study.")
                if version != SCHEMA_VERSION:
                    raise InputError(
                        f"{path}: has schema version {version}, this cornercase reads {SCHEMA_VERSION}; use the version"
                        " that wrote it."
                    )
                if lock is None:
                    connection.execute("PRAGMA query_only = ON")
                else:
                    connection.execute("PRAGMA journal_mode = WAL")
                    # A scenario counts as run only when it is on the disk.
                    connection.execute("PRAGMA synchronous = FULL")
                return cls(path, connection, lock)
            except BaseException:
                connection.close()
                raise

    def close(self) -> None:
        """Close the file."""
        self._connection.close()
        if self._lock is not None:
            self._lock.release()

    def __enter__(self) -> Study:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def propose(self, number: int, points: FloatArray, values: Sequence[Mapping[str, Value]]) -> list[Row]:
        """Store a round of proposals as pending, all or none; their rows."""
        rows = []
        with _sentences(self.path), self._connection:
            for point, one in zip(points, values, strict=True):
                cursor = self._connection.execute(
                    "INSERT INTO scenarios (round, point, parameters, state) VALUES (?, ?, ?, 'pending')",
                    (number, point.astype("<f8").tobytes(), json.dumps(dict(one))),
                )
                rows.append(Row(int(cursor.lastrowid or 0), number, point, dict(one), "pending", None))
        return rows

    def finish(
        self,
        scenario: int,
        recording: Recording,
        courses: Mapping[str, tuple[FloatArray, float]],
        repeats: Mapping[str, Sequence[float]] | None = None,
    ) -> None:
        """Store what came out of a scenario: its recording, and course and score of each metric.

        Parameters
        ----------
        scenario : int
        recording : Recording
        courses : mapping of str to (ndarray of float64, shape (T,), float)
            Course and score by metric.
        repeats : mapping of str to sequence of float, optional
            Where the scenario was run several times, the scores of all runs by metric.
        """
        with _sentences(self.path), self._connection:
            if repeats is not None:
                self._connection.execute(_REPEATS)
                self._connection.executemany(
                    "INSERT INTO repeats VALUES (?, ?, ?)",
                    [(scenario, name, json.dumps(list(scores))) for name, scores in repeats.items()],
                )
            self._connection.executemany(
                "INSERT INTO courses VALUES (?, ?, ?, ?)",
                [(scenario, name, score, _packed({"course": course})) for name, (course, score) in courses.items()],
            )
            self._connection.execute(
                "UPDATE scenarios SET state = 'done', recording = ? WHERE id = ?",
                (_pack_recording(recording), scenario),
            )

    def fail(self, scenario: int, error: SimulationError) -> None:
        """Store why a scenario could not be run."""
        with _sentences(self.path), self._connection:
            self._connection.execute(
                "UPDATE scenarios SET state = 'failed', error = ? WHERE id = ?", (str(error), scenario)
            )

    def rows(self) -> list[Row]:
        """All scenarios, in the order in which they were proposed."""
        found = self._found("SELECT id, round, point, parameters, state, error FROM scenarios ORDER BY id")
        return [
            Row(i, number, np.frombuffer(point, "<f8").copy(), json.loads(values), state, error)
            for i, number, point, values, state, error in found
        ]

    def done(self) -> list[Row]:
        """Scenarios that were run."""
        return [row for row in self.rows() if row.state == "done"]

    def failed(self) -> list[Row]:
        """Scenarios that could not be run."""
        return [row for row in self.rows() if row.state == "failed"]

    def points(self) -> FloatArray:
        """Points of the scenarios that were run, shape (n, d)."""
        return np.array([row.point for row in self.done()]).reshape(-1, self.space.dimension)

    def scores(self, metric: str) -> FloatArray:
        """Scores of the scenarios that were run, shape (n,)."""
        self._require_metric(metric)
        found = self._found(
            "SELECT score FROM courses JOIN scenarios ON id = scenario WHERE metric = ? AND state = 'done' ORDER BY id",
            metric,
        )
        return np.array([score for (score,) in found], dtype=np.float64)

    def spread(self, metric: str) -> FloatArray | None:
        """Lowest and highest score of the runs of each scenario that was run, shape (n, 2); None if each ran once."""
        self._require_metric(metric)
        if not self._found("SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = 'repeats'"):
            return None
        # Only a scenario that was run has them.
        found = self._found("SELECT scores FROM repeats WHERE metric = ? ORDER BY scenario", metric)
        return np.array([[min(scores), max(scores)] for scores in (json.loads(text) for (text,) in found)])

    def course(self, scenario: int, metric: str) -> FloatArray:
        """Course of a metric in one scenario, shape (T,)."""
        self._require_metric(metric)
        found = self._found("SELECT course FROM courses WHERE scenario = ? AND metric = ?", scenario, metric)
        if not found:
            raise InputError(f"{self.path}: the scenario {scenario} was not run.")
        return np.asarray(_unpacked(found[0][0])["course"])

    def recording(self, scenario: int) -> Recording:
        """Recording of one scenario."""
        found = self._found("SELECT recording FROM scenarios WHERE id = ? AND recording IS NOT NULL", scenario)
        if not found:
            raise InputError(f"{self.path}: the scenario {scenario} was not run.")
        return _unpack_recording(found[0][0])

    def save_analysis(self, name: str, arrays: Mapping[str, Any], info: Mapping[str, Any]) -> None:
        """Store a result under a name, instead of the one that was there."""
        with _sentences(self.path), self._connection:
            self._connection.execute(
                "INSERT OR REPLACE INTO analyses VALUES (?, ?, ?)",
                (name, json.dumps(dict(info)), _packed(arrays)),
            )

    def analyses(self) -> list[str]:
        """Names of the stored clusterings: ``ego-trajectory`` first, then the metrics."""
        names = [name for (name,) in self._found("SELECT name FROM analyses")]
        order = ["ego-trajectory", *self.meta.metrics]
        return [name for name in order if name in names]

    def analysis(self, name: str, *arrays: str) -> tuple[dict[str, Any], dict[str, Any]]:
        """Arrays and further facts of a stored result; with `arrays` only these are unpacked."""
        found = self._found("SELECT arrays, info FROM analyses WHERE name = ?", name)
        if not found:
            raise InputError(f"{self.path}: holds no analysis by {name}; run 'cornercase analyze {self.path}'.")
        packed, info = found[0]
        return _unpacked(packed, arrays), json.loads(info)

    def reduction(self) -> dict[str, Any] | None:
        """Return what is known of the reduced set, as in its manifest; None before the reduction."""
        found = self._found("SELECT info FROM analyses WHERE name = 'reduction'")
        return dict(json.loads(found[0][0])) if found else None

    def add_elapsed(self, stage: str, seconds: float) -> None:
        """Add to the time spent in a stage, in s."""
        with _sentences(self.path), self._connection:
            self._connection.execute(
                "INSERT INTO elapsed VALUES (?, ?)"
                " ON CONFLICT (stage) DO UPDATE SET seconds = seconds + excluded.seconds",
                (stage, seconds),
            )

    def elapsed(self) -> dict[str, float]:
        """Time spent by stage, in s."""
        return dict(self._found("SELECT stage, seconds FROM elapsed ORDER BY stage"))

    def export(self, folder: Path | str, parquet: bool = False) -> None:
        """Write everything as CSV: one table of scenarios, and recording and courses of each.

        Parameters
        ----------
        folder : path
            Gets ``scenarios.csv``, ``recordings/ID.csv`` and ``courses/ID.csv``.
        parquet : bool, default False
            Write ``scenarios.parquet`` too.

        Raises
        ------
        InputError
            The folder cannot be written, or the package that writes Parquet is not installed.
        """
        folder, table = Path(folder), self._table()
        if parquet:
            _write_parquet(folder / "scenarios.parquet", table)
        with (
            written_whole(folder / "scenarios.csv") as temporary,
            open(temporary, "w", newline="", encoding="utf-8") as file,
        ):
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(table)
            writer.writerows(zip(*table.values(), strict=True))
        for row in self.done():
            recording = self.recording(row.id)
            recording.to_csv(folder / "recordings" / f"{row.id:05}.csv")
            courses = {name: self.course(row.id, name) for name in self.meta.metrics}
            write_courses(folder / "courses" / f"{row.id:05}.csv", recording.time, courses)

    def _table(self) -> dict[str, list[Any]]:
        """One row per scenario, by column; None where there is no value."""
        rows, done = self.rows(), [row.id for row in self.done()]
        table: dict[str, list[Any]] = {key: [getattr(row, key) for row in rows] for key in ("id", "round", "state")}
        for parameter in self.space.parameters:
            table[parameter.name] = [parameter.read(row.values) for row in rows]
        for name in self.meta.metrics:
            scores = dict(zip(done, self.scores(name).tolist(), strict=True))
            table[name] = [scores.get(row.id) for row in rows]
            if (spread := self.spread(name)) is not None:
                ends = dict(zip(done, spread.tolist(), strict=True))
                table[f"lowest {name}"] = [ends.get(row.id, (None, None))[0] for row in rows]
                table[f"highest {name}"] = [ends.get(row.id, (None, None))[1] for row in rows]
        for name in self.analyses():
            arrays, _ = self.analysis(name)
            labels = dict(zip(arrays["ids"].tolist(), arrays["labels"].tolist(), strict=True))
            table[f"cluster by {name}"] = [labels.get(row.id) for row in rows]
        table["error"] = [row.error for row in rows]
        return table

    def _found(self, question: str, *values: Any) -> list[Any]:
        with _sentences(self.path):
            return self._connection.execute(question, values).fetchall()

    def _require_metric(self, metric: str) -> None:
        if metric not in self.meta.metrics:
            raise InputError(
                f"{self.path}: holds no course of the metric '{metric}'; it has {', '.join(self.meta.metrics)}."
            )


@contextmanager
def _sentences(path: Path) -> Iterator[None]:
    try:
        yield
    except sqlite3.Error as error:
        raise InputError(f"{path}: cannot be used as a study ({error}).") from error


def _connected(path: Path) -> sqlite3.Connection:
    # A reader of a file in WAL mode has to make its shared memory beside it. Where it cannot, nobody writes either.
    alone = not os.access(path.parent, os.W_OK) and not path.with_name(path.name + "-wal").exists()
    location = f"{path.resolve().as_uri()}?{'immutable=1' if alone else 'mode=rw'}"
    return sqlite3.connect(location, uri=True, timeout=30.0)


def _locked(path: Path) -> BaseFileLock:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = taken_lock(path.with_name(path.name + ".lock"))
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}).") from error
    if lock is None:
        raise InputError(f"{path}: another cornercase is writing to it; wait until it has ended.")
    return lock


def _write_parquet(path: Path, table: Mapping[str, list[Any]]) -> None:
    try:
        arrow, files = importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")
    except ImportError:
        raise InputError(f"{path}: Parquet needs pyarrow; install it with 'pip install cornercase[parquet]'.") from None
    with written_whole(path) as temporary:
        files.write_table(arrow.table(dict(table)), temporary)


def _packed(arrays: Mapping[str, Any]) -> bytes:
    # np.savez stamps no time into its members, so the bytes depend on the arrays alone.
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **{name: np.asarray(array) for name, array in arrays.items()})
    return buffer.getvalue()


def _unpacked(data: bytes, names: Sequence[str] = ()) -> dict[str, Any]:
    with np.load(io.BytesIO(data), allow_pickle=False) as loaded:
        return {name: loaded[name] for name in names or loaded.files}


_ARRAYS: Final = ("time", "x", "y", "heading", "speed", "acceleration", "length", "width", "center_x")


def _pack_recording(recording: Recording) -> bytes:
    arrays: dict[str, Any] = {name: getattr(recording, name) for name in _ARRAYS}
    arrays["names"], arrays["kinds"] = np.array(recording.names), np.array(recording.kinds)
    arrays["collision_time"] = np.array([c.time for c in recording.collisions], dtype=np.float64)
    arrays["collision_entities"] = np.array(
        [[recording.names.index(n) for n in c.entities] for c in recording.collisions], dtype=np.int64
    ).reshape(-1, 2)
    return _packed(arrays)


def _unpack_recording(data: bytes) -> Recording:
    arrays = _unpacked(data)
    names = tuple(map(str, arrays["names"]))
    collisions = tuple(
        Collision(float(time), (names[a], names[b]))
        for time, (a, b) in zip(arrays["collision_time"], arrays["collision_entities"], strict=True)
    )
    return Recording(
        **{name: arrays[name] for name in _ARRAYS},
        names=names,
        kinds=tuple(map(str, arrays["kinds"])),
        collisions=collisions,
    )
