"""Concrete scenarios as OpenSCENARIO 1.0, in the dialect of CARLA's ScenarioRunner."""

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
    set_beginning,
    start_at_once,
    take_over,
)
from cornercase.simulators.carla.trajectories import add_trajectories, sample

_MINOR: Final = 0
# Attributes that are newer than 1.0, and without which the rest means the same.
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
    "Positions were turned from CARLA's left-handed axes, in which the file is as its description begins with 'CARLA:',"
    " to those of the road file; the new file's description does not begin so."
)


@dataclass(frozen=True)
class Conversion:
    """A concrete scenario that was written as OpenSCENARIO 1.0.

    Attributes
    ----------
    path : Path
        Of the new file.
    notes : tuple of str
        What is not quite the same in 1.0, and how it was put, a sentence each.
    """

    path: Path
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        lines = "".join(f"\n  {note}" for note in self.notes) or "\n  nothing had to be put in other words"
        return f"<Conversion {self.path}:{lines}>"


def convert(
    scenario: Scenario | Path | str,
    output: Path | str,
    *,
    ego: str,
    values: Mapping[str, Value] | None = None,
) -> Conversion:
    """Write a concrete scenario as OpenSCENARIO 1.0, as CARLA's ScenarioRunner reads it.

    All parameters and expressions become their values, as 1.0 has no expressions, and what stands in catalogs comes
    into the file; the ego becomes ScenarioRunner's ``ego_vehicle``. The road file is copied beside the new file and
    named after it (``t10.xodr`` beside ``t10.xosc``), unless it is the name of one of CARLA's maps (``Town01``).

    Parameters
    ----------
    scenario : Scenario or path
        OpenSCENARIO of any version.
    output : path
        File to write.
    ego : str
        Entity that becomes the ego vehicle.
    values : mapping of str to float or str, optional
        Of the scenario's parameters; the others keep the values of their declarations.

    Returns
    -------
    Conversion

    Raises
    ------
    InputError
        A file cannot be read or written, the scenario has no such entity or parameter, or something in it cannot be
        said in OpenSCENARIO 1.0.

    Examples
    --------
    >>> from cornercase.simulators import convert
    >>> convert("t_intersection.xosc", "t10.xosc", ego="Ego", values={"c_speed": 9.0}).notes  # doctest: +SKIP
    ("Ego is driven by the agent that ScenarioRunner gives it, not by cornercase's driver 'normal'.", ...)
    """
    if not isinstance(scenario, Scenario):
        scenario = Scenario.read(scenario)
    output, given = path("output", output), numbers_or_texts("values", values)
    require_other_file(output, scenario.path)
    return Conversion(output, write_1_0(scenario, given, output, ego=ego, run=Run(judged=True)))


