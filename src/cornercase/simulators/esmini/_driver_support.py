"""Checks that a driver of cornercase can drive an entity in esmini."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from lxml import etree

from cornercase._common.errors import InputError
from cornercase.scenario._file import ScenarioFile

_CONTROLLER_ACTIONS: Final = ("AssignControllerAction", "ActivateControllerAction")
_SPEED_ACTIONS: Final = ("LongitudinalAction", "SynchronizeAction")
_SELF_MADE_TRAFFIC: Final = ("TrafficSwarmAction", "TrafficSourceAction")


def check_driver_support(scenario: ScenarioFile, entity: str) -> None:
    """Raise `InputError` if a driver of cornercase cannot drive an entity as its storyboard demands."""
    scope, root = scenario.scope([{}]), scenario.root
    if not scenario.road_file_as_written():
        raise InputError(
            f"{scenario.path}: has no road file, but the driver of '{entity}' needs roads in esmini; name a road file"
            " in <LogicFile>, or leave out the driver."
        )
    initial = find_initial_trajectory_action(scenario, entity)
    refused = [(tag, "esmini cannot change who drives while it runs") for tag in _CONTROLLER_ACTIONS] + [
        ("FollowTrajectoryAction", "esmini lets it follow only a trajectory without times, and only from the start")
    ]
    if initial is not None:
        refused += [(tag, "esmini does not let it change its target speed on a trajectory") for tag in _SPEED_ACTIONS]
    for tag, reason in refused:
        if (element := next(_iter_later_actions(scenario, entity, tag), None)) is not None:
            raise scope.error_at(element, f"<{tag}>: '{entity}' has a driver, and {reason}; leave out one of them.")
    if initial is not None and (timing := initial.find("TimeReference/Timing")) is not None:
        raise scope.error_at(
            timing,
            f"<Timing>: '{entity}' has a driver, which decides the speed on the trajectory; replace it by <None/>, or"
            " leave out the driver.",
        )
    for element in root.iter(*_SELF_MADE_TRAFFIC):
        raise scope.error_at(
            element,
            f"<{element.tag}>: the driver of '{entity}' does not see entities that esmini adds by itself; use"
            " <ScenarioObject>, or leave out the driver.",
        )


def find_initial_trajectory_action(scenario: ScenarioFile, entity: str) -> etree._Element | None:
    """Return the initial action by which an entity follows a trajectory; None without this action."""
    return next(_iter_initial_actions(scenario, entity, "FollowTrajectoryAction"), None)


def has_initial_speed(scenario: ScenarioFile, entity: str) -> bool:
    """Return whether an entity has an initial longitudinal action, such as an action that sets its speed."""
    return next(_iter_initial_actions(scenario, entity, "LongitudinalAction"), None) is not None


def _iter_initial_actions(scenario: ScenarioFile, entity: str, tag: str) -> Iterator[etree._Element]:
    scope = scenario.scope([{}])
    for private in scenario.root.iterfind("Storyboard/Init/Actions/Private"):
        if scope.read_text(private, "entityRef") == entity:
            yield from private.iter(tag)


def _iter_later_actions(scenario: ScenarioFile, entity: str, tag: str) -> Iterator[etree._Element]:
    scope = scenario.scope([{}])
    for group in scenario.root.iter("ManeuverGroup"):
        if entity in [scope.read_text(actor, "entityRef") for actor in group.iterfind("Actors/EntityRef")]:
            yield from group.iter(tag)
            for reference in group.iterfind("CatalogReference"):
                yield from scope.resolve_catalog_reference(reference, "Maneuver")[0].iter(tag)
