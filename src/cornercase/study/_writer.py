"""Write scenarios, results and analyses into an open study."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from sqlite3 import Connection
from typing import TYPE_CHECKING, Any, Final

import numpy.typing as npt

from cornercase._common.errors import InputError, SimulationError
from cornercase._common.text.sanitize import remove_folders
from cornercase._common.typing import FloatArray
from cornercase.drivers.references.r157._preventability import ReferenceOutcome
from cornercase.metrics._measure import MetricResult
from cornercase.recordings import Recording
from cornercase.scenario import Value
from cornercase.scenario._file import ScenarioFile
from cornercase.study._analysis_arrays import write_arrays
from cornercase.study._checksums import delete_rows, insert_rows
from cornercase.study._codec import pack_arrays, pack_recording
from cornercase.study._database import Database
from cornercase.study._meta import StudyMeta
from cornercase.study._reference_outcomes import write_reference_outcomes
from cornercase.study._scenario_digest import (
    N_STRIDE_RECORDINGS,
    downsampling_stride,
    encode_digest,
    make_digest,
    measure_registered_features,
)
from cornercase.study._scenario_table import ScenarioRecord
from cornercase.study._schema import CREATE_STATEMENTS, TABLES

if TYPE_CHECKING:
    from cornercase.study._study_file import StudyFile

# Tables with content, each before the tables that it refers to.
_CONTENT_TABLES: Final = tuple(table for table in reversed(TABLES) if table not in ("meta", "tallies"))
# Fields that may change when a study is continued.
_MUTABLE_FIELDS: Final = ("space", "critical", "budget", "kinds", "requirements", "origin")


class StudyWriter:
    """Writer of scenarios and results into an open study.

    Each method is one transaction. It raises `StudyLostError` if the study was removed, replaced or taken over, and
    `InputError` if writing is impossible for another reason.
    """

    def __init__(self, study: StudyFile, database: Database) -> None:
        self._study, self._database = study, database

    def check_and_update_meta(self, meta: StudyMeta, *, same_budget: bool = False) -> None:
        """Check that the study can be continued with the description `meta`, and store the fields that may change.

        These fields may change: the budget, and for a suite the requirements, cluster names and origin. Constraints of
        the parameter space and a threshold are added if the study has none. With `same_budget` the budget may not
        change, because the optimizer depends on the budget. If another field differs, `InputError` is raised, provided
        that a scenario has ended. If none has ended, the study is emptied instead, and takes over all of `meta`.
        """
        self._study.require_undamaged()
        try:
            self._study.meta.require_resumable(meta, self._study.path, same_budget=same_budget)
        except InputError:
            if any(row.state != "pending" for row in self._study.rows()):
                raise
            self._reset(meta)
        updated = replace(
            self._study.meta,
            space=self._study.space if self._study.space.declarations else meta.space,
            critical=meta.critical if self._study.meta.critical is None else self._study.meta.critical,
            # Existing scenarios stay, even if the new budget is smaller.
            budget=max(meta.budget, min(self._study.meta.budget, len(self._study.rows()))),
            # These only affect how results are judged.
            kinds=meta.kinds,
            requirements=meta.requirements,
            origin=meta.origin,
        )
        if updated == self._study.meta:
            return
        with self._database.transaction() as connection:
            values = updated.to_json()
            insert_rows(connection, "meta", [(key, json.dumps(values[key], sort_keys=True)) for key in _MUTABLE_FIELDS])
        self._study.meta, self._study.space = updated, updated.space

    def save_warm_start(self, points: FloatArray, scores: FloatArray) -> None:
        """Store what a search takes over from an earlier study: points (n, d) and scores to minimize, shape (n,).

        A study that already holds such data for a warm start is not changed.
        """
        rows = [(point.astype("<f8").tobytes(), score) for point, score in zip(points, scores.tolist(), strict=True)]
        with self._database.transaction() as connection:
            if connection.execute("SELECT 1 FROM elsewhere LIMIT 1").fetchone() is not None:
                return
            insert_rows(connection, "elsewhere", rows)

    def save_repeatability(
        self, scenario: int, same: bool, max_distance: float | None, is_random: bool = False
    ) -> None:
        """Store whether a second run of a scenario with the same seed gave the same bytes.

        `same` is True if it did. `max_distance` is the largest distance in m between the positions of an entity in both
        runs; None if unknown. `is_random` is True if sensors are random, so that runs with other seeds differ.
        """
        result = {"scenario": scenario, "same": same, "apart": max_distance} | ({"random": True} if is_random else {})
        with self._database.transaction() as connection:
            insert_rows(connection, "meta", [("repeatability", json.dumps(result, sort_keys=True))])
        self._study.meta = replace(self._study.meta, repeatability=result)

    def remove_scenarios(self) -> None:
        """Remove all scenarios and all results."""
        with self._database.transaction() as connection:
            _remove_content(connection)

    def _reset(self, meta: StudyMeta) -> None:
        """Empty the study and replace its description."""
        with self._database.transaction() as connection:
            _remove_content(connection)
            for name in optional_table_names(meta):
                connection.execute(CREATE_STATEMENTS[name].replace("CREATE TABLE", "CREATE TABLE IF NOT EXISTS"))
            delete_rows(connection, "meta")
            items = meta.to_json().items()
            insert_rows(connection, "meta", [(key, json.dumps(value, sort_keys=True)) for key, value in items])
        self._study.meta, self._study.space = meta, meta.space

    def add_pending(
        self,
        round_number: int,
        points: FloatArray,
        values: Sequence[Mapping[str, Value]],
        ids: Sequence[int] | None = None,
    ) -> list[ScenarioRecord]:
        """Store a round of proposed scenarios that are pending (not run yet), all or none.

        `round_number` counts from 1. `points` are in the unit cube, shape (n, d); `values` are the parameter values of
        each point. By default the scenarios get the next free ids; pass `ids` to restore lost scenarios.
        """
        with self._database.transaction() as connection:
            ((last,),) = connection.execute("SELECT COALESCE(MAX(id), 0) FROM scenarios")
            numbers = range(last + 1, last + 1 + len(points)) if ids is None else ids
            rows = [
                ScenarioRecord(scenario_id, round_number, point, dict(parameters), "pending", None)
                for scenario_id, point, parameters in zip(numbers, points, values, strict=True)
            ]
            insert_rows(connection, "scenarios", [_encode_pending_row(row) for row in rows])
        return rows

    def record_result(
        self,
        scenario: int,
        recording: Recording,
        courses: Mapping[str, tuple[FloatArray, float] | MetricResult],
        repeats: Mapping[str, Sequence[float]] | None = None,
        references: Mapping[str, ReferenceOutcome] | None = None,
    ) -> None:
        """Store the result of a scenario: its recording, and the course and score of each metric.

        `courses` maps a metric to its course and score. If the study has several entities besides the ego, the values
        must be `MetricResult` objects, which name the entity that the score is measured against. If the scenario was
        run several times, `repeats` has the scores of all runs, by metric. `references` maps a reference driver to the
        outcome of the scenario with this driver driving the ego.
        """
        with self._database.transaction() as connection:
            write_reference_outcomes(connection, scenario, references or {})
            runs = [(scenario, name, json.dumps(list(scores))) for name, scores in (repeats or {}).items()]
            insert_rows(connection, "repeats", runs)
            packed = [
                (scenario, name, result[1], pack_arrays({"course": result[0]})) for name, result in courses.items()
            ]
            insert_rows(connection, "courses", packed)
            if len(self._study.meta.others) > 1:
                sources = [
                    (scenario, name, result.against)
                    for name, result in courses.items()
                    if isinstance(result, MetricResult)
                ]
                insert_rows(connection, "against", sources)
            self._end_scenario(connection, scenario, "done", None, pack_recording(recording))
            plain_courses = {name: result[0] for name, result in courses.items()}
            self._save_digest(connection, scenario, recording, plain_courses)

    def rows_without_digest(self) -> list[ScenarioRecord]:
        """Return the finished scenarios whose digest (summary of the recording) is missing in a damaged study."""
        stored = {scenario for (scenario,) in self._database.query("SELECT scenario FROM digests")}
        return [row for row in self._study.finished_rows() if row.id not in stored]

    def save_missing_digests(self, scenario: ScenarioFile | None) -> None:
        """Compute missing digests again from recordings and courses, and store them.

        This is part of the repair of a damaged study. The roads of `scenario`, which recordings do not contain, help to
        decide who is at fault in collisions.
        """
        with self._database.transaction() as connection:
            for row in self.rows_without_digest():
                recording = self._study.recording(row.id)
                if scenario is not None:
                    # A simulator may have run a file whose road cornercase does not find.
                    with suppress(InputError):
                        recording = replace(recording, road_file=scenario.road_path_for(row.values))
                courses = {name: self._study.course(row.id, name) for name in self._study.meta.metrics}
                self._save_digest(connection, row.id, recording, courses)

    def _save_digest(
        self,
        connection: Connection,
        scenario: int,
        recording: Recording,
        courses: Mapping[str, FloatArray],
    ) -> None:
        meta = self._study.meta
        lengths = [*self._study.lengths_of_first_recordings(scenario), len(recording.time)]
        stride = downsampling_stride(lengths[:N_STRIDE_RECORDINGS])
        digest = make_digest(recording, courses, meta, stride, self._study.metrics())
        insert_rows(
            connection, "digests", [(scenario, *encode_digest(digest, measure_registered_features(recording, meta)))]
        )

    def save_reference_outcome(self, scenario: int, driver: str, outcome: ReferenceOutcome) -> None:
        """Store the outcome of a scenario that was run again with a reference driver driving the ego."""
        with self._database.transaction() as connection:
            write_reference_outcomes(connection, scenario, {driver: outcome})

    def record_failure(self, scenario: int, error: SimulationError) -> None:
        """Store why a scenario failed."""
        with self._database.transaction() as connection:
            self._end_scenario(connection, scenario, "failed", remove_folders(str(error)), None)

    def retry_failed(self) -> int:
        """Make failed scenarios pending again; return how many."""
        failed = self._study.failed_rows()
        with self._database.transaction() as connection:
            insert_rows(
                connection,
                "scenarios",
                [_encode_pending_row(replace(row, state="pending", error=None)) for row in failed],
            )
            for row in failed if self._study.meta.asynchronous else ():
                # It will get a new result.
                delete_rows(connection, "results", "scenario = ?", row.id)
        return len(failed)

    def _end_scenario(
        self, connection: Connection, scenario: int, state: str, error: str | None, recording: bytes | None
    ) -> None:
        """Store that a scenario has ended; in an asynchronous search, also store the order of results."""
        stored = self._database.read_rows("scenarios", "id = ?", scenario)
        if not stored:
            return
        insert_rows(connection, "scenarios", [(*stored[0][:4], state, error, recording)])
        if self._study.meta.asynchronous and not self._database.read_rows("results", "scenario = ?", scenario):
            # The next round is the first that can use this result.
            ((last,),) = connection.execute("SELECT round FROM scenarios ORDER BY id DESC LIMIT 1")
            ((number,),) = connection.execute("SELECT COALESCE(MAX(number), 0) FROM results")
            insert_rows(connection, "results", [(number + 1, scenario, last + 1)])

    def save_analysis(self, name: str, arrays: Mapping[str, npt.ArrayLike], info: Mapping[str, Any]) -> None:
        """Store a result under a name: its arrays, and its other values (`info`) as JSON.

        An earlier result of this name is replaced. The array ``"distances"`` holds the distance between any two
        scenarios in ``"ids"``. This array is square, symmetric, and 0 on the diagonal.
        """
        self.save_analyses({name: (arrays, info)})

    def save_analyses(
        self,
        results: Mapping[str, tuple[Mapping[str, npt.ArrayLike], Mapping[str, Any]] | None],
        outcomes: Mapping[int, str] | None = None,
    ) -> None:
        """Store several results by name, all or none, each as (arrays, info) for `save_analysis`.

        None removes an earlier result of this name. `outcomes` describe in words how scenarios ended, by id.
        """
        with self._database.transaction() as connection:
            insert_rows(connection, "outcomes", sorted((outcomes or {}).items()))
            for name, value in results.items():
                delete_rows(connection, "analyses", "name = ?", name)
                delete_rows(connection, "arrays", "analysis = ?", name)
                if value is not None:
                    arrays, info = value
                    insert_rows(connection, "analyses", [(name, json.dumps(dict(info)))])
                    write_arrays(connection, name, arrays)

    def add_elapsed_time(self, stage: str, seconds: float) -> None:
        """Add `seconds` to the stored time that a stage of the work took."""
        self.add_elapsed_times({stage: seconds})

    def add_elapsed_times(self, seconds: Mapping[str, float]) -> None:
        """Add seconds to the stored times that several stages of the work took, in one transaction."""
        with self._database.transaction() as connection:
            stored = dict(self._database.read_rows("elapsed"))
            insert_rows(
                connection, "elapsed", [(stage, stored.get(stage, 0.0) + spent) for stage, spent in seconds.items()]
            )


def _encode_pending_row(row: ScenarioRecord) -> tuple[Any, ...]:
    """Return the database row of a scenario that has not ended."""
    return row.id, row.round, row.point.astype("<f8").tobytes(), json.dumps(row.values), row.state, row.error, None


def optional_table_names(meta: StudyMeta) -> tuple[str, ...]:
    """Return the names of the optional tables that a study with this description has."""
    is_present = {"against": len(meta.others) > 1, "results": meta.asynchronous, "elsewhere": bool(meta.elsewhere)}
    return tuple(name for name, present in is_present.items() if present)


def _remove_content(connection: Connection) -> None:
    tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    for table in _CONTENT_TABLES:
        if table in tables:
            delete_rows(connection, table)
