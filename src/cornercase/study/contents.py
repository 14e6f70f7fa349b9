"""What a study holds, for those who read it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, suppress
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np

from cornercase._common.arguments import whole_number
from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.metrics import METRICS
from cornercase.recordings import Recording
from cornercase.study.arrays import read_arrays
from cornercase.study.codec import unpack_arrays, unpack_recording
from cornercase.study.damage import damage_told, loaded, require
from cornercase.study.database import Database
from cornercase.study.export import write_scenarios, write_table
from cornercase.study.meta import StudyMeta
from cornercase.study.repeated_runs import shares_of_runs
from cornercase.study.table import Row, scenario_table

if TYPE_CHECKING:
    import pandas as pd

_SHOWN: Final = 10
_CRITICAL_RUNS: Final = ("critical runs", "critical runs from", "critical runs to")
# SQLite counts no further.
_LARGEST_ID: Final = 2**63 - 1

# Files are read and checked; the optimizer proposes and learns; scenarios are simulated, measured and stored; the
# critical set is judged; recordings are read back and compared; and so on.
STAGES: Final = (
    "files", "optimize", "simulate", "measure", "store", "judge", "read", "compare", "cluster", "reduce", "draw",
)  # fmt: skip


class StudyContents:
    """Everything in a study that can be read, while others write to it or not.

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
        self.meta = StudyMeta.from_json(
            {key: loaded(value) for key, value in database.found("SELECT key, value FROM meta")}
        )
        self.space = self.meta.space

    @property
    def readonly(self) -> bool:
        """Whether the study is open for reading only."""
        return self._database.readonly

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def __repr__(self) -> str:
        meta, counts = self.meta, self._counts()
        return (
            f"<Study {str(self.path)!r}: {meta.title}, {meta.ego} and {meta.other}, by"
            f" {', '.join(meta.metrics)}; {counts.get('done', 0)} scenarios run, {counts.get('failed', 0)} failed,"
            f" {counts.get('pending', 0)} pending>"
        )

    def _repr_html_(self) -> str:
        table = self.table()
        # A metric of another package may not be there; then the first scenarios are shown.
        with suppress(InputError):
            metric = METRICS.create(self.meta.metrics[0])
            table = table.sort_values(metric.name, ascending=metric.lower_is_critical, kind="stable")
        return f"<p>{escape(repr(self))}</p>{table.head(_SHOWN).to_html(index=False)}"

    def rows(self) -> list[Row]:
        """List all scenarios.

        Returns
        -------
        list of Row
            In the order in which they were proposed.
        """
        found = self._database.found("SELECT id, round, point, parameters, state, error FROM scenarios ORDER BY id")
        with damage_told(self.path):
            rows = [self._row(*one) for one in found]
            require(len({row.id for row in rows}) == len(rows), "a scenario is there twice")
            return rows

    def _row(self, number: int, turn: int, point: bytes, values: str, state: str, error: str | None) -> Row:
        require(isinstance(number, int) and number > 0, f"a scenario is numbered {str(number)[:60]!r}")
        row = Row(number, turn, np.frombuffer(point, "<f8").copy(), loaded(values), state, error)
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
        question = "SELECT id, round, point, parameters, state, error FROM scenarios WHERE round = ? ORDER BY id"
        found = self._database.found(question, turn)
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
        return [row for row in self.rows() if row.state == "failed"]

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
        found = self._database.found(
            "SELECT id, score FROM scenarios LEFT JOIN courses ON id = scenario AND metric = ?"
            " WHERE state = 'done' ORDER BY id",
            metric,
        )
        with damage_told(self.path):
            require(len(dict(found)) == len(found), f"a scenario has two scores by {metric}")
            return np.array([float(score) for _, score in found], dtype=np.float64)

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
        found = self._database.found(
            "SELECT id, scores FROM scenarios LEFT JOIN repeats ON id = scenario AND metric = ?"
            " WHERE state = 'done' ORDER BY id",
            metric,
        )
        if all(text is None for _, text in found):
            return None
        with damage_told(self.path):
            require(len(dict(found)) == len(found), f"a scenario has two sets of scores by {metric}")
            scores = [loaded(text) for _, text in found]
            return np.array([[min(one), max(one)] for one in scores], dtype=np.float64)

    def critical_runs(self) -> FloatArray | None:
        """Probability that a run of each scenario is critical, where each was run several times.

        Returns
        -------
        ndarray of float64, shape (n, 3), or None
            Share of its runs that were critical, and its 90 % interval: whether a scenario is critical is open where
            that holds 0.5. None where each was run once, or nothing says of one score what is critical.
        """
        if self.meta.critical is None or self.meta.weights or self.meta.pareto:
            return None
        metric = METRICS.create(self.meta.metrics[0])
        found = self._database.found(
            "SELECT id, scores FROM scenarios LEFT JOIN repeats ON id = scenario AND metric = ?"
            " WHERE state = 'done' ORDER BY id",
            metric.name,
        )
        if all(text is None for _, text in found):
            return None
        with damage_told(self.path):
            scores = [[metric.oriented(float(score)) for score in loaded(text)] for _, text in found]
            return shares_of_runs(scores, metric.oriented(self.meta.critical))

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
        found = self._database.found("SELECT course FROM courses WHERE scenario = ? AND metric = ?", one, metric)
        if not found:
            raise InputError(f"{self.path}: the scenario {one} was not run.")
        with damage_told(self.path):
            course = np.asarray(unpack_arrays(found[0][0])["course"])
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
        one = whole_number("scenario", scenario, most=_LARGEST_ID)
        found = self._database.found("SELECT recording FROM scenarios WHERE id = ? AND recording IS NOT NULL", one)
        if not found:
            raise InputError(f"{self.path}: the scenario {one} was not run.")
        with damage_told(self.path):
            return unpack_recording(found[0][0])

    def outcomes(self) -> dict[int, str]:
        """How scenarios ended, in words.

        Returns
        -------
        dict of int to str
            By id; those of all scenarios that had been run when the study was analysed.
        """
        found = self._database.found("SELECT scenario, outcome FROM outcomes ORDER BY scenario")
        return {scenario: str(outcome) for scenario, outcome in found}

    def analyses(self) -> list[str]:
        """List the aspects that the study was analysed by.

        Returns
        -------
        list of str
            ``ego-trajectory`` first, the metrics last, the others between them in alphabetical order.
        """
        names = {str(name) for (name,) in self._database.found("SELECT name FROM analyses")} - {"reduction", "estimate"}
        metrics = [name for name in self.meta.metrics if name in names]
        return [*sorted(names - set(metrics), key=lambda name: (name != "ego-trajectory", name)), *metrics]

    def analysis(self, name: str, *arrays: str) -> tuple[dict[str, Any], dict[str, Any]]:
        """Read a stored result.

        Parameters
        ----------
        name : str
        *arrays : str
            Arrays to read, as large ones take time; all by default.

        Returns
        -------
        arrays : dict of str to ndarray, of the shapes that were stored
        info : dict

        Raises
        ------
        InputError
            There is no such result.
        """
        found = self._database.found("SELECT info FROM analyses WHERE name = ?", name)
        if not found:
            raise InputError(f"{self.path}: holds no analysis by {name}; run `analyze` first.")
        question = "SELECT name FROM arrays WHERE analysis = ? AND part = 0"
        known = [key for (key,) in self._database.found(question, name)]
        if missing := sorted(set(arrays).difference(known)):
            raise InputError(f"{self.path}: its analysis by {name} lacks {', '.join(missing)}; run `analyze` again.")
        with damage_told(self.path), self.snapshot():
            read = read_arrays(self._database.found, name, list(arrays or known), sum(self._counts().values()))
            return read, loaded(found[0][0])

    def reduction(self) -> dict[str, Any] | None:
        """Read what is known of the reduced set, as in its manifest.

        Returns
        -------
        dict or None
            None before the reduction.
        """
        found = self._database.found("SELECT info FROM analyses WHERE name = 'reduction'")
        with damage_told(self.path):
            return dict(loaded(found[0][0])) if found else None

    def elapsed(self) -> dict[str, float]:
        """Time spent by stage.

        Returns
        -------
        dict of str to float
            s, in the order in which the stages come.
        """
        found = self._database.found("SELECT stage, seconds FROM elapsed ORDER BY stage")
        with damage_told(self.path):
            known = {str(stage): float(seconds) for stage, seconds in found}
        return {stage: known[stage] for stage in (*STAGES, *known) if stage in known}

    def snapshot(self) -> AbstractContextManager[None]:
        """Read what the study holds at one moment, while an explorer goes on writing.

        Returns
        -------
        context manager
            What is read within it is of one moment.
        """
        return self._database.snapshot()

    def table(self) -> pd.DataFrame:
        """Put everything that is known of the scenarios in a table.

        Returns
        -------
        DataFrame
            A row for each scenario, in the order of the ids, with the columns ``id``, ``round`` and ``state``, and
            ``audit`` where there are audits; a column for each parameter; for each metric one of the score, and
            ``lowest …`` and ``highest …`` of its runs where each scenario was run several times, and ``critical runs``
            as in `critical_runs`; ``cluster by …`` for each aspect that the study was analysed by, -1 for noise;
            ``outcome`` once it was analysed; ``error``. Empty where there is no value. A parameter that is called like
            another column is found as ``parameter …``.
        """
        with self.snapshot():
            scores = {}
            for name in self.meta.metrics:
                scores[name] = self.scores(name)
                if (spread := self.spread(name)) is not None:
                    scores[f"lowest {name}"], scores[f"highest {name}"] = spread.T
            with suppress(InputError):  # A metric of another package may not be there.
                if (runs := self.critical_runs()) is not None:
                    scores |= dict(zip(_CRITICAL_RUNS, runs.T, strict=True))
            clusters = {}
            for name in self.analyses():
                arrays, _ = self.analysis(name, "ids", "labels")
                clusters[name] = arrays["ids"], arrays["labels"]
            rows = self.rows()
            ids = {row.id for row in rows}
            with damage_told(self.path):
                for name, each in clusters.items():
                    whole = all(one.ndim == 1 and one.dtype.kind == "i" and len(one) == len(each[0]) for one in each)
                    require(whole and set(each[0].tolist()) <= ids, f"its clusters by {name} are of other scenarios")
                audits = [self.meta.is_audit(row.id) for row in rows] if self.meta.audit else None
                return scenario_table(rows, self.space, scores, clusters, self.outcomes(), audits)

    def export(self, folder: Path | str, parquet: bool = False) -> None:
        """Write everything as CSV: one table of scenarios, and recording and courses of each.

        Parameters
        ----------
        folder : path
            Gets ``scenarios.csv`` as in `table`, ``recordings/ID.csv`` and ``courses/ID.csv``.
        parquet : bool, default False
            Write ``scenarios.parquet`` too.

        Raises
        ------
        InputError
            The folder cannot be written, or the package that writes Parquet is not installed.
        """
        folder = Path(folder)
        table = self.table()
        # A damaged study leaves no part of an export behind: all is read before any is written.
        for _ in self.recorded():
            pass
        write_table(folder, table, parquet)
        write_scenarios(folder, self.recorded())

    def recorded(self) -> Iterator[tuple[int, Recording, dict[str, FloatArray]]]:
        """Read what is known over time of each scenario that was run.

        Yields
        ------
        int
            Its id.
        Recording
        dict of str to ndarray of float64, shape (T,)
            Course by metric.

        Raises
        ------
        InputError
            A course is shorter or longer than its recording.
        """
        for row in self.done():
            recording = self.recording(row.id)
            courses = {name: self.course(row.id, name) for name in self.meta.metrics}
            with damage_told(self.path):
                for name, course in courses.items():
                    require(
                        len(course) == len(recording.time),
                        f"{len(course)} instants of {name} in the scenario {row.id}, of which the recording has"
                        f" {len(recording.time)}",
                    )
            yield row.id, recording, courses

    def _counts(self) -> dict[str, int]:
        """Count the scenarios in each state."""
        return dict(self._database.found("SELECT state, COUNT(*) FROM scenarios GROUP BY state"))

    def _require_metric(self, metric: str) -> None:
        if metric not in self.meta.metrics:
            raise InputError(
                f"{self.path}: holds no course of the metric '{metric}'; it has {', '.join(self.meta.metrics)}."
            )
