"""Plan of how each entity is moved in ScenarioRunner: by an agent, by the storyboard or along a trajectory."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common.errors import InputError
from cornercase.scenario._file import DRIVER_PROPERTY
from cornercase.scenario._maps import describe_how_to_get_map
from cornercase.simulators.carla._support_table import HandlingStatus, SupportFinding, SupportRow, find_unsupported

# Conditions that stay true once they are true.
_LASTING_CONDITIONS: Final = ("SimulationTimeCondition", "TraveledDistanceCondition", "StoryboardElementStateCondition")
_REFERENCE_ATTRIBUTES: Final = ("entityRef", "masterEntityRef")


@dataclass
class MovementPlan:
    """A plan of how each entity of a scenario is moved.

    `sampled`: entities that move along a trajectory of the builtin simulator, with the reasons. `reacting`: entities
    that react to agent-driven entities. `dropped`: agent-driven entities whose events are left out. `notes`: sentences
    about content that has no effect, or another effect than in the file.
    """

    sampled: dict[str, list[str]] = field(default_factory=dict)
    reacting: set[str] = field(default_factory=set)
    dropped: set[str] = field(default_factory=set)
    notes: list[str] = field(default_factory=list)


def plan_movements(
    root: etree._Element,
    driven: Collection[str],
    source: Path,
    carla_map_name: str,
    deviations: Mapping[str, str],
    lowest_speeds: Mapping[str, float],
) -> MovementPlan:
    """Decide how each entity is moved: by an agent, by the storyboard or along a trajectory.

    An entity that does not react to agent-driven entities moves the same way in each run. If ScenarioRunner would
    deviate from the storyboard, such an entity therefore follows a trajectory of the builtin simulator. An entity that
    reacts to agent-driven entities is moved by the storyboard, as long as ScenarioRunner does something similar.
    Without a road file, the storyboard moves each entity that no agent drives. `InputError` is then raised if
    ScenarioRunner cannot execute the motion of such an entity.

    `driven`: agent-driven entities. `source` names the scenario in messages. `carla_map_name`: CARLA's map, empty if
    there is a road file. `deviations`: reasons why ScenarioRunner's own controls would move an entity along another
    path. `lowest_speeds`: lowest speed of each entity in the builtin simulator in m/s.
    """
    names = [element.get("name", "") for element in root.iterfind("Entities/ScenarioObject")]
    parts = {name: list(_find_elements_moving_entity(root, name)) for name in names}
    reacting = _reacting_entities(root, parts, driven)
    result = MovementPlan(reacting=reacting - set(driven))
    result.notes += _describe_ineffective(root)
    for name in names:
        if name in driven:
            _drop_events_of_driven(name, parts[name], result)
            continue
        reasons: list[str] = []
        for part in parts[name]:
            for finding in (
                *find_unsupported(part),
                *_find_implicit_deviations(part, root),
                *_find_negative_speeds(part, driven, lowest_speeds),
            ):
                if finding.row.status is HandlingStatus.SAMPLED:
                    result.sampled.setdefault(name, []).append(_describe_finding(finding))
                elif finding.row.status is HandlingStatus.APPROXIMATE:
                    reasons.append(_describe_finding(finding))
        if name in deviations:
            reasons.append(deviations[name])
        if _has_cornercase_driver(root, name):
            reasons.append("it has a driver of cornercase")
        if reasons and name not in reacting and not carla_map_name:
            result.sampled.setdefault(name, []).extend(reasons)
        elif reasons and name not in result.sampled:
            result.notes += [f"{name}: {reason}." for reason in dict.fromkeys(reasons)]
    _plan_trajectories_of_waiting_entities(root, parts, result, driven)
    if carla_map_name and result.sampled:
        name, reasons = next(iter(result.sampled.items()))
        raise InputError(
            f"{source}: ScenarioRunner cannot execute the motion of '{name}' ({reasons[0]}). To replace this motion by"
            f" a trajectory, cornercase needs the road file of {carla_map_name};"
            f" {describe_how_to_get_map(carla_map_name)}."
        )
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


def select_stop_conditions(
    root: etree._Element, actor_plan: MovementPlan, driven: Collection[str]
) -> list[etree._Element]:
    """Return the condition groups of the stop trigger that ScenarioRunner can check; note all others in the plan.

    Without agent-driven entities no group is returned or noted, since the builtin simulator has shown when the scenario
    ends.
    """
    groups = []
    for group in root.iterfind("Storyboard/StopTrigger/ConditionGroup"):
        all_findings = [*find_unsupported(group), *_find_implicit_deviations(group, root)]
        unsupported = [finding for finding in all_findings if finding.row.status is HandlingStatus.SAMPLED]
        if len(group) > 1 or not driven:
            unsupported = unsupported or [
                _sampled_finding(group, "one condition of a group is enough for ScenarioRunner to end an act")
            ]
        if not unsupported:
            groups.append(group)
        elif driven:
            actor_plan.notes.append(f"The stop trigger is without {_describe_finding(unsupported[0])}.")
    return groups


def _drop_events_of_driven(name: str, parts: list[etree._Element], actor_plan: MovementPlan) -> None:
    """Plan to leave out the events of an agent-driven entity if ScenarioRunner cannot execute one of them."""
    for part in parts:
        if part.tag == "ManeuverGroup" and any(
            finding.row.status is HandlingStatus.SAMPLED for finding in find_unsupported(part)
        ):
            actor_plan.dropped.add(name)
    if name in actor_plan.dropped:
        actor_plan.notes.append(f"{name}: its events are left out, as an agent drives it.")


def _find_elements_moving_entity(root: etree._Element, name: str) -> Iterator[etree._Element]:
    """Yield the elements that move an entity.

    They are its initial actions, the actions that add or remove it, its maneuver groups, and the triggers of their
    acts.
    """
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


def refuse_unsupported(root: etree._Element, source: Path) -> None:
    """Raise `InputError` for the first element or attribute that cannot be converted for ScenarioRunner.

    The support table marks such content as refused, or has no row for it.
    """
    for finding in find_unsupported(root):
        if finding.row.status is HandlingStatus.REFUSED:
            raise InputError(
                f"{source}, line {finding.element.sourceline}: {finding.description} {_describe_refusal(finding)}."
            )


def _describe_ineffective(root: etree._Element) -> list[str]:
    without: dict[str, list[str]] = {}
    for finding in find_unsupported(root):
        if finding.row.status is HandlingStatus.WITHOUT_EFFECT:
            without.setdefault(finding.row.note, []).append(finding.description)
    return [f"{', '.join(dict.fromkeys(names))}: without effect, as {note}." for note, names in without.items()]


def _describe_refusal(finding: SupportFinding) -> str:
    return finding.row.note if finding.row.note.startswith("is ") else f"cannot be used, as {finding.row.note}"


def _describe_finding(finding: SupportFinding) -> str:
    return f"{finding.description}: {finding.row.note}"


def _find_implicit_deviations(part: etree._Element, root: etree._Element) -> Iterator[SupportFinding]:
    """Yield deviations of ScenarioRunner from the standard that concern no single element or attribute."""
    if part.tag == "Private":
        yield from _find_unsupported_init_actions(part)
    for group in part.iter("ConditionGroup"):
        conditions = group.findall("Condition")
        lasting = all(
            any(condition.find(f".//{tag}") is not None for tag in _LASTING_CONDITIONS) for condition in conditions
        )
        if len(conditions) > 1 and not lasting:
            yield _approximate_finding(
                group, "it is enough for ScenarioRunner that each condition has been true at some time"
            )
    for entities in part.iter("TriggeringEntities"):
        if len(entities) > 1:
            yield _sampled_finding(entities, "ScenarioRunner looks at the last entity only")
    for time in part.iter("SimulationTimeCondition"):
        if time.get("rule", "").startswith("less"):
            yield _approximate_finding(time, "ScenarioRunner counts from when it first looks at the condition")
    for state in part.iter("StoryboardElementStateCondition"):
        if not _is_referenced_element_executed(root, state):
            yield _sampled_finding(state, "it waits for what is left out")
    act = part.getparent() if part.tag == "ManeuverGroup" else None
    if act is not None and not _starts_immediately(act) and any(True for _ in part.iter("SimulationTimeCondition")):
        yield _approximate_finding(part, "ScenarioRunner counts the time from the start of the act")
    if part.tag == "StopTrigger":
        for group in part.iterfind("ConditionGroup"):
            if len(group) > 1:
                yield _approximate_finding(group, "one condition of a group is enough for ScenarioRunner to end an act")


def _find_negative_speeds(
    part: etree._Element, driven: Collection[str], lowest_speeds: Mapping[str, float]
) -> Iterator[SupportFinding]:
    """Yield findings for speeds below 0, at which ScenarioRunner stops an entity instead of reversing it."""
    for speed in part.iter("AbsoluteTargetSpeed", "AbsoluteSpeed"):
        if float(speed.get("value", "0")) < 0.0:
            yield _sampled_finding(speed, "ScenarioRunner stops at speeds below 0")
    for speed in part.iter("RelativeTargetSpeed", "RelativeSpeedToMaster"):
        action = next(speed.iterancestors("SynchronizeAction"), None)
        other = speed.get("entityRef", "") if action is None else action.get("masterEntityRef", "")
        value, slowest_speed = float(speed.get("value", "0")), lowest_speeds.get(other, 0.0)
        factor = speed.get("speedTargetValueType") == "factor"
        if slowest_speed < 0.0 or (value < 0.0 if factor else slowest_speed + value < 0.0):
            yield _sampled_finding(speed, "ScenarioRunner stops at speeds below 0")
        elif other in driven and value < 0.0:
            yield _approximate_finding(speed, "ScenarioRunner stops if it leads below 0")


def _find_unsupported_init_actions(private: etree._Element) -> Iterator[SupportFinding]:
    """Yield findings for initial actions that ScenarioRunner does not execute as the standard says."""
    for action_tag in ("LateralAction", "SynchronizeAction", "LongitudinalDistanceAction", "SpeedProfileAction"):
        for action in private.iter(action_tag):
            yield _sampled_finding(action, "ScenarioRunner does not do it in <Init> as the standard says")
    is_walker = not any(
        element.get("name") == private.get("entityRef") and element.find("Vehicle") is not None
        for element in private.getroottree().iterfind("Entities/ScenarioObject")
    )
    for action_tag in ("AssignRouteAction", "AcquirePositionAction") if is_walker else ():
        for action in private.iter(action_tag):
            yield _sampled_finding(action, "CARLA's route planner is for vehicles")
    for relative in private.iter("RelativeTargetSpeed"):
        if relative.get("continuous") in ("true", "1"):
            yield _sampled_finding(relative, "ScenarioRunner does not do it in <Init>")


def _starts_immediately(act: etree._Element) -> bool:
    trigger = act.find("StartTrigger")
    for condition in () if trigger is None else trigger.iter("Condition"):
        time = condition.find("ByValueCondition/SimulationTimeCondition")
        if time is None or not time.get("rule", "").startswith("greater") or float(time.get("value", "0")) > 0.0:
            return False
    return True


def _make_finding(status: HandlingStatus, element: etree._Element, note: str) -> SupportFinding:
    return SupportFinding(f"<{element.tag}>", SupportRow(str(element.tag), "", (), status, note), element)


_approximate_finding = partial(_make_finding, HandlingStatus.APPROXIMATE)
_sampled_finding = partial(_make_finding, HandlingStatus.SAMPLED)


def _has_cornercase_driver(root: etree._Element, name: str) -> bool:
    for holder in root.iterfind("Entities/ScenarioObject"):
        if holder.get("name") == name:
            return holder.find(f".//Property[@name='{DRIVER_PROPERTY}']") is not None
    return False


def _reacting_entities(
    root: etree._Element, parts: dict[str, list[etree._Element]], driven: Collection[str]
) -> set[str]:
    """Return the agent-driven entities and all entities whose motion depends on them."""
    referenced = {
        name: {
            element.get(attribute, "")
            for part in elements
            for element in part.iter()
            for attribute in _REFERENCE_ATTRIBUTES
            if isinstance(element.tag, str) and element.get(attribute) is not None
        }
        for name, elements in parts.items()
    }
    for name, elements in parts.items():
        for state in (element for part in elements for element in part.iter("StoryboardElementStateCondition")):
            referenced[name] |= _referenced_actors(root, state)
        if _has_cornercase_driver(root, name):
            referenced[name] |= set(parts)
    reacting = set(driven)
    while more := {name for name, names in referenced.items() if name not in reacting and names & reacting}:
        reacting |= more
    return reacting


def _is_referenced_element_executed(root: etree._Element, state: etree._Element) -> bool:
    """Return whether the storyboard elements that a condition refers to exist and will be executed.

    Global actions and actions without effect are removed from the storyboard, so a condition cannot wait for them.
    """
    elements = [
        element
        for element in _referenced_elements(root, state)
        if str(element.tag).lower() == state.get("storyboardElementType", "").lower()
    ]
    return bool(elements) and not any(
        action.tag == "GlobalAction" or finding.row.status is HandlingStatus.WITHOUT_EFFECT
        for element in elements
        for action in element.iter("PrivateAction", "GlobalAction")
        for finding in find_unsupported(action)
    )


def _referenced_elements(root: etree._Element, state: etree._Element) -> list[etree._Element]:
    """Return the storyboard elements that a condition on a state refers to by name."""
    name = state.get("storyboardElementRef", "").replace("::", "/").rpartition("/")[2]
    return [element for element in root.iterfind("Storyboard/Story//*[@name]") if element.get("name") == name]


def _referenced_actors(root: etree._Element, state: etree._Element) -> set[str]:
    """Return the entities that act in the storyboard elements that a condition refers to."""
    return {
        reference.get("entityRef", "")
        for element in _referenced_elements(root, state)
        for group in (*element.iter("ManeuverGroup"), *element.iterancestors("ManeuverGroup"))
        for reference in group.iterfind("Actors/EntityRef")
    }


def _plan_trajectories_of_waiting_entities(
    root: etree._Element, parts: dict[str, list[etree._Element]], actor_plan: MovementPlan, driven: Collection[str]
) -> None:
    """Plan trajectories also for entities that wait for events that the plan removes from the storyboard."""
    waiting = {
        name: {
            actor
            for part in elements
            for state in part.iter("StoryboardElementStateCondition")
            for actor in _referenced_actors(root, state)
        }
        for name, elements in parts.items()
        if name not in driven
    }

    def replaced_entities(actor_plan: MovementPlan) -> set[str]:
        return actor_plan.dropped | set(actor_plan.sampled)

    while more := [
        name
        for name, actors in waiting.items()
        if name not in actor_plan.sampled and actors & replaced_entities(actor_plan)
    ]:
        for name in more:
            actor_plan.sampled[name] = ["it waits for events that are left out of the storyboard"]
