"""Judge whether recordings fulfill requirements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Final

from cornercase._common.errors import InputError, PluginError
from cornercase._common.text.sanitize import quote_name
from cornercase._common.typing import FloatArray
from cornercase.drivers.references.r157._preventability import ReferenceOutcome
from cornercase.metrics import METRICS
from cornercase.metrics._evaluation import evaluate_run
from cornercase.metrics._explain_expression import explain
from cornercase.metrics._outcome import Fault
from cornercase.recordings import Collision, Recording
from cornercase.study import ScenarioRecord, StudyFile
from cornercase.study._damage import reraise_read_errors
from cornercase.suite._requirement import Requirement
from cornercase.suite._verdict import Verdict, VerdictState

# With several other entities, the verdict is the first of these states that occurs.
_STATE_PRIORITY: Final = ("failed", "passed", "inconclusive")
_STATES: Final[dict[bool | None, VerdictState]] = {True: "passed", False: "failed", None: "inconclusive"}


def judge(
    requirement: Requirement,
    recording: Recording,
    ego: str,
    other: str | Sequence[str],
    *,
    courses: Mapping[str, FloatArray] | None = None,
    references: Mapping[str, ReferenceOutcome] | None = None,
) -> Verdict:
    """Judge whether a recording fulfills a requirement.

    Parameters
    ----------
    requirement : Requirement
    recording : Recording
    ego : str
        Name of the entity under test.
    other : str or sequence of str
        Entity that the requirement relates the ego to. If there are several, the requirement is judged against each of
        them. The result is failed if at least one of these verdicts is failed; otherwise passed if at least one is
        passed; otherwise inconclusive. The returned verdict is the one with this result that has the smallest
        robustness (margin to a violation). If the verdicts differ, its reason names the entity.
    courses : mapping of str to ndarray of float64, shape (T,), optional
        Courses (values over time) of metrics by name, if they are known already. If there are several other entities,
        only courses of metrics that do not depend on the other entity are used.
    references : mapping of str to ReferenceOutcome, optional
        Outcomes of the scenario with the reference drivers that the requirement names, by name of the driver. Drivers
        that were not run are left out.

    Returns
    -------
    Verdict
        Inconclusive if the situation in the requirement never occurred, if the recording ends before the time limit, if
        the verdict depends on a reference driver that was not run, or if a custom metric raised an exception.

    Raises
    ------
    InputError
        The recording has no entity with the name `ego`. Or the requirement depends on other entities, and the recording
        has none of those in `other`. Or `other` is empty.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase.recordings import Recording
    >>> from cornercase.suite import Requirement, judge
    >>> still = np.zeros((2, 3))
    >>> recording = Recording(
    ...     time=np.array([0.0, 0.1, 0.2]), names=("Ego", "Other"), object_types=("car", "car"),
    ...     x=np.array([[0.0, 1.0, 2.0], [20.0, 20.0, 20.0]]), y=still, heading=still,
    ...     speed=np.array([[10.0] * 3, [0.0] * 3]), acceleration=still,
    ...     length=np.full(2, 4.0), width=np.full(2, 2.0), center_x=np.zeros(2),
    ... )
    >>> judge(Requirement.parse("reach 2,0,0.5 within 1"), recording, "Ego", "Other").reason
    'Ego reaches (2, 0) at 0.2 s'
    """
    if not other:
        raise InputError("`other`: is empty; name at least one entity.")
    return _judge(requirement, recording, ego, other, courses, references)


def _judge(
    requirement: Requirement,
    recording: Recording,
    ego: str,
    other: str | Sequence[str],
    courses: Mapping[str, FloatArray] | None = None,
    references: Mapping[str, ReferenceOutcome] | None = None,
    faults: Mapping[Collision, Fault] = MappingProxyType({}),
) -> Verdict:
    """Judge a recording like `judge`; `faults` says who is at fault in collisions for which this is known already."""
    texts = {name: outcome.describe(name) for name, outcome in (references or {}).items()}
    collides = {name: outcome.collides for name, outcome in (references or {}).items()}
    try:
        evaluations = evaluate_run(requirement.expression.root, recording, ego, other, courses, collides, faults)
        verdicts = {
            name: Verdict(_STATES[evaluation.is_fulfilled()], requirement.text, *explain(evaluation, texts))
            for name, evaluation in evaluations.items()
        }
    except PluginError as error:
        return Verdict("inconclusive", requirement.text, str(error))
    first, *_ = verdicts.values()
    if all(verdict == first for verdict in verdicts.values()):
        # It does not depend on the other entity, or is inconclusive against all.
        return first
    margins = {name: float(evaluation.robustness()[0]) for name, evaluation in evaluations.items()}
    worst = min(verdicts, key=lambda name: (_STATE_PRIORITY.index(verdicts[name].state), margins[name]))
    return replace(verdicts[worst], reason=f"against {quote_name(worst)}: {verdicts[worst].reason}")


def compute_margin(requirement: Requirement, recording: Recording, ego: str, others: Sequence[str]) -> float | None:
    """Return the margin by which a recording fulfills a requirement, in the requirement's unit; negative if violated.

    None if the requirement has no margin, such as ``"no collision"``.
    """
    if not requirement.expression.has_margin:
        return None
    evaluations = evaluate_run(requirement.expression.root, recording, ego, others).values()
    return min(float(evaluation.robustness()[0]) for evaluation in evaluations)


def measure_margins(study: StudyFile, verdicts: Mapping[int, Sequence[Verdict]]) -> dict[int, dict[str, float]]:
    """Return the margins by which requirements are fulfilled (negative: violated), by scenario id and requirement.

    Inconclusive verdicts, and requirements without a margin such as ``"no collision"``, are left out.
    """
    margins: dict[int, dict[str, float]] = {}
    for scenario, of_scenario in verdicts.items():
        decided = [Requirement.parse(verdict.requirement) for verdict in of_scenario if verdict.state != "inconclusive"]
        measured = [requirement for requirement in decided if requirement.expression.has_margin]
        if measured:
            recording = study.recording(scenario)
            values = {
                requirement.text: compute_margin(requirement, recording, study.meta.ego, study.meta.others)
                for requirement in measured
            }
            margins[scenario] = {text: value for text, value in values.items() if value is not None}
    return margins


def depends_on_reference(requirement: Requirement, recording: Recording, ego: str, others: Sequence[str]) -> bool:
    """Return whether a recording alone leaves a verdict against any entity open, so that reference drivers are run."""
    evaluations = evaluate_run(requirement.expression.root, recording, ego, others).values()
    return any(evaluation.is_fulfilled() is None for evaluation in evaluations)


def judge_study(study: StudyFile) -> dict[int, list[Verdict]]:
    """Judge the finished scenarios of a study by the requirements that it stores; return verdicts by scenario id."""
    with reraise_read_errors(study.path):
        requirements = [Requirement.parse(text) for text in study.meta.requirements]
        if not requirements:
            return {}
        return {row.id: judge_scenario(study, row, requirements) for row in study.rows() if row.state != "pending"}


def judge_scenario(study: StudyFile, row: ScenarioRecord, requirements: list[Requirement]) -> list[Verdict]:
    """Judge one finished scenario by each requirement that applies to it."""
    meta = study.meta
    file, kind = (_entry_of_row(row, names) if meta.suite else "" for names in (meta.files, meta.kinds))
    applicable = [requirement for requirement in requirements if requirement.applies_to(file, kind)]
    if row.state == "failed":
        return [Verdict("inconclusive", requirement.text, f"it failed: {row.error}") for requirement in applicable]
    recording = study.recording(row.id)
    # With several others it is unknown which one a course refers to at each time.
    needed = {
        name
        for item in applicable
        for name in item.expression.metrics
        if len(meta.others) == 1 or METRICS.create(name).ego_only
    }
    courses = {name: study.course(row.id, name) for name in meta.metrics if name in needed}
    drivers = dict.fromkeys(name for item in applicable for name in item.expression.reference_drivers)
    outcomes = {name: study.reference_outcome(row.id, name) for name in drivers}
    references = {name: outcome for name, outcome in outcomes.items() if outcome is not None}
    asks_for_fault = any(item.expression.asks_for_fault for item in applicable)
    faults = _stored_faults(study, row.id, recording) if asks_for_fault else {}
    return [
        _judge(requirement, recording, meta.ego, meta.others, courses, references, faults) for requirement in applicable
    ]


def _stored_faults(study: StudyFile, scenario: int, recording: Recording) -> dict[Collision, Fault]:
    """Return who is at fault in the collisions of a scenario, as decided and stored when the scenario was run.

    The roads, which help to decide this, were known at that time; recordings do not contain roads.
    """
    stored = {(hit.time, hit.entity): hit.fault for hit in study.digest(scenario).outcomes[0].impacts}
    faults = {}
    for collision in recording.collisions:
        for name in collision.entities:
            if (fault := stored.get((collision.time, name))) is not None:
                faults[collision] = fault
    return faults


def _entry_of_row(row: ScenarioRecord, names: tuple[str, ...]) -> str:
    return names[row.id - 1] if row.id <= len(names) else ""
