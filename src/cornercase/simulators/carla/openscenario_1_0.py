"""Write concrete scenarios as OpenSCENARIO 1.0 for CARLA's ScenarioRunner."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.arguments import numbers_or_texts, path
from cornercase._common.errors import InputError
from cornercase._common.files import require_other_file, written_whole
from cornercase._common.pending_files import written_together
from cornercase.scenario import DRIVER_PROPERTY, Scenario, Scope, Value, copy_beside, turn_axes
from cornercase.simulators.builtin.checking import schema_errors
from cornercase.simulators.carla.dialect import Agents, assign_controllers
from cornercase.simulators.carla.foreign_code import put_in_criteria, refuse_code, take_out_criteria
from cornercase.simulators.carla.lanes import heights, strays
from cornercase.simulators.carla.plan import Plan, kept_ends, plan, refuse
from cornercase.simulators.carla.storyboard import (
    end_acts,
    end_at,
    leave_out,
    name_apart,
    remove_element,
    set_beginning,
    start_at_once,
    take_over,
)
from cornercase.simulators.carla.trajectories import add_trajectories, sample

_MINOR: Final = 0
# Attributes introduced after 1.0 that do not change the meaning of the rest.
_LATER: Final = {
    "SynchronizeAction": ("targetTolerance", "targetToleranceMaster"),
    "Vehicle": ("mass", "role", "model3d"),
    "Pedestrian": ("role", "model3d"),
    "MiscObject": ("model3d",),
    "SpeedActionDynamics": ("followingMode",),
    "LongitudinalDistanceAction": ("coordinateSystem", "displacement"),
    "RelativeDistanceCondition": ("coordinateSystem", "routingAlgorithm"),
    "DistanceCondition": ("coordinateSystem", "routingAlgorithm"),
    "TimeToCollisionCondition": ("coordinateSystem", "routingAlgorithm"),
    "DynamicConstraints": ("maxAccelerationRate", "maxDecelerationRate"),
    "Performance": ("maxAccelerationRate", "maxDecelerationRate"),
}
_NAMED: Final = str.maketrans("", "", "${}")
_RULES: Final = {"greaterOrEqual": "greaterThan", "lessOrEqual": "lessThan"}
# Numbers and truth values of XML.
_NUMBER: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|-?INF|NaN|true|false", re.ASCII)
_MOST_ENTITIES: Final = 500
_TURNED: Final = (
    "Positions were converted from CARLA's left-handed axes (the description begins with 'CARLA:') to those of the road"
    " file; the new file's description lacks this prefix."
)


@dataclass(frozen=True)
class Conversion:
    """A concrete scenario that was written as OpenSCENARIO 1.0.

    Attributes
    ----------
    path : Path
        The new file.
    notes : tuple of str
        Differences from the original and replacements, one sentence each.
    """

    path: Path
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        lines = "".join(f"\n  {note}" for note in self.notes) or "\n  nothing had to be changed"
        return f"<Conversion {self.path}:{lines}>"


def convert(
    scenario: Scenario | Path | str,
    output: Path | str,
    *,
    ego: str,
    values: Mapping[str, Value] | None = None,
) -> Conversion:
    """Write a concrete scenario as OpenSCENARIO 1.0, as CARLA's ScenarioRunner reads it.

    Parameters and expressions are replaced by their values, since 1.0 has no expressions, and catalog entries are
    copied into the file. The ego becomes ScenarioRunner's ``ego_vehicle``. The road file is copied next to the new file
    and named after it (``t10.xodr`` for ``t10.xosc``), unless it is the name of one of CARLA's maps (``Town01``).

    Parameters
    ----------
    scenario : Scenario or path
        OpenSCENARIO of any version.
    output : path
        File to write.
    ego : str
        Entity that becomes the ego vehicle.
    values : mapping of str to float or str, optional
        Parameter values; others keep those of their declarations.

    Returns
    -------
    Conversion

    Raises
    ------
    InputError
        A file cannot be read or written, there is no such entity or parameter, or something cannot be expressed in
        OpenSCENARIO 1.0.

    Examples
    --------
    >>> from cornercase.simulators import convert
    >>> convert("t_intersection.xosc", "t10.xosc", ego="Ego", values={"c_speed": 9.0}).notes  # doctest: +SKIP
    ("Ego is driven by the agent that ScenarioRunner gives it, not by cornercase's driver 'normal'.", ...)
    """
    if not isinstance(scenario, Scenario):
        scenario = Scenario.read(scenario)
    output, checked_values = path("output", output), numbers_or_texts("values", values)
    require_other_file(output, scenario.path)
    return Conversion(output, write_1_0(scenario, checked_values, output, ego=ego, run=Run(judged=True)))


@dataclass(frozen=True)
class Run:
    """Options of a converted scenario.

    `agents` drive entities instead of the storyboard; `time_step` and `duration` in s; `open_loop`: an entity may move
    along a trajectory although it should react to an agent-driven one; `road_file` and `controllers`: path of the
    copied road file and folder of our controllers, relative to the new file (default: next to it); `judged`:
    ScenarioRunner judges the run by the scenario's criteria.
    """

    agents: Agents = field(default_factory=Agents)
    time_step: float = 0.05
    duration: float = 60.0
    open_loop: bool = True
    road_file: str = ""
    controllers: str = ""
    judged: bool = False


def write_1_0(
    scenario: Scenario, values: Mapping[str, Value], target: Path | str, *, ego: str, run: Run | None = None
) -> tuple[str, ...]:
    """Write a concrete scenario for ScenarioRunner, as `convert` does; return notes on differences."""
    run = run or Run()
    scenario.require_parameters(list(values))
    scenario.require_entity(ego, "ego")
    target, road = Path(target), scenario.road_file(values)
    town = carla_map(scenario, values)
    missing_map = "" if road is None or road.exists() else town
    root, notes, controllers = _tree_1_0(scenario, values, ego, run, missing_map)
    # A scenario must not choose the name of a written file: ScenarioRunner would import 'carla.py'.
    road_file = run.road_file or f"{target.stem}.xodr"
    file = root.find("RoadNetwork/LogicFile")
    if road is not None and file is not None:
        try:
            file.set("filepath", town or road_file)
        except ValueError as error:
            raise InputError(f"{target}: its name has characters that XML cannot hold; choose another one.") from error
    violations = schema_errors(root)
    if violations is None:
        notes.append("It was not validated against the schema of 1.0; pip install 'cornercase[validate]'.")
    elif violations:
        raise InputError(f"{scenario.path}: cannot be expressed in OpenSCENARIO 1.0 ({violations[0]}).")
    content = io.BytesIO()
    # Into memory: lxml may silently lose data when it writes to a full disk.
    etree.ElementTree(root).write(content, encoding="utf-8", xml_declaration=True, pretty_print=True)
    with written_together():
        if road is not None and not town:
            copy_beside(road, target.parent / road_file, "OpenDRIVE")
        for controller in controllers:
            with written_whole(target.parent / run.controllers / controller.name) as temporary:
                temporary.write_bytes(controller.read_bytes())
        with written_whole(target) as temporary:
            temporary.write_bytes(content.getvalue())
    return tuple(dict.fromkeys(notes))


def carla_map(scenario: Scenario, values: Mapping[str, Value]) -> str:
    """Return the name of CARLA's map that a scenario names instead of a road file; empty for a file or no road."""
    reference = scenario.road_reference(values)
    road = scenario.beside(reference, "road file")
    if not reference or road.exists() or not re.fullmatch(r"\w+", road.name, re.ASCII):
        return ""
    return road.name


