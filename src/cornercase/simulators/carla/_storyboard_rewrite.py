"""Changes of a storyboard for ScenarioRunner: remove unsupported parts, make names unique, end acts in time."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable
from copy import deepcopy
from typing import Final, Protocol

from lxml import etree
from lxml.builder import ElementMaker

from cornercase._common.typing import FloatArray
from cornercase.recordings import Recording
from cornercase.simulators.carla._support_table import HandlingStatus, SupportFinding, find_unsupported


class _TypedMaker(Protocol):
    """Type of lxml's factory of XML elements, as in ``E.Tag(child, name="value")``."""

    def __getattr__(self, tag: str) -> Callable[..., etree._Element]: ...


E: Final[_TypedMaker] = ElementMaker()

_NAMED_ELEMENTS: Final = ("Story", "Act", "ManeuverGroup", "Maneuver", "Event", "Action", "Condition")
# Elements without effect that OpenSCENARIO 1.0 requires or other functions remove.
_REQUIRED_ELEMENTS: Final = ("BoundingBox", "Performance", "Axles", "ObjectController")
_ROUTE_ACTIONS: Final = ("AssignRouteAction", "AcquirePositionAction")


def remove_ineffective(root: etree._Element) -> None:
    """Remove all content that has no effect in ScenarioRunner, and all global actions."""
    for finding in list(find_unsupported(root)):
        if finding.row.status is HandlingStatus.WITHOUT_EFFECT:
            _remove_finding(finding)
    for action in list(root.iter("GlobalAction")):
        remove_element(_enclosing_action(action))
    for empty in [*root.iter("PrivateAction")]:
        if len(empty) == 0:
            remove_element(_enclosing_action(empty))


def _remove_finding(finding: SupportFinding) -> None:
    if finding.row.attribute:
        finding.element.attrib.pop(finding.row.attribute, "")
    elif finding.element.tag not in _REQUIRED_ELEMENTS:
        remove_element(finding.element)


def _enclosing_action(action: etree._Element) -> etree._Element:
    """Return the ``Action`` element around an event's action; for an initial action, return the action itself."""
    parent = action.getparent()
    return parent if parent is not None and parent.tag == "Action" else action


def remove_element(element: etree._Element) -> None:
    """Remove an element from its parent, if it has a parent."""
    parent = element.getparent()
    if parent is not None:
        parent.remove(element)


def remove_entities_from_storyboard(root: etree._Element, names: Collection[str]) -> None:
    """Remove entities from all maneuver groups, and then all elements that have become empty."""
    for reference in list(root.iterfind(".//Actors/EntityRef")):
        if reference.get("entityRef") in names:
            remove_element(reference)
    for event in list(root.iter("Event")):
        if event.find("Action") is None:
            remove_element(event)
    for group in list(root.iter("ManeuverGroup")):
        if group.find("Actors/EntityRef") is None or next(group.iter("Event"), None) is None:
            remove_element(group)
        else:
            for maneuver in group.findall("Maneuver"):
                if maneuver.find("Event") is None:
                    group.remove(maneuver)
    for tag, inner in (("Act", "ManeuverGroup"), ("Story", "Act")):
        for element in list(root.iter(tag)):
            if element.find(inner) is None:
                remove_element(element)


def set_initial_state(
    root: etree._Element,
    recording: Recording,
    keep_routes_of: Iterable[str],
    heights: FloatArray,
    *,
    by_centers: bool = False,
) -> None:
    """Replace all initial actions by positions, speeds and heights from the start of a recording.

    `keep_routes_of`: entities whose initial routes stay. `heights`: height in m of each entity of the recording. With
    `by_centers`, positions are those of the centres of boxes, where CARLA's actors have their origins.
    """
    actions = root.find("Storyboard/Init/Actions")
    assert actions is not None
    keeps_route, routes = set(keep_routes_of), {}
    for private in actions.findall("Private"):
        for action in private.findall("PrivateAction"):
            if any(action.find(f"RoutingAction/{action_tag}") is not None for action_tag in _ROUTE_ACTIONS):
                routes[private.get("entityRef", "")] = action
    for child in list(actions):
        actions.remove(child)
    entities = {entity.get("name") for entity in root.iterfind("Entities/ScenarioObject")}
    for k, name in enumerate(recording.names):
        if name not in entities:
            # Trailers are left out.
            continue
        heading, ahead = recording.heading[k, 0], float(recording.center_x[k]) if by_centers else 0.0
        x, y = recording.x[k, 0] + ahead * math.cos(heading), recording.y[k, 0] + ahead * math.sin(heading)
        position = make_world_position(x, y, heading)
        if heights[k]:
            position[0].set("z", format_number(heights[k]))
        private = E.Private(E.PrivateAction(E.TeleportAction(position)), entityRef=name)
        if name in keeps_route and name in routes:
            private.append(routes[name])
        if recording.object_types[k] != "misc":
            private.append(make_speed_action(max(float(recording.speed[k, 0]), 0.0)))
        actions.append(private)


