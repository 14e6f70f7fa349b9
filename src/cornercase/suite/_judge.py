"""Judge whether recordings fulfill requirements."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from cornercase._common.errors import PluginError
from cornercase._common.text.sanitize import quote_name
from cornercase._common.typing import FloatArray
from cornercase.drivers.references.r157._preventability import ReferenceOutcome
from cornercase.metrics import Formula, Signals, signals_from_recording
from cornercase.metrics._other_entities import present_others
from cornercase.metrics.formulas._ast import Comparison
from cornercase.recordings import Collision, Recording
from cornercase.study import ScenarioRecord, StudyFile
from cornercase.study._damage import reraise_as_damage
from cornercase.suite._at_fault import is_at_fault
from cornercase.suite._requirement import Requirement, RequirementKind
from cornercase.suite._verdict import Verdict, VerdictState

# Tolerance of a simulator's clock in s.
_TIME_TOLERANCE: Final = 1e-6
# The verdict against several others is the first of these that occurs.
_STATE_PRIORITY: Final = ("failed", "passed", "inconclusive")


def judge(
    requirement: Requirement,
    recording: Recording,
    ego: str,
    other: str | Sequence[str],
    *,
    courses: Mapping[str, FloatArray] | None = None,
    reference: ReferenceOutcome | None = None,
) -> Verdict:
    """Judge a recording.

    Parameters
    ----------
    requirement : Requirement
    recording : Recording
    ego : str
        Name of the entity under test.
    other : str or sequence of str
        Entity that formulas and bounds refer to. With several, each is judged: the requirement is failed if it is
        failed against any, else passed if it is passed against at least one. The verdict is the one with the smallest
        robustness, and names its entity.
    courses : mapping of str to ndarray of float64, shape (T,), optional
        Courses of metrics that are known already, by name; not used with several others.
    reference : ReferenceOutcome, optional
        Outcome of the scenario with the reference driver of the requirement, if it was run.

    Returns
    -------
    Verdict
        Inconclusive if the situation of the requirement never occurred, if the recording ends before the time limit, or
        if a custom metric raised an exception.

    Raises
    ------
    InputError
        The recording has no entity of that name.

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
    if requirement.formula is not None:
        others = present_others(recording, (other,) if isinstance(other, str) else other)
        try:
            if isinstance(other, str) or len(other) == 1:
                return _judge_formula(
                    requirement, requirement.formula, signals_from_recording(recording, ego, others[0], courses)
                )
            return _judge_against_each(requirement, requirement.formula, recording, ego, others)
        except PluginError as error:
            return Verdict("inconclusive", requirement.text, str(error))
    verdict = _JUDGE_BY_KIND[requirement.kind](requirement, recording, ego)
    if requirement.reference and verdict.state == "failed":
        return _judge_with_reference(verdict, requirement.reference, reference)
    return verdict


def compute_margin(requirement: Requirement, recording: Recording, ego: str, others: Sequence[str]) -> float | None:
    """Margin of a recording to a requirement, negative if it is violated; None if unknown, and for collisions.

    It is the smallest robustness of a formula, or in m: how much closer than required the ego comes to a position, or
    how much farther than required it drives.
    """
    margin = np.nan
    if requirement.formula is not None:
        signals = [signals_from_recording(recording, ego, other) for other in present_others(recording, others)]
        margins = [float(requirement.formula.robustness(signal)[0]) for signal in signals]
        margin = min((signal for signal in margins if not np.isnan(signal)), default=np.nan)
    elif requirement.position is not None:
        x, y, radius = requirement.position
        is_in_time = recording.time - recording.time[0] <= requirement.time_limit + _TIME_TOLERANCE
        distances = np.hypot(*(recording.box_center(ego)[is_in_time] - (x, y)).T)
        margin = radius - min(distances[np.isfinite(distances)], default=np.nan)
    elif requirement.kind == "drive":
        margin = _driven_distance(recording, ego)[-1] - requirement.distance
    return None if np.isnan(margin) else float(margin)


