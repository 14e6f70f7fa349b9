"""Studies in SQLite files, with all scenarios that were run. The page ``docs/study-format.md`` describes the schema."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Collection, Container, Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np

from cornercase._common import validation
from cornercase._common.errors import InputError
from cornercase._common.io.atomic import atomic_write_group
from cornercase._common.io.files import check_output_folder
from cornercase._common.text.sanitize import check_no_surrogates, parse_json
from cornercase._common.typing import BoolArray, FloatArray
from cornercase._common.validation import check_float, check_int
from cornercase.drivers._serialization import format_driver
from cornercase.drivers.references.r157._preventability import ReferenceOutcome
from cornercase.metrics import Metric, registered_features
from cornercase.metrics._outcome import Impact
from cornercase.recordings import Collision, Recording, write_osi
from cornercase.recordings._compact_encoding import encode_rounded
from cornercase.study._analysis_arrays import read_arrays
from cornercase.study._codec import unpack_arrays, unpack_recording
from cornercase.study._connection import remove_leftover_journals
from cornercase.study._criterion import Criterion
from cornercase.study._critical_run_rates import critical_run_rates
from cornercase.study._criticality_order import order_by_criticality
from cornercase.study._damage import DamageError, require_condition, reraise_read_errors
from cornercase.study._database import Database
from cornercase.study._meta import StudyMeta, hash_points_and_scores
from cornercase.study._notes import MAX_NOTE_LENGTH
from cornercase.study._objective import Objective
from cornercase.study._reference_outcomes import decode_reference_outcome, reference_metric_name
from cornercase.study._scenario_digest import (
    DIGEST_PARTS,
    N_STRIDE_RECORDINGS,
    DigestPart,
    ScenarioDigest,
    create_metrics_if_known,
    decode_collisions,
    decode_digest,
    decode_digest_facts,
    decode_features,
    decode_impacts,
    decode_rounded_recording,
    measure_registered_features,
    registered_features_checksum,
)
from cornercase.study._scenario_table import ScenarioRecord, build_scenario_table
from cornercase.study._schema import TABLES
from cornercase.study._write_tables import write_parameters, write_scenarios, write_table
from cornercase.study._writer import StudyWriter, optional_table_names

if TYPE_CHECKING:
    import pandas as pd

# Largest integer of SQLite.
_MAX_ID: Final = 2**63 - 1
_CRITICAL_RUN_COLUMNS: Final = ("critical runs", "critical runs from", "critical runs to")

# Files are read and checked; the optimizer proposes and learns; scenarios are simulated, measured and stored; the
# critical set is judged; recordings are read back and compared; and so on.
ELAPSED_STAGES: Final = (
    "files", "optimize", "simulate", "measure", "store", "judge", "read", "compare", "cluster", "reduce", "draw",
)  # fmt: skip


class StudyFile:
    """An open study. Make the object with `create` or `open`, and use it as a context manager.

    Other processes can read a study while an exploration writes to it.

    Parameters
    ----------
    database : Database
        The open SQLite file.
    critical : float, optional
        Threshold that replaces the threshold of the study in this object; the file stays as it is.

    Attributes
    ----------
    path : Path
        The file.
    meta : StudyMeta
        Description of the study.
    space : ParameterSpace
        The parameter space.

    Raises
    ------
    InputError
        `database` is a path; use `open` for a path.

    Examples
    --------
    >>> from cornercase.study import StudyFile
    >>> with StudyFile.open("study.db") as study:  # doctest: +SKIP
    ...     print(len(study.finished_rows()), study.most_critical()[0], study.scores("wttc").max().round(2))
    200 17 1.69
    """

    def __init__(self, database: Database, critical: float | None = None) -> None:
        if not isinstance(database, Database):
            raise InputError("`StudyFile`: to open the study at a path, use StudyFile.open(path).")
        self._database, self._critical = database, critical
        self.path = database.path
        self.meta = self.read_meta()
        self.space = self.meta.space
        self._row_cache: tuple[tuple[int, int], list[ScenarioRecord]] | None = None
        self._score_cache: dict[str, tuple[tuple[int, int], FloatArray]] = {}
        # Creating metrics takes longer than a scenario may, so it is done once.
        self._metrics: tuple[tuple[str, ...], tuple[Metric, ...]] | None = None
        # Lengths of the first recordings, and the id of the last of them, once there are enough.
        self._first_lengths: tuple[int, list[int]] | None = None

    @classmethod
    def create(cls, path: Path | str, meta: StudyMeta) -> Self:
        """Create a study in a new file, and open it for writing.

        Parameters
        ----------
        path : path
        meta : StudyMeta
            Description of the study.

        Returns
        -------
        StudyFile

        Raises
        ------
        InputError
            The file exists already, or cannot be written.
        """
        items = sorted(meta.to_json().items())
        rows = [(key, json.dumps(value, sort_keys=True)) for key, value in items]
        try:
            check_no_surrogates(json.dumps(items, ensure_ascii=False))
        except ValueError as error:
            raise InputError(f"{path}: cannot be created, since {error}; change this name.") from error
        return cls(Database.create(Path(path), rows, *optional_table_names(meta)))

    @classmethod
    def open(cls, path: Path | str, readonly: bool = True) -> Self:
        """Open a study.

        Parameters
        ----------
        path : path
        readonly : bool, default True
            Open the file for reading only. Any number of processes can read at the same time, even while one process
            writes. Only one process at a time can have the file open for writing.

        Returns
        -------
        StudyFile

        Raises
        ------
        InputError
            There is no such file, it is not a study of this schema version, or its tables or its description are
            damaged. If it is opened for writing, also: any page is damaged, the file cannot be written or has several
            hard links, or another process has it open for writing.
        """
        database: Database | None = None
        try:
            file = validation.check_path("path", path)
            # Its description may be damaged.
            with reraise_read_errors(file):
                database = Database.open(file, readonly)
                return cls(database)
        except InputError:
            if database is not None:
                database.close()
            raise

    @property
    def writer(self) -> StudyWriter:
        """Writer of this study; writing raises `InputError` if the study is open for reading only."""
        return StudyWriter(self, self._database)

    @property
    def readonly(self) -> bool:
        """True if the study is open for reading only."""
        return self._database.readonly

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def snapshot(self) -> AbstractContextManager[None]:
        """Within the block, read the study as it was at one moment, while an exploration goes on writing.

        Returns
        -------
        context manager
            Everything read within the block is of the same moment.
        """
        return self._database.snapshot()

    def data_version(self) -> int | None:
        """Return a counter of writes by other connections, so that a reader knows when to read again.

        Returns
        -------
        int or None
            The number changes between two calls if another connection has written. None if writes cannot be noticed,
            because the file was read-only when it was opened.
        """
        return self._database.data_version()

    def read_meta(self) -> StudyMeta:
        """Read the description of the study again; an exploration that continues the study may have changed the budget.

        Returns
        -------
        StudyMeta
        """
        pairs = self._database.read_rows("meta")
        return StudyMeta.from_json({key: parse_json(value) for key, value in pairs})

    def rows(self) -> list[ScenarioRecord]:
        """List all scenarios.

        Returns
        -------
        list of ScenarioRecord
            In the order in which they were proposed.
        """
        # Checking 50,000 rows takes seconds, so it is repeated only after a write, as are those of scores.
        version = self._database.count_writes()
        if self._row_cache is None or self._row_cache[0] != version:
            stored = self._database.read_rows("scenarios")
            with reraise_read_errors(self.path):
                rows = [self._decode_row(*columns) for columns in stored]
            self._row_cache = version, rows
        return list(self._row_cache[1])

    def _decode_row(
        self, scenario_id: int, round_number: int, point: bytes, parameters: str, state: str, error: str | None
    ) -> ScenarioRecord:
        require_condition(
            isinstance(scenario_id, int) and scenario_id > 0, f"a scenario is numbered {str(scenario_id)[:60]!r}"
        )
        row = ScenarioRecord(
            scenario_id, round_number, np.frombuffer(point, "<f8"), parse_json(parameters), state, error
        )
        require_condition(
            row.point.shape == (self.space.dimension,), f"the scenario {scenario_id} has another number of parameters"
        )
        require_condition(bool(np.isfinite(row.point).all()), f"the point of the scenario {scenario_id} is not finite")
        is_plain = all(isinstance(item, str | int | float) for item in row.values.values())
        require_condition(is_plain, f"the scenario {scenario_id} has values that are neither numbers nor texts")
        for parameter in self.space.parameters:
            value = parameter.extract_value(row.values)
            if parameter.choices:
                require_condition(
                    str(value) in parameter.choices,
                    f"the scenario {scenario_id} has an unknown choice of {parameter.name}",
                )
            else:
                require_condition(
                    np.isfinite(float(value)), f"the scenario {scenario_id} has no number for {parameter.name}"
                )
        require_condition(
            isinstance(round_number, int) and isinstance(error, str | None), f"the scenario {scenario_id} is damaged"
        )
        return row

    def _read_rows_where(self, condition: str, value: int | str) -> list[ScenarioRecord]:
        self._database.require_all_rows("scenarios")
        stored = self._database.read_rows("scenarios", condition, value)
        with reraise_read_errors(self.path):
            return [self._decode_row(*columns) for columns in stored]

    def rows_of_round(self, round_number: int) -> list[ScenarioRecord]:
        """List the scenarios of a round.

        Parameters
        ----------
        round_number : int

        Returns
        -------
        list of ScenarioRecord
            In the order in which they were proposed.
        """
        return self._read_rows_where("round = ?", round_number)

    def rows_from_id(self, first_id: int) -> list[ScenarioRecord]:
        """List the scenarios from an id on.

        Parameters
        ----------
        first_id : int

        Returns
        -------
        list of ScenarioRecord
            In the order in which they were proposed.
        """
        return self._read_rows_where("id >= ?", first_id)

    def finished_rows(self) -> list[ScenarioRecord]:
        """List the scenarios that ran successfully.

        Returns
        -------
        list of ScenarioRecord
        """
        return [row for row in self.rows() if row.state == "done"]

    def failed_rows(self) -> list[ScenarioRecord]:
        """List the scenarios that failed.

        Returns
        -------
        list of ScenarioRecord
        """
        return self._read_rows_where("state = ?", "failed")

    def points(self) -> FloatArray:
        """Points of the scenarios that ran without failing.

        Returns
        -------
        ndarray of float64, shape (n, d)
            In the unit cube.
        """
        return np.array([row.point for row in self.finished_rows()]).reshape(-1, self.space.dimension)

    def audit_mask(self) -> BoolArray:
        """Tell which scenarios that ran are audits: drawn at random, and hidden from the search.

        Returns
        -------
        ndarray of bool, shape (n,)
            True for audits.
        """
        return np.array([self.meta.is_audit(row.id) for row in self.finished_rows()], dtype=np.bool_)

    def scores(self, metric: str) -> FloatArray:
        """Scores of the scenarios that ran without failing.

        Parameters
        ----------
        metric : str

        Returns
        -------
        ndarray of float64, shape (n,)
            In the metric's unit.

        Raises
        ------
        InputError
            The study has no such metric.
        """
        self._require_metric(metric)
        with self.snapshot():
            version = self._database.count_writes()
            if metric not in self._score_cache or self._score_cache[metric][0] != version:
                self._database.require_all_rows("courses")
                done = self.finished_rows()
                score_of = {
                    scenario: score for scenario, _, score in self._database.read_rows("courses", "metric = ?", metric)
                }
                with reraise_read_errors(self.path):
                    scores = np.array([float(score_of[row.id]) for row in done], dtype=np.float64)
                self._score_cache[metric] = version, scores
            return self._score_cache[metric][1].copy()

    def scenario_scores(self, scenario: int) -> dict[str, float]:
        """Scores of one scenario.

        Parameters
        ----------
        scenario : int
            Id of the scenario.

        Returns
        -------
        dict of str to float
            Score by metric, in the metric's unit; empty if the scenario has not run.
        """
        scores = {name: score for _, name, score in self._database.read_rows("courses", "scenario = ?", scenario)}
        with reraise_read_errors(self.path):
            return {name: float(scores[name]) for name in self.meta.metrics if name in scores}

    def reference_outcomes(self, driver: str) -> dict[int, ReferenceOutcome]:
        """Outcomes of scenarios that were run again with a reference driver driving the ego.

        Parameters
        ----------
        driver : str
            Name of the reference driver.

        Returns
        -------
        dict of int to ReferenceOutcome
            Outcome by scenario id, for scenarios that were run again with this driver.
        """
        self._database.require_all_rows("courses")
        stored = self._database.read_rows("courses", "metric = ?", reference_metric_name(driver), with_blob=True)
        with reraise_read_errors(self.path):
            return {scenario: decode_reference_outcome(score, packed) for scenario, _, score, packed in stored}

    def score_sources(self, metric: str) -> dict[int, str | None]:
        """Return the entity that the score of each scenario is measured against, if there are several candidates.

        Parameters
        ----------
        metric : str

        Returns
        -------
        dict of int to (str or None)
            Name of the entity by scenario id; None if the score is not measured against a single entity. Empty if the
            study has only one entity besides the ego.

        Raises
        ------
        InputError
            The study has no such metric.
        """
        self._require_metric(metric)
        others = self.meta.others
        if len(others) == 1:
            return {}
        with self.snapshot():
            self._database.require_all_rows("against")
            done = self.finished_rows()
            sources = {
                scenario: other for scenario, _, other in self._database.read_rows("against", "metric = ?", metric)
            }
        with reraise_read_errors(self.path):
            require_condition(
                all(scenario is None or scenario in others for scenario in sources.values()),
                f"a score of {metric} is measured against an unknown entity",
            )
            return {row.id: sources[row.id] for row in done}

    def scenario_score_sources(self, scenario: int) -> dict[str, str | None]:
        """Return the entity that each score of one scenario is measured against, if there are several candidates.

        Parameters
        ----------
        scenario : int
            Id of the scenario.

        Returns
        -------
        dict of str to (str or None)
            Name of the entity by metric; None if the score is not measured against a single entity. Empty if the study
            has only one entity besides the ego, or if the scenario has not run.
        """
        if len(self.meta.others) == 1:
            return {}
        sources = {name: other for _, name, other in self._database.read_rows("against", "scenario = ?", scenario)}
        with reraise_read_errors(self.path):
            require_condition(
                all(source is None or source in self.meta.others for source in sources.values()),
                "a score is measured against an unknown entity",
            )
            return {name: sources[name] for name in self.meta.metrics if name in sources}

    def primary_other(self) -> str:
        """Choose the most important entity besides the ego; outcomes and analyses relate this entity to the ego.

        Returns
        -------
        str
            Name of the entity that most scores by the first metric are measured against, in the first round. Later
            rounds do not count, because scores decide which scenarios are in these rounds. In a search without rounds,
            the first scenarios count, up to the batch size. In a tie, the study's order of entities decides, also if no
            score is measured against a single entity.
        """
        others = self.meta.others
        if len(others) == 1:
            return others[0]
        has_rounds = not self.meta.asynchronous
        first_ids = {row.id for row in self.rows() if (row.round == 1 if has_rounds else row.id <= self.meta.batch)}
        counts = Counter(
            source for scenario, source in self.score_sources(self.meta.metrics[0]).items() if scenario in first_ids
        )
        return max(others, key=counts.__getitem__)

    def reference_outcome(self, scenario: int, driver: str) -> ReferenceOutcome | None:
        """Outcome of one scenario that was run again with a reference driver driving the ego.

        Parameters
        ----------
        scenario : int
            Id of the scenario.
        driver : str
            Name of the reference driver.

        Returns
        -------
        ReferenceOutcome or None
            None if the scenario was not run again with this driver.
        """
        condition = "scenario = ? AND metric = ?"
        stored = self._database.read_rows("courses", condition, scenario, reference_metric_name(driver), with_blob=True)
        with reraise_read_errors(self.path):
            return decode_reference_outcome(*stored[0][2:]) if stored else None

    def score_range(self, metric: str) -> FloatArray | None:
        """Lowest and highest score among the repeated runs of each scenario.

        Parameters
        ----------
        metric : str

        Returns
        -------
        ndarray of float64, shape (n, 2), or None
            Lowest and highest score in the metric's unit; None if each scenario was run once.

        Raises
        ------
        InputError
            The study has no such metric.
        """
        self._require_metric(metric)
        if (scores := self._read_run_scores(metric)) is None:
            return None
        with reraise_read_errors(self.path):
            return np.array([[min(run_scores), max(run_scores)] for run_scores in scores], dtype=np.float64)

    def _read_run_scores(self, metric: str) -> list[Any] | None:
        """Scores of all runs of each scenario; None if each scenario was run once."""
        with self.snapshot():
            self._database.require_all_rows("repeats")
            done = self.finished_rows()
            texts = {scenario: text for scenario, _, text in self._database.read_rows("repeats", "metric = ?", metric)}
        if not texts:
            return None
        with reraise_read_errors(self.path):
            return [parse_json(texts[row.id]) for row in done]

    def course(self, scenario: int, metric: str) -> FloatArray:
        """Course of a metric over time in one scenario.

        Parameters
        ----------
        scenario : int
            Id of the scenario.
        metric : str

        Returns
        -------
        ndarray of float64, shape (T,)
            In the metric's unit.

        Raises
        ------
        InputError
            The scenario has not run, its id is not an integer, or the study has no such metric.
        """
        self._require_metric(metric)
        scenario_id = self._check_id_number(scenario)
        rows = self._database.read_rows("courses", "scenario = ? AND metric = ?", scenario_id, metric, with_blob=True)
        if not rows:
            raise self._make_not_run_error(scenario_id)
        with reraise_read_errors(self.path):
            course = np.asarray(unpack_arrays(rows[0][-1])["course"])
            require_condition(
                course.ndim == 1 and course.dtype.kind in "fiu",
                f"the course of {metric} in the scenario {scenario_id} is not valid",
            )
            return course

    def recording(self, scenario: int) -> Recording:
        """Recording of one scenario.

        Parameters
        ----------
        scenario : int
            Id of the scenario.

        Returns
        -------
        Recording

        Raises
        ------
        InputError
            The scenario has not run, or its id is not an integer.
        """
        return self._unpack_recording(self._read_packed_recording(scenario))

    def _read_packed_recording(self, scenario: int) -> bytes:
        scenario_id = self._check_id_number(scenario)
        rows = self._database.read_rows("scenarios", "id = ?", scenario_id, with_blob=True)
        if not rows or rows[0][-1] is None:
            raise self._make_not_run_error(scenario_id)
        packed: bytes = rows[0][-1]
        return packed

    def _unpack_recording(self, packed: bytes) -> Recording:
        with reraise_read_errors(self.path):
            return unpack_recording(packed)

    def collisions(self) -> dict[int, tuple[Collision, ...]]:
        """Collisions in the scenarios that ran, without reading their recordings.

        Returns
        -------
        dict of int to tuple of Collision
            Collisions by scenario id, in the order in which scenarios were proposed.
        """
        return {scenario: decode_collisions(facts) for scenario, facts in self._iter_digest_facts()}

    def impacts(self, ids: Container[int] | None = None) -> dict[int, tuple[Impact, ...]]:
        """Collisions of the ego in the scenarios that ran, with the relative speed at contact.

        Parameters
        ----------
        ids : container of int, optional
            Ids of the scenarios to look at, by default of all.

        Returns
        -------
        dict of int to tuple of Impact
            Collisions in the order of time, by scenario id; scenarios are in the order in which they were proposed.
        """
        return {scenario: decode_impacts(facts) for scenario, facts in self._iter_digest_facts(ids)}

    def most_critical(self, metric: str | None = None) -> list[int]:
        """List the scenarios that ran, the most critical first.

        Parameters
        ----------
        metric : str, optional
            By default the objective of the search; for a Pareto front the first metric of the study.

        Returns
        -------
        list of int
            Ids of the scenarios. Scenarios with the same score are sorted by the relative speed of the ego's first
            collision, the fastest first; scenarios without a collision come last.

        Raises
        ------
        InputError
            The study has no such metric, or the package of the metric is not installed.
        """
        with self.snapshot():
            impacts = self.impacts()
            if metric is None and self.meta.weights:
                minimized = self.objective.minimized_scores(self)
            else:
                name = self.meta.metrics[0] if metric is None else metric
                scores = self.scores(name)
                minimized = self.meta.create_metric(name).to_minimize(scores)
        order = order_by_criticality(minimized, list(impacts.values()))
        ids = list(impacts)
        return [ids[k] for k in order]

    def _iter_digest_facts(self, ids: Container[int] | None = None) -> Iterator[tuple[int, dict[str, Any]]]:
        """Yield scenario id and decoded facts (the JSON values) of each digest; `ids` limits the scenarios."""
        self._database.require_all_rows("digests")
        with reraise_read_errors(self.path), closing(self._database.iter_rows("digests")) as rows:
            for scenario, facts in rows:
                if ids is None or scenario in ids:
                    yield scenario, decode_digest_facts(facts)

    def iter_digests(self, parts: Collection[DigestPart] = DIGEST_PARTS) -> Iterator[tuple[int, ScenarioDigest]]:
        """Yield the digest of each scenario that ran: the values that analysis and report need of its recording.

        Parameters
        ----------
        parts : collection of {"series", "courses", "lines", "rounded"}
            Parts of the digests to read, by default all; parts that are not read are empty.

        Yields
        ------
        int
            Id of the scenario.
        ScenarioDigest
        """
        ids = [row.id for row in self.finished_rows()]
        self._database.require_all_rows("digests")
        count = 0
        with reraise_read_errors(self.path), closing(self._database.iter_rows("digests", with_blob=True)) as rows:
            for scenario, facts, packed in rows:
                if count == len(ids) or ids[count] != scenario:
                    raise DamageError.from_problem(
                        self.path, f"its table digests has scenario {scenario} where another one is expected"
                    )
                count += 1
                yield scenario, decode_digest(decode_digest_facts(facts), packed, self.meta, parts)
            if count < len(ids):
                raise DamageError.from_problem(self.path, f"its table digests lacks scenario {ids[count]}")

    def digest(self, scenario: int) -> ScenarioDigest:
        """Read the digest of one scenario: the values that analysis and report need of its recording.

        Parameters
        ----------
        scenario : int
            Id of the scenario.

        Returns
        -------
        ScenarioDigest

        Raises
        ------
        InputError
            The scenario has not run, or its id is not an integer.
        """
        facts, packed = self._read_digest(scenario)
        with reraise_read_errors(self.path):
            return decode_digest(decode_digest_facts(facts), packed, self.meta)

    def _read_digest(self, scenario: int) -> tuple[str, bytes]:
        scenario_id = self._check_id_number(scenario)
        rows = self._database.read_rows("digests", "scenario = ?", scenario_id, with_blob=True)
        if not rows:
            raise self._make_not_run_error(scenario_id)
        _, facts, packed = rows[0]
        return facts, packed

    def rounded_recording(self, scenario: int) -> bytes:
        """Return the recording of one scenario, and its metrics over time, in the compact format of the report page.

        Numbers are rounded, and values of a metric are limited to its cap.

        Parameters
        ----------
        scenario : int
            Id of the scenario.

        Returns
        -------
        bytes
            In the format of the report page.

        Raises
        ------
        InputError
            The scenario has not run, or its id is not an integer.
        """
        _, packed = self._read_digest(scenario)
        with reraise_read_errors(self.path):
            rounded = decode_rounded_recording(unpack_arrays(packed, names=("rounded",)))
        if rounded:
            return rounded
        recording, courses = self.recording_and_courses(scenario)
        return encode_rounded(
            recording, {name: self.meta.create_metric(name).clip_course(course) for name, course in courses.items()}
        )

    def features(self, scenarios: Sequence[int | None]) -> FloatArray:
        """Return all registered features of scenarios, as stored in the study, or else computed from recordings.

        Parameters
        ----------
        scenarios : sequence of int or None
            Ids; None for a scenario that failed.

        Returns
        -------
        ndarray of float64, shape (n, f)
            As `cornercase.metrics.compute_features` returns them; NaN for a scenario that failed.

        Raises
        ------
        InputError
            A scenario has not run, or features that another package has registered cannot be computed.
        """
        checksum = registered_features_checksum()
        features = np.full((len(scenarios), len(registered_features())), np.nan)
        for row, scenario in zip(features, scenarios, strict=True):
            if scenario is not None:
                row[:] = self._scenario_features(scenario, checksum)
        return features

    def _scenario_features(self, scenario: int, checksum: int) -> FloatArray:
        """Return the f registered features of one scenario, shape (f,)."""
        with reraise_read_errors(self.path):
            stored = decode_features(self._read_digest(scenario)[1], checksum)
        return measure_registered_features(self.recording(scenario), self.meta) if stored is None else stored

    def metrics(self) -> tuple[Metric, ...]:
        """Metrics of the study.

        Returns
        -------
        tuple of Metric
            Empty if a metric comes from a package that is not installed.
        """
        if self._metrics is None or self._metrics[0] != self.meta.metrics:
            self._metrics = self.meta.metrics, create_metrics_if_known(self.meta)
        return self._metrics[1]

    def lengths_of_first_recordings(self, before: int) -> list[int]:
        """Numbers of instants of the first recordings; they decide how coarsely stored series are sampled.

        Parameters
        ----------
        before : int
            Scenario id; only recordings of scenarios with a lower id are used.

        Returns
        -------
        list of int
            Numbers of instants of at most 32 recordings, in the order of scenario ids.
        """
        if self._first_lengths is None or before <= self._first_lengths[0]:
            condition = "scenario IN (SELECT scenario FROM digests WHERE scenario < ? ORDER BY scenario LIMIT ?)"
            rows = self._database.read_rows("digests", condition, before, N_STRIDE_RECORDINGS)
            with reraise_read_errors(self.path):
                lengths = [int(decode_digest_facts(facts)["instants"]) for _, facts in rows]
            self._first_lengths = (rows[-1][0], lengths) if len(rows) == N_STRIDE_RECORDINGS else None
            return lengths
        return self._first_lengths[1]

    def outcomes(self) -> dict[int, str]:
        """Describe in words how each scenario ended.

        Returns
        -------
        dict of int to str
            Description by scenario id, for scenarios that had run when the study was clustered.
        """
        rows = self._database.read_rows("outcomes")
        return {scenario: str(outcome) for scenario, outcome in rows}

    def notes(self) -> dict[int, str]:
        """Read the notes about scenarios.

        Returns
        -------
        dict of int to str
            Note by scenario id, for scenarios with a note.
        """
        rows = self._database.read_rows("notes")
        with reraise_read_errors(self.path):
            for scenario, note in rows:
                require_condition(
                    isinstance(note, str) and len(note) <= MAX_NOTE_LENGTH,
                    f"the note on the scenario {scenario} is not valid",
                )
            return dict(rows)

    def _check_id_number(self, scenario: object) -> int:
        with suppress(InputError):
            return check_int("scenario", scenario, maximum=_MAX_ID)
        ids = describe_ids([row.id for row in self.rows()])
        raise InputError(
            f"`scenario` {validation.repr_short(scenario)}: give the id of a scenario, a whole number from 1 on; {ids}."
        )

    def _make_not_run_error(self, scenario: int) -> InputError:
        """Return the error for a scenario that does not exist, or has no recording."""
        ids = [row.id for row in self.rows()]
        if scenario in ids:
            return InputError(f"{self.path}: the scenario {scenario} was not run.")
        return InputError(f"{self.path}: has no scenario {scenario}; {describe_ids(ids)}.")

    def _require_metric(self, metric: str) -> None:
        if metric not in self.meta.metrics:
            raise InputError(
                f"{self.path}: holds no course of the metric '{metric}'; its metrics are"
                f" {', '.join(self.meta.metrics)}."
            )

    @property
    def critical(self) -> float | None:
        """Threshold in the unit of the objective: the stored threshold, or the threshold given to this object."""
        return self.meta.critical if self._critical is None else self._critical

    @property
    def objective(self) -> Objective:
        """Objective of the search, with the threshold of `critical`."""
        return Objective.from_study_meta(self.meta, self._critical)

    @property
    def criterion(self) -> Criterion | None:
        """Criterion for critical scenarios; None if there is no threshold, or if a Pareto front was searched."""
        return self.objective.criterion

    def critical_mask(self) -> BoolArray:
        """Mask of critical scenarios among those that ran.

        Returns
        -------
        ndarray of bool, shape (n,)
            All False without a threshold.
        """
        objective = self.objective
        return objective.critical_mask(objective.minimized_scores(self))

    def with_critical(self, critical: float | None) -> StudyFile:
        """Return another object for the same open file, with another threshold.

        Parameters
        ----------
        critical : float or None
            Threshold in the unit of the objective; None keeps the current threshold.

        Returns
        -------
        StudyFile

        Raises
        ------
        InputError
            A condition, not a threshold, decides what is critical. Or the study has no single score that a threshold
            could apply to. Or the study is an estimate of probabilities, which hold for the stored threshold only.
        """
        if critical is None:
            return self
        meta = self.meta
        if condition := meta.condition:
            raise InputError(
                f"{self.path}: the condition '{condition}' decides what is critical; leave out `critical`."
            )
        if meta.pareto:
            raise InputError(f"{self.path}: a Pareto front has no threshold; leave out `critical`.")
        if self.read_estimate() is not None:
            raise InputError(
                f"{self.path}: its probabilities hold for one threshold only; estimate again with another `critical`."
            )
        return StudyFile(self._database, critical)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def __repr__(self) -> str:
        meta, counts = self.meta, self._count_states()
        drivers = "".join(f", {entity} driven by {format_driver(driver)}" for entity, driver in meta.drivers.items())
        return (
            f"<Study {str(self.path)!r}: {meta.title}, {meta.ego} and {', '.join(meta.others)}, by"
            f" {', '.join(meta.metrics)}, in {meta.simulator}{drivers}; {counts.get('done', 0)} scenarios run,"
            f" {counts.get('failed', 0)} failed, {counts.get('pending', 0)} pending>"
        )

    def critical_run_rates(self) -> FloatArray | None:
        """Probability that a run of each scenario is critical, estimated from repeated runs.

        Returns
        -------
        ndarray of float64, shape (n, 3), or None
            Fraction of critical runs, and lower and upper end of its 90 % interval. If the interval contains 0.5, it is
            undecided whether the scenario is critical. None if each scenario was run once, or if the study has no
            threshold, or if the search was by several metrics at once (weighted sum or Pareto front).
        """
        objective = self.objective
        if objective.criterion is None or objective.weights:
            return None
        metric = objective.metrics[0]
        if (runs := self._read_run_scores(metric.name)) is None:
            return None
        with reraise_read_errors(self.path):
            scores = [[metric.to_minimize(float(score)) for score in run_scores] for run_scores in runs]
            return critical_run_rates(scores, objective.criterion)

    def warm_start_data(self) -> tuple[FloatArray, FloatArray] | None:
        """Read the points and scores of the earlier study that the search began with; None without a warm start.

        Returns
        -------
        points : ndarray of float64, shape (n, d)
            In the unit cube of this study's space.
        scores : ndarray of float64, shape (n,)
            Scores to minimize.

        Raises
        ------
        InputError
            The points and scores are missing because the study is damaged.
        """
        if not self.meta.elsewhere:
            return None
        with reraise_read_errors(self.path):
            rows = self._database.read_rows("elsewhere")
            points = np.array([np.frombuffer(point, dtype="<f8") for point, _ in rows], dtype=np.float64)
            scores = np.array([score for _, score in rows], dtype=np.float64)
            digest = hash_points_and_scores(points, scores)
            require_condition(digest == self.meta.elsewhere.get("sha256"), "the warm-start data is incomplete")
            return points, scores

    def analyzed_aspects(self) -> list[str]:
        """List the aspects (what scenarios are compared by) of all stored analyses.

        Returns
        -------
        list of str
            ``ego-trajectory`` first, then the others in alphabetical order, the metrics last.
        """
        names = {str(name) for name, _ in self._database.read_rows("analyses")} - {"reduction", "estimate"}
        metrics = [name for name in self.meta.metrics if name in names]
        return [*sorted(names - set(metrics), key=lambda name: (name != "ego-trajectory", name)), *metrics]

    def read_analysis(self, name: str, *array_names: str) -> tuple[dict[str, Any], dict[str, Any]]:
        """Read the stored result of an analysis.

        Parameters
        ----------
        name : str
            Aspect of the analysis, by which scenarios were compared.
        *array_names : str
            Names of the arrays to read, by default all; reading large arrays takes time.

        Returns
        -------
        arrays : dict of str to ndarray, in the shapes that were stored
        info : dict
            The other values of the result.

        Raises
        ------
        InputError
            The study was not analyzed by this aspect, or the analysis has no array of a given name.
        """
        rows = self._database.read_rows("analyses", "name = ?", name)
        if not rows:
            others = ", ".join(self.analyzed_aspects())
            advice = (
                f", only by {others}; choose among these, or run `analyze` by it" if others else "; run `analyze` first"
            )
            raise InputError(f"{self.path}: holds no analysis by {name}{advice}.")
        self._database.require_all_rows("arrays")
        # In the order in which they were written.
        query = "SELECT name FROM arrays WHERE analysis = ? AND part = 0 ORDER BY rowid"
        stored = [key for (key,) in self._database.query(query, name)]
        if missing := sorted(set(array_names).difference(stored)):
            raise InputError(
                f"{self.path}: its analysis by {name} has no array {', '.join(missing)}; run `analyze` again."
            )
        with reraise_read_errors(self.path), self.snapshot():
            values = read_arrays(
                self._database.read_rows, name, list(array_names or stored), sum(self._count_states().values())
            )
            return values, parse_json(rows[0][1])

    def read_reduction(self) -> dict[str, Any] | None:
        """Read the description of the reduced set, as in its manifest.

        Returns
        -------
        dict or None
            None if the study was not reduced.
        """
        return self._read_analysis_info("reduction")

    def read_estimate(self) -> dict[str, Any] | None:
        """Read the result of an estimate of probabilities.

        Returns
        -------
        dict or None
            None if the study is not an estimate, or if the estimate has not ended.
        """
        return self._read_analysis_info("estimate")

    def _read_analysis_info(self, name: str) -> dict[str, Any] | None:
        self._database.require_all_rows("analyses")
        rows = self._database.read_rows("analyses", "name = ?", name)
        with reraise_read_errors(self.path):
            return dict(parse_json(rows[0][1])) if rows else None

    def result_order(self) -> list[tuple[int, int]]:
        """Read the order in which results arrived in an asynchronous search.

        Returns
        -------
        list of (int, int)
            For each scenario that has ended, in the order of arrival: its id, and the number of the first round (set of
            scenarios that the optimizer proposes at once) that was or will be proposed with knowledge of the result.
            Empty if the search is not asynchronous.
        """
        if not self.meta.asynchronous:
            return []
        with self.snapshot():
            stored = self._database.read_rows("results")
            rows = {row.id: row for row in self.rows()}
        ended_ids = {row.id for row in rows.values() if row.state != "pending"}
        with reraise_read_errors(self.path):
            rounds = [round_number for _, _, round_number in stored]
            require_condition(
                all(isinstance(round_number, int) for round_number in rounds) and rounds == sorted(rounds),
                "the order of its results is not valid",
            )
            last = max((row.round for row in rows.values()), default=0)
            require_condition(
                all(rows[scenario_id].round < round_number <= last + 1 for _, scenario_id, round_number in stored),
                "the round of a result is not valid",
            )
            require_condition(
                len(stored) == len(ended_ids) and {scenario_id for _, scenario_id, _ in stored} == ended_ids,
                "a result is missing, there twice, or of a scenario that has not ended",
            )
            return [(scenario, round_number) for _, scenario, round_number in stored]

    def elapsed_by_stage(self) -> dict[str, float]:
        """Time spent in each stage of the work.

        Returns
        -------
        dict of str to float
            Time in s by stage, in the order of the stages.
        """
        rows = self._database.read_rows("elapsed")
        with reraise_read_errors(self.path):
            seconds_of = {str(stage): float(seconds) for stage, seconds in rows}
        return {stage: seconds_of[stage] for stage in (*ELAPSED_STAGES, *seconds_of) if stage in seconds_of}

    def table(self) -> pd.DataFrame:
        """Make a table of all scenarios.

        Returns
        -------
        DataFrame
            One row per scenario, indexed by its id. The columns are ``round``, ``state``, ``audit`` if there are
            audits, and one for each parameter and metric. If a weighted sum was searched, ``objective`` is this sum;
            low values are critical. If scenarios were run several times, there are also ``lowest …`` and ``highest …``
            for each metric, ``critical runs`` as in `critical_run_rates`, and, if the number of runs may vary, ``runs``
            (the number of runs that did not fail). If there are several other entities, ``other by …`` names the entity
            that the score of a metric is measured against. ``collision`` names the entity that the ego collides with
            first, and ``impact speed`` is their relative speed at contact in m/s. ``fault`` says whose fault this
            collision is (``"ego"``, ``"other"``, ``"both"`` or ``"undecided"``), and ``fault reason`` why. ``cluster
            by …`` is the cluster by an aspect (what scenarios are compared by), -1 for noise. Then follow ``outcome``
            after an analysis, ``note`` if there are notes, and ``error``. Cells without a value are empty. A parameter
            with the name of another column becomes ``parameter …``.
        """
        with self.snapshot():
            scores = {}
            for name in self.meta.metrics:
                scores[name] = self.scores(name)
                if (spread := self.score_range(name)) is not None:
                    scores[f"lowest {name}"], scores[f"highest {name}"] = spread.T
            if self.meta.weights:
                with suppress(InputError):  # The package of a metric may be missing.
                    scores["objective"] = self.objective.minimized_scores(self)
            with suppress(InputError):  # The package of a metric may be missing.
                if (runs := self.critical_run_rates()) is not None:
                    scores |= dict(zip(_CRITICAL_RUN_COLUMNS, runs.T, strict=True))
            clusters = {}
            for name in self.analyzed_aspects():
                arrays, _ = self.read_analysis(name, "ids", "labels")
                clusters[name] = arrays["ids"], arrays["labels"]
            rows = self.rows()
            ids = {row.id for row in rows}
            with reraise_read_errors(self.path):
                for name, ids_and_labels in clusters.items():
                    is_valid = all(
                        array.ndim == 1 and array.dtype.kind == "i" and len(array) == len(ids_and_labels[0])
                        for array in ids_and_labels
                    )
                    require_condition(
                        is_valid and set(ids_and_labels[0].tolist()) <= ids,
                        f"its clusters by {name} are of other scenarios",
                    )
                audits = [self.meta.is_audit(row.id) for row in rows] if self.meta.audit else None
                against = {name: self.score_sources(name) for name in self.meta.metrics if len(self.meta.others) > 1}
                counts = self._count_runs() if self.meta.most_repeats is not None else None
                return build_scenario_table(
                    rows,
                    self.space,
                    scores,
                    clusters,
                    self.outcomes(),
                    audits,
                    self.notes(),
                    against,
                    counts,
                    self.impacts(),
                )

    def _count_runs(self) -> dict[int, int]:
        """Return the number of runs that did not fail, by scenario id."""
        runs = self._read_run_scores(self.meta.metrics[0]) or []
        return {row.id: len(scores) for row, scores in zip(self.finished_rows(), runs, strict=True)}

    def export(self, folder: Path | str, parquet: bool = False, osi: bool = False) -> None:
        """Write the study as CSV: a table of scenarios, and the recording and metric courses of each scenario.

        Parameters
        ----------
        folder : path
            Folder for ``scenarios.csv`` and, for each scenario, ``recordings/ID.csv`` and ``courses/ID.csv``.
            ``scenarios.csv`` holds the columns of `table`, with underscores for spaces in their names.
            ``parameters.csv`` lists the recording file and the parameters of each scenario, for `import_recordings`.
        parquet : bool, default False
            Also write ``scenarios.parquet``, ``recordings.parquet`` and ``courses.parquet`` of all scenarios. The
            column ``scenario`` of the last two is the scenario id.
        osi : bool, default False
            Also write ``osi/ID.osi``, a trace of ASAM OSI with the ego as host vehicle, for each scenario.

        Raises
        ------
        InputError
            The folder cannot be written, or the package that writes Parquet or OSI is not installed. In both cases no
            file has changed.
        """
        folder = check_output_folder("folder", folder)
        table = self.table()
        # All files appear at the end, so that a damaged study leaves no partial export.
        with atomic_write_group():
            write_table(folder, table, parquet)
            write_parameters(folder, {row.id: row.values for row in self.finished_rows()}, self.space.names)
            write_scenarios(folder, self.iter_recordings(), parquet)
            if osi:
                for number, recording, _ in self.iter_recordings():
                    write_osi(folder / "osi" / f"{number:05}.osi", recording, self.meta.ego)

    def read_recording_pair(self, scenario: int, other: StudyFile, other_scenario: int) -> tuple[Recording, Recording]:
        """Read the recording of a scenario, and the recording of a scenario in another study.

        Parameters
        ----------
        scenario : int
            Id in this study.
        other : StudyFile
        other_scenario : int
            Id in the other study.

        Returns
        -------
        Recording
            From this study.
        Recording
            From the other study; the same object as the first if the stored bytes are equal.

        Raises
        ------
        InputError
            One of the scenarios has not run, or its id is not an integer.
        """
        packed, other_packed = self._read_packed_recording(scenario), other._read_packed_recording(other_scenario)
        recording = self._unpack_recording(packed)
        return recording, recording if packed == other_packed else other._unpack_recording(other_packed)

    def iter_recordings(self) -> Iterator[tuple[int, Recording, dict[str, FloatArray]]]:
        """Yield the recording and the metric courses of each scenario that ran.

        Yields
        ------
        int
            Id of the scenario.
        Recording
        dict of str to ndarray of float64, shape (T,)
            Course by metric.

        Raises
        ------
        InputError
            A course has another length than its recording.
        """
        for row in self.finished_rows():
            yield row.id, *self.recording_and_courses(row.id)

    def recording_and_courses(self, scenario: int) -> tuple[Recording, dict[str, FloatArray]]:
        """Read the recording and the metric courses of one scenario.

        Parameters
        ----------
        scenario : int
            Id of the scenario.

        Returns
        -------
        Recording
        dict of str to ndarray of float64, shape (T,)

        Raises
        ------
        InputError
            The scenario has not run, its id is not an integer, or a course has another length than its recording.
        """
        recording = self.recording(scenario)
        courses = {name: self.course(scenario, name) for name in self.meta.metrics}
        with reraise_read_errors(self.path):
            for name, course in courses.items():
                require_condition(
                    len(course) == len(recording.time),
                    f"the course of {name} in the scenario {scenario} has {len(course)} instants, and its recording has"
                    f" {len(recording.time)}",
                )
        return recording, courses

    def require_undamaged(self) -> None:
        """Check the checksums of all rows, without decoding their content.

        Raises
        ------
        InputError
            Something is damaged.
        """
        tables = {name for (name,) in self._database.query("SELECT name FROM sqlite_master WHERE type = 'table'")}
        for table in (name for name in TABLES if name in tables):
            self._database.require_all_rows(table)
            with closing(self._database.iter_rows(table, with_blob=True)) as rows:
                for _ in rows:
                    pass

    def checksum_totals(self) -> dict[str, tuple[int, int]]:
        """Row count and XOR of checksums of each table; studies with equal values have equal content.

        Returns
        -------
        dict of str to (int, int)
            Number of rows, and the XOR of their checksums, by table.
        """
        return {name: (rows, sums) for name, rows, sums in self._database.read_rows("tallies")}

    def _count_states(self) -> dict[str, int]:
        """Return the number of scenarios in each state."""
        return Counter(row.state for row in self.rows())


def describe_ids(ids: Collection[int]) -> str:
    """Describe in words the range of the scenario ids of a study."""
    last = max(ids, default=0)
    return f"its scenarios are 1 to {last}" if last > 1 else "its only scenario is 1" if last else "it has none yet"


@contextmanager
def open_study(
    study: StudyFile | Path | str, readonly: bool = False, critical: float | None = None
) -> Iterator[StudyFile]:
    """Open the study at a path within the block; if `study` is open already, yield it.

    `critical` replaces the threshold within the block; the file stays as it is. Raises `InputError` if an open study is
    read-only but has to be written, or if `critical` cannot apply to the study (see `StudyFile.with_critical`).
    """
    threshold = None if critical is None else check_float("critical", critical)
    if isinstance(study, StudyFile):
        if study.readonly and not readonly:
            raise InputError(f"{study.path}: is open for reading only; open it with readonly=False, or give its path.")
        yield study.with_critical(threshold)
        return
    with StudyFile.open(validation.check_path("study", study), readonly) as opened:
        yield opened.with_critical(threshold)


@contextmanager
def open_or_create_study(path: Path, meta: StudyMeta) -> Iterator[StudyFile]:
    """Within the block, open a study for writing; create it if the file does not exist.

    A new study is removed again if the block raises `InputError` before any scenario has run.
    """
    if path.exists():
        with StudyFile.open(path, readonly=False) as study:
            yield study
        return
    with StudyFile.create(path, meta) as study:
        try:
            yield study
        except InputError:
            # The error of the block matters more than that of removing the file.
            with suppress(InputError, OSError):
                if not study.finished_rows() and not study.notes():
                    study.close()
                    path.unlink()
                    remove_leftover_journals(path)
            raise
