"""What a study holds of its scenarios one by one."""

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

# SQLite counts no further.
_LARGEST_ID: Final = 2**63 - 1


class ScenarioContents:
    """What a study holds of its scenarios, while others write to it or not.

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
        """Read what the study holds at one moment, while an explorer goes on writing.

        Returns
        -------
        context manager
            What is read within it is of one moment.
        """
        return self._database.snapshot()

    def changes(self) -> int | None:
        """Count what others wrote, so that a reader knows when to look again.

        Returns
        -------
        int or None
            Another number than before where another connection wrote since; None where a reader of this study does not
            see what others write: it lay where nobody could write when it was opened.
        """
        return self._database.changes()

    def stored_meta(self) -> StudyMeta:
        """Read what the study is about by now: an explorer that goes on with it may change its budget.

        Returns
        -------
        StudyMeta
        """
        found = self._database.rows("meta")
        return StudyMeta.from_json({key: loaded_json(value) for key, value in found})

    def rows(self) -> list[Row]:
        """List all scenarios.

        Returns
        -------
        list of Row
            In the order in which they were proposed.
        """
        # Checking each of 50,000 takes seconds: it is done again only where somebody has written since.
        written = self._database.written()
        if self._known is None or self._known[0] != written:
            found = self._database.rows("scenarios")
            with damage_told(self.path):
                rows = [self._row(*one) for one in found]
            self._known = written, rows
        return list(self._known[1])

    def _row(self, number: int, turn: int, point: bytes, values: str, state: str, error: str | None) -> Row:
        require(isinstance(number, int) and number > 0, f"a scenario is numbered {str(number)[:60]!r}")
        row = Row(number, turn, np.frombuffer(point, "<f8"), loaded_json(values), state, error)
        require(row.point.shape == (self.space.dimension,), f"the scenario {number} has another number of parameters")
        require(bool(np.isfinite(row.point).all()), f"the scenario {number} lies nowhere in the space")
        plain = all(isinstance(one, str | int | float) for one in row.values.values())
        require(plain, f"the scenario {number} has values that are neither numbers nor texts")
        for parameter in self.space.parameters:
            value = parameter.read(row.values)
            if parameter.choices:
                require(
                    str(value) in parameter.choices, f"the scenario {number} has none of {parameter.name}'s choices"
                )
            else:
                require(np.isfinite(float(value)), f"the scenario {number} has no number for {parameter.name}")
        require(isinstance(turn, int) and isinstance(error, str | None), f"the scenario {number} is damaged")
        return row

    def rows_of(self, turn: int) -> list[Row]:
        """List the scenarios of a round.

        Parameters
        ----------
        turn : int
            Number of the round.

        Returns
        -------
        list of Row
            In the order in which they were proposed.
        """
        self._database.require_all("scenarios")
        found = self._database.rows("scenarios", "round = ?", turn)
        with damage_told(self.path):
            return [self._row(*one) for one in found]

    def rows_from(self, first: int) -> list[Row]:
        """List the scenarios from one on.

        Parameters
        ----------
        first : int
            Id of the first one that is listed, where there is such a scenario.

        Returns
        -------
        list of Row
            In the order in which they were proposed.
        """
        self._database.require_all("scenarios")
        found = self._database.rows("scenarios", "id >= ?", first)
        with damage_told(self.path):
            return [self._row(*one) for one in found]

    def done(self) -> list[Row]:
        """List the scenarios that were run.

        Returns
        -------
        list of Row
        """
        return [row for row in self.rows() if row.state == "done"]

    def failed(self) -> list[Row]:
        """List the scenarios that could not be run.

        Returns
        -------
        list of Row
        """
        self._database.require_all("scenarios")
        found = self._database.rows("scenarios", "state = ?", "failed")
        with damage_told(self.path):
            return [self._row(*one) for one in found]

    def points(self) -> FloatArray:
        """Points of the scenarios that were run.

        Returns
        -------
        ndarray of float64, shape (n, d)
            In the unit cube.
        """
        return np.array([row.point for row in self.done()]).reshape(-1, self.space.dimension)

    def audits(self) -> BoolArray:
        """Tell which of the scenarios that were run are audits: drawn at random, and never told to the search.

        Returns
        -------
        ndarray of bool, shape (n,)
        """
        return np.array([self.meta.is_audit(row.id) for row in self.done()], dtype=np.bool_)

    def scores(self, metric: str) -> FloatArray:
        """Scores of the scenarios that were run.

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
            found = {one: score for one, _, score in self._database.rows("courses", "metric = ?", metric)}
        with damage_told(self.path):
            return np.array([float(found[row.id]) for row in done], dtype=np.float64)

    def scores_of(self, scenario: int) -> dict[str, float]:
        """Scores of one scenario.

        Parameters
        ----------
        scenario : int
            Its id.

        Returns
        -------
        dict of str to float
            By metric, in the metric's unit; empty where it was not run.
        """
        found = {name: score for _, name, score in self._database.rows("courses", "scenario = ?", scenario)}
        with damage_told(self.path):
            return {name: float(found[name]) for name in self.meta.metrics if name in found}

    def references(self, driver: str) -> dict[int, ReferenceOutcome]:
        """What came of the scenarios that were run again with a reference at the wheel of the ego.

        Parameters
        ----------
        driver : str
            Name of the reference.

        Returns
        -------
        dict of int to ReferenceOutcome
            By id of each scenario that was run with it.
        """
        self._database.require_all("courses")
        found = self._database.rows("courses", "metric = ?", row_name(driver), blob=True)
        with damage_told(self.path):
            return {scenario: read_reference(score, packed) for scenario, _, score, packed in found}

    def against(self, metric: str) -> dict[int, str | None]:
        """Tell whom the scores of the scenarios that were run are against, in a study of several others.

        Parameters
        ----------
        metric : str

        Returns
        -------
        dict of int to (str or None)
            By id the one of the others, or None where the score is not of one rather than of another, as of
            `cornercase.metrics.Measured`. Empty in a study of one other.

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
            found = {one: whom for one, _, whom in self._database.rows("against", "metric = ?", metric)}
        with damage_told(self.path):
            require(all(one is None or one in others for one in found.values()), f"{metric} is against somebody else")
            return {row.id: found[row.id] for row in done}

    def against_of(self, scenario: int) -> dict[str, str | None]:
        """Tell whom the scores of one scenario are against, in a study of several others.

        Parameters
        ----------
        scenario : int
            Its id.

        Returns
        -------
        dict of str to (str or None)
            By metric, as `against`; empty in a study of one other, and where the scenario was not run.
        """
        if len(self.meta.others) == 1:
            return {}
        found = {name: whom for _, name, whom in self._database.rows("against", "scenario = ?", scenario)}
        with damage_told(self.path):
            require(all(one is None or one in self.meta.others for one in found.values()), "a score against somebody")
            return {name: found[name] for name in self.meta.metrics if name in found}

    def main_other(self) -> str:
        """Find the one of several others that the study is told of: how scenarios end, and what aspects compare.

        Returns
        -------
        str
            The one that most scores of the first round are against, by the first metric: a search does not choose that
            round by scores, and the study may grow. Of a search without rounds it is as many scenarios. Of equal ones,
            and where there is none, the first of the others.
        """
        others = self.meta.others
        if len(others) == 1:
            return others[0]
        rounds = not self.meta.asynchronous
        first = {row.id for row in self.rows() if (row.round == 1 if rounds else row.id <= self.meta.batch)}
        counts = Counter(whom for one, whom in self.against(self.meta.metrics[0]).items() if one in first)
        return max(others, key=counts.__getitem__)

    def reference_of(self, scenario: int, driver: str) -> ReferenceOutcome | None:
        """What came of one scenario that was run again with a reference at the wheel of the ego.

        Parameters
        ----------
        scenario : int
            Its id.
        driver : str
            Name of the reference.

        Returns
        -------
        ReferenceOutcome or None
            None where it was not run with it.
        """
        wanted = "scenario = ? AND metric = ?"
        found = self._database.rows("courses", wanted, scenario, row_name(driver), blob=True)
        with damage_told(self.path):
            return read_reference(*found[0][2:]) if found else None

    def spread(self, metric: str) -> FloatArray | None:
        """Lowest and highest score of the runs of each scenario that was run.

        Parameters
        ----------
        metric : str

        Returns
        -------
        ndarray of float64, shape (n, 2), or None
            None where each scenario was run once.

        Raises
        ------
        InputError
            The study has no such metric.
        """
        self._require_metric(metric)
        if (scores := self._runs(metric)) is None:
            return None
        with damage_told(self.path):
            return np.array([[min(one), max(one)] for one in scores], dtype=np.float64)

    def _runs(self, metric: str) -> list[Any] | None:
        """Read the scores of the runs of each scenario that was run; None where each was run once."""
        with self.snapshot():
            self._database.require_all("repeats")
            done = self.done()
            found = {one: text for one, _, text in self._database.rows("repeats", "metric = ?", metric)}
        if not found:
            return None
        with damage_told(self.path):
            return [loaded_json(found[row.id]) for row in done]

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
            The scenario was not run, its id is no whole number, or the study has no such metric.
        """
        self._require_metric(metric)
        one = whole_number("scenario", scenario, most=_LARGEST_ID)
        found = self._database.rows("courses", "scenario = ? AND metric = ?", one, metric, blob=True)
        if not found:
            raise InputError(f"{self.path}: the scenario {one} was not run.")
        with damage_told(self.path):
            course = np.asarray(unpack_arrays(found[0][-1])["course"])
            require(course.ndim == 1 and course.dtype.kind in "fiu", f"the course of {metric} in the scenario {one}")
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
            The scenario was not run, or its id is no whole number.
        """
        return self._unpacked(self._packed(scenario))

    def _packed(self, scenario: int) -> bytes:
        one = whole_number("scenario", scenario, most=_LARGEST_ID)
        found = self._database.rows("scenarios", "id = ?", one, blob=True)
        if not found or found[0][-1] is None:
            raise InputError(f"{self.path}: the scenario {one} was not run.")
        packed: bytes = found[0][-1]
        return packed

    def _unpacked(self, packed: bytes) -> Recording:
        with damage_told(self.path):
            return unpack_recording(packed)

    def collisions(self) -> dict[int, tuple[Collision, ...]]:
        """Find who collides in the scenarios that were run, without reading the rest of their recordings.

        Returns
        -------
        dict of int to tuple of Collision
            By id, in the order in which they were proposed.
        """
        self._database.require_all("scenarios")
        done = self._database.each_row("scenarios", "state = 'done'", blob=True)
        with damage_told(self.path), closing(done) as found:
            return {row[0]: unpack_collisions(row[-1]) for row in found}

    def outcomes(self) -> dict[int, str]:
        """How scenarios ended, in words.

        Returns
        -------
        dict of int to str
            By id; those of all scenarios that had been run when the study was analysed.
        """
        found = self._database.rows("outcomes")
        return {scenario: str(outcome) for scenario, outcome in found}

    def notes(self) -> dict[int, str]:
        """What people wrote about scenarios.

        Returns
        -------
        dict of int to str
            By id; only those that have a note.
        """
        found = self._database.rows("notes")
        with damage_told(self.path):
            for scenario, note in found:
                require(isinstance(note, str) and len(note) <= LONGEST_NOTE, f"the note on the scenario {scenario}")
            return dict(found)

    def _require_metric(self, metric: str) -> None:
        if metric not in self.meta.metrics:
            raise InputError(
                f"{self.path}: holds no course of the metric '{metric}'; it has {', '.join(self.meta.metrics)}."
            )
