"""Results of a suite that was run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from cornercase._common.text.notebook_html import render_html_table
from cornercase._common.validation import check_path
from cornercase.reduction import KillMatrix
from cornercase.scenario import Value
from cornercase.suite._junit import write_junit
from cornercase.suite._markdown import write_markdown_summary
from cornercase.suite._recording_difference import RecordingDifference
from cornercase.suite._verdict import Verdict, VerdictState, worst_state

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class ScenarioResult:
    """Result of one scenario of a suite.

    Attributes
    ----------
    id : int
        Id in the study of the suite.
    file : str
    state : {"passed", "failed", "inconclusive", "error"}
        State of the worst verdict; ``"error"`` if the simulator failed.
    values : mapping of str to float or str
        Parameter values.
    scores : mapping of str to float
        By metric; empty if the simulator failed.
    duration : float or None
        Duration of the recording in s; None if the simulator failed.
    verdicts : tuple of Verdict
        One for each requirement that applies. Without requirements, a single verdict says whether the scenario ran.
    kind, role, why : str
        Name of the cluster that the scenario represents, its role in the suite, and why it was selected; empty if
        unknown.
    origin : int or None
        Id in the study that the scenario was selected from.
    difference : RecordingDifference or None
        Difference from the earlier recording; None if there is no earlier recording.
    others : mapping of str to str
        If there are several entities besides the ego: the entity that the score of each metric is measured against.
        Metrics that are not measured against a single entity are left out.

    Examples
    --------
    >>> import cornercase as cc
    >>> result = cc.run_suite("reduced", "run.db", require=["no collision"])  # doctest: +SKIP
    >>> first = result.scenarios[0]  # doctest: +SKIP
    >>> first.file, first.state, first.reason  # doctest: +SKIP
    ('x_intersection-00017.xosc', 'failed', 'Ego and Pedestrian collide at 9.9 s with 2.2 m/s to each other')
    """

    id: int
    file: str
    state: VerdictState | Literal["error"]
    values: Mapping[str, Value]
    scores: Mapping[str, float]
    duration: float | None
    verdicts: tuple[Verdict, ...]
    kind: str = ""
    role: str = ""
    why: str = ""
    origin: int | None = None
    difference: RecordingDifference | None = None
    others: Mapping[str, str] = field(default_factory=dict)

    @property
    def reason(self) -> str:
        """Reason for the state of the scenario, from the first verdict with that state."""
        worst = worst_state(self.verdicts)
        return next((verdict.reason for verdict in self.verdicts if verdict.state == worst), "no requirement applies")


@dataclass(frozen=True, repr=False)
class SuiteResult:
    """Result of a suite that was run; as a bool, the result is True if the suite passed (see `has_passed`).

    Attributes
    ----------
    study : Path
        Study of the suite.
    suite : Path
        Manifest or folder of the suite.
    simulator : str
    requirements : tuple of str
    scenarios : tuple of ScenarioResult
        In the order of the suite.
    against : Path or None
        Study that the recordings were compared with.
    changed_driver : tuple of str or None
        Drivers of the ego in the study `against` and in this run; None if their names are the same or unknown, or if
        nothing was compared.
    no_comparison_reason : str
        Why the recordings were not compared, as a sentence without a period; empty if they were compared.
    n_ran_before : int
        Number of scenarios whose stored results were judged without running them again.
    kill_matrix : KillMatrix or None
        Which scenarios, by id, kill which mutants (faulty variants) of the ego's driver; None if no mutants were run.

    Examples
    --------
    A folder of concrete scenarios is a suite; this folder has one scenario.

    >>> import shutil
    >>> import cornercase as cc
    >>> _ = shutil.copytree("examples/x_intersection", "suite", ignore=shutil.ignore_patterns("*.space.xosc"))
    >>> suite = cc.Suite.open("suite", ego="Ego", other="Pedestrian")
    >>> result = suite.run("run.db", require=["no collision"])
    >>> bool(result), result.count_scenarios("passed"), len(result.table())
    (True, 1, 1)
    >>> result.junit("out.xml").name
    'out.xml'
    """

    study: Path
    suite: Path
    simulator: str
    requirements: tuple[str, ...]
    scenarios: tuple[ScenarioResult, ...]
    against: Path | None = None
    changed_driver: tuple[str, str] | None = None
    no_comparison_reason: str = ""
    n_ran_before: int = 0
    kill_matrix: KillMatrix | None = None

    def __bool__(self) -> bool:
        return self.has_passed()

    def count_scenarios(self, state: str) -> int:
        """Count the scenarios in a state.

        Parameters
        ----------
        state : {"passed", "failed", "inconclusive", "error"}

        Returns
        -------
        int
        """
        return sum(scenario.state == state for scenario in self.scenarios)

    def has_passed(self, *, strict: bool = False) -> bool:
        """Tell whether the suite passed: no requirement was violated, and no simulation failed.

        Parameters
        ----------
        strict : bool, default False
            Whether inconclusive verdicts count as failed.

        Returns
        -------
        bool
        """
        refused = ("failed", "error", "inconclusive") if strict else ("failed", "error")
        return not any(scenario.state in refused for scenario in self.scenarios)

    @property
    def summary(self) -> str:
        """Number of scenarios that passed, failed, were inconclusive or not run, in a sentence without a period."""
        names = {"error": "not run"}
        counts = Counter(scenario.state for scenario in self.scenarios)
        parts = [
            f"{counts[state]} {names.get(state, state)}"
            for state in ("passed", "failed", "inconclusive", "error")
            if counts[state]
        ]
        return f"{', '.join(parts)} of {len(self.scenarios)} scenario{'' if len(self.scenarios) == 1 else 's'}"

    @property
    def comparison_summary(self) -> str:
        """Sentence without a period that says how the recordings differ from the earlier recordings."""
        if self.against is None:
            return f"Not compared: {self.no_comparison_reason}"
        compared = [item.difference for item in self.scenarios if item.difference is not None]
        n_same = sum(item.same for item in compared)
        distances = [item.distance for item in compared if item.distance is not None and not item.same]
        note = f"; the ego is up to {max(distances):.3g} m away" if distances else ""
        if self.changed_driver is not None and n_same < len(compared):
            before, now = self.changed_driver
            return f"The ego was driven by {before} in {self.against.name} and by {now} here, so runs differ{note}"
        return f"{n_same} of {len(compared)} recordings are identical to those in {self.against.name}{note}"

    @property
    def has_comparable_recordings(self) -> bool:
        """True if recordings were compared with earlier ones, and should be equal as the ego's driver is the same."""
        return self.against is not None and self.changed_driver is None

    def table(self) -> pd.DataFrame:
        """Make a table of the scenarios.

        Returns
        -------
        DataFrame
            One row per scenario, indexed by its id in the study of the suite: ``file``, ``state``, ``reason``, ``kind``
            (the cluster that the scenario represents), ``duration`` in s, and the score by each metric.
        """
        import pandas as pd

        rows = [
            {
                "id": scenario.id,
                "file": scenario.file,
                "state": scenario.state,
                "reason": scenario.reason,
                "kind": scenario.kind,
                "duration": scenario.duration,
            }
            | dict(scenario.scores)
            for scenario in self.scenarios
        ]
        return pd.DataFrame(rows).set_index("id")

    def junit(self, path: Path | str) -> Path:
        """Write the verdicts as JUnit XML, which Jenkins, GitLab and others show.

        Parameters
        ----------
        path : path
            File to write. The same results give the same bytes.

        Returns
        -------
        Path

        Raises
        ------
        InputError
            The file cannot be written.
        """
        file = check_path("path", path)
        write_junit(self, file)
        return file

    def markdown(self, path: Path | str) -> Path:
        """Write the verdicts as a Markdown table, which GitHub shows on the page of a job.

        Parameters
        ----------
        path : path
            File to write. The same results give the same bytes.

        Returns
        -------
        Path

        Raises
        ------
        InputError
            The file cannot be written.
        """
        file = check_path("path", path)
        write_markdown_summary(self, file)
        return file

    def _repr_html_(self) -> str:
        """Table of the scenarios, for notebooks."""
        return render_html_table(repr(self), self.table(), n_rows=len(self.scenarios))

    def __repr__(self) -> str:
        return f"<SuiteResult: {self.summary}, in {str(self.study)!r}>"

    def to_json(self) -> dict[str, Any]:
        """Return the result as values that JSON can store.

        Returns
        -------
        dict of str to object
            The output of ``cornercase test --json``.
        """
        return {
            "study": str(self.study),
            "suite": str(self.suite),
            "simulator": self.simulator,
            "requirements": list(self.requirements),
            "passed": self.count_scenarios("passed"),
            "failed": self.count_scenarios("failed"),
            "inconclusive": self.count_scenarios("inconclusive"),
            "errors": self.count_scenarios("error"),
            "ran_before": self.n_ran_before,
            "against": None if self.against is None else str(self.against),
            "scenarios": [asdict(scenario) | {"reason": scenario.reason} for scenario in self.scenarios],
        } | ({} if self.kill_matrix is None else {"mutants": self.kill_matrix.to_json()})
