"""Which entities ScenarioRunner can move by the storyboard, and which move along trajectories instead."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common.errors import InputError
from cornercase.scenario import DRIVER_PROPERTY, way_to_map
from cornercase.simulators.carla.table import Finding, Row, Status, findings

# Conditions that stay true once they are.
_LASTING: Final = ("SimulationTimeCondition", "TraveledDistanceCondition", "StoryboardElementStateCondition")
_REFERENCES: Final = ("entityRef", "masterEntityRef")


@dataclass
class Plan:
    """How each entity of a scenario is moved.

    Attributes
    ----------
    sampled : dict of str to list of str
        Entities that move along a trajectory, each with the reasons.
    reacting : set of str
        Those that react to who is driven from outside.
    dropped : set of str
        Driven entities whose events are left out.
    notes : list of str
        What has no effect, and what is done otherwise.
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

    Who does not react to an entity that is driven from outside always moves in the same way, so that a trajectory loses
    nothing; it takes one wherever ScenarioRunner does not do exactly what the storyboard says. Who reacts keeps the
    storyboard as long as ScenarioRunner does something near.

    Parameters
    ----------
    root : lxml element
        Of a concrete scenario, without references to catalogs.
    driven : collection of str
        Entities that an agent drives, whatever the storyboard says.
    source : Path
        For messages.
    map_of_carla : str
        Name of the map; empty where there is a road file, without which there is no run to take trajectories from.
    astray : mapping of str to str
        Entities that ScenarioRunner's own controls would take elsewhere, and why.
    slowest : mapping of str to float
        Lowest speed of each entity in the builtin simulator, m/s; what is missing is taken to stop.

    Returns
    -------
    Plan

    Raises
    ------
    InputError
        An entity needs a trajectory, and there is none.
    """
    names = [one.get("name", "") for one in root.iterfind("Entities/ScenarioObject")]
    parts = {name: list(_parts(root, name)) for name in names}
    reacting = _reacting(root, parts, driven)
    made = Plan(reacting=reacting - set(driven))
    made.notes += _left_out(root)
    for name in names:
        if name in driven:
            _driven(name, parts[name], made)
            continue
        near: list[str] = []
        for part in parts[name]:
            for one in (*findings(part), *_between_the_lines(part, root), *_backwards(part, driven, slowest)):
                if one.row.status is Status.SAMPLED:
                    made.sampled.setdefault(name, []).append(_reason(one))
                elif one.row.status is Status.APPROXIMATE:
                    near.append(_reason(one))
        if name in astray:
            near.append(astray[name])
        if _has_driver(root, name):
            near.append("it has a driver of cornercase")
        if map_of_carla and name in made.sampled:
            raise InputError(
                f"{source}: ScenarioRunner cannot move '{name}' so ({made.sampled[name][0]}), and without a road file"
                f" beside CARLA's map {map_of_carla} there is no trajectory instead; {way_to_map(map_of_carla)}."
            )
        if near and name not in reacting and not map_of_carla:
            made.sampled.setdefault(name, []).extend(near)
        elif near and name not in made.sampled:
            made.notes += [f"{name}: {reason}." for reason in dict.fromkeys(near)]
    _follow_references(root, parts, made, driven)
    made.notes += [
        f"{name} moves along a trajectory of the builtin simulator, as {'; '.join(dict.fromkeys(why))}."
        for name, why in made.sampled.items()
    ]
    made.notes += [
        f"{name} would react to {' and '.join(driven)}, and no longer does."
        for name in made.sampled
        if name in reacting
    ]
    return made


def kept_ends(root: etree._Element, made: Plan, driven: Collection[str]) -> list[etree._Element]:
    """Find what of the storyboard's stop trigger stays: what depends on entities that are driven from outside.

    Parameters
    ----------
    root : lxml element
    made : Plan
        Gets a note for what does not stay.
    driven : collection of str

    Returns
    -------
    list of lxml element
        Groups of conditions.
    """
    kept = []
    for group in root.iterfind("Storyboard/StopTrigger/ConditionGroup"):
        found = [*findings(group), *_between_the_lines(group, root)]
        wrong = [one for one in found if one.row.status is Status.SAMPLED]
        if len(group) > 1 or not driven:
            wrong = wrong or [_sampled(group, "one condition of a group is enough for ScenarioRunner to end an act")]
        if not wrong:
            kept.append(group)
        elif driven:
            made.notes.append(f"The stop trigger is without {_reason(wrong[0])}.")
    return kept


def _driven(name: str, parts: list[etree._Element], made: Plan) -> None:
    """Leave out the events of an entity that an agent drives, where ScenarioRunner would stop at one."""
    for part in parts:
        if part.tag == "ManeuverGroup" and any(one.row.status is Status.SAMPLED for one in findings(part)):
            made.dropped.add(name)
    if name in made.dropped:
        made.notes.append(f"{name}: its events are left out, as an agent drives it.")


def _parts(root: etree._Element, name: str) -> Iterator[etree._Element]:
    """What of a storyboard moves an entity: actions of its own, groups in which it acts, triggers of their acts."""
    yield from (one for one in root.iterfind("Storyboard/Init/Actions/Private") if one.get("entityRef") == name)
    for action in root.iter("EntityAction"):
        if action.get("entityRef") == name:
            yield action
    for group in root.iter("ManeuverGroup"):
        if any(one.get("entityRef") == name for one in group.iterfind("Actors/EntityRef")):
            yield group
            act = group.getparent()
            if act is not None:
                yield from (*act.iterfind("StartTrigger"), *act.iterfind("StopTrigger"))


def refuse(root: etree._Element, source: Path) -> None:
    """Refuse a scenario with an element or attribute that the table refuses, or does not know.

    Parameters
    ----------
    root : lxml element
        Of a concrete scenario, without references to catalogs.
    source : Path
        For messages.

    Raises
    ------
    InputError
        Names the first one.
    """
    for one in findings(root):
        if one.row.status is Status.REFUSED:
            raise InputError(f"{source}, line {one.element.sourceline}: {one.what} {_refusal(one)}.")


def _left_out(root: etree._Element) -> list[str]:
    without: dict[str, list[str]] = {}
    for one in findings(root):
        if one.row.status is Status.WITHOUT_EFFECT:
            without.setdefault(one.row.note, []).append(one.what)
    return [f"{', '.join(dict.fromkeys(what))}: without effect, as {note}." for note, what in without.items()]


def _refusal(one: Finding) -> str:
    return one.row.note if one.row.note.startswith("is ") else f"cannot be used, as {one.row.note}"


def _reason(one: Finding) -> str:
    return f"{one.what}: {one.row.note}"


def _between_the_lines(part: etree._Element, root: etree._Element) -> Iterator[Finding]:
    """What no single element or attribute tells."""
    if part.tag == "Private":
        yield from _init(part)
    for group in part.iter("ConditionGroup"):
        conditions = group.findall("Condition")
        lasting = all(any(one.find(f".//{tag}") is not None for tag in _LASTING) for one in conditions)
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
    """Speeds below 0, at which ScenarioRunner stops."""
    for speed in part.iter("AbsoluteTargetSpeed", "AbsoluteSpeed"):
        if float(speed.get("value", "0")) < 0.0:
            yield _sampled(speed, "ScenarioRunner stops at speeds below 0")
    for speed in part.iter("RelativeTargetSpeed", "RelativeSpeedToMaster"):
        action = next(speed.iterancestors("SynchronizeAction"), None)
        other = speed.get("entityRef", "") if action is None else action.get("masterEntityRef", "")
        value, least = float(speed.get("value", "0")), slowest.get(other, 0.0)
        factor = speed.get("speedTargetValueType") == "factor"
        if least < 0.0 or (value < 0.0 if factor else least + value < 0.0):
            yield _sampled(speed, "ScenarioRunner stops at speeds below 0")
        elif other in driven and value < 0.0:
            yield _approximate(speed, "ScenarioRunner stops if it leads below 0")


def _init(private: etree._Element) -> Iterator[Finding]:
    """What ScenarioRunner does not do at the beginning, apart from the first position and speed."""
    for kind in ("LateralAction", "SynchronizeAction", "LongitudinalDistanceAction", "SpeedProfileAction"):
        for action in private.iter(kind):
            yield _sampled(action, "ScenarioRunner does not do it in <Init> as the standard says")
    walks = not any(
        one.get("name") == private.get("entityRef") and one.find("Vehicle") is not None
        for one in private.getroottree().iterfind("Entities/ScenarioObject")
    )
    for kind in ("AssignRouteAction", "AcquirePositionAction") if walks else ():
        for action in private.iter(kind):
            yield _sampled(action, "CARLA's route planner is for vehicles")
    for relative in private.iter("RelativeTargetSpeed"):
        if relative.get("continuous") in ("true", "1"):
            yield _sampled(relative, "ScenarioRunner does not do it in <Init>")


def _at_once(act: etree._Element) -> bool:
    """Whether an act starts with the scenario."""
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
    """Entities whose motion depends on those that are driven from outside, and these themselves."""
    heeded = {
        name: {
            one.get(attribute, "")
            for part in of
            for one in part.iter()
            for attribute in _REFERENCES
            if isinstance(one.tag, str) and one.get(attribute) is not None
        }
        for name, of in parts.items()
    }
    for name, of in parts.items():
        for state in (one for part in of for one in part.iter("StoryboardElementStateCondition")):
            heeded[name] |= _actors_of(root, state)
        if _has_driver(root, name):
            heeded[name] |= set(parts)
    found = set(driven)
    while more := {name for name, others in heeded.items() if name not in found and others & found}:
        found |= more
    return found


def _stays(root: etree._Element, state: etree._Element) -> bool:
    """Whether all that a condition refers to stays in the storyboard, if those who act in it do."""
    found = [
        one for one in _named(root, state) if str(one.tag).lower() == state.get("storyboardElementType", "").lower()
    ]
    return bool(found) and not any(
        action.tag == "GlobalAction" or finding.row.status is Status.WITHOUT_EFFECT
        for one in found
        for action in one.iter("PrivateAction", "GlobalAction")
        for finding in findings(action)
    )


def _named(root: etree._Element, state: etree._Element) -> list[etree._Element]:
    """Storyboard elements of the name that a condition refers to."""
    name = state.get("storyboardElementRef", "").replace("::", "/").rpartition("/")[2]
    return [one for one in root.iterfind("Storyboard/Story//*[@name]") if one.get("name") == name]


def _actors_of(root: etree._Element, state: etree._Element) -> set[str]:
    """Entities that act in the storyboard elements that a condition refers to."""
    return {
        one.get("entityRef", "")
        for element in _named(root, state)
        for group in (*element.iter("ManeuverGroup"), *element.iterancestors("ManeuverGroup"))
        for one in group.iterfind("Actors/EntityRef")
    }


def _follow_references(
    root: etree._Element, parts: dict[str, list[etree._Element]], made: Plan, driven: Collection[str]
) -> None:
    """Let those move along trajectories, too, who wait for what they no longer can wait for."""
    waiting = {
        name: {
            actor
            for part in of
            for state in part.iter("StoryboardElementStateCondition")
            for actor in _actors_of(root, state)
        }
        for name, of in parts.items()
        if name not in driven
    }

    def gone(made: Plan) -> set[str]:
        return made.dropped | set(made.sampled)

    while more := [name for name, others in waiting.items() if name not in made.sampled and others & gone(made)]:
        for name in more:
            made.sampled[name] = ["it waits for events of one that moves along a trajectory"]