def _judge_collision(requirement: Requirement, recording: Recording, ego: str) -> Verdict:
    i, entity = recording.entity_index(ego), requirement.entity
    is_present = np.isfinite(recording.x[i])
    if entity:
        is_present &= np.isfinite(recording.x[recording.entity_index(entity)])
    if not is_present.any():
        reason = (
            f"{quote_name(ego)} and {quote_name(entity)} are never present together"
            if entity
            else _describe_absence(ego)
        )
        return Verdict("inconclusive", requirement.text, reason)
    collisions = [
        collision
        for collision in recording.collisions
        if ego in collision.entities and (not entity or entity in collision.entities)
    ]
    if not collisions:
        return Verdict("passed", requirement.text, f"{quote_name(ego)} does not collide{_format_other(entity)}")
    return _collision_verdict(requirement, recording, ego, collisions[0])


def _judge_with_reference(verdict: Verdict, name: str, outcome: ReferenceOutcome | None) -> Verdict:
    """Verdict on a collision that a reference driver may have prevented."""
    if outcome is None:
        return replace(verdict, state="inconclusive", reason=f"{verdict.reason}; {name} was not run")
    state: VerdictState = "failed"
    if outcome.collides is not False:
        state = "inconclusive" if outcome.collides is None else "passed"
    return replace(verdict, state=state, reason=f"{verdict.reason}; {outcome.describe(name)}")


def _judge_fault(requirement: Requirement, recording: Recording, ego: str) -> Verdict:
    if not np.isfinite(recording.x[recording.entity_index(ego)]).any():
        return Verdict("inconclusive", requirement.text, _describe_absence(ego))
    collisions = [collision for collision in recording.collisions if ego in collision.entities]
    at_fault = next((collision for collision in collisions if is_at_fault(recording, ego, collision)), None)
    if at_fault is not None:
        return _collision_verdict(requirement, recording, ego, at_fault, f", as {quote_name(ego)} drives into it")
    if not collisions:
        return Verdict("passed", requirement.text, f"{quote_name(ego)} does not collide")
    first = collisions[0]
    reason = (
        f"{_format_entities(first, ego)} collide at {first.time:.6g} s, but {quote_name(ego)} does not drive into it"
    )
    return Verdict("passed", requirement.text, reason, first.time)


def _judge_position(requirement: Requirement, recording: Recording, ego: str) -> Verdict:
    assert requirement.position is not None
    x, y, radius = requirement.position
    position = f"({x:.6g}, {y:.6g})"
    distances = np.hypot(*(recording.box_center(ego) - (x, y)).T)
    present = np.flatnonzero(np.isfinite(distances))
    if not len(present):
        return Verdict("inconclusive", requirement.text, _describe_absence(ego))
    elapsed = recording.time - recording.time[0]
    inside = present[elapsed[present] <= requirement.time_limit + _TIME_TOLERANCE]
    arrivals = inside[distances[inside] <= radius]
    if len(arrivals):
        at = float(recording.time[arrivals[0]])
        reason = f"{quote_name(ego)} reaches {position} at {at:.6g} s"
        return Verdict("passed", requirement.text, reason, at, float(distances[arrivals[0]]))
    if not len(inside):
        return Verdict(
            "inconclusive", requirement.text, f"{quote_name(ego)} is absent before {elapsed[present[0]]:.6g} s"
        )
    nearest = inside[distances[inside].argmin()]
    at, value = float(recording.time[nearest]), float(distances[nearest])
    text = f"{quote_name(ego)} comes no nearer to {position} than {value:.4g} m, at {at:.6g} s"
    # If the ego left the scenario before, it can no longer arrive.
    if elapsed[-1] < requirement.time_limit - _TIME_TOLERANCE and present[-1] == len(elapsed) - 1:
        reason = f"{text}, but was observed for {elapsed[-1]:.6g} s only"
        return Verdict("inconclusive", requirement.text, reason, at, value)
    return Verdict("failed", requirement.text, f"{text}, within {requirement.time_limit:.6g} s", at, value)


