"""The scenarios of a study."""

from __future__ import annotations

from collections import Counter
from contextlib import AbstractContextManager, closing
from typing import Any, Final

import numpy as np

from cornercase._common.arguments import whole_number
from cornercase._common.errors import InputError
from cornercase._common.texts import loaded_json
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.drivers import ReferenceOutcome
from cornercase.recordings import Collision, Recording
from cornercase.study.codec import unpack_arrays, unpack_collisions, unpack_recording
from cornercase.study.damage import damage_told, require
from cornercase.study.database import Database
from cornercase.study.meta import StudyMeta
from cornercase.study.notes import LONGEST_NOTE
from cornercase.study.second_runs import read_reference, row_name
from cornercase.study.table import Row

# Largest integer of SQLite.
_LARGEST_ID: Final = 2**63 - 1


class ScenarioContents:
    """Everything that a study holds of its scenarios, while others write to it or not.

    Attributes
    ----------
    path : Path
        The file.
    meta : StudyMeta
        Description of the study.
    space : ParameterSpace
        The parameter space.
    """

    def __init__(self, database: Database) -> None:
        self._database = database
        self.path = database.path
        self.meta = self.stored_meta()
        self.space = self.meta.space
        self._asked: float | None = None
        self._known: tuple[tuple[int, int], list[Row]] | None = None

    @property
    def readonly(self) -> bool:
        """Whether the study is open for reading only."""
        return self._database.readonly

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def snapshot(self) -> AbstractContextManager[None]:
        """Read the study at one moment, while an exploration goes on writing.

        Returns
        -------
        context manager
            Everything that is read within it is of one moment.
        """
        return self._database.snapshot()

    def changes(self) -> int | None:
        """Count writes of other connections, so that a reader knows when to read again.

        Returns
        -------
        int or None
            It differs from the last value if another connection has written since. None if this reader cannot see what
            others write, since nobody could write to the file when it was opened.
        """
        return self._database.changes()

    def stored_meta(self) -> StudyMeta:
        """Read the description of the study anew: an exploration that continues it may change the budget.

        Returns
        -------
        StudyMeta
        """
        pairs = self._database.rows("meta")
        return StudyMeta.from_json({key: loaded_json(value) for key, value in pairs})

    def rows(self) -> list[Row]:
        """List all scenarios.

        Returns
        -------
        list of ScenarioRecord
            In the order in which they were proposed.
        """
        # Checking 50,000 rows takes seconds, so it is repeated only after a write.
        version = self._database.written()
        if self._known is None or self._known[0] != version:
            stored = self._database.rows("scenarios")
            with damage_told(self.path):
                rows = [self._row(*columns) for columns in stored]
            self._known = version, rows
        return list(self._known[1])

    def _row(self, number: int, turn: int, point: bytes, values: str, state: str, error: str | None) -> Row:
        require(isinstance(number, int) and number > 0, f"a scenario is numbered {str(number)[:60]!r}")
        row = Row(number, turn, np.frombuffer(point, "<f8"), loaded_json(values), state, error)
        require(row.point.shape == (self.space.dimension,), f"the scenario {number} has another number of parameters")
        require(bool(np.isfinite(row.point).all()), f"the point of the scenario {number} is not finite")
        is_plain = all(isinstance(item, str | int | float) for item in row.values.values())
        require(is_plain, f"the scenario {number} has values that are neither numbers nor texts")
        for parameter in self.space.parameters:
            value = parameter.read(row.values)
            if parameter.choices:
                require(
                    str(value) in parameter.choices, f"the scenario {number} has an unknown choice of {parameter.name}"
                )
            else:
                require(np.isfinite(float(value)), f"the scenario {number} has no number for {parameter.name}")
        require(isinstance(turn, int) and isinstance(error, str | None), f"the scenario {number} is damaged")
        return row

    def rows_of(self, turn: int) -> list[Row]:
        """List the scenarios of a round.

        Parameters
        ----------
        round_number : int

        Returns
        -------
        list of ScenarioRecord
            In the order in which they were proposed.
        """
        self._database.require_all("scenarios")
        stored = self._database.rows("scenarios", "round = ?", turn)
        with damage_told(self.path):
            return [self._row(*columns) for columns in stored]

    def rows_from(self, first: int) -> list[Row]:
        """List the scenarios from an id on.

        Parameters
        ----------
        first_id : int

        Returns
        -------
        list of ScenarioRecord
            In the order in which they were proposed.
        """
        self._database.require_all("scenarios")
        stored = self._database.rows("scenarios", "id >= ?", first)
        with damage_told(self.path):
            return [self._row(*columns) for columns in stored]

    def done(self) -> list[Row]:
        """List the scenarios that ran successfully.

        Returns
        -------
        list of ScenarioRecord
        """
        return [row for row in self.rows() if row.state == "done"]

    def failed(self) -> list[Row]:
        """List the scenarios that failed.

        Returns
        -------
        list of ScenarioRecord
        """
        self._database.require_all("scenarios")
        stored = self._database.rows("scenarios", "state = ?", "failed")
        with damage_told(self.path):
            return [self._row(*columns) for columns in stored]

    def points(self) -> FloatArray:
        """Points of the scenarios that ran.

        Returns
        -------
        ndarray of float64, shape (n, d)
            In the unit cube.
        """
        return np.array([row.point for row in self.done()]).reshape(-1, self.space.dimension)

    def audits(self) -> BoolArray:
        """Mask of the scenarios that ran which are audits: drawn at random, and hidden from the search.

        Returns
        -------
        ndarray of bool, shape (n,)
        """
        return np.array([self.meta.is_audit(row.id) for row in self.done()], dtype=np.bool_)

    def scores(self, metric: str) -> FloatArray:
        """Scores of the scenarios that ran.

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
            self._database.require_all("courses")
            done = self.done()
            score_of = {scenario: score for scenario, _, score in self._database.rows("courses", "metric = ?", metric)}
        with damage_told(self.path):
            return np.array([float(score_of[row.id]) for row in done], dtype=np.float64)

    def scores_of(self, scenario: int) -> dict[str, float]:
        """Scores of one scenario.

        Parameters
        ----------
        scenario : int
            Its id.

        Returns
        -------
        dict of str to float
            By metric, in the metric's unit; empty if it has not run.
        """
        scores = {name: score for _, name, score in self._database.rows("courses", "scenario = ?", scenario)}
        with damage_told(self.path):
            return {name: float(scores[name]) for name in self.meta.metrics if name in scores}

    def references(self, driver: str) -> dict[int, ReferenceOutcome]:
        """Outcomes of the scenarios that were run again with a reference driver in the ego.

        Parameters
        ----------
        driver : str
            Name of the reference driver.

        Returns
        -------
        dict of int to ReferenceOutcome
            By id of each scenario that was run with it.
        """
        self._database.require_all("courses")
        stored = self._database.rows("courses", "metric = ?", row_name(driver), blob=True)
        with damage_told(self.path):
            return {scenario: read_reference(score, packed) for scenario, _, score, packed in stored}

    def against(self, metric: str) -> dict[int, str | None]:
        """Name the entity that each score is against, in a study of several others.

        Parameters
        ----------
        metric : str

        Returns
        -------
        dict of int to (str or None)
            By id of each scenario that ran; None if the score is not against a single entity, see
            `cornercase.metrics.MetricResult`. Empty in a study of one other.

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
            self._database.require_all("against")
            done = self.done()
            sources = {scenario: other for scenario, _, other in self._database.rows("against", "metric = ?", metric)}
        with damage_told(self.path):
            require(
                all(scenario is None or scenario in others for scenario in sources.values()),
                f"a score of {metric} is against an unknown entity",
            )
            return {row.id: sources[row.id] for row in done}

    def against_of(self, scenario: int) -> dict[str, str | None]:
        """Name the entity that each score of one scenario is against, in a study of several others.

        Parameters
        ----------
        scenario : int
            Its id.

        Returns
        -------
        dict of str to (str or None)
            By metric; empty in a study of one other, and if the scenario has not run.
        """
        if len(self.meta.others) == 1:
            return {}
        sources = {name: other for _, name, other in self._database.rows("against", "scenario = ?", scenario)}
        with damage_told(self.path):
            require(
                all(source is None or source in self.meta.others for source in sources.values()),
                "a score is against an unknown entity",
            )
            return {name: sources[name] for name in self.meta.metrics if name in sources}

    def main_other(self) -> str:
        """Choose the one of several others that describes how scenarios end, and that aspects compare.

        Returns
        -------
        str
            The one that most scores of the first round are against, by the first metric: that round does not depend on
            scores, and the study may grow. Without rounds, as many scenarios count. In a tie, or if no score is against
            a single entity, it is the first of the others.
        """
        others = self.meta.others
        if len(others) == 1:
            return others[0]
        has_rounds = not self.meta.asynchronous
        first_ids = {row.id for row in self.rows() if (row.round == 1 if has_rounds else row.id <= self.meta.batch)}
        counts = Counter(
            source for scenario, source in self.against(self.meta.metrics[0]).items() if scenario in first_ids
        )
        return max(others, key=counts.__getitem__)

    def reference_of(self, scenario: int, driver: str) -> ReferenceOutcome | None:
        """Outcome of one scenario that was run again with a reference driver in the ego.

        Parameters
        ----------
        scenario : int
            Its id.
        driver : str
            Name of the reference driver.

        Returns
        -------
        ReferenceOutcome or None
            None if it was not run with this driver.
        """
        condition = "scenario = ? AND metric = ?"
        stored = self._database.rows("courses", condition, scenario, row_name(driver), blob=True)
        with damage_told(self.path):
            return read_reference(*stored[0][2:]) if stored else None

    def spread(self, metric: str) -> FloatArray | None:
        """Lowest and highest score among the runs of each scenario that ran.

        Parameters
        ----------
        metric : str

        Returns
        -------
        ndarray of float64, shape (n, 2), or None
            None if each scenario has one run.

        Raises
        ------
        InputError
            The study has no such metric.
        """
        self._require_metric(metric)
        if (scores := self._runs(metric)) is None:
            return None
        with damage_told(self.path):
            return np.array([[min(run_scores), max(run_scores)] for run_scores in scores], dtype=np.float64)

    def _runs(self, metric: str) -> list[Any] | None:
        """Scores of all runs of each scenario that ran; None if each has one run."""
        with self.snapshot():
            self._database.require_all("repeats")
            done = self.done()
            texts = {scenario: text for scenario, _, text in self._database.rows("repeats", "metric = ?", metric)}
        if not texts:
            return None
        with damage_told(self.path):
            return [loaded_json(texts[row.id]) for row in done]

    def course(self, scenario: int, metric: str) -> FloatArray:
        """Course of a metric in one scenario.

        Parameters
        ----------
        scenario : int
            Its id.
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
        scenario_id = whole_number("scenario", scenario, most=_LARGEST_ID)
        rows = self._database.rows("courses", "scenario = ? AND metric = ?", scenario_id, metric, blob=True)
        if not rows:
            raise InputError(f"{self.path}: the scenario {scenario_id} was not run.")
        with damage_told(self.path):
            course = np.asarray(unpack_arrays(rows[0][-1])["course"])
            require(
                course.ndim == 1 and course.dtype.kind in "fiu", f"the course of {metric} in the scenario {scenario_id}"
            )
            return course

    def recording(self, scenario: int) -> Recording:
        """Recording of one scenario.

        Parameters
        ----------
        scenario : int
            Its id.

        Returns
        -------
        Recording

        Raises
        ------
        InputError
            The scenario has not run, or its id is not an integer.
        """
        return self._unpacked(self._packed(scenario))

    def _packed(self, scenario: int) -> bytes:
        scenario_id = whole_number("scenario", scenario, most=_LARGEST_ID)
        rows = self._database.rows("scenarios", "id = ?", scenario_id, blob=True)
        if not rows or rows[0][-1] is None:
            raise InputError(f"{self.path}: the scenario {scenario_id} was not run.")
        packed: bytes = rows[0][-1]
        return packed

    def _unpacked(self, packed: bytes) -> Recording:
        with damage_told(self.path):
            return unpack_recording(packed)

    def collisions(self) -> dict[int, tuple[Collision, ...]]:
        """Collisions in the scenarios that ran, without reading the rest of their recordings.

        Returns
        -------
        dict of int to tuple of Collision
            By id, in the order in which they were proposed.
        """
        self._database.require_all("scenarios")
        iterator = self._database.each_row("scenarios", "state = 'done'", blob=True)
        with damage_told(self.path), closing(iterator) as rows:
            return {row[0]: unpack_collisions(row[-1]) for row in rows}

    def outcomes(self) -> dict[int, str]:
        """Describe how scenarios ended.

        Returns
        -------
        dict of int to str
            By id of each scenario that had run when the study was analyzed.
        """
        rows = self._database.rows("outcomes")
        return {scenario: str(outcome) for scenario, outcome in rows}

    def notes(self) -> dict[int, str]:
        """Read the notes about scenarios.

        Returns
        -------
        dict of int to str
            By id of each scenario that has a note.
        """
        rows = self._database.rows("notes")
        with damage_told(self.path):
            for scenario, note in rows:
                require(isinstance(note, str) and len(note) <= LONGEST_NOTE, f"the note on the scenario {scenario}")
            return dict(rows)

    def _require_metric(self, metric: str) -> None:
        if metric not in self.meta.metrics:
            raise InputError(
                f"{self.path}: holds no course of the metric '{metric}'; it has {', '.join(self.meta.metrics)}."
            )
