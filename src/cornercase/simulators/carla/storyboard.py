"""The storyboard as ScenarioRunner takes it: what others do is taken out, names are unique, acts end with it."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from copy import deepcopy
from typing import Final

from lxml import etree

from cornercase._common.typing import FloatArray
from cornercase.recordings import Recording
from cornercase.simulators.carla.table import Finding, Status, findings

_NAMED: Final = ("Story", "Act", "ManeuverGroup", "Maneuver", "Event", "Action", "Condition")
# Without effect, but 1.0 asks for them, or they are taken out elsewhere.
_REQUIRED: Final = ("BoundingBox", "Performance", "Axles", "ObjectController")
_ROUTES: Final = ("AssignRouteAction", "AcquirePositionAction")


def leave_out(root: etree._Element) -> None:
    """Leave out what has no effect on ScenarioRunner, and global actions.

    Parameters
    ----------
    root : lxml element
        Changed in place.
    """
    for one in list(findings(root)):
        if one.row.status is Status.WITHOUT_EFFECT:
            _take_out(one)
    for action in list(root.iter("GlobalAction")):
        _remove(_holder_of(action))
    for empty in [*root.iter("PrivateAction")]:
        if len(empty) == 0:
            _remove(_holder_of(empty))


def _take_out(one: Finding) -> None:
    if one.row.attribute:
        one.element.attrib.pop(one.row.attribute, "")
    elif one.element.tag not in _REQUIRED:
        _remove(one.element)


def _holder_of(action: etree._Element) -> etree._Element:
    """The ``Action`` around an action of an event; the action itself in ``Init``."""
    parent = action.getparent()
    return parent if parent is not None and parent.tag == "Action" else action


def _remove(element: etree._Element) -> None:
    parent = element.getparent()
    if parent is not None:
        parent.remove(element)


def take_over(root: etree._Element, names: Collection[str]) -> None:
    """Take entities out of the storyboard, and what then has nothing to do.

    Parameters
    ----------
    root : lxml element
        Changed in place.
    names : collection of str
    """
    for reference in list(root.iterfind(".//Actors/EntityRef")):
        if reference.get("entityRef") in names:
            _remove(reference)
    for event in list(root.iter("Event")):
        if event.find("Action") is None:
            _remove(event)
    for group in list(root.iter("ManeuverGroup")):
        if group.find("Actors/EntityRef") is None or next(group.iter("Event"), None) is None:
            _remove(group)
        else:
            for maneuver in group.findall("Maneuver"):
                if maneuver.find("Event") is None:
                    group.remove(maneuver)
    for tag, inner in (("Act", "ManeuverGroup"), ("Story", "Act")):
        for element in list(root.iter(tag)):
            if element.find(inner) is None:
                _remove(element)


def set_beginning(root: etree._Element, recording: Recording, names: Iterable[str], heights: FloatArray) -> None:
    """Give each entity the position and the speed of the first instant.

    Routes stay for our own controller; all else that is in ``Init`` goes.

    Parameters
    ----------
    root : lxml element
        Changed in place.
    recording : Recording
    names : iterable of str
        Entities that keep their routes.
    heights : ndarray of float64, shape (A,)
        m.
    """
    actions = root.find("Storyboard/Init/Actions")
    assert actions is not None
    keeping, routes = set(names), {}
    for private in actions.findall("Private"):
        for action in private.findall("PrivateAction"):
            if any(action.find(f"RoutingAction/{kind}") is not None for kind in _ROUTES):
                routes[private.get("entityRef", "")] = action
    for child in list(actions):
        actions.remove(child)
    entities = {one.get("name") for one in root.iterfind("Entities/ScenarioObject")}
    for k, name in enumerate(recording.names):
        if name not in entities:
            # A trailer, which is left out.
            continue
        private = etree.SubElement(actions, "Private", entityRef=name)
        holder = etree.SubElement(etree.SubElement(private, "PrivateAction"), "TeleportAction")
        position = world_position(recording.x[k, 0], recording.y[k, 0], recording.heading[k, 0])
        if heights[k]:
            position[0].set("z", plain(heights[k]))
        holder.append(position)
        if name in keeping and name in routes:
            private.append(routes[name])
        if recording.kinds[k] != "misc":
            outer = etree.SubElement(etree.SubElement(private, "PrivateAction"), "LongitudinalAction")
            outer.append(speed_action(max(float(recording.speed[k, 0]), 0.0)))


def world_position(x: float, y: float, heading: float) -> etree._Element:
    """Make a ``Position``.

    Parameters
    ----------
    x, y : float
        m.
    heading : float
        rad.

    Returns
    -------
    lxml element
    """
    position = etree.Element("Position")
    etree.SubElement(position, "WorldPosition", x=plain(x), y=plain(y), h=plain(heading))
    return position


def speed_action(speed: float) -> etree._Element:
    """Make a ``SpeedAction`` that takes no time.

    Parameters
    ----------
    speed : float
        m/s.

    Returns
    -------
    lxml element
    """
    action = etree.Element("SpeedAction")
    etree.SubElement(action, "SpeedActionDynamics", dynamicsShape="step", dynamicsDimension="time", value="0")
    target = etree.SubElement(action, "SpeedActionTarget")
    etree.SubElement(target, "AbsoluteTargetSpeed", value=plain(speed))
    return action


def plain(number: float) -> str:
    """Write a number to a micrometre, without an exponent.

    Parameters
    ----------
    number : float

    Returns
    -------
    str
    """
    text = f"{float(number):.6f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text


def at_time(name: str, seconds: float) -> etree._Element:
    """Make a ``ConditionGroup`` that is true after a time.

    Parameters
    ----------
    name : str
        Of its condition.
    seconds : float

    Returns
    -------
    lxml element
    """
    group = etree.Element("ConditionGroup")
    condition = etree.SubElement(group, "Condition", name=name, delay="0", conditionEdge="none")
    holder = etree.SubElement(condition, "ByValueCondition")
    etree.SubElement(holder, "SimulationTimeCondition", value=plain(seconds), rule="greaterThan")
    return group


def start_at_once(root: etree._Element) -> None:
    """Give events without a condition one that is always true, as ScenarioRunner never starts them otherwise.

    Parameters
    ----------
    root : lxml element
        Changed in place.
    """
    for event in root.iter("Event"):
        trigger = event.find("StartTrigger")
        if trigger is None:
            trigger = etree.SubElement(event, "StartTrigger")
        if len(trigger) == 0:
            trigger.append(at_time("at once", -1.0))


def end_at(root: etree._Element, seconds: float, keep: Collection[etree._Element]) -> None:
    """Let the storyboard end after a time, unless something else that is kept ends it before.

    Parameters
    ----------
    root : lxml element
        Changed in place.
    seconds : float
    keep : collection of lxml element
        Groups of conditions of its stop trigger that stay.
    """
    storyboard = root.find("Storyboard")
    assert storyboard is not None
    stop = storyboard.find("StopTrigger")
    if stop is None:
        stop = etree.SubElement(storyboard, "StopTrigger")
    for group in list(stop):
        if group not in keep:
            stop.remove(group)
    stop.append(at_time("time is over", seconds))


def end_acts(root: etree._Element) -> None:
    """Let acts end with the storyboard, whose own stop trigger ScenarioRunner does not read.

    Parameters
    ----------
    root : lxml element
        Changed in place.
    """
    stop = root.find("Storyboard/StopTrigger")
    groups = [] if stop is None else list(stop)
    for act in root.iter("Act"):
        start, own = act.find("StartTrigger"), act.find("StopTrigger")
        if own is None:
            own = etree.SubElement(act, "StopTrigger")
        own.extend(deepcopy(group) for group in groups)
        # ScenarioRunner waits for acts that have not started yet.
        if start is not None and len(start):
            start.extend(deepcopy(group) for group in groups)


def name_apart(root: etree._Element) -> None:
    """Give all parts of the storyboard names of their own, as ScenarioRunner takes two of one name for the same.

    Parameters
    ----------
    root : lxml element
        Changed in place.
    """
    taken: set[str] = set()
    renamed: dict[tuple[str, str], str] = {}
    for element in root.iterfind("Storyboard//*"):
        if element.tag not in _NAMED:
            continue
        kind, name = str(element.tag), element.get("name", "")
        chosen, number = name or kind, 1
        while chosen in taken:
            number += 1
            chosen = f"{name or kind} {number}"
        taken.add(chosen)
        element.set("name", chosen)
        renamed.setdefault((kind.lower(), name), chosen)
    for state in root.iter("StoryboardElementStateCondition"):
        reference = state.get("storyboardElementRef", "").replace("::", "/").rpartition("/")[2]
        kind = state.get("storyboardElementType", "").lower()
        state.set("storyboardElementRef", renamed.get((kind, reference), reference))
