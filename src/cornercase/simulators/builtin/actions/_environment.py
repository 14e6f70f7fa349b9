"""The action that changes the environment; only the friction of the road is simulated."""

from __future__ import annotations

from pathlib import Path

from lxml import etree

from cornercase._common.io.support_table import NoticeLabel
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.scenario._scope import Scope
from cornercase.simulators.builtin.actions._action import Action
from cornercase.simulators.builtin.actions._controller import DriverControl
from cornercase.simulators.builtin.world._world import World


class FrictionAction(Action):
    """Action that sets the friction of the road for the vehicle models of all entities."""

    def __init__(self, friction: FloatArray, location: str) -> None:
        self._friction, self._location = friction, location

    def start(self, world: World, where: BoolArray) -> None:
        world.friction[where] = self._friction[where]
        drivers = [driver for driver in world.drivers if isinstance(driver, DriverControl)]
        if all(driver.attached_driver.vehicle is None for driver in drivers):
            subject, reason = (
                "frictionScaleFactor of <RoadCondition>",
                "no entity has a vehicle model, on which it acts",
            )
            changed = where & (self._friction != 1.0)
            world.add_notice(self._location, subject, reason, changed, NoticeLabel.WITHOUT_EFFECT)


def read_environment_action(
    element: etree._Element, scope: Scope, world: World, entity: int | None
) -> FrictionAction | None:
    """Read an ``EnvironmentAction``; None if its environment says nothing about the friction of the road."""
    environment, reference = element.find("Environment"), element.find("CatalogReference")
    if environment is None and reference is not None:
        environment, scope = scope.resolve_catalog_reference(reference, "Environment")
    elif environment is not None:
        scope = scope.nested_scope(environment)
    condition = None if environment is None else environment.find("RoadCondition")
    if condition is None:
        return None
    friction = scope.read_numbers(condition, "frictionScaleFactor")
    scope.mark_invalid(condition, "frictionScaleFactor", "is below 0", friction < 0.0)
    return FrictionAction(friction, f"{Path(scope.file_name).name}, line {condition.sourceline}")
