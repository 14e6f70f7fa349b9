"""Criteria by which ScenarioRunner judges a run, and which a scenario asks for in the form of conditions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from lxml import etree

from cornercase._common.recorded_xml import adapt, below
from cornercase.scenario.scope import Scope

# What ScenarioRunner cuts off the name of a condition to get that of a criterion.
_PREFIX: Final = "criteria_"
_RULE: Final = "a ParameterCondition refers to a declared parameter"


@dataclass(frozen=True)
class Criterion:
    """A criterion that a scenario file asks for.

    Attributes
    ----------
    name : str
        As ScenarioRunner calls it: ``"CollisionTest"``.
    value : float or None
        Its bound; None where the file gives none.
    """

    name: str
    value: float | None


def criteria_in(root: etree._Element, scope: Scope) -> tuple[Criterion, ...]:
    """Criteria of a scenario file, in its order.

    Parameters
    ----------
    root : lxml element
    scope : Scope
        Of one scenario.

    Returns
    -------
    tuple of Criterion
        As ScenarioRunner takes them, those of triggers that stop something.

    Raises
    ------
    InputError
        The bound of one is not a number.
    """
    found: list[Criterion] = []
    for trigger in below(root, "StopTrigger"):
        for asked in below(trigger, "ParameterCondition"):
            name = criterion_name(asked)
            if name:
                # Without the name of an argument, ScenarioRunner gives the criterion no value.
                bounded = str(asked.attrib.get("parameterRef", "")).strip() and "value" in asked.attrib
                found.append(Criterion(name, float(scope.number(asked, "value")[0]) if bounded else None))
    return tuple(found)


def criterion_name(element: etree._Element) -> str:
    """Tell which criterion a condition stands for.

    Parameters
    ----------
    element : lxml element
        ``ParameterCondition``.

    Returns
    -------
    str
        Name of the criterion; empty where it stands for none.
    """
    name = _condition_name(element)
    return name.removeprefix(_PREFIX) if name.startswith(_PREFIX) else ""


def is_never_true(element: etree._Element, name: str) -> bool:
    """Tell whether a condition on a parameter that the file does not declare is no mistake, and note what it means.

    Parameters
    ----------
    element : lxml element
        ``ParameterCondition``.
    name : str
        Of the parameter.

    Returns
    -------
    bool
        Whether it is one of ScenarioRunner's criteria, or refers to no parameter at all.
    """
    for read in ("value", "rule"):
        element.get(read)
    if criterion_name(element):
        why = (
            "asks ScenarioRunner for a criterion to judge the run by, not for the value of a parameter; it is never"
            " true, nor is a group that it stands in"
        )
        adapt(element, _condition_name(element), why, _RULE)
        return True
    if not name.strip():
        why = "refers to no parameter; it is never true, nor is a group that it stands in"
        adapt(element, f"condition '{_condition_name(element)}'", why, _RULE)
        return True
    return False


def _condition_name(element: etree._Element) -> str:
    holder = next(element.iterancestors("Condition"), None)
    return "" if holder is None else str(holder.attrib.get("name", ""))