def make_world_position(x: float, y: float, heading: float) -> etree._Element:
    """Create a <Position> of x and y in m and a heading in rad."""
    return E.Position(E.WorldPosition(x=format_number(x), y=format_number(y), h=format_number(heading)))


def make_speed_action(speed: float) -> etree._Element:
    """Create a ``PrivateAction`` that sets the speed in m/s at once."""
    dynamics = E.SpeedActionDynamics(dynamicsShape="step", dynamicsDimension="time", value="0")
    target = E.SpeedActionTarget(E.AbsoluteTargetSpeed(value=format_number(speed)))
    return E.PrivateAction(E.LongitudinalAction(E.SpeedAction(dynamics, target)))


def format_number(number: float) -> str:
    """Format a number with at most six decimals and without an exponent."""
    text = f"{float(number):.6f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text


def make_condition(name: str, by_value: etree._Element) -> etree._Element:
    """Create a ``ConditionGroup`` with a single condition; `by_value` is the element in its ``ByValueCondition``."""
    return E.ConditionGroup(E.Condition(E.ByValueCondition(by_value), name=name, delay="0", conditionEdge="none"))


def make_time_condition(name: str, seconds: float) -> etree._Element:
    """Create a ``ConditionGroup`` that is true after a time in s."""
    return make_condition(name, E.SimulationTimeCondition(value=format_number(seconds), rule="greaterThan"))


def add_missing_start_triggers(root: etree._Element) -> None:
    """Add a start trigger that is always true to events without one, since ScenarioRunner would never start them."""
    for event in root.iter("Event"):
        trigger = event.find("StartTrigger")
        if trigger is None:
            trigger = etree.SubElement(event, "StartTrigger")
        if len(trigger) == 0:
            trigger.append(make_time_condition("at once", -1.0))


def set_end_time(root: etree._Element, seconds: float, keep: Collection[etree._Element]) -> None:
    """End the storyboard at a time in s, or earlier when a condition group in `keep` becomes true.

    All other condition groups of the stop trigger are removed.
    """
    storyboard = root.find("Storyboard")
    assert storyboard is not None
    stop = storyboard.find("StopTrigger")
    if stop is None:
        stop = etree.SubElement(storyboard, "StopTrigger")
    for group in list(stop):
        if group not in keep:
            stop.remove(group)
    stop.append(make_time_condition("time is over", seconds))


def copy_stop_trigger_to_acts(root: etree._Element) -> None:
    """Copy the stop trigger of the storyboard to all acts, since ScenarioRunner ignores it in the storyboard."""
    stop = root.find("Storyboard/StopTrigger")
    groups = [] if stop is None else list(stop)
    for act in root.iter("Act"):
        start, act_stop = act.find("StartTrigger"), act.find("StopTrigger")
        if act_stop is None:
            act_stop = etree.SubElement(act, "StopTrigger")
        act_stop.extend(deepcopy(group) for group in groups)
        # ScenarioRunner waits for acts that have not started yet.
        if start is not None and len(start):
            start.extend(deepcopy(group) for group in groups)


def make_names_unique(root: etree._Element) -> None:
    """Make the names of storyboard elements unique, since ScenarioRunner confuses elements with equal names."""
    used_names: set[str] = set()
    renamed: dict[tuple[str, str], str] = {}
    for element in root.iterfind("Storyboard//*"):
        if element.tag not in _NAMED_ELEMENTS:
            continue
        tag, name = str(element.tag), element.get("name", "")
        unique_name, number = name or tag, 1
        while unique_name in used_names:
            number += 1
            unique_name = f"{name or tag} {number}"
        used_names.add(unique_name)
        element.set("name", unique_name)
        renamed.setdefault((tag.lower(), name), unique_name)
    for state in root.iter("StoryboardElementStateCondition"):
        reference = state.get("storyboardElementRef", "").replace("::", "/").rpartition("/")[2]
        tag = state.get("storyboardElementType", "").lower()
        state.set("storyboardElementRef", renamed.get((tag, reference), reference))
