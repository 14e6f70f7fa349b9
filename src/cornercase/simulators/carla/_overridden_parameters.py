"""Parameters of a scenario that have no effect because an agent drives an entity."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from typing import Final

from lxml import etree

from cornercase.scenario._file import ScenarioFile

_REFERENCE_PATTERN: Final = re.compile(r"\$(\w+)")
_POSITION: Final = ("TeleportAction",)
_ROUTE_OR_POSITION: Final = ("TeleportAction", "RoutingAction")


def describe_overridden_parameters(
    scenario: ScenarioFile, driven: Collection[str], *, externally: Collection[str], obeying: Collection[str]
) -> Iterator[str]:
    """Yield a sentence on each parameter that has little or no effect because a driver moves the entity instead.

    `driven`: entities with a driver. `externally`: driven entities that take only their initial position from the
    scenario. `obeying`: driven entities whose drivers keep the first speed of the scenario.
    """
    names = {
        element.get("name", "") for element in scenario.root.iterfind("ParameterDeclarations/ParameterDeclaration")
    }
    overridden: dict[str, set[str]] = {}
    first_speeds: dict[str, set[str]] = {}
    effective: set[str] = set()
    for element in scenario.root.iter("*"):
        used = {name for text in element.attrib.values() for name in _REFERENCE_PATTERN.findall(str(text))}
        if element.tag == "ParameterCondition":
            used.add(element.get("parameterRef", ""))
        used &= names
        if not used:
            continue
        entity, is_speed = _find_overriding_entity(element, driven)
        if not entity or (is_speed and entity in obeying):
            effective |= used
        elif is_speed and entity not in externally:
            for name in used:
                first_speeds.setdefault(name, set()).add(entity)
        elif not _is_in_initial_action(element, _POSITION if entity in externally else _ROUTE_OR_POSITION):
            for name in used:
                overridden.setdefault(name, set()).add(entity)
        else:
            effective |= used
    for name in sorted(first_speeds.keys() - effective):
        entities = " and ".join(sorted(first_speeds[name]))
        yield f"the parameter {name} sets only the first speed of {entities}, as an agent drives from then on"
    for name in sorted(overridden.keys() - effective - first_speeds.keys()):
        yield f"the parameter {name} has no effect, as an agent drives {' and '.join(sorted(overridden[name]))}"


def _find_overriding_entity(element: etree._Element, driven: Collection[str]) -> tuple[str, bool]:
    """Return the first driven entity whose motion an element sets, and whether the element sets its first speed.

    The entity is empty if the element sets no motion, or the motion of an entity that is not driven.
    """
    action = next(element.iterancestors("PrivateAction"), None)
    if action is None:
        return "", False
    private = next(element.iterancestors("Private"), None)
    if private is not None:
        entity = private.get("entityRef", "")
        return (entity, action.find(".//SpeedAction") is not None) if entity in driven else ("", False)
    group = next(element.iterancestors("ManeuverGroup"), None)
    actors = [] if group is None else [actor.get("entityRef", "") for actor in group.iterfind("Actors/EntityRef")]
    return (actors[0], False) if actors and all(actor in driven for actor in actors) else ("", False)


def _is_in_initial_action(element: etree._Element, tags: Collection[str]) -> bool:
    """Return whether an element belongs to an initial action of an entity with one of the given tags."""
    is_initial = next(element.iterancestors("Private"), None) is not None
    return is_initial and next(element.iterancestors(*tags), None) is not None
