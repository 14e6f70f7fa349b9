"""What of a scenario ScenarioRunner would run as code, and whom it would let choose it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common.errors import InputError
from cornercase.scenario import criterion_name

# ScenarioRunner's own controllers; it would import any other module that a scenario names.
_MODULES: Final = (
    "carla_autopilot", "external_control", "npc_vehicle_control", "pedestrian_control", "simple_vehicle_control",
    "vehicle_longitudinal_control",
)  # fmt: skip

# Criteria of ScenarioRunner that need no more than an actor and a number; it would create whatever class is named.
_CRITERIA: Final = (
    "AverageVelocityTest", "CollisionTest", "DrivenDistanceTest", "EndofRoadTest", "KeepLaneTest", "MaxVelocityTest",
    "OffRoadTest", "OnSidewalkTest", "RunningRedLightTest", "RunningStopTest", "WrongLaneTest",
)  # fmt: skip


def take_out_criteria(root: etree._Element) -> dict[str, etree._Element]:
    """Remove the groups of stop triggers that hold criteria of ScenarioRunner, and so are never true.

    Parameters
    ----------
    root : Element
        Of a concrete scenario; changed in place.

    Returns
    -------
    dict of str to Element
        Conditions by the name of the criterion.
    """
    declared = {one.get("name") for one in root.iterfind("ParameterDeclarations/ParameterDeclaration")}
    found: dict[str, etree._Element] = {}
    for trigger in root.iter("StopTrigger"):
        for group in trigger.findall("ConditionGroup"):
            for condition in group.findall("Condition"):
                asked = condition.find("ByValueCondition/ParameterCondition")
                name = "" if asked is None else criterion_name(asked)
                if asked is not None and name and asked.get("parameterRef") not in declared:
                    found.setdefault(name, condition)
                    if group in trigger:
                        trigger.remove(group)
    return found


def put_in_criteria(root: etree._Element, criteria: Mapping[str, etree._Element]) -> list[str]:
    """Let ScenarioRunner judge a run by criteria of its own.

    Parameters
    ----------
    root : Element
        Changed in place.
    criteria : mapping of str to Element
        As `take_out_criteria` gives them.

    Returns
    -------
    list of str
        What is left out.
    """
    stop = root.find("Storyboard/StopTrigger")
    assert stop is not None
    known = [condition for name, condition in criteria.items() if name in _CRITERIA]
    if known:
        etree.SubElement(stop, "ConditionGroup").extend(known)
    return [
        f"'{condition.get('name')}' is left out, as ScenarioRunner has no such criterion, or has to know more for it."
        for name, condition in criteria.items()
        if name not in _CRITERIA
    ]


def refuse_code(root: etree._Element, source: Path) -> None:
    """Refuse a scenario that names code for ScenarioRunner to run.

    Parameters
    ----------
    root : Element
        Of a scenario without parameters and references to catalogs.
    source : Path
        For messages.

    Raises
    ------
    InputError
        It has a user-defined action, a controller's module that is none of ScenarioRunner's own, or a condition that
        ScenarioRunner would take for the name of a class.
    """
    for action in root.iter("UserDefinedAction"):
        command = action.find("CustomCommandAction")
        kind = "" if command is None else f" with the <CustomCommandAction> '{command.get('type')}'"
        raise InputError(
            f"{source}: has a <UserDefinedAction>{kind}, which ScenarioRunner would run as a program; code that a"
            " scenario names is not run, remove the action."
        )
    for module in root.iterfind(".//Property[@name='module']"):
        if module.get("value") not in _MODULES:
            raise InputError(
                f"{source}: a controller names the module '{module.get('value')}'; code that a scenario names is not"
                " run, give your own as `simulator` carla:agent=FILE."
            )
    for condition in root.iter("Condition"):
        if condition.get("name", "").startswith("criteria_"):
            raise InputError(
                f"{source}: ScenarioRunner would take the condition '{condition.get('name')}' for the name of a class,"
                " and create it; give it another name."
            )