def _judge_distance(requirement: Requirement, recording: Recording, ego: str) -> Verdict:
    if not np.isfinite(recording.x[recording.entity_index(ego)]).any():
        return Verdict("inconclusive", requirement.text, _describe_absence(ego))
    driven, required = _driven_distance(recording, ego), requirement.distance
    reached = np.flatnonzero(driven >= required - _TIME_TOLERANCE)
    if len(reached):
        at = float(recording.time[reached[0]])
        reason = f"{quote_name(ego)} has driven {required:.6g} m at {at:.6g} s"
        return Verdict("passed", requirement.text, reason, at, float(driven[reached[0]]))
    at, total = float(recording.time[-1]), float(driven[-1])
    reason = f"{quote_name(ego)} drives {total:.4g} m until {at:.6g} s, less than {required:.6g} m"
    return Verdict("failed", requirement.text, reason, at, total)


def _driven_distance(recording: Recording, ego: str) -> FloatArray:
    """Distance in m that an entity has driven by each time, shape (T,)."""
    i = recording.entity_index(ego)
    steps = np.hypot(np.diff(recording.x[i], prepend=np.nan), np.diff(recording.y[i], prepend=np.nan))
    return np.asarray(np.cumsum(np.where(np.isfinite(steps), steps, 0.0)))


def _judge_against_each(
    requirement: Requirement, formula: Formula, recording: Recording, ego: str, others: Sequence[str]
) -> Verdict:
    """Judge a formula against each of several others."""
    signals = [signals_from_recording(recording, ego, other) for other in others]
    verdicts = [_judge_formula(requirement, formula, verdict) for verdict in signals]
    if all(verdict == verdicts[0] for verdict in verdicts):
        # It does not depend on the other entity, or is inconclusive against all.
        return verdicts[0]
    margins = [np.nan_to_num(float(formula.robustness(verdict)[0]), nan=np.inf) for verdict in signals]
    index = min(range(len(others)), key=lambda k: (_STATE_PRIORITY.index(verdicts[k].state), margins[k]))
    chosen = verdicts[index]
    return replace(chosen, reason=f"against {quote_name(others[index])}: {chosen.reason}")


def _judge_formula(requirement: Requirement, formula: Formula, signals: Signals) -> Verdict:
    failed = not formula.holds(signals)[0]
    if not failed and not formula.is_defined(signals):
        unobserved = [
            comparison.text for comparison in formula.comparisons if np.isnan(comparison.margin(signals)).all()
        ]
        reason = f"what {' and '.join(unobserved)} refers to never occurred"
        return Verdict("inconclusive", requirement.text, reason)
    if formula.single_comparison is not None:
        return _judge_bound(requirement, formula.single_comparison, signals, failed)
    state: VerdictState = "failed" if failed else "passed"
    text = f"'{formula.text}' {'does not hold' if failed else 'holds'}"
    decisive = formula.find_decisive_comparison(signals)
    if decisive is None:
        reason = f"{text}; the decisive value is infinite, or the interval contains no sample"
        return Verdict(state, requirement.text, reason)
    comparison, k = decisive
    at, value = float(signals.time[k]), float(comparison.left.values(signals)[k])
    left = f"{comparison.left.text} is {comparison.left.format_value(value)} at {at:.6g} s"
    reason = f"{text}: {left}, compared with {comparison.describe_right_side(signals, k)}"
    return Verdict(state, requirement.text, reason, at, value)


