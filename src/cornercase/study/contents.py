"""What a study holds, for those who read it."""

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

    @property
    def critical(self) -> float | None:
        """Score from which a scenario is critical: that of the study, or the one that it is asked with."""
        return self.meta.critical if self._asked is None else self._asked

    def ask(self, critical: float | None) -> float | None:
        """Count other scenarios as critical from now on; the file stays as it is.

        Parameters
        ----------
        critical : float or None
            Score from which a scenario is critical, in the unit of what is searched; None for that of the study.

        Returns
        -------
        float or None
            What was asked before.
        """
        before, self._asked = self._asked, critical
        return before

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
        # A metric of another package may not be there; then the first scenarios are shown.
        with suppress(InputError):
            metric = METRICS.create(self.meta.metrics[0])
            table = table.sort_values(metric.name, ascending=metric.lower_is_critical, kind="stable")
        return f"<p>{escape(repr(self))}</p>{table.head(_SHOWN).to_html(index=False)}"

    def critical_runs(self) -> FloatArray | None:
        """Probability that a run of each scenario is critical, where each was run several times.

        Returns
        -------
        ndarray of float64, shape (n, 3), or None
            Share of its runs that were critical, and its 90 % interval: whether a scenario is critical is open where
            that holds 0.5. None where each was run once, or nothing says of one score what is critical.
        """
        if self.critical is None or self.meta.weights or self.meta.pareto:
            return None
        metric = METRICS.create(self.meta.metrics[0])
        if (runs := self._runs(metric.name)) is None:
            return None
        with damage_told(self.path):
            scores = [[metric.oriented(float(score)) for score in one] for one in runs]
            return shares_of_runs(scores, metric.oriented(self.critical))

    def elsewhere(self) -> tuple[FloatArray, FloatArray] | None:
        """Read what the study that the search began from knew.

        Returns
        -------
        points : ndarray of float64, shape (n, d)
            In the unit cube of this study's space.
        scores : ndarray of float64, shape (n,)
            Oriented. None in place of both where the search began from nothing.

        Raises
        ------
        InputError
            It is not there, as after a damage.
        """
        if not self.meta.elsewhere:
            return None
        with damage_told(self.path):
            found = self._database.rows("elsewhere")
            points = np.array([np.frombuffer(point, dtype="<f8") for point, _ in found], dtype=np.float64)
            scores = np.array([score for _, score in found], dtype=np.float64)
            digest = digest_of_scores(points, scores)
            require(digest == self.meta.elsewhere.get("sha256"), "what the search began from is not all there")
            return points, scores

    def analyses(self) -> list[str]:
        """List the aspects that the study was analysed by.

        Returns
        -------
        list of str
            ``ego-trajectory`` first, the metrics last, the others between them in alphabetical order.
        """
        names = {str(name) for name, _ in self._database.rows("analyses")} - {"reduction", "estimate"}
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
        found = self._database.rows("analyses", "name = ?", name)
        if not found:
            others = ", ".join(self.analyses())
            rest = (
                f", only by {others}; choose among these, or run `analyze` by it" if others else "; run `analyze` first"
            )
            raise InputError(f"{self.path}: holds no analysis by {name}{rest}.")
        self._database.require_all("arrays")
        # In the order in which they were written.
        question = "SELECT name FROM arrays WHERE analysis = ? AND part = 0 ORDER BY rowid"
        known = [key for (key,) in self._database.found(question, name)]
        if missing := sorted(set(arrays).difference(known)):
            raise InputError(f"{self.path}: its analysis by {name} lacks {', '.join(missing)}; run `analyze` again.")
        with damage_told(self.path), self.snapshot():
            read = read_arrays(self._database.rows, name, list(arrays or known), sum(self._counts().values()))
            return read, loaded_json(found[0][1])

    def reduction(self) -> dict[str, Any] | None:
        """Read what is known of the reduced set, as in its manifest.

        Returns
        -------
        dict or None
            None before the reduction.
        """
        return self._info("reduction")

    def estimate(self) -> dict[str, Any] | None:
        """Read what an estimate of probabilities found.

        Returns
        -------
        dict or None
            None of a study that is no estimate, and of one that has not ended.
        """
        return self._info("estimate")

    def _info(self, name: str) -> dict[str, Any] | None:
        self._database.require_all("analyses")
        found = self._database.rows("analyses", "name = ?", name)
        with damage_told(self.path):
            return dict(loaded_json(found[0][1])) if found else None

    def results(self) -> list[tuple[int, int]]:
        """Tell in which order the results of a search without rounds came.

        Returns
        -------
        list of (int, int)
            Id of each scenario that has ended, and the number of the first round that was proposed when the search knew
            of it, or will be; empty in a study of rounds.
        """
        if not self.meta.asynchronous:
            return []
        with self.snapshot():
            found = self._database.rows("results")
            rows = {row.id: row for row in self.rows()}
        ended = {row.id for row in rows.values() if row.state != "pending"}
        with damage_told(self.path):
            turns = [turn for _, _, turn in found]
            require(all(isinstance(turn, int) for turn in turns) and turns == sorted(turns), "the order of its results")
            last = max((row.round for row in rows.values()), default=0)
            require(all(rows[one].round < turn <= last + 1 for _, one, turn in found), "a result's round")
            require(
                len(found) == len(ended) and {one for _, one, _ in found} == ended,
                "a result is missing, there twice, or of a scenario that has not ended",
            )
            return [(scenario, turn) for _, scenario, turn in found]

    def elapsed(self) -> dict[str, float]:
        """Time spent by stage.

        Returns
        -------
        dict of str to float
            s, in the order in which the stages come.
        """
        found = self._database.rows("elapsed")
        with damage_told(self.path):
            known = {str(stage): float(seconds) for stage, seconds in found}
        return {stage: known[stage] for stage in (*STAGES, *known) if stage in known}

    def table(self) -> pd.DataFrame:
        """Put everything that is known of the scenarios in a table.

        Returns
        -------
        DataFrame
            A row for each scenario, in the order of the ids, with the columns ``id``, ``round`` and ``state``, and
            ``audit`` where there are audits; a column for each parameter; for each metric one of the score, and
            ``lowest …`` and ``highest …`` of its runs where each scenario was run several times, ``critical runs`` as
            in `critical_runs`, and ``runs``, how many did not fail, where some may have more than others; of several
            others ``other by …`` for each metric, whom the score is against; ``cluster by …`` for each aspect that the
            study was analysed by, -1 for noise; ``outcome`` once it was analysed; ``note`` where there are notes;
            ``error``. Empty where there is no value. A parameter that is called like another column is found as
            ``parameter …``.
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
                against = {name: self.against(name) for name in self.meta.metrics if len(self.meta.others) > 1}
                counts = self._counts_of_runs() if self.meta.most_repeats is not None else None
                return scenario_table(
                    rows, self.space, scores, clusters, self.outcomes(), audits, self.notes(), against, counts
                )

    def _counts_of_runs(self) -> dict[int, int]:
        """Count the runs of each scenario that was run, without those that failed."""
        runs = self._runs(self.meta.metrics[0]) or []
        return {row.id: len(each) for row, each in zip(self.done(), runs, strict=True)}

    def export(self, folder: Path | str, parquet: bool = False) -> None:
        """Write everything as CSV: one table of scenarios, and recording and courses of each.

        Parameters
        ----------
        folder : path
            Gets ``scenarios.csv`` as in `table`, with underscores for spaces in names of columns, and for each scenario
            ``recordings/ID.csv`` and ``courses/ID.csv``.
        parquet : bool, default False
            Write ``scenarios.parquet``, ``recordings.parquet`` and ``courses.parquet`` too: those of all scenarios,
            with their ids in the column ``scenario``.

        Raises
        ------
        InputError
            The folder cannot be written, or the package that writes Parquet is not installed; no file of it has
            changed then.
        """
        folder = require_folder("folder", folder)
        table = self.table()
        # A damaged study leaves no part of an export behind: nothing has its name before all is read.
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
        its : int
            Id in the other study.

        Returns
        -------
        Recording
            Of this study.
        Recording
            Of the other one; the same object where the files hold the same bytes, which are unpacked once.

        Raises
        ------
        InputError
            As by `recording`.
        """
        mine, theirs = self._packed(scenario), other._packed(its)
        recording = self._unpacked(mine)
        return recording, recording if mine == theirs else other._unpacked(theirs)

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

    def require_sound(self) -> None:
        """Refuse a study in which anything is not as it was written, without unpacking it.

        Raises
        ------
        InputError
            Something is damaged.
        """
        there = {name for (name,) in self._database.found("SELECT name FROM sqlite_master WHERE type = 'table'")}
        for table in (name for name in TABLES if name in there):
            self._database.require_all(table)
            with closing(self._database.each_row(table, blob=True)) as found:
                for _ in found:
                    pass

    def tallies(self) -> dict[str, tuple[int, int]]:
        """Tell what each table holds in short, to compare studies by.

        Returns
        -------
        dict of str to (int, int)
            Number of rows, and the exclusive or of their checksums, by table.
        """
        return {name: (rows, sums) for name, rows, sums in self._database.rows("tallies")}

    def _counts(self) -> dict[str, int]:
        """Count the scenarios in each state."""
        return Counter(row.state for row in self.rows())