@dataclass(frozen=True)
class Run:
    """How a scenario is to be run.

    Attributes
    ----------
    agents : Agents
        Who drives entities instead of the storyboard.
    time_step, duration : float
        s.
    open_loop : bool
        Whether an entity may move along a trajectory that would have to react to one that an agent drives.
    road_file, controllers : str
        Path of the copied road file, and folder of the controllers of ours that ScenarioRunner needs, relative to the
        new file; by default both are beside it, the road file named after it.
    judged : bool
        Whether ScenarioRunner judges the run by the criteria that the scenario asks for.
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
    """Write a concrete scenario for ScenarioRunner, as `convert` does.

    Parameters
    ----------
    scenario : Scenario
    values : mapping of str to float or str
    target : path
    ego : str
    run : Run, optional

    Returns
    -------
    tuple of str
        What is not quite the same.

    Raises
    ------
    InputError
        As in `convert`.
    """
    run = run or Run()
    scenario.require_parameters(list(values))
    scenario.require_entity(ego, "ego")
    target, road = Path(target), scenario.road_file(values)
    town = carla_map(scenario, values)
    unknown = "" if road is None or road.exists() else town
    root, notes, controllers = _tree_1_0(scenario, values, ego, run, unknown)
    # A scenario must not choose the name of a file that is written: ScenarioRunner would import 'carla.py'.
    road_file = run.road_file or f"{target.stem}.xodr"
    file = root.find("RoadNetwork/LogicFile")
    if road is not None and file is not None:
        try:
            file.set("filepath", town or road_file)
        except ValueError as error:
            raise InputError(f"{target}: its name has characters that XML cannot hold; choose another one.") from error
    wrong = schema_errors(root)
    if wrong is None:
        notes.append("It was not held against the schema of 1.0; pip install 'cornercase[validate]'.")
    elif wrong:
        raise InputError(f"{scenario.path}: cannot be expressed in OpenSCENARIO 1.0 ({wrong[0]}).")
    content = io.BytesIO()
    # Into memory: written to a file by lxml, what does not fit on the disk may be lost without a word.
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
    """Return the name of CARLA's map that a scenario names in the place of a road file.

    Parameters
    ----------
    scenario : Scenario
    values : mapping of str to float or str

    Returns
    -------
    str
        Empty where it names a file, or none.
    """
    reference = scenario.road_reference(values)
    road = scenario.beside(reference, "road file")
    if not reference or road.exists() or not re.fullmatch(r"\w+", road.name, re.ASCII):
        return ""
    return road.name


def concrete_tree(scenario: Scenario, values: Mapping[str, Value]) -> etree._Element:
    """Make the tree of a concrete scenario, without parameters and references to catalogs.

    Parameters
    ----------
    scenario : Scenario
    values : mapping of str to float or str

    Returns
    -------
    lxml element

    Raises
    ------
    InputError
        A value cannot be evaluated or breaks a constraint, or there are too many entities.
    """
    # Each is held against all others.
    if len(scenario.entities) > _MOST_ENTITIES:
        raise InputError(
            f"{scenario.path}: has {len(scenario.entities)} entities; at most {_MOST_ENTITIES} can be written."
        )
    root = etree.fromstring(etree.tostring(scenario.root))
    scope = Scope.of_file(str(scenario.path), scenario.root, [dict(values)], scenario.catalog_entry)
    if scope.violations(scenario.root):
        raise InputError(f"{scenario.path}: the values break a constraint of the parameters' declarations.")
    # The file's own declarations are in the scope already, with the values that were given.
    for child in root:
        _resolve(child, scope)
    _trim(root)
    if scenario.is_left_handed:
        turn_axes(root)
    return root


def _tree_1_0(
    scenario: Scenario, values: Mapping[str, Value], ego: str, run: Run, town: str
) -> tuple[etree._Element, list[str], set[Path]]:
    """Tree of a concrete scenario in the words of 1.0, what is not quite the same, and controllers that it needs."""
    root = concrete_tree(scenario, values)
    criteria = take_out_criteria(root)
    refuse_code(root, scenario.path)
    _header(root, scenario.path)
    _name_members(root)
    refuse(root, scenario.path)
    driven = run.agents.driven(ego)
    if ego in scenario.drivers:
        # It is the system under test, which an agent drives that the file cannot name.
        driven.add(ego)
    recording = None if town else sample(scenario, values, run.time_step, run.duration)
    road = scenario.road_file(values)
    astray = {} if recording is None else strays(recording, road, scenario)
    slowest = (
        {} if recording is None else dict(zip(recording.names, np.fmin.reduce(recording.speed, axis=1), strict=True))
    )
    turned = (_TURNED,) if scenario.is_left_handed else ()
    made = plan(root, sorted(driven), scenario.path, town, astray, slowest)
    notes = [*turned, *made.notes]
    for name in made.sampled if not run.open_loop else ():
        if name in made.reacting:
            raise InputError(
                f"{scenario.path}: '{name}' would have to react to {' and '.join(sorted(driven))}, but ScenarioRunner"
                f" cannot move it so ({made.sampled[name][0]}); `simulator` carla:open_loop=true lets it move as in the"
                " builtin simulator, whatever others do."
            )
    kept = kept_ends(root, made, driven or ({ego} if town else set()))
    leave_out(root)
    take_over(root, set(made.sampled) | made.dropped)
    _entities(root, ego, made, notes)
    notes += add_trajectories(root, recording, list(made.sampled), ego)
    centers: dict[str, float] = {}
    end = run.duration
    if recording is not None:
        keeping = set(recording.names) - set(made.sampled)
        set_beginning(root, recording, keeping, heights(recording, road, scenario))
        centers = dict(zip(recording.names, map(float, recording.center_x), strict=True))
        last = float(recording.time[-1])
        # Where nothing ends the scenario, who runs it does.
        end += 1.0
        if not kept and last < run.duration - 0.5 * run.time_step:
            # Conditions of time are true from the first frame after it.
            end = last - 0.5 * run.time_step
    end_at(root, end, kept)
    end_acts(root)
    start_at_once(root)
    name_apart(root)
    if run.judged:
        notes += put_in_criteria(root, criteria)
    _conditions(root, scenario.path, notes)
    _synchronised(root, scenario, notes)
    _later_words(root)
    controllers = assign_controllers(
        root, scenario.path, ego, run.agents, {name: centers[name] for name in made.sampled}
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
    # ScenarioRunner names files after the description, and 'CARLA:' at its beginning would turn the axes.
    header.set("description", "cornercase")
    for child in list(header):
        header.remove(child)
    header.text = None


def _name_members(root: etree._Element) -> None:
    """Name the members of selections in their place, as ScenarioRunner knows no selections."""
    for selection in root.findall("Entities/EntitySelection"):
        members = [one.get("entityRef", "") for one in selection.iterfind("Members/EntityRef")]
        kinds = [one.get("objectType", one.get("type", "")) for one in selection.iterfind("Members/ByType")]
        for holder in root.iterfind("Entities/ScenarioObject"):
            tag = "" if len(holder) == 0 else str(holder[0].tag)
            if {"Vehicle": "vehicle", "Pedestrian": "pedestrian", "MiscObject": "miscellaneous"}.get(tag) in kinds:
                members.append(holder.get("name", ""))
        for reference in list(root.iter("EntityRef")):
            parent = reference.getparent()
            if reference.get("entityRef") == selection.get("name") and parent is not None:
                for member in dict.fromkeys(members):
                    reference.addprevious(etree.Element("EntityRef", entityRef=member))
                parent.remove(reference)
        _detach(selection)


def _detach(element: etree._Element) -> None:
    parent = element.getparent()
    if parent is not None:
        parent.remove(element)


def _later_words(root: etree._Element) -> None:
    """Leave out attributes that came after 1.0, and without which the rest means the same."""
    for tag, names in _LATER.items():
        for element in root.iter(tag):
            for name in names:
                element.attrib.pop(name, "")


def _resolve(element: etree._Element, scope: Scope) -> None:
    """Put values in the place of parameters and expressions."""
    if not isinstance(element.tag, str) or element.tag == "ParameterDeclarations":
        return
    inner = scope.within(element) if element.find("ParameterDeclarations") is not None else scope
    for name, text in element.attrib.items():
        if "$" not in str(text) or name == "parameterRef":
            continue
        if name == "name":
            # In 1.0 a $ in a name would be read as a reference to a parameter; it is left out.
            element.set(name, str(text).translate(_NAMED))
        else:
            element.set(name, inner.text(element, str(name)))
    for child in element:
        if child.tag == "CatalogReference":
            # ScenarioRunner would look for catalogs beside the new file, and cannot read those of later versions.
            entry, own = inner.from_catalog(child)
            within = etree.fromstring(etree.tostring(entry, with_tail=False))
            element.replace(child, within)
            # The scope holds these values, or what the reference assigns in their place.
            for declarations in within.findall("ParameterDeclarations"):
                declarations.clear()
            _resolve(within, own)
        else:
            _resolve(child, inner)


def _trim(root: etree._Element) -> None:
    """Take away the blanks around numbers, which XML allows and ScenarioRunner does not."""
    for element in root.iter("*"):
        for name, text in element.attrib.items():
            if name != "name" and not str(name).endswith("Ref") and _NUMBER.fullmatch(str(text).strip()):
                element.set(name, str(text).strip())


def _entities(root: etree._Element, ego: str, made: Plan, notes: list[str]) -> None:
    for holder in root.iterfind("Entities/ScenarioObject"):
        name = holder.get("name", "")
        for controlled in holder.findall("ObjectController"):
            driver = controlled.find(f"Controller/Properties/Property[@name='{DRIVER_PROPERTY}']")
            # ScenarioRunner does not run these, but would take their properties for the entity's own.
            holder.remove(controlled)
            if driver is not None and name not in made.sampled:
                who = "the agent that ScenarioRunner gives it" if name == ego else "the storyboard alone"
                notes.append(f"{name} is driven by {who}, not by cornercase's driver '{driver.get('value')}'.")
        vehicle, walker = holder.find("Vehicle"), holder.find("Pedestrian")
        if vehicle is not None:
            properties = vehicle.find("Properties")
            if properties is None:
                properties = etree.SubElement(vehicle, "Properties")
            for old in properties.findall("Property[@name='type']"):
                properties.remove(old)
            kind = "ego_vehicle" if name == ego else "simulation"
            rear = vehicle.find("Axles/RearAxle")
            if rear is not None and vehicle.find("Axles/FrontAxle") is None:
                # 1.0 asks for both, and nobody reads them.
                front = etree.fromstring(etree.tostring(rear, with_tail=False))
                front.tag = "FrontAxle"
                rear.addprevious(front)
            # Before the files that properties may hold.
            properties.insert(0, etree.Element("Property", name="type", value=kind))
        if walker is not None:
            # In 1.0 a pedestrian has a model, and ScenarioRunner takes it for a blueprint of CARLA.
            walker.set("model", walker.get("model", "walker.pedestrian.0001"))
        for body in holder.iterfind("*"):
            if body.tag in ("Pedestrian", "MiscObject"):
                # 1.0 asks for a mass, which nobody reads.
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
        # ScenarioRunner does not look at the edge.
        condition.set("conditionEdge", "none")
        if condition.get("delay") is None:
            condition.set("delay", "0")


def _synchronised(root: etree._Element, scenario: Scenario, notes: list[str]) -> None:
    """Give a final speed to each synchronisation, which ScenarioRunner cannot do without."""
    for action in root.iter("SynchronizeAction"):
        steady = action.find("FinalSpeed")
        if steady is not None and steady.find("*/SteadyState") is not None:
            raise InputError(
                f"{scenario.path}: a steady state of <SynchronizeAction> cannot be expressed in OpenSCENARIO 1.0."
            )
        if steady is not None:
            continue
        group = next((one for one in action.iterancestors("ManeuverGroup")), None)
        actors = [] if group is None else [one.get("entityRef") for one in group.iterfind("Actors/EntityRef")]
        speeds = [
            float(one.get("value", "0"))
            for holder in root.iter("ManeuverGroup", "Private")
            if holder.get("entityRef") in actors
            or any(one.get("entityRef") in actors for one in holder.iterfind("Actors/EntityRef"))
            for one in holder.iter("AbsoluteTargetSpeed")
        ]
        if not speeds:
            raise InputError(
                f"{scenario.path}: a <SynchronizeAction> needs a <FinalSpeed> for ScenarioRunner; add one."
            )
        etree.SubElement(etree.SubElement(action, "FinalSpeed"), "AbsoluteSpeed", value=f"{max(speeds):g}")
        notes.append(f"{actors[0] if actors else 'Who'} synchronises with a final speed of {max(speeds):g} m/s.")
