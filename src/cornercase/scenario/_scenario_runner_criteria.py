"""Pass/fail criteria of ScenarioRunner, which scenario files request by conditions with special names."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from lxml import etree

from cornercase._common.io.tracked_xml import iter_descendants_untracked, note_adaptation
from cornercase.scenario._scope import Scope

# Prefix of a condition's name that requests a criterion of ScenarioRunner.
_CRITERION_PREFIX: Final = "criteria_"
_PARAMETER_CONDITION_RULE: Final = "a ParameterCondition refers to a declared parameter"


@dataclass(frozen=True)
class ScenarioRunnerCriterion:
    """A pass/fail criterion of ScenarioRunner, such as ``"CollisionTest"``; `threshold` is None if none is given."""

    name: str
    threshold: float | None


def read_scenario_runner_criteria(root: etree._Element, scope: Scope) -> tuple[ScenarioRunnerCriterion, ...]:
    """Return the criteria of ScenarioRunner that the stop triggers of a scenario file request, in file order."""
    criteria: list[ScenarioRunnerCriterion] = []
    for trigger in iter_descendants_untracked(root, "StopTrigger"):
        for condition in iter_descendants_untracked(trigger, "ParameterCondition"):
            name = find_requested_criterion(condition)
            if name:
                # ScenarioRunner ignores the value if there is no parameterRef.
                has_bound = str(condition.attrib.get("parameterRef", "")).strip() and "value" in condition.attrib
                criteria.append(
                    ScenarioRunnerCriterion(
                        name, float(scope.read_numbers(condition, "value")[0]) if has_bound else None
                    )
                )
    return tuple(criteria)


def find_requested_criterion(element: etree._Element) -> str:
    """Return the criterion of ScenarioRunner that a ``ParameterCondition`` requests; empty for other conditions."""
    name = _condition_name(element)
    return name.removeprefix(_CRITERION_PREFIX) if name.startswith(_CRITERION_PREFIX) else ""


def is_condition_never_true(element: etree._Element, parameter_name: str) -> bool:
    """Return whether a condition on an undeclared parameter is no mistake, but a condition that is never true.

    Such a condition requests a criterion of ScenarioRunner, or refers to no parameter at all. If the condition is never
    true, record that on the element.
    """
    for attribute in ("value", "rule"):
        element.get(attribute)
    if find_requested_criterion(element):
        reason = (
            "requests a criterion of ScenarioRunner instead of comparing a parameter; the condition and its group are"
            " never true"
        )
        note_adaptation(element, _condition_name(element), reason, _PARAMETER_CONDITION_RULE)
        return True
    if not parameter_name.strip():
        reason = "refers to no parameter; the condition and its group are never true"
        note_adaptation(element, f"condition '{_condition_name(element)}'", reason, _PARAMETER_CONDITION_RULE)
        return True
    return False


def _condition_name(element: etree._Element) -> str:
    holder = next(element.iterancestors("Condition"), None)
    return "" if holder is None else str(holder.attrib.get("name", ""))
