"""Events of a storyboard that move entities, and their start conditions, in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.text.sanitize import quote_name
from cornercase.report.cards._condition_texts import describe_position, describe_trigger, format_speed
from cornercase.scenario import Value
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._scope import Scope

_AT_START: Final = "at the start"


@dataclass(frozen=True)
class Movement:
    """Event of a storyboard that moves entities: who does what and when, in words; `actors` are entity names."""

    who: str
    what: str
    when: str
    actors: tuple[str, ...] = ()


def list_movements(scenario: ScenarioFile, values: Mapping[str, Value]) -> list[Movement]:
    """List the events of a scenario that move entities, with their start conditions in words.

    The words contain the parameter values of the concrete scenario. InputError if the file cannot be read with these
    values.
    """
    names = set(scenario.parameters)
    scope = scenario.scope([{name: value for name, value in values.items() if name in names}])
    return list(_iter_movements(scenario, scope))


def _iter_movements(scenario: ScenarioFile, scope: Scope) -> Iterator[Movement]:
    for act in scenario.root.iterfind("Storyboard/Story/Act"):
        act_when = describe_trigger(act.find("StartTrigger"), scope)
        # An act whose trigger is always true begins with the run.
        act_when = "" if act_when in ("0.00 s since the start", "at least 0.00 s since the start") else act_when
        for group in act.iterfind("ManeuverGroup"):
            actors = tuple(scope.read_text(actor, "entityRef") for actor in group.iterfind("Actors/EntityRef"))
            who = ", ".join(map(quote_name, actors)) or "–"
            for maneuver, inner in _maneuvers(group, scope):
                for event in maneuver.iterfind("Event"):
                    what = [text for action in event.iterfind("Action") if (text := _describe_action(action, inner))]
                    if what:
                        own = describe_trigger(event.find("StartTrigger"), inner)
                        when = ", and ".join(text for text in (act_when, own) if text) or _AT_START
                        when = _AT_START if when == "0.00 s since the start" else when
                        name = event.get("name", "")
                        yield Movement(who, f"{', '.join(what)} (“{name}”)", when, actors)


def _maneuvers(group: etree._Element, scope: Scope) -> Iterator[tuple[etree._Element, Scope]]:
    for child in group:
        if child.tag == "Maneuver":
            yield child, scope.nested_scope(child)
        elif child.tag == "CatalogReference":
            yield scope.resolve_catalog_reference(child, "Maneuver")


def _describe_action(action: etree._Element, scope: Scope) -> str:
    """Describe an action that moves its actors; empty for any other action."""
    leaf = next(
        (
            child
            for path in (
                "LongitudinalAction/*",
                "LateralAction/*",
                "RoutingAction/*",
                "SynchronizeAction",
                "TeleportAction",
            )
            if (child := action.find(f"PrivateAction/{path}")) is not None
        ),
        None,
    )
    if leaf is None:
        return ""
    try:
        return _describe_movement(leaf, scope)
    except InputError:
        return _WORDS.get(str(leaf.tag), str(leaf.tag))


def _describe_movement(leaf: etree._Element, scope: Scope) -> str:
    if leaf.tag == "SpeedAction":
        target = leaf.find("SpeedActionTarget/*")
        dynamics = leaf.find("SpeedActionDynamics")
        if target is None or target.tag != "AbsoluteTargetSpeed":
            return "changes its speed"
        return f"goes to {format_speed(scope.read_number(target, 'value'))}{_describe_dynamics(dynamics, scope)}"
    if leaf.tag == "SynchronizeAction":
        targets = leaf.find("TargetPosition/*"), leaf.find("TargetPositionMaster/*")
        master = quote_name(scope.read_text(leaf, "masterEntityRef"))
        own, of_master = ("its place" if target is None else describe_position(target, scope) for target in targets)
        return f"times its speed to be at {own} when {master} is at {of_master}"
    return _WORDS.get(str(leaf.tag), str(leaf.tag))


def _describe_dynamics(dynamics: etree._Element | None, scope: Scope) -> str:
    if dynamics is None or scope.read_text(dynamics, "dynamicsShape", "step") == "step":
        return " at once"
    value = scope.read_number(dynamics, "value")
    unit = {"time": "within {} s", "distance": "within {} m", "rate": "with {} m/s²"}
    return " " + unit.get(scope.read_text(dynamics, "dynamicsDimension", "time"), "").format(f"{value:g}")


_WORDS: Final = {
    "SpeedAction": "changes its speed",
    "SpeedProfileAction": "follows a speed profile",
    "LongitudinalDistanceAction": "keeps a distance",
    "LaneChangeAction": "changes lane",
    "LaneOffsetAction": "moves aside in its lane",
    "LateralDistanceAction": "keeps a distance to the side",
    "AssignRouteAction": "takes a route",
    "FollowTrajectoryAction": "follows a trajectory",
    "AcquirePositionAction": "goes to a place",
    "RandomRouteAction": "takes a route at random",
    "SynchronizeAction": "times its speed to be at a place with another",
    "TeleportAction": "is put to a place",
}
