"""Concrete scenarios as OpenSCENARIO 1.0, in the dialect of CARLA's ScenarioRunner."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common.arguments import numbers_or_texts, path
from cornercase._common.errors import InputError
from cornercase._common.files import require_other_file, written_whole
from cornercase.scenario import DRIVER_PROPERTY, Scenario, Scope, Value, copy_beside
from cornercase.simulators.builtin.checking import schema_errors
from cornercase.simulators.carla.foreign_code import refuse_code

_MINOR: Final = 0
# Attributes that are newer than 1.0, and without which the rest means the same.
_LATER: Final = {
    "SynchronizeAction": ("targetTolerance", "targetToleranceMaster"),
    "Vehicle": ("mass", "role", "model3d"),
    "Pedestrian": ("role", "model3d"),
    "MiscObject": ("model3d",),
}
_NAMED: Final = str.maketrans("", "", "${}")
_RULES: Final = {"greaterOrEqual": "greaterThan", "lessOrEqual": "lessThan"}


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
    return Conversion(output, write_1_0(scenario, given, output, ego=ego))


def write_1_0(
    scenario: Scenario,
    values: Mapping[str, Value],
    target: Path | str,
    *,
    ego: str,
    road_file: str = "",
    adapt: Callable[[etree._Element], None] | None = None,
) -> tuple[str, ...]:
    """Write a concrete scenario for ScenarioRunner, as `convert` does.

    Parameters
    ----------
    scenario : Scenario
    values : mapping of str to float or str
    target : path
    ego : str
    road_file : str, optional
        Path of the copied road file, relative to that of the new file; by default beside it, named after it.
    adapt : callable, optional
        Changes the tree before it is held against the schema and written.

    Returns
    -------
    tuple of str
        What is not quite the same.

    Raises
    ------
    InputError
        As in `convert`.
    """
    scenario.require_parameters(list(values))
    scenario.require_entity(ego, "ego")
    root, notes = _tree_1_0(scenario, values, ego)
    target, road = Path(target), scenario.road_file(values)
    town = carla_map(road)
    # A scenario must not choose the name of a file that is written: ScenarioRunner would import 'carla.py'.
    road_file = road_file or f"{target.stem}.xodr"
    file = root.find("RoadNetwork/LogicFile")
    if road is not None and file is not None:
        file.set("filepath", town or road_file)
    if adapt is not None:
        adapt(root)
    wrong = schema_errors(root)
    if wrong is None:
        notes.append("It was not held against the schema of 1.0; pip install 'cornercase[validate]'.")
    elif wrong:
        raise InputError(f"{scenario.path}: cannot be said in OpenSCENARIO 1.0 ({wrong[0]}).")
    if road is not None and not town:
        copy_beside(road, target.parent / road_file, "OpenDRIVE")
    with written_whole(target) as temporary:
        etree.ElementTree(root).write(str(temporary), encoding="utf-8", xml_declaration=True, pretty_print=True)
    return tuple(dict.fromkeys(notes))


def carla_map(road: Path | None) -> str:
    """Return the name of CARLA's map that a road file stands for.

    Parameters
    ----------
    road : Path or None

    Returns
    -------
    str
        Empty where it is a file, or there is none.
    """
    if road is None or road.exists() or not re.fullmatch(r"\w+", road.name, re.ASCII):
        return ""
    return road.name


def _tree_1_0(scenario: Scenario, values: Mapping[str, Value], ego: str) -> tuple[etree._Element, list[str]]:
    """Tree of a concrete scenario in the words of 1.0, and what is not quite the same."""
    root = etree.fromstring(etree.tostring(scenario.root))
    notes: list[str] = []
    scope = Scope.of_file(str(scenario.path), scenario.root, [dict(values)], scenario.catalog_entry)
    if scope.violations(scenario.root):
        raise InputError(f"{scenario.path}: the values break a constraint of the parameters' declarations.")
    # The file's own declarations are in the scope already, with the values that were given.
    for child in root:
        _resolve(child, scope)
    for unused in root.iter("ParameterDeclarations", "CatalogLocations"):
        unused.clear()
    header = root.find("FileHeader")
    if header is None:
        raise InputError(f"{scenario.path}: has no <FileHeader>.")
    header.set("revMajor", "1")
    header.set("revMinor", str(_MINOR))
    # ScenarioRunner names files after the description, and 'CARLA:' at its beginning would turn the axes.
    header.set("description", "cornercase")
    for child in list(header):
        header.remove(child)
    header.text = None
    refuse_code(root, scenario.path)
    _entities(root, ego, notes)
    _trajectories(root)
    _conditions(root, notes)
    _synchronised(root, scenario, notes)
    _later_words(root, notes)
    return root, notes


def _later_words(root: etree._Element, notes: list[str]) -> None:
    """Leave out elements and attributes that came after 1.0."""
    for part in list(root.iter("TrailerHitch", "TrailerCoupler", "Trailer")):
        holder = part.getparent()
        if holder is not None:
            holder.remove(part)
        if part.tag == "Trailer":
            notes.append("Trailers are left out.")
    for action in root.iter("LongitudinalDistanceAction", "LateralDistanceAction"):
        if action.get("coordinateSystem") == "entity":
            action.attrib.pop("coordinateSystem")
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
            within = deepcopy(entry)
            element.replace(child, within)
            # The scope holds these values, or what the reference assigns in their place.
            for declarations in within.findall("ParameterDeclarations"):
                declarations.clear()
            _resolve(within, own)
        else:
            _resolve(child, inner)


def _entities(root: etree._Element, ego: str, notes: list[str]) -> None:
    for holder in root.iterfind("Entities/ScenarioObject"):
        name = holder.get("name", "")
        for controlled in holder.findall("ObjectController"):
            driver = controlled.find(f"Controller/Properties/Property[@name='{DRIVER_PROPERTY}']")
            # ScenarioRunner does not run these, but would take their properties for the entity's own.
            holder.remove(controlled)
            if driver is None:
                notes.append(f"The <ObjectController> of {name} has no effect on ScenarioRunner.")
            else:
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
            # Before the files that properties may hold.
            properties.insert(0, etree.Element("Property", name="type", value=kind))
        if walker is not None:
            # In 1.0 a pedestrian has a model, and ScenarioRunner takes it for a blueprint of CARLA.
            walker.set("model", walker.get("model", "walker.pedestrian.0001"))


def _trajectories(root: etree._Element) -> None:
    for action in root.iter("FollowTrajectoryAction"):
        reference = action.find("TrajectoryRef")
        if reference is not None:
            action.replace(reference, reference[0])
        action.attrib.pop("initialDistanceOffset", "")
    for vertex in root.iter("Vertex"):
        vertex.set("time", vertex.get("time", "0"))
    for trajectory in root.iter("Trajectory"):
        if trajectory.find("ParameterDeclarations") is None:
            trajectory.insert(0, etree.Element("ParameterDeclarations"))


def _conditions(root: etree._Element, notes: list[str]) -> None:
    for element in root.iter():
        rule = element.get("rule") if isinstance(element.tag, str) else None
        if rule in _RULES:
            element.set("rule", _RULES[str(rule)])
            notes.append(f"'{rule}' became '{_RULES[str(rule)]}', which may be true a time step later.")
        elif rule == "notEqualTo":
            raise InputError(f"<{element.tag}>: 'notEqualTo' cannot be said in OpenSCENARIO 1.0.")
    for event in root.iter("Event"):
        if event.get("priority") == "override":
            event.set("priority", "overwrite")
    for condition in root.iter("Condition"):
        if condition.get("conditionEdge") is None:
            condition.set("conditionEdge", "none")
        if condition.get("delay") is None:
            condition.set("delay", "0")


def _synchronised(root: etree._Element, scenario: Scenario, notes: list[str]) -> None:
    """Give a final speed to each synchronisation, which ScenarioRunner cannot do without."""
    for action in root.iter("SynchronizeAction"):
        steady = action.find("FinalSpeed")
        if steady is not None and steady.find("*/SteadyState") is not None:
            raise InputError(
                f"{scenario.path}: a steady state of <SynchronizeAction> cannot be said in OpenSCENARIO 1.0."
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
