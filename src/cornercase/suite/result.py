"""What came out of a suite."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from cornercase.reduction import Exposure
from cornercase.scenario import Value
from cornercase.suite.difference import Difference
from cornercase.suite.verdict import State, Verdict, worst_state


@dataclass(frozen=True)
class ScenarioResult:
    """What came out of one scenario of a suite.

    Attributes
    ----------
    id : int
        In the study of the suite.
    file : str
    state : {"passed", "failed", "inconclusive", "error"}
        Of all verdicts the worst; an error where the simulator failed.
    values : mapping of str to float or str
        Parameters.
    scores : mapping of str to float
        By metric; empty where the simulator failed.
    duration : float or None
        Of the recording in s; None where the simulator failed.
    verdicts : tuple of Verdict
        By requirement. Without any there is one that tells whether the scenario ran.
    kind, role, why : str
        Which cluster it represents, in which role, and why it was kept; empty where it is not known.
    origin : int or None
        Id in the study that it was kept from.
    difference : Difference or None
        From the earlier recording; None where there is none.
    others : mapping of str to str
        Of several others, whom each score is against, by metric; metrics that are against none of them are left out.
    """

    id: int
    file: str
    state: State | Literal["error"]
    values: Mapping[str, Value]
    scores: Mapping[str, float]
    duration: float | None
    verdicts: tuple[Verdict, ...]
    kind: str = ""
    role: str = ""
    why: str = ""
    origin: int | None = None
    difference: Difference | None = None
    others: Mapping[str, str] = field(default_factory=dict)

    @property
    def reason(self) -> str:
        """Why it is in its state, by the first verdict that says so."""
        worst = worst_state(self.verdicts)
        return next((one.reason for one in self.verdicts if one.state == worst), "no requirement is for it")


@dataclass(frozen=True, repr=False)
class SuiteResult:
    """What came out of a suite.

    Attributes
    ----------
    study : Path
        Of the suite.
    suite : Path
        The manifest, or the folder.
    simulator : str
    requirements : tuple of str
    scenarios : tuple of ScenarioResult
        In the order of the suite.
    against : Path or None
        Study whose recordings they were compared with.
    why_not_compared : str
        Why there is none, as a sentence without a full stop.
    ran_before : int
        Scenarios that the study held already, and that were judged without being run again.
    exposure : Exposure or None
        Which scenarios, by id, expose which mutants of the ego's driver; None where none were run.
    """

    study: Path
    suite: Path
    simulator: str
    requirements: tuple[str, ...]
    scenarios: tuple[ScenarioResult, ...]
    against: Path | None = None
    why_not_compared: str = ""
    ran_before: int = 0
    exposure: Exposure | None = None

    def count(self, state: str) -> int:
        """Count the scenarios in a state.

        Parameters
        ----------
        state : {"passed", "failed", "inconclusive", "error"}

        Returns
        -------
        int
        """
        return sum(one.state == state for one in self.scenarios)

    def has_passed(self, *, strict: bool = False) -> bool:
        """Tell whether the suite as a whole passed: nothing failed, neither a requirement nor the simulator.

        Parameters
        ----------
        strict : bool, default False
            Whether nothing may be inconclusive either.

        Returns
        -------
        bool
        """
        refused = ("failed", "error", "inconclusive") if strict else ("failed", "error")
        return not any(one.state in refused for one in self.scenarios)

    @property
    def text(self) -> str:
        """How it went, in a sentence without a full stop."""
        names = {"error": "not run"}
        counts = Counter(one.state for one in self.scenarios)
        said = [
            f"{counts[state]} {names.get(state, state)}"
            for state in ("passed", "failed", "inconclusive", "error")
            if counts[state]
        ]
        return f"{', '.join(said)} of {len(self.scenarios)} scenario{'' if len(self.scenarios) == 1 else 's'}"

    @property
    def comparison(self) -> str:
        """How the recordings compare with the earlier ones, in a sentence without a full stop."""
        if self.against is None:
            return f"Not compared: {self.why_not_compared}"
        compared = [one.difference for one in self.scenarios if one.difference is not None]
        same = sum(one.same for one in compared)
        far = [one.distance for one in compared if one.distance is not None and not one.same]
        most = f"; the ego is up to {max(far):.3g} m elsewhere" if far else ""
        return f"{same} of {len(compared)} recordings are byte for byte those in {self.against.name}{most}"

    def __repr__(self) -> str:
        return f"<SuiteResult: {self.text}, in {str(self.study)!r}>"

    def to_json(self) -> dict[str, Any]:
        """Put it into plain values.

        Returns
        -------
        dict of str to object
            What ``cornercase test --json`` prints.
        """
        return {
            "study": str(self.study),
            "suite": str(self.suite),
            "simulator": self.simulator,
            "requirements": list(self.requirements),
            "passed": self.count("passed"),
            "failed": self.count("failed"),
            "inconclusive": self.count("inconclusive"),
            "errors": self.count("error"),
            "ran_before": self.ran_before,
            "against": None if self.against is None else str(self.against),
            "scenarios": [asdict(one) | {"reason": one.reason} for one in self.scenarios],
        } | ({} if self.exposure is None else {"mutants": self.exposure.to_json()})
