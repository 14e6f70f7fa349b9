"""What of a scenario ScenarioRunner would run as code, and whom it would let choose it."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common.errors import InputError

# ScenarioRunner's own controllers; it would import any other module that a scenario names.
_MODULES: Final = (
    "carla_autopilot", "external_control", "npc_vehicle_control", "pedestrian_control", "simple_vehicle_control",
    "vehicle_longitudinal_control",
)  # fmt: skip


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