def concrete_tree(scenario: Scenario, values: Mapping[str, Value]) -> etree._Element:
    """Return the tree of a concrete scenario without parameters and catalog references.

    Raises `InputError` if a value cannot be evaluated or breaks a constraint, or there are too many entities.
    """
    # The time grows with the square of the number of entities.
    if len(scenario.entities) > _MOST_ENTITIES:
        raise InputError(
            f"{scenario.path}: has {len(scenario.entities)} entities; at most {_MOST_ENTITIES} can be written."
        )
    root = etree.fromstring(etree.tostring(scenario.root))
    scope = Scope.of_file(str(scenario.path), scenario.root, [dict(values)], scenario.catalog_entry)
    if scope.violations(scenario.root):
        raise InputError(f"{scenario.path}: the values break a constraint of the parameters' declarations.")
    # The scope contains the file's own declarations already, with the given values.
    for child in root:
        _resolve(child, scope)
    _trim(root)
    if scenario.is_left_handed:
        turn_axes(root)
    return root


def _tree_1_0(
    scenario: Scenario, values: Mapping[str, Value], ego: str, run: Run, town: str
) -> tuple[etree._Element, list[str], set[Path]]:
    """Return the tree of a concrete scenario in OpenSCENARIO 1.0, notes on differences, and needed controllers."""
    root = concrete_tree(scenario, values)
    criteria = take_out_criteria(root)
    refuse_code(root, scenario.path)
    _header(root, scenario.path)
    _name_members(root)
    refuse(root, scenario.path)
    driven = run.agents.driven(ego)
    if ego in scenario.drivers:
        # The ego is the system under test, driven by an agent that the file cannot name.
        driven.add(ego)
    recording = None if town else sample(scenario, values, run.time_step, run.duration)
    road = scenario.road_file(values)
    astray = {} if recording is None else strays(recording, road, scenario)
    slowest = (
        {} if recording is None else dict(zip(recording.names, np.fmin.reduce(recording.speed, axis=1), strict=True))
    )
    axes_notes = (_TURNED,) if scenario.is_left_handed else ()
    actor_plan = plan(root, sorted(driven), scenario.path, town, astray, slowest)
    notes = [*axes_notes, *actor_plan.notes]
    for name in actor_plan.sampled if not run.open_loop else ():
        if name in actor_plan.reacting:
            raise InputError(
                f"{scenario.path}: '{name}' has to react to {' and '.join(sorted(driven))}, but ScenarioRunner cannot"
                f" move it like that ({actor_plan.sampled[name][0]}); with `simulator` carla:open_loop=true it moves as"
                " in the builtin simulator, without reacting."
            )
    kept_groups = kept_ends(root, actor_plan, driven or ({ego} if town else set()))
    leave_out(root)
    take_over(root, set(actor_plan.sampled) | actor_plan.dropped)
    _entities(root, ego, actor_plan, notes)
    notes += add_trajectories(root, recording, list(actor_plan.sampled), ego)
    centers: dict[str, float] = {}
    end = run.duration
    if recording is not None:
        by_storyboard = set(recording.names) - set(actor_plan.sampled)
        set_beginning(root, recording, by_storyboard, heights(recording, road, scenario))
        centers = dict(zip(recording.names, map(float, recording.center_x), strict=True))
        last_time = float(recording.time[-1])
        # If nothing ends the scenario, the caller ends it.
        end += 1.0
        if not kept_groups and last_time < run.duration - 0.5 * run.time_step:
            # Time conditions become true in the first frame after the time.
            end = last_time - 0.5 * run.time_step
    end_at(root, end, kept_groups)
    end_acts(root)
    start_at_once(root)
    name_apart(root)
    if run.judged:
        notes += put_in_criteria(root, criteria)
    _conditions(root, scenario.path, notes)
    _synchronised(root, scenario, notes)
    _later_words(root)
    controllers = assign_controllers(
        root, scenario.path, ego, run.agents, {name: centers[name] for name in actor_plan.sampled}
    )
    return root, notes, controllers


