"""Decide which entities ScenarioRunner can move by the storyboard, and which need trajectories."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common.errors import InputError
from cornercase.scenario import DRIVER_PROPERTY, way_to_map
from cornercase.simulators.carla.table import Finding, Row, Status, findings

# Conditions that stay true once they are true.
_LASTING: Final = ("SimulationTimeCondition", "TraveledDistanceCondition", "StoryboardElementStateCondition")
_REFERENCES: Final = ("entityRef", "masterEntityRef")


@dataclass
class Plan:
    """How each entity of a scenario is moved.

    `sampled`: entities that move along a trajectory, with reasons; `reacting`: those that react to externally driven
    ones; `dropped`: driven entities whose events are left out; `notes`: what has no effect or differs.
    """

    sampled: dict[str, list[str]] = field(default_factory=dict)
    reacting: set[str] = field(default_factory=set)
    dropped: set[str] = field(default_factory=set)
    notes: list[str] = field(default_factory=list)


def plan(
    root: etree._Element,
    driven: Collection[str],
    source: Path,
    map_of_carla: str,
    astray: Mapping[str, str],
    slowest: Mapping[str, float],
) -> Plan:
    """Decide how each entity is moved.

    An entity that does not react to an externally driven one always moves the same way, so a trajectory loses nothing:
    it gets one wherever ScenarioRunner deviates from the storyboard. An entity that reacts keeps the storyboard as long
    as ScenarioRunner does something similar.

    `driven` are entities that an agent drives. `map_of_carla` is the map's name, empty if there is a road file (without
    one, no trajectories can be sampled). `astray` says why ScenarioRunner's controls would lead entities elsewhere.
    `slowest` is the lowest speed of each entity in the builtin simulator in m/s (missing: 0). Raises `InputError` if an
    entity needs a trajectory and there is none.
    """
    names = [element.get("name", "") for element in root.iterfind("Entities/ScenarioObject")]
    parts = {name: list(_parts(root, name)) for name in names}
    reacting = _reacting(root, parts, driven)
    result = Plan(reacting=reacting - set(driven))
    result.notes += _left_out(root)
    for name in names:
        if name in driven:
            _driven(name, parts[name], result)
            continue
        deviations: list[str] = []
        for part in parts[name]:
            for finding in (*findings(part), *_between_the_lines(part, root), *_backwards(part, driven, slowest)):
                if finding.row.status is Status.SAMPLED:
                    result.sampled.setdefault(name, []).append(_reason(finding))
                elif finding.row.status is Status.APPROXIMATE:
                    deviations.append(_reason(finding))
        if name in astray:
            deviations.append(astray[name])
        if _has_driver(root, name):
            deviations.append("it has a driver of cornercase")
        if map_of_carla and name in result.sampled:
            raise InputError(
                f"{source}: ScenarioRunner cannot move '{name}' like that ({result.sampled[name][0]}), and a trajectory"
                f" needs a road file besides CARLA's map {map_of_carla}; {way_to_map(map_of_carla)}."
            )
        if deviations and name not in reacting and not map_of_carla:
            result.sampled.setdefault(name, []).extend(deviations)
        elif deviations and name not in result.sampled:
            result.notes += [f"{name}: {reason}." for reason in dict.fromkeys(deviations)]
    _follow_references(root, parts, result, driven)
    result.notes += [
        f"{name} moves along a trajectory of the builtin simulator, as {'; '.join(dict.fromkeys(reasons))}."
        for name, reasons in result.sampled.items()
    ]
    result.notes += [
        f"{name} should react to {' and '.join(driven)}, but no longer does."
        for name in result.sampled
        if name in reacting
    ]
    return result


def kept_ends(root: etree._Element, made: Plan, driven: Collection[str]) -> list[etree._Element]:
    """Return the condition groups of the stop trigger that depend on externally driven entities and stay.

    Adds a note to the plan for each group that does not stay.
    """
    groups = []
    for group in root.iterfind("Storyboard/StopTrigger/ConditionGroup"):
        all_findings = [*findings(group), *_between_the_lines(group, root)]
        unsupported = [finding for finding in all_findings if finding.row.status is Status.SAMPLED]
        if len(group) > 1 or not driven:
            unsupported = unsupported or [
                _sampled(group, "one condition of a group is enough for ScenarioRunner to end an act")
            ]
        if not unsupported:
            groups.append(group)
        elif driven:
            made.notes.append(f"The stop trigger is without {_reason(unsupported[0])}.")
    return groups


def _driven(name: str, parts: list[etree._Element], made: Plan) -> None:
    """Drop the events of an agent-driven entity if ScenarioRunner would fail at one."""
    for part in parts:
        if part.tag == "ManeuverGroup" and any(finding.row.status is Status.SAMPLED for finding in findings(part)):
            made.dropped.add(name)
    if name in made.dropped:
        made.notes.append(f"{name}: its events are left out, as an agent drives it.")


def _parts(root: etree._Element, name: str) -> Iterator[etree._Element]:
    """Storyboard elements that move an entity: its own actions, its maneuver groups, and triggers of their acts."""
    yield from (
        element for element in root.iterfind("Storyboard/Init/Actions/Private") if element.get("entityRef") == name
    )
    for action in root.iter("EntityAction"):
        if action.get("entityRef") == name:
            yield action
    for group in root.iter("ManeuverGroup"):
        if any(element.get("entityRef") == name for element in group.iterfind("Actors/EntityRef")):
            yield group
            act = group.getparent()
            if act is not None:
                yield from (*act.iterfind("StartTrigger"), *act.iterfind("StopTrigger"))


def refuse(root: etree._Element, source: Path) -> None:
    """Raise `InputError` for the first element or attribute that the support table refuses or lacks."""
    for finding in findings(root):
        if finding.row.status is Status.REFUSED:
            raise InputError(f"{source}, line {finding.element.sourceline}: {finding.what} {_refusal(finding)}.")


def _left_out(root: etree._Element) -> list[str]:
    without: dict[str, list[str]] = {}
    for finding in findings(root):
        if finding.row.status is Status.WITHOUT_EFFECT:
            without.setdefault(finding.row.note, []).append(finding.what)
    return [f"{', '.join(dict.fromkeys(names))}: without effect, as {note}." for note, names in without.items()]


def _refusal(one: Finding) -> str:
    return one.row.note if one.row.note.startswith("is ") else f"cannot be used, as {one.row.note}"


def _reason(one: Finding) -> str:
    return f"{one.what}: {one.row.note}"


def _between_the_lines(part: etree._Element, root: etree._Element) -> Iterator[Finding]:
    """Find deviations that no single element or attribute shows."""
    if part.tag == "Private":
        yield from _init(part)
    for group in part.iter("ConditionGroup"):
        conditions = group.findall("Condition")
        lasting = all(any(condition.find(f".//{tag}") is not None for tag in _LASTING) for condition in conditions)
        if len(conditions) > 1 and not lasting:
            yield _approximate(group, "it is enough for ScenarioRunner that each condition has been true at some time")
    for entities in part.iter("TriggeringEntities"):
        if len(entities) > 1:
            yield _sampled(entities, "ScenarioRunner looks at the last entity only")
    for time in part.iter("SimulationTimeCondition"):
        if time.get("rule", "").startswith("less"):
            yield _approximate(time, "ScenarioRunner counts from when it first looks at the condition")
    for state in part.iter("StoryboardElementStateCondition"):
        if not _stays(root, state):
            yield _sampled(state, "it waits for what is left out")
    act = part.getparent() if part.tag == "ManeuverGroup" else None
    if act is not None and not _at_once(act) and any(True for _ in part.iter("SimulationTimeCondition")):
        yield _approximate(part, "ScenarioRunner counts the time from the start of the act")
    if part.tag == "StopTrigger":
        for group in part.iterfind("ConditionGroup"):
            if len(group) > 1:
                yield _approximate(group, "one condition of a group is enough for ScenarioRunner to end an act")


def _backwards(part: etree._Element, driven: Collection[str], slowest: Mapping[str, float]) -> Iterator[Finding]:
    """Find speeds below 0, at which ScenarioRunner stops."""
    for speed in part.iter("AbsoluteTargetSpeed", "AbsoluteSpeed"):
        if float(speed.get("value", "0")) < 0.0:
            yield _sampled(speed, "ScenarioRunner stops at speeds below 0")
    for speed in part.iter("RelativeTargetSpeed", "RelativeSpeedToMaster"):
        action = next(speed.iterancestors("SynchronizeAction"), None)
        other = speed.get("entityRef", "") if action is None else action.get("masterEntityRef", "")
        value, slowest_speed = float(speed.get("value", "0")), slowest.get(other, 0.0)
        factor = speed.get("speedTargetValueType") == "factor"
        if slowest_speed < 0.0 or (value < 0.0 if factor else slowest_speed + value < 0.0):
            yield _sampled(speed, "ScenarioRunner stops at speeds below 0")
        elif other in driven and value < 0.0:
            yield _approximate(speed, "ScenarioRunner stops if it leads below 0")


def _init(private: etree._Element) -> Iterator[Finding]:
    """Find initial actions that ScenarioRunner does not execute, besides the first position and speed."""
    for action_tag in ("LateralAction", "SynchronizeAction", "LongitudinalDistanceAction", "SpeedProfileAction"):
        for action in private.iter(action_tag):
            yield _sampled(action, "ScenarioRunner does not do it in <Init> as the standard says")
    is_walker = not any(
        element.get("name") == private.get("entityRef") and element.find("Vehicle") is not None
        for element in private.getroottree().iterfind("Entities/ScenarioObject")
    )
    for action_tag in ("AssignRouteAction", "AcquirePositionAction") if is_walker else ():
        for action in private.iter(action_tag):
            yield _sampled(action, "CARLA's route planner is for vehicles")
    for relative in private.iter("RelativeTargetSpeed"):
        if relative.get("continuous") in ("true", "1"):
            yield _sampled(relative, "ScenarioRunner does not do it in <Init>")


def _at_once(act: etree._Element) -> bool:
    """Return whether an act starts with the scenario."""
    trigger = act.find("StartTrigger")
    for condition in () if trigger is None else trigger.iter("Condition"):
        time = condition.find("ByValueCondition/SimulationTimeCondition")
        if time is None or not time.get("rule", "").startswith("greater") or float(time.get("value", "0")) > 0.0:
            return False
    return True


def _approximate(element: etree._Element, note: str) -> Finding:
    return _found(element, Status.APPROXIMATE, note)


def _sampled(element: etree._Element, note: str) -> Finding:
    return _found(element, Status.SAMPLED, note)


def _found(element: etree._Element, status: Status, note: str) -> Finding:
    return Finding(f"<{element.tag}>", Row(str(element.tag), "", (), status, note), element)


def _has_driver(root: etree._Element, name: str) -> bool:
    for holder in root.iterfind("Entities/ScenarioObject"):
        if holder.get("name") == name:
            return holder.find(f".//Property[@name='{DRIVER_PROPERTY}']") is not None
    return False


def _reacting(root: etree._Element, parts: dict[str, list[etree._Element]], driven: Collection[str]) -> set[str]:
    """Entities whose motion depends on externally driven ones, including these."""
    referenced = {
        name: {
            element.get(attribute, "")
            for part in elements
            for element in part.iter()
            for attribute in _REFERENCES
            if isinstance(element.tag, str) and element.get(attribute) is not None
        }
        for name, elements in parts.items()
    }
    for name, elements in parts.items():
        for state in (element for part in elements for element in part.iter("StoryboardElementStateCondition")):
            referenced[name] |= _actors_of(root, state)
        if _has_driver(root, name):
            referenced[name] |= set(parts)
    reacting = set(driven)
    while more := {name for name, names in referenced.items() if name not in reacting and names & reacting}:
        reacting |= more
    return reacting


def _stays(root: etree._Element, state: etree._Element) -> bool:
    """Return whether everything that a condition refers to stays in the storyboard, if its actors do."""
    elements = [
        element
        for element in _named(root, state)
        if str(element.tag).lower() == state.get("storyboardElementType", "").lower()
    ]
    return bool(elements) and not any(
        action.tag == "GlobalAction" or finding.row.status is Status.WITHOUT_EFFECT
        for element in elements
        for action in element.iter("PrivateAction", "GlobalAction")
        for finding in findings(action)
    )


def _named(root: etree._Element, state: etree._Element) -> list[etree._Element]:
    """Storyboard elements with the name that a condition refers to."""
    name = state.get("storyboardElementRef", "").replace("::", "/").rpartition("/")[2]
    return [element for element in root.iterfind("Storyboard/Story//*[@name]") if element.get("name") == name]


def _actors_of(root: etree._Element, state: etree._Element) -> set[str]:
    """Entities that act in the storyboard elements that a condition refers to."""
    return {
        reference.get("entityRef", "")
        for element in _named(root, state)
        for group in (*element.iter("ManeuverGroup"), *element.iterancestors("ManeuverGroup"))
        for reference in group.iterfind("Actors/EntityRef")
    }


def _follow_references(
    root: etree._Element, parts: dict[str, list[etree._Element]], made: Plan, driven: Collection[str]
) -> None:
    """Give trajectories also to entities that wait for events that are replaced."""
    waiting = {
        name: {
            actor
            for part in elements
            for state in part.iter("StoryboardElementStateCondition")
            for actor in _actors_of(root, state)
        }
        for name, elements in parts.items()
        if name not in driven
    }

    def gone(made: Plan) -> set[str]:
        return made.dropped | set(made.sampled)

    while more := [name for name, actors in waiting.items() if name not in made.sampled and actors & gone(made)]:
        for name in more:
            made.sampled[name] = ["it waits for events of one that moves along a trajectory"]
