"""Everything that was run, in one SQLite file; its schema is in ``docs/study-format.md``."""

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

# Tables that hold something of scenarios; those that refer to others come first.
_CONTENT: Final = tuple(table for table in reversed(TABLES) if table not in ("meta", "tallies"))
# What of a study may change while it goes on.
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
        rows = [(key, json.dumps(value, sort_keys=True)) for key, value in plain]
        try:
            require_whole(json.dumps(plain, ensure_ascii=False))
        except ValueError as error:
            raise InputError(f"{path}: cannot be made, since {error}, which no file can hold; rename it.") from error
        return cls(Database.create(Path(path), rows, *_more_tables(meta)))

    @classmethod
    def open(cls, path: Path | str, readonly: bool = True) -> Study:
        """Open a study.

        Parameters
        ----------
        path : path
        readonly : bool, default True
            Whether it is only read, which any number do at a time, and which keeps nobody from writing. One at a time
            has it open for writing.

        Returns
        -------
        Study

        Raises
        ------
        InputError
            There is none, it is none, it is damaged, another process is to write to it too, or it is of another schema
            version.
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
        """Refuse to go on with a study of something else, and note what has changed.

        That is the budget, the requirements and kinds of a suite, and what an earlier version did not write: the
        constraints of the space, which follow from the same scenario file, and a threshold. A study in which no
        scenario has ended yet becomes one of `meta`.

        Parameters
        ----------
        meta : StudyMeta
            What one wants to go on with.
        same_budget : bool, default False
            Whether the budget may not grow, because the search depends on it.

        Raises
        ------
        InputError
            The study is of something else, or damaged.
        """
        self.require_sound()
        try:
            self.meta.require_same(meta, self.path, same_budget=same_budget)
        except InputError:
            if any(row.state != "pending" for row in self.rows()):
                raise
            self._begin_anew(meta)
        known = replace(
            self.meta,
            space=self.space if self.space.declarations else meta.space,
            critical=meta.critical if self.meta.critical is None else self.meta.critical,
            # Scenarios that are there already stay, also where the new budget is smaller.
            budget=max(meta.budget, min(self.meta.budget, len(self.rows()))),
            # What ran stays; it is only judged by something else.
            kinds=meta.kinds,
            requirements=meta.requirements,
            origin=meta.origin,
        )
        if known == self.meta:
            return
        with self._database.writing() as connection:
            plain = known.to_json()
            put(connection, "meta", [(key, json.dumps(plain[key], sort_keys=True)) for key in _CHANGING])
        self.meta, self.space = known, known.space

    def keep_elsewhere(self, points: FloatArray, scores: FloatArray) -> None:
        """Keep what another study knows, so that the search goes on from it without that study.

        Parameters
        ----------
        points : ndarray of float64, shape (n, d)
            In the unit cube of this study's space.
        scores : ndarray of float64, shape (n,)
            Oriented. Nothing is written where they are kept already.
        """
        rows = [(one.astype("<f8").tobytes(), score) for one, score in zip(points, scores.tolist(), strict=True)]
        with self._database.writing() as connection:
            if connection.execute("SELECT 1 FROM elsewhere LIMIT 1").fetchone() is not None:
                return
            put(connection, "elsewhere", rows)

    def save_repeatability(self, scenario: int, same: bool, apart: float | None) -> None:
        """Store what came of running a scenario a second time.

        Parameters
        ----------
        scenario : int
            Its id.
        same : bool
            Whether both recordings are the same bytes.
        apart : float or None
            By how many m entities are apart at most.
        """
        found = {"scenario": scenario, "same": same, "apart": apart}
        with self._database.writing() as connection:
            put(connection, "meta", [("repeatability", json.dumps(found, sort_keys=True))])
        self.meta = replace(self.meta, repeatability=found)

    def clear(self) -> None:
        """Remove all scenarios, and what is known of them."""
        with self._database.writing() as connection:
            _remove_content(connection)

    def _begin_anew(self, meta: StudyMeta) -> None:
        """Make an empty study of something else of this one."""
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
        """Store a round of proposals as pending, all or none.

        Parameters
        ----------
        number : int
            Of the round, from 1 on.
        points : ndarray of float64, shape (n, d)
            In the unit cube.
        values : sequence of mapping, length n
            Values of the scenario's parameters.
        ids : sequence of int, length n, optional
            Ids of scenarios that were lost; by default the next ones.

        Returns
        -------
        list of Row
        """
        with self._database.writing() as connection:
            ((last,),) = connection.execute("SELECT COALESCE(MAX(id), 0) FROM scenarios")
            numbers = range(last + 1, last + 1 + len(points)) if ids is None else ids
            rows = [
                Row(one, number, point, dict(found), "pending", None)
                for one, point, found in zip(numbers, points, values, strict=True)
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
        """Store what came out of a scenario: its recording, and course and score of each metric.

        Parameters
        ----------
        scenario : int
            Its id.
        recording : Recording
        courses : mapping of str to (ndarray of float64, shape (T,), float) or Measured
            Course and score by metric, and in a study of several others whom the score is against.
        repeats : mapping of str to sequence of float, optional
            Where the scenario was run several times, the scores of all runs by metric.
        references : mapping of str to ReferenceOutcome, optional
            Where it was run again with references at the wheel of the ego, what came of it, by the name of each.
        """
        with self._database.writing() as connection:
            write_references(connection, scenario, references or {})
            runs = [(scenario, name, json.dumps(list(scores))) for name, scores in (repeats or {}).items()]
            put(connection, "repeats", runs)
            packed = [(scenario, name, one[1], pack_arrays({"course": one[0]})) for name, one in courses.items()]
            put(connection, "courses", packed)
            if len(self.meta.others) > 1:
                whom = [(scenario, name, one.against) for name, one in courses.items() if isinstance(one, Measured)]
                put(connection, "against", whom)
            self._end(connection, scenario, "done", None, pack_recording(recording))

    def save_reference(self, scenario: int, driver: str, outcome: ReferenceOutcome) -> None:
        """Store what came of a scenario that was run again with a reference at the wheel of the ego.

        Parameters
        ----------
        scenario : int
            Its id.
        driver : str
            Name of the reference.
        outcome : ReferenceOutcome
        """
        with self._database.writing() as connection:
            write_references(connection, scenario, {driver: outcome})

    def fail(self, scenario: int, error: SimulationError) -> None:
        """Store why a scenario could not be run.

        Parameters
        ----------
        scenario : int
            Its id.
        error : SimulationError
        """
        with self._database.writing() as connection:
            self._end(connection, scenario, "failed", without_folders(str(error)), None)

    def retry_failed(self) -> int:
        """Make scenarios that failed pending again.

        Returns
        -------
        int
            How many.
        """
        failed = self.failed()
        with self._database.writing() as connection:
            put(connection, "scenarios", [_plain_row(replace(row, state="pending", error=None)) for row in failed])
            for row in failed if self.meta.asynchronous else ():
                # Its result comes anew.
                remove(connection, "results", "scenario = ?", row.id)
        return len(failed)

    def _end(
        self, connection: Connection, scenario: int, state: str, error: str | None, recording: bytes | None
    ) -> None:
        """Note that a scenario has ended, and without rounds that its result has come."""
        found = self._database.rows("scenarios", "id = ?", scenario)
        if not found:
            return
        put(connection, "scenarios", [(*found[0][:4], state, error, recording)])
        if self.meta.asynchronous and not self._database.rows("results", "scenario = ?", scenario):
            # The first round that may know of it is the next one.
            ((last,),) = connection.execute("SELECT round FROM scenarios ORDER BY id DESC LIMIT 1")
            ((number,),) = connection.execute("SELECT COALESCE(MAX(number), 0) FROM results")
            put(connection, "results", [(number + 1, scenario, last + 1)])

    def save_analysis(self, name: str, arrays: Mapping[str, npt.ArrayLike], info: Mapping[str, Any]) -> None:
        """Store a result under a name, instead of the one that was there.

        Parameters
        ----------
        name : str
        arrays : mapping of str to array_like of any shape
            ``"distances"`` are those between all scenarios in ``"ids"``: square, symmetric, and 0 on the diagonal.
        info : mapping of str to object
            Further facts, plain values.
        """
        self.save_analyses({name: (arrays, info)})

    def save_analyses(
        self,
        results: Mapping[str, tuple[Mapping[str, npt.ArrayLike], Mapping[str, Any]] | None],
        outcomes: Mapping[int, str] | None = None,
    ) -> None:
        """Store results under their names, instead of those that were there: all of them or none.

        Parameters
        ----------
        results : mapping of str to (tuple or None), arrays of any shape
            Arrays and further facts by name, as `save_analysis` takes them; None removes what is there.
        outcomes : mapping of int to str, optional
            How scenarios ended, in words, by id; stored with them.
        """
        with self._database.writing() as connection:
            put(connection, "outcomes", sorted((outcomes or {}).items()))
            for name, result in results.items():
                remove(connection, "analyses", "name = ?", name)
                remove(connection, "arrays", "analysis = ?", name)
                if result is not None:
                    arrays, info = result
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
        """Add to the times spent in stages, which takes no longer than for one.

        Parameters
        ----------
        seconds : mapping of str to float
            s, by stage.
        """
        with self._database.writing() as connection:
            known = dict(self._database.rows("elapsed"))
            put(connection, "elapsed", [(stage, known.get(stage, 0.0) + spent) for stage, spent in seconds.items()])


def _plain_row(row: Row) -> tuple[Any, ...]:
    """Give a scenario that has not ended as it is stored."""
    return row.id, row.round, row.point.astype("<f8").tobytes(), json.dumps(row.values), row.state, row.error, None


def _more_tables(meta: StudyMeta) -> tuple[str, ...]:
    """Name the tables that it has and not every study."""
    wanted = {"against": len(meta.others) > 1, "results": meta.asynchronous, "elsewhere": bool(meta.elsewhere)}
    return tuple(name for name, there in wanted.items() if there)


def _remove_content(connection: Connection) -> None:
    there = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    for table in _CONTENT:
        if table in there:
            remove(connection, table)