def _header(root: etree._Element, source: Path) -> None:
    for unused in root.iter("ParameterDeclarations", "CatalogLocations"):
        unused.clear()
    for unused in root.findall("VariableDeclarations") + root.findall("MonitorDeclarations"):
        root.remove(unused)
    header = root.find("FileHeader")
    if header is None:
        raise InputError(f"{source}: has no <FileHeader>.")
    header.set("revMajor", "1")
    header.set("revMinor", str(_MINOR))
    # ScenarioRunner names files after the description, and a leading 'CARLA:' would change the axes.
    header.set("description", "cornercase")
    for child in list(header):
        header.remove(child)
    header.text = None


def _name_members(root: etree._Element) -> None:
    """Replace entity selections by their members, since ScenarioRunner has no selections."""
    for selection in root.findall("Entities/EntitySelection"):
        members = [member_element.get("entityRef", "") for member_element in selection.iterfind("Members/EntityRef")]
        object_types = [
            member_element.get("objectType", member_element.get("type", ""))
            for member_element in selection.iterfind("Members/ByType")
        ]
        for holder in root.iterfind("Entities/ScenarioObject"):
            tag = "" if len(holder) == 0 else str(holder[0].tag)
            if {"Vehicle": "vehicle", "Pedestrian": "pedestrian", "MiscObject": "miscellaneous"}.get(
                tag
            ) in object_types:
                members.append(holder.get("name", ""))
        for reference in list(root.iter("EntityRef")):
            parent = reference.getparent()
            if reference.get("entityRef") == selection.get("name") and parent is not None:
                for member in dict.fromkeys(members):
                    reference.addprevious(etree.Element("EntityRef", entityRef=member))
                parent.remove(reference)
        remove_element(selection)


