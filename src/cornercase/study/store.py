"""Everything that was run, in one SQLite file; its schema is in ``docs/study-format.md``."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from cornercase._common.errors import InputError, SimulationError
from cornercase._common.typing import FloatArray
from cornercase.metrics import METRICS
from cornercase.recordings import Recording
from cornercase.scenario import Value
from cornercase.study.codec import pack_arrays, pack_recording, unpack_arrays, unpack_recording
from cornercase.study.database import Database
from cornercase.study.export import write_scenarios, write_table
from cornercase.study.meta import StudyMeta
from cornercase.study.table import Row, scenario_table

if TYPE_CHECKING:
    import pandas as pd

_SHOWN: Final = 10


class Study:
    """A study that is open; use it as a context manager.

    Readers work while an explorer writes. Make one with `create` or `open`.

    Attributes
    ----------
    path : Path
        The file.
    meta : StudyMeta
        What the study is about.
    space : ParameterSpace
        What is varied.
    """

    def __init__(self, database: Database) -> None:
        self._database = database
        self.path = database.path
        self.meta = StudyMeta.from_json(
            {key: json.loads(value) for key, value in database.found("SELECT key, value FROM meta")}
        )
        self.space = self.meta.space

    @classmethod
    def create(cls, path: Path | str, meta: StudyMeta) -> Study:
        """Make a study in a new file, and open it for writing.

        Parameters
        ----------
        path : path
        meta : StudyMeta
            What it is about.

        Returns
        -------
        Study

        Raises
        ------
        InputError
            The file exists already, or cannot be written.
        """
        plain = sorted(meta.to_json().items())
        return cls(Database.create(Path(path), [(key, json.dumps(value, sort_keys=True)) for key, value in plain]))

    @classmethod
    def open(cls, path: Path | str, readonly: bool = False) -> Study:
        """Open a study.

        A study of an earlier version is brought to the schema of today: the file itself when it is opened for writing,
        a temporary copy when it is only read.

        Parameters
        ----------
        path : path
        readonly : bool, default False
            Needs neither a lock nor the right to write.

        Returns
        -------
        Study

        Raises
        ------
        InputError
            There is none, it is none, another program writes to it, or it is of a later schema version.
        """
        database = Database.open(Path(path), readonly)
        try:
            return cls(database)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            database.close()
            raise InputError(f"{path}: cannot be used as a study ({error!r}).") from error

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def __enter__(self) -> Study:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def __repr__(self) -> str:
        meta, counts = self.meta, self._counts()
        return (
            f"<Study {str(self.path)!r}: {Path(meta.scenario).stem}, {meta.ego} and {meta.other}, by"
            f" {', '.join(meta.metrics)}; {counts.get('done', 0)} scenarios run, {counts.get('failed', 0)} failed,"
            f" {counts.get('pending', 0)} pending>"
        )

    def _repr_html_(self) -> str:
        table, metric = self.table(), METRICS.create(self.meta.metrics[0])
        worst = table.sort_values(metric.name, ascending=metric.lower_is_critical, kind="stable").head(_SHOWN)
        return f"<p>{escape(repr(self))}</p><p>Most critical by {escape(metric.name)}:</p>{worst.to_html(index=False)}"

    def continue_with(self, meta: StudyMeta, *, same_budget: bool = False) -> None:
        """Refuse to go on with a study of something else, and note what an earlier version did not write.

        That is the constraints of the space, which follow from the same scenario file, and a threshold.

        Parameters
        ----------
        meta : StudyMeta
            What one wants to go on with.
        same_budget : bool, default False
            Whether the budget may not grow, because the search depends on it.

        Raises
        ------
        InputError
            The study is of something else.
        """
        self.meta.require_same(meta, self.path, same_budget=same_budget)
        known = replace(
            self.meta,
            space=self.space if self.space.declarations else meta.space,
            critical=meta.critical if self.meta.critical is None else self.meta.critical,
        )
        if known == self.meta:
            return
        with self._database.writing() as connection:
            plain = known.to_json()
            connection.executemany(
                "UPDATE meta SET value = ? WHERE key = ?",
                [(json.dumps(plain[key], sort_keys=True), key) for key in ("space", "critical")],
            )
        self.meta, self.space = known, known.space

    def propose(self, number: int, points: FloatArray, values: Sequence[Mapping[str, Value]]) -> list[Row]:
        """Store a round of proposals as pending, all or none.

        Parameters
        ----------
        number : int
            Of the round, from 1 on.
        points : ndarray of float64, shape (n, d)
            In the unit cube.
        values : sequence of mapping, length n
            Values of the scenario's parameters.

        Returns
        -------
        list of Row
        """
        rows = []
        with self._database.writing() as connection:
            for point, one in zip(points, values, strict=True):
                cursor = connection.execute(
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
            Its id.
        recording : Recording
        courses : mapping of str to (ndarray of float64, shape (T,), float)
            Course and score by metric.
        repeats : mapping of str to sequence of float, optional
            Where the scenario was run several times, the scores of all runs by metric.
        """
        with self._database.writing() as connection:
            connection.executemany(
                "INSERT INTO repeats VALUES (?, ?, ?)",
                [(scenario, name, json.dumps(list(scores))) for name, scores in (repeats or {}).items()],
            )
            connection.executemany(
                "INSERT INTO courses VALUES (?, ?, ?, ?)",
                [(scenario, name, score, pack_arrays({"course": course})) for name, (course, score) in courses.items()],
            )
            connection.execute(
                "UPDATE scenarios SET state = 'done', recording = ? WHERE id = ?",
                (pack_recording(recording), scenario),
            )

    def fail(self, scenario: int, error: SimulationError) -> None:
        """Store why a scenario could not be run.

        Parameters
        ----------
        scenario : int
            Its id.
        error : SimulationError
        """
        with self._database.writing() as connection:
            connection.execute("UPDATE scenarios SET state = 'failed', error = ? WHERE id = ?", (str(error), scenario))

    def rows(self) -> list[Row]:
        """All scenarios, in the order in which they were proposed."""
        found = self._database.found("SELECT id, round, point, parameters, state, error FROM scenarios ORDER BY id")
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
        """Scores of the scenarios that were run, in the metric's unit, shape (n,)."""
        self._require_metric(metric)
        found = self._database.found(
            "SELECT score FROM courses JOIN scenarios ON id = scenario WHERE metric = ? AND state = 'done' ORDER BY id",
            metric,
        )
        return np.array([score for (score,) in found], dtype=np.float64)

    def spread(self, metric: str) -> FloatArray | None:
        """Lowest and highest score of the runs of each scenario that was run, shape (n, 2); None if each ran once."""
        self._require_metric(metric)
        # Only a scenario that was run has them.
        found = self._database.found("SELECT scores FROM repeats WHERE metric = ? ORDER BY scenario", metric)
        if not found:
            return None
        return np.array([[min(scores), max(scores)] for scores in (json.loads(text) for (text,) in found)])

    def course(self, scenario: int, metric: str) -> FloatArray:
        """Course of a metric in one scenario, in the metric's unit, shape (T,)."""
        self._require_metric(metric)
        found = self._database.found("SELECT course FROM courses WHERE scenario = ? AND metric = ?", scenario, metric)
        if not found:
            raise InputError(f"{self.path}: the scenario {scenario} was not run.")
        return np.asarray(unpack_arrays(found[0][0])["course"])

    def recording(self, scenario: int) -> Recording:
        """Recording of one scenario."""
        found = self._database.found("SELECT recording FROM scenarios WHERE id = ? AND recording IS NOT NULL", scenario)
        if not found:
            raise InputError(f"{self.path}: the scenario {scenario} was not run.")
        return unpack_recording(found[0][0])

    def save_outcomes(self, outcomes: Mapping[int, str]) -> None:
        """Store how scenarios ended, in words.

        Parameters
        ----------
        outcomes : mapping of int to str
            By id.
        """
        with self._database.writing() as connection:
            connection.executemany("INSERT OR REPLACE INTO outcomes VALUES (?, ?)", sorted(outcomes.items()))

    def outcomes(self) -> dict[int, str]:
        """How scenarios ended, in words, by id; those of all that had been run when the study was analysed."""
        return dict(self._database.found("SELECT scenario, outcome FROM outcomes ORDER BY scenario"))

    def save_analysis(self, name: str, arrays: Mapping[str, npt.ArrayLike], info: Mapping[str, Any]) -> None:
        """Store a result under a name, instead of the one that was there.

        Parameters
        ----------
        name : str
        arrays : mapping of str to array_like
        info : mapping of str to object
            Further facts, plain values.
        """
        with self._database.writing() as connection:
            connection.execute("INSERT OR REPLACE INTO analyses VALUES (?, ?)", (name, json.dumps(dict(info))))
            connection.execute("DELETE FROM arrays WHERE analysis = ?", (name,))
            connection.executemany(
                "INSERT INTO arrays VALUES (?, ?, ?)",
                [(name, key, pack_arrays({key: array})) for key, array in arrays.items()],
            )

    def analyses(self) -> list[str]:
        """Aspects that the study was analysed by: ``ego-trajectory`` first, then the metrics."""
        names = [name for (name,) in self._database.found("SELECT name FROM analyses")]
        order = ["ego-trajectory", *self.meta.metrics]
        return [name for name in order if name in names]

    def analysis(self, name: str, *arrays: str) -> tuple[dict[str, Any], dict[str, Any]]:
        """Arrays and further facts of a stored result.

        Parameters
        ----------
        name : str
        *arrays : str
            Arrays to read, as large ones take time; all by default.

        Returns
        -------
        arrays : dict of str to ndarray
        info : dict

        Raises
        ------
        InputError
            There is no such result.
        """
        found = self._database.found("SELECT info FROM analyses WHERE name = ?", name)
        if not found:
            raise InputError(f"{self.path}: holds no analysis by {name}; run `analyze` first.")
        names = arrays or [key for (key,) in self._database.found("SELECT name FROM arrays WHERE analysis = ?", name)]
        packed = {
            key: self._database.found("SELECT data FROM arrays WHERE analysis = ? AND name = ?", name, key)[0][0]
            for key in names
        }
        return {key: unpack_arrays(data)[key] for key, data in packed.items()}, json.loads(found[0][0])

    def reduction(self) -> dict[str, Any] | None:
        """Return what is known of the reduced set, as in its manifest; None before the reduction."""
        found = self._database.found("SELECT info FROM analyses WHERE name = 'reduction'")
        return dict(json.loads(found[0][0])) if found else None

    def add_elapsed(self, stage: str, seconds: float) -> None:
        """Add to the time spent in a stage, in s."""
        with self._database.writing() as connection:
            connection.execute(
                "INSERT INTO elapsed VALUES (?, ?)"
                " ON CONFLICT (stage) DO UPDATE SET seconds = seconds + excluded.seconds",
                (stage, seconds),
            )

    def elapsed(self) -> dict[str, float]:
        """Time spent by stage, in s."""
        return dict(self._database.found("SELECT stage, seconds FROM elapsed ORDER BY stage"))

    def snapshot(self) -> AbstractContextManager[None]:
        """Read within it what the study holds at one moment, while an explorer goes on writing."""
        return self._database.snapshot()

    def table(self) -> pd.DataFrame:
        """Put everything that is known of the scenarios in a table.

        Returns
        -------
        DataFrame
            A row for each scenario, in the order of the ids, with the columns ``id``, ``round`` and ``state``; a column
            for each parameter; for each metric one of the score, and ``lowest …`` and ``highest …`` of its runs where
            each scenario was run several times; ``cluster by …`` for each aspect that the study was analysed by, -1 for
            noise; ``outcome`` once it was analysed; ``error``. Empty where there is no value. A parameter that is
            called like another column is found as ``parameter …``.
        """
        with self.snapshot():
            scores = {}
            for name in self.meta.metrics:
                scores[name] = self.scores(name)
                if (spread := self.spread(name)) is not None:
                    scores[f"lowest {name}"], scores[f"highest {name}"] = spread.T
            clusters = {}
            for name in self.analyses():
                arrays, _ = self.analysis(name, "ids", "labels")
                clusters[name] = arrays["ids"], arrays["labels"]
            return scenario_table(self.rows(), self.space, scores, clusters, self.outcomes())

    def export(self, folder: Path | str, parquet: bool = False) -> None:
        """Write everything as CSV: one table of scenarios, and recording and courses of each.

        Parameters
        ----------
        folder : path
            Gets ``scenarios.csv`` as of `table`, ``recordings/ID.csv`` and ``courses/ID.csv``.
        parquet : bool, default False
            Write ``scenarios.parquet`` too.

        Raises
        ------
        InputError
            The folder cannot be written, or the package that writes Parquet is not installed.
        """
        folder = Path(folder)
        write_table(folder, self.table(), parquet)
        write_scenarios(
            folder,
            (
                (row.id, self.recording(row.id), {name: self.course(row.id, name) for name in self.meta.metrics})
                for row in self.done()
            ),
        )

    def _counts(self) -> dict[str, int]:
        """Count the scenarios in each state."""
        return dict(self._database.found("SELECT state, COUNT(*) FROM scenarios GROUP BY state"))

    def _require_metric(self, metric: str) -> None:
        if metric not in self.meta.metrics:
            raise InputError(
                f"{self.path}: holds no course of the metric '{metric}'; it has {', '.join(self.meta.metrics)}."
            )
