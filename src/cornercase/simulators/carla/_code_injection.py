"""Refusal of scenario content that would make ScenarioRunner execute code."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common.errors import InputError
from cornercase.scenario._scenario_runner_criteria import find_requested_criterion

# ScenarioRunner's own controllers; it would import any module that a scenario names.
_ALLOWED_CONTROLLER_MODULES: Final = (
    "carla_autopilot", "external_control", "npc_vehicle_control", "pedestrian_control", "simple_vehicle_control",
    "vehicle_longitudinal_control",
)  # fmt: skip

# Criteria of ScenarioRunner that only need an actor and a number; it would instantiate any named class.
_SUPPORTED_CRITERIA: Final = (
    "AverageVelocityTest", "CollisionTest", "DrivenDistanceTest", "EndofRoadTest", "KeepLaneTest", "MaxVelocityTest",
    "OffRoadTest", "OnSidewalkTest", "RunningRedLightTest", "RunningStopTest", "WrongLaneTest",
)  # fmt: skip


def pop_criteria(root: etree._Element) -> dict[str, etree._Element]:
    """Remove the criteria of ScenarioRunner from all stop triggers; return the conditions of criteria, by their names.

    Criteria are tests by which ScenarioRunner judges a run. A stop trigger contains criteria as conditions that
    never become true. Condition groups with such a condition are removed, since they could not become true either.
    """
    declared = {declaration.get("name") for declaration in root.iterfind("ParameterDeclarations/ParameterDeclaration")}
    criteria: dict[str, etree._Element] = {}
    for trigger in root.iter("StopTrigger"):
        for group in trigger.findall("ConditionGroup"):
            for condition in group.findall("Condition"):
                parameter_condition = condition.find("ByValueCondition/ParameterCondition")
                name = "" if parameter_condition is None else find_requested_criterion(parameter_condition)
                if parameter_condition is not None and name and parameter_condition.get("parameterRef") not in declared:
                    criteria.setdefault(name, condition)
                    if group in trigger:
                        trigger.remove(group)
    return criteria


def add_criteria(root: etree._Element, criteria: Mapping[str, etree._Element]) -> list[str]:
    """Add the criteria by which ScenarioRunner may judge a run; return notes on criteria that are left out."""
    stop = root.find("Storyboard/StopTrigger")
    assert stop is not None
    supported = [condition for name, condition in criteria.items() if name in _SUPPORTED_CRITERIA]
    if supported:
        etree.SubElement(stop, "ConditionGroup").extend(supported)
    return [
        f"'{condition.get('name')}' is left out: ScenarioRunner has no such criterion, or needs more arguments for it."
        for name, condition in criteria.items()
        if name not in _SUPPORTED_CRITERIA
    ]


def refuse_code_injection(root: etree._Element, source: Path) -> None:
    """Raise `InputError` if a scenario names code that ScenarioRunner would execute.

    Such code is named by user-defined actions, by controllers that are not ScenarioRunner's own, and by conditions
    whose names start with ``criteria_``.
    """
    for action in root.iter("UserDefinedAction"):
        command = action.find("CustomCommandAction")
        description = "" if command is None else f" with the <CustomCommandAction> '{command.get('type')}'"
        raise InputError(
            f"{source}: has a <UserDefinedAction>{description}, which ScenarioRunner would run as a program; remove it:"
            " code that a scenario names is not run."
        )
    for module in root.iterfind(".//Property[@name='module']"):
        if module.get("value") not in _ALLOWED_CONTROLLER_MODULES:
            raise InputError(
                f"{source}: a controller names the module '{module.get('value')}', which is not one of ScenarioRunner's"
                f" own."
                " Code that a scenario names is not run; remove this controller, and give your agent as `simulator`"
                " carla:agent=FILE."
            )
    for condition in root.iter("Condition"):
        if condition.get("name", "").startswith("criteria_"):
            raise InputError(
                f"{source}: ScenarioRunner would run a class of its own for the condition '{condition.get('name')}',"
                f" since its"
                " name starts with 'criteria_'; rename the condition."
            )