def _later_words(root: etree._Element) -> None:
    """Remove attributes introduced after 1.0 that do not change the meaning of the rest."""
    for tag, names in _LATER.items():
        for element in root.iter(tag):
            for name in names:
                element.attrib.pop(name, "")


def _resolve(element: etree._Element, scope: Scope) -> None:
    """Replace parameters and expressions by values."""
    if not isinstance(element.tag, str) or element.tag == "ParameterDeclarations":
        return
    inner = scope.within(element) if element.find("ParameterDeclarations") is not None else scope
    for name, text in element.attrib.items():
        if "$" not in str(text) or name == "parameterRef":
            continue
        if name == "name":
            # In 1.0, a $ in a name would be read as a parameter reference; remove it.
            element.set(name, str(text).translate(_NAMED))
        else:
            element.set(name, inner.text(element, str(name)))
    for child in element:
        if child.tag == "CatalogReference":
            # ScenarioRunner would search catalogs next to the new file, and cannot read later versions.
            entry, entry_scope = inner.from_catalog(child)
            resolved_entry = etree.fromstring(etree.tostring(entry, with_tail=False))
            element.replace(child, resolved_entry)
            # The scope contains these values, or those that the reference assigns.
            for declarations in resolved_entry.findall("ParameterDeclarations"):
                declarations.clear()
            _resolve(resolved_entry, entry_scope)
        else:
            _resolve(child, inner)


def _trim(root: etree._Element) -> None:
    """Remove blanks around numbers, which XML allows but ScenarioRunner does not."""
    for element in root.iter("*"):
        for name, text in element.attrib.items():
            if name != "name" and not str(name).endswith("Ref") and _NUMBER.fullmatch(str(text).strip()):
                element.set(name, str(text).strip())