def _judge_bound(requirement: Requirement, bound: Comparison, signals: Signals, failed: bool) -> Verdict:
    margin, values = bound.margin(signals), bound.left.values(signals)
    worst = int(np.nanargmin(margin))
    at, value = float(signals.time[worst]), float(values[worst])
    lower = bound.relation in (">", ">=")
    if not failed and np.isinf(value):
        reason = f"{bound.left.text} is infinite throughout"
        return Verdict("passed", requirement.text, reason)
    if not failed:
        reason = (
            f"{bound.left.text} is {bound.left.format_value(value)} at {'least' if lower else 'most'}, at {at:.6g} s"
        )
        return Verdict("passed", requirement.text, reason, at, value)
    verb, side = ("falls", "below") if lower else ("rises", "above")
    if margin[worst] == 0.0:
        side = f"not {'above' if lower else 'below'}"
    text = f"{verb} to {bound.left.format_value(value)} at {at:.6g} s"
    reason = f"{bound.left.text} {text}, {side} {bound.describe_right_side(signals, worst)}"
    first = float(signals.time[np.flatnonzero(bound.truth_values(signals) < 0.0)[0]])
    return Verdict(
        "failed", requirement.text, f"{reason}{f', first at {first:.6g} s' if first < at else ''}", at, value
    )


def _collision_verdict(
    requirement: Requirement, recording: Recording, ego: str, collision: Collision, suffix: str = ""
) -> Verdict:
    i, j = (recording.entity_index(name) for name in collision.entities)
    at = int(np.abs(recording.time - collision.time).argmin())
    vx, vy = (
        recording.speed[i, at] * part(recording.heading[i, at])
        - recording.speed[j, at] * part(recording.heading[j, at])
        for part in (np.cos, np.sin)
    )
    speed = float(np.hypot(vx, vy))
    reason = (
        f"{_format_entities(collision, ego)} collide at {collision.time:.6g} s with"
        f" {speed:.3g} m/s to each other{suffix}"
    )
    return Verdict("failed", requirement.text, reason, collision.time, speed)


def _format_entities(collision: Collision, ego: str) -> str:
    (partner,) = (name for name in collision.entities if name != ego)
    return f"{quote_name(ego)} and {quote_name(partner)}"


def _format_other(name: str) -> str:
    return f" with {quote_name(name)}" if name else ""


def _describe_absence(ego: str) -> str:
    return f"{quote_name(ego)} is never present"


_JUDGE_BY_KIND: Final[dict[RequirementKind, Callable[[Requirement, Recording, str], Verdict]]] = {
    "no collision": _judge_collision,
    "no collision with": _judge_collision,
    "no collision at fault": _judge_fault,
    "no collision unless": _judge_collision,
    "reach": _judge_position,
    "drive": _judge_distance,
}


def judge_study(study: StudyFile) -> dict[int, list[Verdict]]:
    """Judge the scenarios of an open study by the requirements that it holds; empty without requirements.

    Returns verdicts by id of each scenario that ended, one for each requirement that applies to it; inconclusive if the
    simulator failed.
    """
    with reraise_as_damage(study.path):
        requirements = [Requirement.parse(text) for text in study.meta.requirements]
        if not requirements:
            return {}
        return {row.id: judge_scenario(study, row, requirements) for row in study.rows() if row.state != "pending"}


def judge_scenario(study: StudyFile, row: ScenarioRecord, requirements: list[Requirement]) -> list[Verdict]:
    """Judge one scenario that has ended, by each requirement that applies to it."""
    meta = study.meta
    file, kind = (_entry_of_row(row, names) if meta.suite else "" for names in (meta.files, meta.kinds))
    applicable = [requirement for requirement in requirements if requirement.applies_to(file, kind)]
    if row.state == "failed":
        return [Verdict("inconclusive", requirement.text, f"it failed: {row.error}") for requirement in applicable]
    recording = study.recording(row.id)
    formula_metrics = {
        name for requirement in applicable if requirement.formula is not None for name in requirement.formula.metrics
    }
    # With several others it is unknown which one a course refers to at each time.
    formula_metrics = formula_metrics if len(meta.others) == 1 else set()
    courses = {name: study.course(row.id, name) for name in meta.metrics if name in formula_metrics}
    return [
        judge(
            requirement,
            recording,
            meta.ego,
            meta.others,
            courses=courses,
            reference=study.reference_outcome(row.id, requirement.reference) if requirement.reference else None,
        )
        for requirement in applicable
    ]


def _entry_of_row(row: ScenarioRecord, names: tuple[str, ...]) -> str:
    return names[row.id - 1] if row.id <= len(names) else ""
