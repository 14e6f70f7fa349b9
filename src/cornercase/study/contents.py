"""Read a study."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import closing, suppress
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np

from cornercase._common.displays import DISPLAYS
from cornercase._common.errors import InputError
from cornercase._common.files import require_folder
from cornercase._common.pending_files import written_together
from cornercase._common.texts import loaded_json
from cornercase._common.typing import FloatArray
from cornercase.metrics import METRICS
from cornercase.recordings import Recording
from cornercase.study.arrays import read_arrays
from cornercase.study.damage import damage_told, require
from cornercase.study.elsewhere import digest_of_scores
from cornercase.study.export import write_scenarios, write_table
from cornercase.study.repeated_runs import shares_of_runs
from cornercase.study.scenarios import ScenarioContents
from cornercase.study.schema import TABLES
from cornercase.study.table import scenario_table

if TYPE_CHECKING:
    import pandas as pd

_SHOWN: Final = 10
_CRITICAL_RUNS: Final = ("critical runs", "critical runs from", "critical runs to")

# Files are read and checked; the optimizer proposes and learns; scenarios are simulated, measured and stored; the
# critical set is judged; recordings are read back and compared; and so on.
STAGES: Final = (
    "files", "optimize", "simulate", "measure", "store", "judge", "read", "compare", "cluster", "reduce", "draw",
)  # fmt: skip


class StudyContents(ScenarioContents):
    """Everything in a study that can be read, while others write to it or not.

    Attributes
    ----------
    path : Path
        The file.
    meta : StudyMeta
        Description of the study.
    space : ParameterSpace
        The parameter space.
    """

    @property
    def critical(self) -> float | None:
        """Threshold: that of the study, or the one that currently replaces it."""
        return self.meta.critical if self._asked is None else self._asked

    def ask(self, critical: float | None) -> float | None:
        """Replace the threshold from now on; the file stays as it is.

        Parameters
        ----------
        critical : float or None
            Threshold in the unit of the objective; None for that of the study.

        Returns
        -------
        float or None
            The previous replacement.
        """
        previous, self._asked = self._asked, critical
        return previous

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def __repr__(self) -> str:
        meta, counts = self.meta, self._counts()
        return (
            f"<Study {str(self.path)!r}: {meta.title}, {meta.ego} and {', '.join(meta.others)}, by"
            f" {', '.join(meta.metrics)}; {counts.get('done', 0)} scenarios run, {counts.get('failed', 0)} failed,"
            f" {counts.get('pending', 0)} pending>"
        )

    def _repr_html_(self) -> str:
        with suppress(InputError):
            if "study" in DISPLAYS and (page := DISPLAYS.create("study", path=self.path)) is not None:
                return page
        table = self.table()
        # If the package of a metric is missing, the first scenarios are shown.
        with suppress(InputError):
            metric = METRICS.create(self.meta.metrics[0])
            table = table.sort_values(metric.name, ascending=metric.lower_is_critical, kind="stable")
        return f"<p>{escape(repr(self))}</p>{table.head(_SHOWN).to_html(index=False)}"

    def critical_runs(self) -> FloatArray | None:
        """Probability that a run of each scenario is critical, if each was run several times.

        Returns
        -------
        ndarray of float64, shape (n, 3), or None
            Fraction of critical runs and its 90 % interval: if that contains 0.5, it is undecided whether the scenario
            is critical. None if each scenario has one run, or if there is no threshold of a single metric.
        """
        if self.critical is None or self.meta.weights or self.meta.pareto:
            return None
        metric = METRICS.create(self.meta.metrics[0])
        if (runs := self._runs(metric.name)) is None:
            return None
        with damage_told(self.path):
            scores = [[metric.oriented(float(score)) for score in run_scores] for run_scores in runs]
            return shares_of_runs(scores, metric.oriented(self.critical))

    def elsewhere(self) -> tuple[FloatArray, FloatArray] | None:
        """Read the points and scores of the study that the search was warm-started from.

        Returns
        -------
        points : ndarray of float64, shape (n, d)
            In the unit cube of this study's space.
        scores : ndarray of float64, shape (n,)
            To be minimized. None instead of both without a warm start.

        Raises
        ------
        InputError
            They are missing, as after a damage.
        """
        if not self.meta.elsewhere:
            return None
        with damage_told(self.path):
            rows = self._database.rows("elsewhere")
            points = np.array([np.frombuffer(point, dtype="<f8") for point, _ in rows], dtype=np.float64)
            scores = np.array([score for _, score in rows], dtype=np.float64)
            digest = digest_of_scores(points, scores)
            require(digest == self.meta.elsewhere.get("sha256"), "the warm-start data is incomplete")
            return points, scores

    def analyses(self) -> list[str]:
        """List the aspects that the study was analyzed by.

        Returns
        -------
        list of str
            ``ego-trajectory`` first, then the others in alphabetical order, the metrics last.
        """
        names = {str(name) for name, _ in self._database.rows("analyses")} - {"reduction", "estimate"}
        metrics = [name for name in self.meta.metrics if name in names]
        return [*sorted(names - set(metrics), key=lambda name: (name != "ego-trajectory", name)), *metrics]

    def analysis(self, name: str, *arrays: str) -> tuple[dict[str, Any], dict[str, Any]]:
        """Read the stored result of an analysis.

        Parameters
        ----------
        name : str
            Its aspect.
        *arrays : str
            Names of arrays to read, as large ones take time; all by default.

        Returns
        -------
        arrays : dict of str to ndarray
            In the shapes that were stored.
        info : dict

        Raises
        ------
        InputError
            There is no such result.
        """
        rows = self._database.rows("analyses", "name = ?", name)
        if not rows:
            others = ", ".join(self.analyses())
            advice = (
                f", only by {others}; choose among these, or run `analyze` by it" if others else "; run `analyze` first"
            )
            raise InputError(f"{self.path}: holds no analysis by {name}{advice}.")
        self._database.require_all("arrays")
        # In the order in which they were written.
        query = "SELECT name FROM arrays WHERE analysis = ? AND part = 0 ORDER BY rowid"
        stored = [key for (key,) in self._database.found(query, name)]
        if missing := sorted(set(arrays).difference(stored)):
            raise InputError(f"{self.path}: its analysis by {name} lacks {', '.join(missing)}; run `analyze` again.")
        with damage_told(self.path), self.snapshot():
            values = read_arrays(self._database.rows, name, list(arrays or stored), sum(self._counts().values()))
            return values, loaded_json(rows[0][1])

    def reduction(self) -> dict[str, Any] | None:
        """Read the description of the reduced set, as in its manifest.

        Returns
        -------
        dict or None
            None before the reduction.
        """
        return self._info("reduction")

    def estimate(self) -> dict[str, Any] | None:
        """Read the result of an estimate of probabilities.

        Returns
        -------
        dict or None
            None if the study is not an estimate, or has not ended.
        """
        return self._info("estimate")

    def _info(self, name: str) -> dict[str, Any] | None:
        self._database.require_all("analyses")
        rows = self._database.rows("analyses", "name = ?", name)
        with damage_told(self.path):
            return dict(loaded_json(rows[0][1])) if rows else None

    def results(self) -> list[tuple[int, int]]:
        """Read the order in which the results of an asynchronous search came.

        Returns
        -------
        list of (int, int)
            Id of each scenario that has ended, and the number of the first round that was proposed, or will be, when
            the optimizer knew the result; empty in a study with rounds.
        """
        if not self.meta.asynchronous:
            return []
        with self.snapshot():
            stored = self._database.rows("results")
            rows = {row.id: row for row in self.rows()}
        ended_ids = {row.id for row in rows.values() if row.state != "pending"}
        with damage_told(self.path):
            rounds = [round_number for _, _, round_number in stored]
            require(
                all(isinstance(round_number, int) for round_number in rounds) and rounds == sorted(rounds),
                "the order of its results",
            )
            last = max((row.round for row in rows.values()), default=0)
            require(
                all(rows[scenario_id].round < round_number <= last + 1 for _, scenario_id, round_number in stored),
                "a result's round",
            )
            require(
                len(stored) == len(ended_ids) and {scenario_id for _, scenario_id, _ in stored} == ended_ids,
                "a result is missing, there twice, or of a scenario that has not ended",
            )
            return [(scenario, round_number) for _, scenario, round_number in stored]

    def elapsed(self) -> dict[str, float]:
        """Time spent by stage.

        Returns
        -------
        dict of str to float
            s, in the order of the stages.
        """
        rows = self._database.rows("elapsed")
        with damage_told(self.path):
            seconds_of = {str(stage): float(seconds) for stage, seconds in rows}
        return {stage: seconds_of[stage] for stage in (*STAGES, *seconds_of) if stage in seconds_of}

    def table(self) -> pd.DataFrame:
        """Make a table of all scenarios.

        Returns
        -------
        DataFrame
            One row per scenario, in the order of the ids, with the columns ``id``, ``round`` and ``state``, and
            ``audit`` if there are audits; a column for each parameter; for each metric one of the score, and ``lowest
            …`` and ``highest …`` of its runs if each scenario was run several times, ``critical runs`` as in
            `critical_run_rates`, and ``runs``, the number of runs that did not fail, if it may vary; with several
            others ``other by …`` for each metric, the entity that the score is against; ``cluster by …`` for each
            aspect that the study was analyzed by, -1 for noise; ``outcome`` once it was analyzed; ``note`` if there are
            notes; ``error``. Empty if there is no value. A parameter with the name of another column becomes
            ``parameter …``.
        """
        with self.snapshot():
            scores = {}
            for name in self.meta.metrics:
                scores[name] = self.scores(name)
                if (spread := self.spread(name)) is not None:
                    scores[f"lowest {name}"], scores[f"highest {name}"] = spread.T
            with suppress(InputError):  # The package of a metric may be missing.
                if (runs := self.critical_runs()) is not None:
                    scores |= dict(zip(_CRITICAL_RUNS, runs.T, strict=True))
            clusters = {}
            for name in self.analyses():
                arrays, _ = self.analysis(name, "ids", "labels")
                clusters[name] = arrays["ids"], arrays["labels"]
            rows = self.rows()
            ids = {row.id for row in rows}
            with damage_told(self.path):
                for name, ids_and_labels in clusters.items():
                    is_valid = all(
                        array.ndim == 1 and array.dtype.kind == "i" and len(array) == len(ids_and_labels[0])
                        for array in ids_and_labels
                    )
                    require(
                        is_valid and set(ids_and_labels[0].tolist()) <= ids,
                        f"its clusters by {name} are of other scenarios",
                    )
                audits = [self.meta.is_audit(row.id) for row in rows] if self.meta.audit else None
                against = {name: self.against(name) for name in self.meta.metrics if len(self.meta.others) > 1}
                counts = self._counts_of_runs() if self.meta.most_repeats is not None else None
                return scenario_table(
                    rows, self.space, scores, clusters, self.outcomes(), audits, self.notes(), against, counts
                )

    def _counts_of_runs(self) -> dict[int, int]:
        """Number of runs that did not fail, by id of each scenario that ran."""
        runs = self._runs(self.meta.metrics[0]) or []
        return {row.id: len(scores) for row, scores in zip(self.done(), runs, strict=True)}

    def export(self, folder: Path | str, parquet: bool = False) -> None:
        """Write everything as CSV: one table of scenarios, and recording and courses of each.

        Parameters
        ----------
        folder : path
            Gets ``scenarios.csv`` as in `table`, with underscores for spaces in names of columns, and for each scenario
            ``recordings/ID.csv`` and ``courses/ID.csv``.
        parquet : bool, default False
            Also write ``scenarios.parquet``, ``recordings.parquet`` and ``courses.parquet`` of all scenarios; the last
            two have their ids in the column ``scenario``.

        Raises
        ------
        InputError
            The folder cannot be written, or the package that writes Parquet is not installed; no file has changed then.
        """
        folder = require_folder("folder", folder)
        table = self.table()
        # All files appear at the end, so that a damaged study leaves no partial export.
        with written_together():
            write_table(folder, table, parquet)
            write_scenarios(folder, self.recorded(), parquet)

    def recordings_beside(self, scenario: int, other: StudyContents, its: int) -> tuple[Recording, Recording]:
        """Recordings of a scenario and of one of another study.

        Parameters
        ----------
        scenario : int
            Id in this study.
        other : Study
        other_scenario : int
            Id in the other study.

        Returns
        -------
        Recording
            Of this study.
        Recording
            Of the other one; the same object if the stored bytes are equal, so that they are unpacked once.

        Raises
        ------
        InputError
            As by `recording`.
        """
        packed, other_packed = self._packed(scenario), other._packed(its)
        recording = self._unpacked(packed)
        return recording, recording if packed == other_packed else other._unpacked(other_packed)

    def recorded(self) -> Iterator[tuple[int, Recording, dict[str, FloatArray]]]:
        """Yield recording and courses of each scenario that ran.

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
            A course has another length than its recording.
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

    def require_sound(self) -> None:
        """Check all checksums without unpacking anything.

        Raises
        ------
        InputError
            Something is damaged.
        """
        tables = {name for (name,) in self._database.found("SELECT name FROM sqlite_master WHERE type = 'table'")}
        for table in (name for name in TABLES if name in tables):
            self._database.require_all(table)
            with closing(self._database.each_row(table, blob=True)) as rows:
                for _ in rows:
                    pass

    def tallies(self) -> dict[str, tuple[int, int]]:
        """Row counts and checksums of all tables, to compare studies by.

        Returns
        -------
        dict of str to (int, int)
            Number of rows, and the XOR of their checksums, by table.
        """
        return {name: (rows, sums) for name, rows, sums in self._database.rows("tallies")}

    def _counts(self) -> dict[str, int]:
        """Number of scenarios by state."""
        return Counter(row.state for row in self.rows())
