"""Create, open and write a study: one SQLite file whose schema is described in ``docs/study-format.md``."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from sqlite3 import Connection
from typing import Any, Final

import numpy.typing as npt

from cornercase._common import arguments
from cornercase._common.errors import InputError, SimulationError
from cornercase._common.texts import require_whole, without_folders
from cornercase._common.typing import FloatArray
from cornercase.drivers import ReferenceOutcome
from cornercase.metrics import Measured
from cornercase.recordings import Recording
from cornercase.scenario import Value
from cornercase.study.arrays import write_arrays
from cornercase.study.codec import pack_arrays, pack_recording
from cornercase.study.contents import StudyContents
from cornercase.study.damage import damage_told
from cornercase.study.database import Database
from cornercase.study.meta import StudyMeta
from cornercase.study.schema import STATEMENTS, TABLES
from cornercase.study.seals import put, remove
from cornercase.study.second_runs import write_references
from cornercase.study.table import Row

# Tables with content, each before those that it refers to.
_CONTENT: Final = tuple(table for table in reversed(TABLES) if table not in ("meta", "tallies"))
# Fields that may change when a study is continued.
_CHANGING: Final = ("space", "critical", "budget", "kinds", "requirements", "origin")


class Study(StudyContents):
    """A study that is open; use it as a context manager.

    Readers work while an explorer writes. Make one with `create` or `open`.

    Parameters
    ----------
    database : Database

    Attributes
    ----------
    path : Path
        The file.
    meta : StudyMeta
        What the study is about.
    space : ParameterSpace
        What is varied.
    """

    @classmethod
    def create(cls, path: Path | str, meta: StudyMeta) -> Study:
        """Create a study in a new file, and open it for writing.

        Parameters
        ----------
        path : path
        meta : StudyMeta
            Its description.

        Returns
        -------
        Study

        Raises
        ------
        InputError
            The file exists already, or cannot be written.
        """
        plain = sorted(meta.to_json().items())
        rows = [(key, json.dumps(value, sort_keys=True)) for key, value in plain]
        try:
            require_whole(json.dumps(plain, ensure_ascii=False))
        except ValueError as error:
            raise InputError(f"{path}: cannot be created, since {error}; rename it.") from error
        return cls(Database.create(Path(path), rows, *_more_tables(meta)))

    @classmethod
    def open(cls, path: Path | str, readonly: bool = True) -> Study:
        """Open a study.

        Parameters
        ----------
        path : path
        readonly : bool, default True
            Open it for reading only. Any number of processes can read at a time, also while one writes; only one at a
            time can have it open for writing.

        Returns
        -------
        Study

        Raises
        ------
        InputError
            There is no such file, it is not a study or of another schema version, it is damaged, or another process has
            it open for writing.
        """
        database: Database | None = None
        try:
            file = arguments.path("path", path)
            # Its description may be damaged.
            with damage_told(file):
                database = Database.open(file, readonly)
                return cls(database)
        except InputError:
            if database is not None:
                database.close()
            raise

    def continue_with(self, meta: StudyMeta, *, same_budget: bool = False) -> None:
        """Check that the study matches a description, and update what may change.

        That is the budget, the requirements and kinds of a suite, constraints of the space, and a threshold if there
        was none. A study in which no scenario has ended yet takes over `meta` completely.

        Parameters
        ----------
        meta : StudyMeta
            Description to continue with.
        same_budget : bool, default False
            Whether the budget has to stay, because the optimizer depends on it.

        Raises
        ------
        InputError
            The study belongs to something else, or is damaged.
        """
        self.require_sound()
        try:
            self.meta.require_same(meta, self.path, same_budget=same_budget)
        except InputError:
            if any(row.state != "pending" for row in self.rows()):
                raise
            self._begin_anew(meta)
        updated = replace(
            self.meta,
            space=self.space if self.space.declarations else meta.space,
            critical=meta.critical if self.meta.critical is None else self.meta.critical,
            # Existing scenarios stay, even if the new budget is smaller.
            budget=max(meta.budget, min(self.meta.budget, len(self.rows()))),
            # These only affect how results are judged.
            kinds=meta.kinds,
            requirements=meta.requirements,
            origin=meta.origin,
        )
        if updated == self.meta:
            return
        with self._database.writing() as connection:
            plain = updated.to_json()
            put(connection, "meta", [(key, json.dumps(plain[key], sort_keys=True)) for key in _CHANGING])
        self.meta, self.space = updated, updated.space

    def keep_elsewhere(self, points: FloatArray, scores: FloatArray) -> None:
        """Store points and scores of another study, so that the warm-started search no longer needs that study.

        Nothing is written if they are stored already.

        Parameters
        ----------
        points : ndarray of float64, shape (n, d)
            In the unit cube of this study's space.
        scores : ndarray of float64, shape (n,)
            To be minimized.
        """
        rows = [(point.astype("<f8").tobytes(), score) for point, score in zip(points, scores.tolist(), strict=True)]
        with self._database.writing() as connection:
            if connection.execute("SELECT 1 FROM elsewhere LIMIT 1").fetchone() is not None:
                return
            put(connection, "elsewhere", rows)

    def save_repeatability(self, scenario: int, same: bool, apart: float | None) -> None:
        """Store the result of running a scenario a second time.

        Parameters
        ----------
        scenario : int
            Its id.
        same : bool
            Whether both recordings have the same bytes.
        max_distance : float or None
            Largest distance of an entity between both recordings, in m.
        """
        result = {"scenario": scenario, "same": same, "apart": apart}
        with self._database.writing() as connection:
            put(connection, "meta", [("repeatability", json.dumps(result, sort_keys=True))])
        self.meta = replace(self.meta, repeatability=result)

    def clear(self) -> None:
        """Remove all scenarios, and everything about them."""
        with self._database.writing() as connection:
            _remove_content(connection)

    def _begin_anew(self, meta: StudyMeta) -> None:
        """Turn this study into an empty one with another description."""
        with self._database.writing() as connection:
            _remove_content(connection)
            for name in _more_tables(meta):
                connection.execute(STATEMENTS[name].replace("CREATE TABLE", "CREATE TABLE IF NOT EXISTS"))
            remove(connection, "meta")
            plain = meta.to_json().items()
            put(connection, "meta", [(key, json.dumps(value, sort_keys=True)) for key, value in plain])
        self.meta, self.space = meta, meta.space

    def propose(
        self,
        number: int,
        points: FloatArray,
        values: Sequence[Mapping[str, Value]],
        ids: Sequence[int] | None = None,
    ) -> list[Row]:
        """Store a round of proposed scenarios as pending, all or none.

        Parameters
        ----------
        round_number : int
            From 1 on.
        points : ndarray of float64, shape (n, d)
            In the unit cube.
        values : sequence of mapping, length n
            Parameter values of each scenario.
        ids : sequence of int, length n, optional
            Ids of scenarios that were lost; by default the next ones.

        Returns
        -------
        list of ScenarioRecord
        """
        with self._database.writing() as connection:
            ((last,),) = connection.execute("SELECT COALESCE(MAX(id), 0) FROM scenarios")
            numbers = range(last + 1, last + 1 + len(points)) if ids is None else ids
            rows = [
                Row(scenario_id, number, point, dict(parameters), "pending", None)
                for scenario_id, point, parameters in zip(numbers, points, values, strict=True)
            ]
            put(connection, "scenarios", [_plain_row(row) for row in rows])
        return rows

    def finish(
        self,
        scenario: int,
        recording: Recording,
        courses: Mapping[str, tuple[FloatArray, float] | Measured],
        repeats: Mapping[str, Sequence[float]] | None = None,
        references: Mapping[str, ReferenceOutcome] | None = None,
    ) -> None:
        """Store the result of a scenario: its recording, and course and score of each metric.

        Parameters
        ----------
        scenario : int
            Its id.
        recording : Recording
        courses : mapping of str to (ndarray of float64, shape (T,), float) or MetricResult
            Course and score by metric, and in a study of several others the entity that the score is against.
        repeats : mapping of str to sequence of float, optional
            Scores of all runs by metric, if the scenario was run several times.
        references : mapping of str to ReferenceOutcome, optional
            Outcomes by reference driver, if the scenario was run again with reference drivers in the ego.
        """
        with self._database.writing() as connection:
            write_references(connection, scenario, references or {})
            runs = [(scenario, name, json.dumps(list(scores))) for name, scores in (repeats or {}).items()]
            put(connection, "repeats", runs)
            packed = [
                (scenario, name, result[1], pack_arrays({"course": result[0]})) for name, result in courses.items()
            ]
            put(connection, "courses", packed)
            if len(self.meta.others) > 1:
                sources = [
                    (scenario, name, result.against) for name, result in courses.items() if isinstance(result, Measured)
                ]
                put(connection, "against", sources)
            self._end(connection, scenario, "done", None, pack_recording(recording))

    def save_reference(self, scenario: int, driver: str, outcome: ReferenceOutcome) -> None:
        """Store the outcome of a scenario that was run again with a reference driver in the ego.

        Parameters
        ----------
        scenario : int
            Its id.
        driver : str
            Name of the reference driver.
        outcome : ReferenceOutcome
        """
        with self._database.writing() as connection:
            write_references(connection, scenario, {driver: outcome})

    def fail(self, scenario: int, error: SimulationError) -> None:
        """Store why a scenario failed.

        Parameters
        ----------
        scenario : int
            Its id.
        error : SimulationError
        """
        with self._database.writing() as connection:
            self._end(connection, scenario, "failed", without_folders(str(error)), None)

    def retry_failed(self) -> int:
        """Make failed scenarios pending again.

        Returns
        -------
        int
            Their number.
        """
        failed = self.failed()
        with self._database.writing() as connection:
            put(connection, "scenarios", [_plain_row(replace(row, state="pending", error=None)) for row in failed])
            for row in failed if self.meta.asynchronous else ():
                # It will get a new result.
                remove(connection, "results", "scenario = ?", row.id)
        return len(failed)

    def _end(
        self, connection: Connection, scenario: int, state: str, error: str | None, recording: bytes | None
    ) -> None:
        """Store that a scenario has ended, and in an asynchronous search that its result has come."""
        stored = self._database.rows("scenarios", "id = ?", scenario)
        if not stored:
            return
        put(connection, "scenarios", [(*stored[0][:4], state, error, recording)])
        if self.meta.asynchronous and not self._database.rows("results", "scenario = ?", scenario):
            # The next round is the first that can use this result.
            ((last,),) = connection.execute("SELECT round FROM scenarios ORDER BY id DESC LIMIT 1")
            ((number,),) = connection.execute("SELECT COALESCE(MAX(number), 0) FROM results")
            put(connection, "results", [(number + 1, scenario, last + 1)])

    def save_analysis(self, name: str, arrays: Mapping[str, npt.ArrayLike], info: Mapping[str, Any]) -> None:
        """Store a result under a name, replacing an earlier one.

        Parameters
        ----------
        name : str
        arrays : mapping of str to array_like
            Of any shape. ``"distances"`` are those between all scenarios in ``"ids"``: square, symmetric, and 0 on the
            diagonal.
        info : mapping of str to object
            Further facts as plain values.
        """
        self.save_analyses({name: (arrays, info)})

    def save_analyses(
        self,
        results: Mapping[str, tuple[Mapping[str, npt.ArrayLike], Mapping[str, Any]] | None],
        outcomes: Mapping[int, str] | None = None,
    ) -> None:
        """Store several results under their names, replacing earlier ones, all of them or none.

        Parameters
        ----------
        results : mapping of str to (tuple or None)
            Arrays and further facts by name, as for `save_analysis`; None removes an earlier result.
        outcomes : mapping of int to str, optional
            How scenarios ended, in words, by id; stored with them.
        """
        with self._database.writing() as connection:
            put(connection, "outcomes", sorted((outcomes or {}).items()))
            for name, value in results.items():
                remove(connection, "analyses", "name = ?", name)
                remove(connection, "arrays", "analysis = ?", name)
                if value is not None:
                    arrays, info = value
                    put(connection, "analyses", [(name, json.dumps(dict(info)))])
                    write_arrays(connection, name, arrays)

    def add_elapsed(self, stage: str, seconds: float) -> None:
        """Add to the time spent in a stage.

        Parameters
        ----------
        stage : str
        seconds : float
            s.
        """
        self.add_all_elapsed({stage: seconds})

    def add_all_elapsed(self, seconds: Mapping[str, float]) -> None:
        """Add to the times spent in several stages, in one transaction.

        Parameters
        ----------
        seconds : mapping of str to float
            s, by stage.
        """
        with self._database.writing() as connection:
            stored = dict(self._database.rows("elapsed"))
            put(connection, "elapsed", [(stage, stored.get(stage, 0.0) + spent) for stage, spent in seconds.items()])


def _plain_row(row: Row) -> tuple[Any, ...]:
    """Columns of a scenario that has not ended."""
    return row.id, row.round, row.point.astype("<f8").tobytes(), json.dumps(row.values), row.state, row.error, None


def _more_tables(meta: StudyMeta) -> tuple[str, ...]:
    """Names of the optional tables that the study has."""
    is_present = {"against": len(meta.others) > 1, "results": meta.asynchronous, "elsewhere": bool(meta.elsewhere)}
    return tuple(name for name, present in is_present.items() if present)


def _remove_content(connection: Connection) -> None:
    tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    for table in _CONTENT:
        if table in tables:
            remove(connection, table)