def _entities(root: etree._Element, ego: str, made: Plan, notes: list[str]) -> None:
    for holder in root.iterfind("Entities/ScenarioObject"):
        name = holder.get("name", "")
        for controlled in holder.findall("ObjectController"):
            driver = controlled.find(f"Controller/Properties/Property[@name='{DRIVER_PROPERTY}']")
            # ScenarioRunner ignores these, but would use their properties as the entity's own.
            holder.remove(controlled)
            if driver is not None and name not in made.sampled:
                driver_name = "the agent that ScenarioRunner gives it" if name == ego else "the storyboard only"
                notes.append(f"{name} is driven by {driver_name}, not by cornercase's driver '{driver.get('value')}'.")
        vehicle, walker = holder.find("Vehicle"), holder.find("Pedestrian")
        if vehicle is not None:
            properties = vehicle.find("Properties")
            if properties is None:
                properties = etree.SubElement(vehicle, "Properties")
            for old_property in properties.findall("Property[@name='type']"):
                properties.remove(old_property)
            type_value = "ego_vehicle" if name == ego else "simulation"
            rear = vehicle.find("Axles/RearAxle")
            if rear is not None and vehicle.find("Axles/FrontAxle") is None:
                # 1.0 requires both, and they have no effect.
                front = etree.fromstring(etree.tostring(rear, with_tail=False))
                front.tag = "FrontAxle"
                rear.addprevious(front)
            # Before any <File> elements.
            properties.insert(0, etree.Element("Property", name="type", value=type_value))
        if walker is not None:
            # In 1.0 a pedestrian has a model, which ScenarioRunner uses as the name of a CARLA blueprint.
            walker.set("model", walker.get("model", "walker.pedestrian.0001"))
        for body in holder.iterfind("*"):
            if body.tag in ("Pedestrian", "MiscObject"):
                # 1.0 requires a mass, which has no effect.
                body.set("mass", body.get("mass", "80"))
                if body.find("Properties") is None:
                    etree.SubElement(body, "Properties")


def _conditions(root: etree._Element, source: Path, notes: list[str]) -> None:
    for element in root.iter():
        rule = element.get("rule") if isinstance(element.tag, str) else None
        if rule in _RULES:
            element.set("rule", _RULES[str(rule)])
            notes.append(f"'{rule}' became '{_RULES[str(rule)]}', which may be true a time step later.")
        elif rule == "notEqualTo":
            raise InputError(f"{source}: 'notEqualTo' of <{element.tag}> cannot be expressed in OpenSCENARIO 1.0.")
    for event in root.iter("Event"):
        if event.get("priority") == "override":
            event.set("priority", "overwrite")
    for condition in root.iter("Condition"):
        # ScenarioRunner ignores the edge.
        condition.set("conditionEdge", "none")
        if condition.get("delay") is None:
            condition.set("delay", "0")


def _synchronised(root: etree._Element, scenario: Scenario, notes: list[str]) -> None:
    """Add a final speed to synchronize actions, which ScenarioRunner requires."""
    for action in root.iter("SynchronizeAction"):
        final_speed = action.find("FinalSpeed")
        if final_speed is not None and final_speed.find("*/SteadyState") is not None:
            raise InputError(
                f"{scenario.path}: a steady state of <SynchronizeAction> cannot be expressed in OpenSCENARIO 1.0."
            )
        if final_speed is not None:
            continue
        group = next((element for element in action.iterancestors("ManeuverGroup")), None)
        actors = [] if group is None else [element.get("entityRef") for element in group.iterfind("Actors/EntityRef")]
        speeds = [
            float(element.get("value", "0"))
            for holder in root.iter("ManeuverGroup", "Private")
            if holder.get("entityRef") in actors
            or any(element.get("entityRef") in actors for element in holder.iterfind("Actors/EntityRef"))
            for element in holder.iter("AbsoluteTargetSpeed")
        ]
        if not speeds:
            raise InputError(
                f"{scenario.path}: a <SynchronizeAction> needs a <FinalSpeed> for ScenarioRunner; add one."
            )
        etree.SubElement(etree.SubElement(action, "FinalSpeed"), "AbsoluteSpeed", value=f"{max(speeds):g}")
        notes.append(f"{actors[0] if actors else 'Who'} synchronises with a final speed of {max(speeds):g} m/s.")
