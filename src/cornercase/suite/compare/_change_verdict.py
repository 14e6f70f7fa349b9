"""Decide whether the new version is better or worse than the old version; changes within tolerances do not count."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

from cornercase._common import validation
from cornercase._common.errors import InputError, suggest_name
from cornercase.metrics import Metric
from cornercase.suite._requirement import Requirement
from cornercase.suite.compare._comparison import (
    ALPHA,
    ChangeDirection,
    ChangeTest,
    ComparisonVerdict,
    Finding,
    FindingKind,
    ScenarioPair,
    describe_findings,
)
from cornercase.suite.compare._significance import change_direction, score_difference

DEFAULT_TOLERANCES: Final = MappingProxyType(
    {"s": 0.1, "m": 0.1, "m/s": 0.1, "m/s²": 0.1, "s²": 0.1, "rad": 0.01, "1": 0.01}
)
"""Largest change of a score that does not count, by unit of the score; 0 for other units."""

# From the most to the least important.
_KINDS_BY_IMPORTANCE: Final[tuple[FindingKind, ...]] = ("collision", "requirement", "run", "critical", "score")
_KIND_OF_TEST: Final[Mapping[str, FindingKind]] = MappingProxyType(
    {"collision": "collision", "failed verdict": "requirement", "not run": "run", "critical": "critical"}
)


@dataclass(frozen=True)
class PairChange:
    """A change for the better or worse between the old and the new run of a scenario.

    `about` is the requirement or metric, `ids` has the ids of the scenario in both studies, and `size` is the change of
    a score, in the unit of the score.
    """

    kind: FindingKind
    about: str
    direction: ChangeDirection
    ids: tuple[int, int]
    exceeds_tolerance: bool = True
    size: float | None = None


def resolve_tolerances(metrics: Mapping[str, Metric], overrides: Mapping[str, float] | None) -> dict[str, float]:
    """Return the tolerance (largest change that does not count) of each metric; `overrides` replace the defaults."""
    limits = {name: DEFAULT_TOLERANCES.get(metric.unit, 0.0) for name, metric in metrics.items()}
    for name, value in validation.check_mapping("tolerances", overrides or {}).items():
        if name not in limits:
            raise InputError(f"`tolerances` {name}: is not a compared metric; {suggest_name(name, limits)}")
        try:
            limits[name] = validation.check_float("tolerances", value, minimum=0.0)
        except InputError as error:
            raise InputError(
                f"`tolerances` {name}={validation.repr_short(value)}: give a number of 0 or more."
            ) from error
    return limits


def find_findings(
    pairs: Sequence[ScenarioPair],
    tests: Sequence[ChangeTest],
    metrics: Mapping[str, Metric],
    tolerances: Mapping[str, float],
    deterministic: bool,
) -> tuple[tuple[Finding, ...], tuple[Finding, ...], tuple[Finding, ...]]:
    """Return three groups of findings: worse with the new version, better, and changed within the tolerances only.

    If both simulators are deterministic, each pair of runs that differs shows a change. Otherwise only significant
    tests count. Such a test also needs confirmation: of the scenarios that changed by more than the tolerance, more
    must have changed in the direction of the test than in the other direction. Significant tests of unpaired scenarios
    count in both cases; a shift of scores must then exceed the tolerance. The most important findings come first.
    """
    steps = [
        step
        for pair in pairs
        if deterministic or pair.is_score_independent
        for step in _iter_pair_changes(pair, metrics, tolerances)
    ]
    counted = [change for change in steps if change.exceeds_tolerance]
    within = [change for change in steps if not change.exceeds_tolerance]
    findings = list(_group_into_findings(counted, metrics)) if deterministic else []
    for test in tests:
        if test.corrected <= ALPHA and test.direction is not None and (not deterministic or test.differ is None):
            findings += _iter_test_findings(test, test.direction, counted, metrics, tolerances)
    findings.sort(key=lambda finding: _KINDS_BY_IMPORTANCE.index(finding.kind))
    worse, better = (
        tuple(change for change in findings if change.direction == direction) for direction in ("worse", "better")
    )
    return worse, better, tuple(_group_into_findings(within, metrics))


def _iter_pair_changes(
    pair: ScenarioPair, metrics: Mapping[str, Metric], tolerances: Mapping[str, float]
) -> Iterator[PairChange]:
    if pair.run == "not in one":
        yield PairChange("run", "", "worse" if pair.errors[0] is None else "better", pair.ids)
    # Rounding may still cross a bound; that is listed but does not count.
    otherwise = pair.run == "otherwise"
    if pair.collides[0] != pair.collides[1]:
        yield PairChange("collision", "", "worse" if pair.collides[1] else "better", pair.ids)
    for old, new in pair.changed_verdicts:
        is_failed = [verdict.state == "failed" for verdict in (old, new)]
        if is_failed[0] != is_failed[1]:
            margins = pair.margins.get(old.requirement)
            counts = margins is None or (
                otherwise and _exceeds_tolerance(*margins, _margin_tolerance(old.requirement, tolerances))
            )
            yield PairChange("requirement", old.requirement, "worse" if is_failed[1] else "better", pair.ids, counts)
    if pair.is_critical is not None and pair.is_critical[0] != pair.is_critical[1]:
        # If several metrics define criticality, one that changed is enough.
        counts = otherwise and any(
            _exceeds_tolerance(*scores, tolerances[name]) for name, scores in pair.criticality_scores.items()
        )
        yield PairChange("critical", "", "worse" if pair.is_critical[1] else "better", pair.ids, counts)
    for name, (before, after) in pair.scores.items():
        if otherwise and _exceeds_tolerance(before, after, tolerances[name]):
            worse = change_direction(metrics[name], after - before) == "worse"
            yield PairChange("score", name, "worse" if worse else "better", pair.ids, size=after - before)


def _exceeds_tolerance(before: float, after: float, tolerance: float) -> bool:
    """Tell whether a number changed by more than a tolerance and more than rounding errors."""
    if not (np.isfinite(before) and np.isfinite(after)):
        return before != after
    size = abs(float(score_difference(np.array([before]), np.array([after]))[0]))
    # A change equal to the tolerance up to rounding does not exceed it.
    return bool(score_difference(np.array([tolerance]), np.array([size]))[0] > 0.0)


def _margin_tolerance(requirement: str, tolerances: Mapping[str, float]) -> float:
    """Return the tolerance for the margin (robustness) of a requirement.

    This is the smallest tolerance of its metrics; what is not a compared metric has the default tolerance of its unit.
    """
    units = Requirement.parse(requirement).expression.compared_units
    return min(tolerances[name] if name in tolerances else DEFAULT_TOLERANCES.get(unit, 0.0) for name, unit in units)


def _group_into_findings(changes: Iterable[PairChange], metrics: Mapping[str, Metric]) -> Iterator[Finding]:
    """Combine changes of the same kind and direction; findings about scores are in the order of `metrics`."""
    order = {name: k for k, name in enumerate(metrics)}
    groups: dict[tuple[FindingKind, str, ChangeDirection], list[PairChange]] = {}
    for step in changes:
        groups.setdefault((step.kind, step.about, step.direction), []).append(step)

    def sort_key(group: tuple[FindingKind, str, ChangeDirection]) -> tuple[int, int, str, bool]:
        kind, about, direction = group
        return _KINDS_BY_IMPORTANCE.index(kind), order.get(about, 0), about, direction == "better"

    for kind, about, direction in sorted(groups, key=sort_key):
        yield _build_finding(kind, about, direction, groups[kind, about, direction], metrics)


def _build_finding(
    kind: FindingKind,
    about: str,
    direction: ChangeDirection,
    changes: Sequence[PairChange],
    metrics: Mapping[str, Metric],
    n_opposite: int = 0,
    test: ChangeTest | None = None,
) -> Finding:
    unit = metrics[about].unit if kind == "score" else ""
    largest = max((step.size for step in changes if step.size is not None), key=abs, default=None)
    ids = tuple(dict.fromkeys(step.ids for step in changes))
    return Finding(kind, about, direction, ids, n_opposite, largest, unit, test)


def _iter_test_findings(
    test: ChangeTest,
    direction: ChangeDirection,
    changes: Sequence[PairChange],
    metrics: Mapping[str, Metric],
    tolerances: Mapping[str, float],
) -> Iterator[Finding]:
    """Yield the finding of a significant test; nothing if the change is within the tolerances."""
    kind = _KIND_OF_TEST.get(test.about, "score")
    about = test.about if kind == "score" else ""
    if test.differ is None:
        # The test uses ranks; a shift of the mean in the opposite direction would contradict it.
        agrees = change_direction(metrics[about] if about else None, test.shift) == direction
        if agrees and (not about or _exceeds_tolerance(0.0, test.shift, tolerances[about])):
            yield _build_finding(kind, about, direction, (), metrics, test=test)
        return
    relevant = [step for step in changes if step.kind == kind and (not about or step.about == about)]
    confirming = [step for step in relevant if step.direction == direction]
    against = len({step.ids for step in relevant if step.direction != direction})
    if len({step.ids for step in confirming}) > against:
        yield _build_finding(kind, about, direction, confirming, metrics, against, test)


def decide_verdict(
    findings: tuple[Sequence[Finding], Sequence[Finding]],
    pairs: Sequence[ScenarioPair],
    tests: Sequence[ChangeTest],
    changed: tuple[bool, str],
    deterministic: bool,
) -> tuple[ComparisonVerdict, str]:
    """Return the verdict on the new version, and the reason for the verdict.

    `findings` are the worse and the better findings. `changed` says whether the versions differ, and why.
    """
    worse, better = (describe_findings(item) for item in findings)
    if worse and better:
        return "mixed", f"Worse: {worse}; better: {better}"
    if worse or better:
        return ("worse", worse) if worse else ("better", better)
    n_ran, n_different = sum(item.both_ran for item in pairs), sum(item.run == "otherwise" for item in pairs)
    if all(item.run in ("the same", "in neither") for item in pairs) and n_ran and not changed[0]:
        return "the same", changed[1]
    if deterministic and n_different:
        return "the same", f"{n_different} of {n_ran} scenarios that ran with both differ, within the tolerances"
    if changed[0]:
        return "the same", "no significant change exceeds the tolerances"
    if deterministic and n_ran:
        return "the same", changed[1]
    if not tests:
        return "cannot say", f"{changed[1]}; explore both with audits"
    if not any(_can_be_significant(item, len(tests)) for item in tests):
        count, n_needed = max(item.old for item in tests), math.ceil(math.log2(2.0 * len(tests) / ALPHA))
        return "cannot say", f"{count} scenarios are too few for {len(tests)} tests, which need {n_needed}"
    return "the same", changed[1]


def _can_be_significant(test: ChangeTest, n_tests: int) -> bool:
    """Tell whether the test would be significant among `n_tests` tests if all scenarios changed in one direction."""
    # Unpaired samples have at least 20 scenarios, enough for any number of tests.
    return test.differ is None or n_tests * 2.0 * 0.5**test.old <= ALPHA
