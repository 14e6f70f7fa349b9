"""Conversion of concrete scenarios to OpenSCENARIO 1.0 for CARLA's ScenarioRunner."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.io.atomic import atomic_write_group
from cornercase._common.io.files import atomic_write, check_output_differs_from_source
from cornercase._common.optional_packages import describe_install
from cornercase._common.validation import check_parameter_values, check_path
from cornercase.recordings import Recording
from cornercase.roads._network import RoadNetwork
from cornercase.scenario import Value
from cornercase.scenario._concrete_file import copy_companion_file
from cornercase.scenario._file import DRIVER_PROPERTY, ScenarioFile
from cornercase.scenario._left_handed_axes import mirror_axes
from cornercase.scenario._scope import Scope
from cornercase.simulators.builtin._check import schema_errors
from cornercase.simulators.carla._code_injection import add_criteria, pop_criteria, refuse_code_injection
from cornercase.simulators.carla._controller_assignment import DrivingAgents, assign_controllers
from cornercase.simulators.carla._movement_plan import (
    MovementPlan,
    plan_movements,
    refuse_unsupported,
    select_stop_conditions,
)
from cornercase.simulators.carla._path_deviations import find_deviating_entities, initial_heights
from cornercase.simulators.carla._road_conversion import NARROW_WIDTH, VERGE_WIDTH, find_entities_beyond_ground, is_flat
from cornercase.simulators.carla._storyboard_rewrite import (
    add_missing_start_triggers,
    copy_stop_trigger_to_acts,
    format_number,
    make_names_unique,
    remove_element,
    remove_entities_from_storyboard,
    remove_ineffective,
    set_end_time,
    set_initial_state,
)
from cornercase.simulators.carla._support_table import describe_version_gap, find_version_gaps
from cornercase.simulators.carla._trajectories import add_trajectories, make_trajectory, simulate_builtin

_MINOR_REVISION: Final = 0
# Attributes introduced after 1.0 that do not change the meaning of the rest.
_LATER_ATTRIBUTES: Final = {
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
_PARAMETER_CHARACTERS: Final = str.maketrans("", "", "${}")
_RULES_IN_1_0: Final = {"greaterOrEqual": "greaterThan", "lessOrEqual": "lessThan"}
# Numbers and truth values of XML.
_NUMBER_PATTERN: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|-?INF|NaN|true|false", re.ASCII)
_PLAIN_NUMBER_PATTERN: Final = re.compile(r"-?\d+(\.\d*)?", re.ASCII)
_MAX_ENTITIES: Final = 500
# How names of CARLA's objects begin, and the object that ScenarioRunner 0.9.16 takes for all other names.
_THING_PREFIX, _DEFAULT_THING = "static.", "static.prop.streetbarrier"
GROUND_NOTE: Final = "the world that CARLA makes of the road file has ground beside them up to"
_AXES_NOTE: Final = (
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

    Examples
    --------
    >>> import cornercase as cc
    >>> conversion = cc.convert("examples/t_intersection/t_intersection.xosc", "t10.xosc", ego="Ego")
    >>> print(conversion.notes[-1])
    C synchronises with a final speed of 10 m/s.
    """

    path: Path
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        lines = "".join(f"\n  {note}" for note in self.notes) or "\n  nothing had to be changed"
        return f"<Conversion {self.path}:{lines}>"


def convert(
    scenario: ScenarioFile | Path | str, output: Path | str, *, ego: str, values: Mapping[str, Value] | None = None
) -> Conversion:
    """Write a concrete scenario as OpenSCENARIO 1.0 for CARLA's ScenarioRunner.

    Parameters and expressions are replaced by their values, since 1.0 has no expressions, and catalog entries are
    copied into the file. The ego becomes ScenarioRunner's ``ego_vehicle``. The road file is copied next to the new file
    and named after it (``t10.xodr`` for ``t10.xosc``). If the scenario names a map of CARLA (``Town01``) instead, no
    road file is copied.

    Parameters
    ----------
    scenario : ScenarioFile or path
        OpenSCENARIO of any version.
    output : path
        File to write.
    ego : str
        Entity that becomes the ego vehicle.
    values : mapping of str to float or str, optional
        Parameter values; all other parameters keep the values of their declarations.

    Returns
    -------
    Conversion

    Raises
    ------
    InputError
        A file cannot be read or written, the entity or a parameter does not exist, or something cannot be expressed in
        OpenSCENARIO 1.0.

    Examples
    --------
    >>> from cornercase.simulators import convert
    >>> convert("t_intersection.xosc", "t10.xosc", ego="Ego", values={"c_speed": 9.0}).notes  # doctest: +SKIP
    ("Ego is driven by the agent that ScenarioRunner gives it, not by cornercase's driver 'normal'.", ...)
    """
    if not isinstance(scenario, ScenarioFile):
        scenario = ScenarioFile.read(scenario)
    output, checked_values = check_path("output", output), check_parameter_values("values", values)
    check_output_differs_from_source(output, scenario.path)
    return Conversion(
        output,
        write_openscenario_1_0(
            scenario, checked_values, output, ego=ego, options=ConversionOptions(with_criteria=True)
        ),
    )


@dataclass(frozen=True)
class ConversionOptions:
    """Options of a converted scenario.

    `agents`: agents that drive entities instead of the storyboard. `time_step`, `duration`: in s. `open_loop`: whether
    an entity may move along a trajectory although it should react to an agent-driven entity. `road_file`: path of the
    copied road file, relative to the folder of the new file (default: next to it). `controllers`: folder of
    cornercase's controllers, relative to the same folder. `with_criteria`: whether ScenarioRunner judges the run by the
    criteria of the scenario. `is_run`: whether the file is only for a run by cornercase; trajectories are then given
    only to controllers, otherwise they are also written into the storyboard. `knows_left_hand_traffic`: whether CARLA's
    client recognizes left-hand traffic in a road file, as in 0.9.16 and later.
    """

    agents: DrivingAgents = field(default_factory=DrivingAgents)
    time_step: float = 0.05
    duration: float = 60.0
    open_loop: bool = True
    road_file: str = ""
    controllers: str = ""
    with_criteria: bool = False
    is_run: bool = False
    knows_left_hand_traffic: bool = False


def write_openscenario_1_0(
    scenario: ScenarioFile,
    values: Mapping[str, Value],
    target: Path | str,
    *,
    ego: str,
    options: ConversionOptions | None = None,
) -> tuple[str, ...]:
    """Write a concrete scenario for ScenarioRunner like `convert`, with more options; return notes on differences."""
    options = options or ConversionOptions()
    scenario.require_declared(list(values))
    scenario.require_entity(ego, "ego")
    target, road = Path(target), scenario.road_path_for(values)
    town = carla_map_name(scenario, values)
    missing_map = "" if road is None or road.exists() else town
    root, notes, controllers = _make_tree_1_0(scenario, values, ego, options, missing_map)
    # A scenario must not choose the name of a written file: ScenarioRunner would import 'carla.py'.
    road_file = options.road_file or f"{target.stem}.xodr"
    file = root.find("RoadNetwork/LogicFile")
    if road is not None and file is not None:
        try:
            file.set("filepath", town or road_file)
        except ValueError as error:
            raise InputError(f"{target}: its name has characters that XML cannot hold; choose another one.") from error
    if not options.is_run:
        notes += [f"{describe_version_gap(*gap)}." for gap in find_version_gaps(root).items()]
    violations = schema_errors(root)
    if violations is None:
        notes.append(f"It was not validated against the schema of 1.0: {describe_install('validate')}.")
    elif violations:
        raise InputError(f"{scenario.path}: cannot be expressed in OpenSCENARIO 1.0 ({violations[0]}).")
    content = io.BytesIO()
    # Into memory: lxml may silently lose data when it writes to a full disk.
    etree.ElementTree(root).write(content, encoding="utf-8", xml_declaration=True, pretty_print=True)
    with atomic_write_group():
        if road is not None and not town:
            copy_companion_file(road, target.parent / road_file, "OpenDRIVE")
        for controller in controllers:
            with atomic_write(target.parent / options.controllers / controller.name) as temporary:
                temporary.write_bytes(controller.read_bytes())
        with atomic_write(target) as temporary:
            temporary.write_bytes(content.getvalue())
    return tuple(dict.fromkeys(notes))


def carla_map_name(scenario: ScenarioFile, values: Mapping[str, Value]) -> str:
    """Return the name of the map of CARLA that a scenario names instead of a road file; empty if it names none."""
    reference = scenario.road_reference_for(values)
    road = scenario.resolve_path(reference, "road file")
    if not reference or road.exists() or not re.fullmatch(r"\w+", road.name, re.ASCII):
        return ""
    return road.name


def make_concrete_tree(scenario: ScenarioFile, values: Mapping[str, Value]) -> etree._Element:
    """Return the XML tree of a concrete scenario, with parameters and catalog references replaced."""
    # The time grows with the square of the number of entities.
    if len(scenario.entities) > _MAX_ENTITIES:
        raise InputError(
            f"{scenario.path}: has {len(scenario.entities)} entities; at most {_MAX_ENTITIES} can be written."
        )
    root = etree.fromstring(etree.tostring(scenario.root))
    scope = scenario.scope([values])
    if scope.find_violations_in(scenario.root):
        raise InputError(f"{scenario.path}: the values break a constraint of the parameters' declarations.")
    # The scope contains the file's own declarations already, with the given values.
    for child in root:
        _resolve_expressions(child, scope)
    _trim_numbers(root)
    if scenario.has_left_handed_axes:
        mirror_axes(root)
    return root


def _make_tree_1_0(
    scenario: ScenarioFile, values: Mapping[str, Value], ego: str, options: ConversionOptions, map_name: str
) -> tuple[etree._Element, list[str], set[Path]]:
    """Return the tree of a scenario in OpenSCENARIO 1.0, notes on differences, and the needed controller files."""
    root = make_concrete_tree(scenario, values)
    criteria = pop_criteria(root)
    refuse_code_injection(root, scenario.path)
    _rewrite_header(root, scenario.path)
    _expand_selections(root)
    refuse_unsupported(root, scenario.path)
    driven = options.agents.driven_entities(ego)
    if ego in scenario.drivers:
        # The ego is the system under test, driven by an agent that the file cannot name.
        driven.add(ego)
    recording = None if map_name else simulate_builtin(scenario, values, options.time_step, options.duration)
    road = scenario.road_path_for(values)
    astray = (
        {}
        if recording is None
        else find_deviating_entities(recording, road, scenario, knows_left_hand_traffic=options.knows_left_hand_traffic)
    )
    slowest = (
        {} if recording is None else dict(zip(recording.names, np.fmin.reduce(recording.speed, axis=1), strict=True))
    )
    beyond_ground = (
        [] if recording is None or road is None else _describe_missing_ground(recording, road, scenario, options)
    )
    axes_notes = (_AXES_NOTE,) if scenario.has_left_handed_axes else ()
    actor_plan = plan_movements(root, sorted(driven), scenario.path, map_name, astray, slowest)
    notes = [*axes_notes, *actor_plan.notes, *beyond_ground]
    for name in actor_plan.sampled if not options.open_loop else ():
        if name in actor_plan.reacting:
            raise InputError(
                f"{scenario.path}: '{name}' has to react to {' and '.join(sorted(driven))}, but ScenarioRunner cannot"
                f" execute the motion of '{name}' ({actor_plan.sampled[name][0]}); with `simulator`"
                f" carla:open_loop=true '{name}' moves as in the builtin simulator, without reacting."
            )
    if options.is_run and not options.knows_left_hand_traffic and road is not None and not map_name:
        by_lanes = [*options.agents.driven_by_route(ego), *(actor_plan.reacting - set(actor_plan.sampled))]
        _refuse_left_hand_traffic(scenario, road, by_lanes)
    kept_groups = select_stop_conditions(root, actor_plan, driven or ({ego} if map_name else set()))
    remove_ineffective(root)
    remove_entities_from_storyboard(root, set(actor_plan.sampled) | actor_plan.dropped)
    _rewrite_entities(root, ego, actor_plan, notes)
    trajectories = {} if recording is None else {name: make_trajectory(recording, name) for name in actor_plan.sampled}
    notes += filter(None, (trajectory.note for trajectory in trajectories.values()))
    # ScenarioRunner 0.9.13 knows no trajectories; in a run, the controller knows all.
    add_trajectories(root, {} if options.is_run else trajectories, ego)
    centers: dict[str, float] = {}
    end = options.duration
    if recording is not None:
        by_storyboard = set(recording.names) - set(actor_plan.sampled)
        heights = initial_heights(recording, road, scenario)
        # ScenarioRunner puts the origin of an actor, which is in its middle, where the file has the reference point.
        set_initial_state(root, recording, by_storyboard, heights, by_centers=options.is_run)
        centers = dict(zip(recording.names, map(float, recording.center_x), strict=True))
        last_time = float(recording.time[-1])
        # If nothing ends the scenario, the caller ends it.
        end += 1.0
        if not kept_groups and last_time < options.duration - 0.5 * options.time_step:
            # Time conditions become true in the first frame after the time.
            end = last_time - 0.5 * options.time_step
    set_end_time(root, end, kept_groups)
    copy_stop_trigger_to_acts(root)
    add_missing_start_triggers(root)
    make_names_unique(root)
    if options.with_criteria:
        notes += add_criteria(root, criteria)
    _rewrite_conditions(root, scenario.path, notes)
    _add_final_speeds(root, scenario, notes)
    _remove_later_attributes(root)
    controllers = assign_controllers(
        root, scenario.path, ego, options.agents,
        {
            name: {"center_x": format_number(centers[name]), **trajectory.to_properties(ends=options.is_run)}
            for name, trajectory in trajectories.items()
        },
    )  # fmt: skip
    return root, notes, controllers


def _refuse_left_hand_traffic(scenario: ScenarioFile, road: Path, by_lanes: Sequence[str]) -> None:
    """Raise `InputError` if roads have left-hand traffic and entities (`by_lanes`) move along CARLA's lanes."""
    if by_lanes and not all(
        element.is_right_hand_traffic for element in RoadNetwork.from_xml(scenario.get_root(road), road).roads
    ):
        raise InputError(
            f"{road}: has left-hand traffic, which CARLA before 0.9.16 takes for right-hand traffic, so"
            f" {' and '.join(sorted(by_lanes))} would drive on the wrong side; use CARLA 0.9.16."
        )


def _describe_missing_ground(
    recording: Recording, road: Path, scenario: ScenarioFile, options: ConversionOptions
) -> list[str]:
    root = scenario.get_root(road)
    width = VERGE_WIDTH if options.is_run and is_flat(root) else NARROW_WIDTH
    distances = find_entities_beyond_ground(recording, RoadNetwork.from_xml(root, road), width)
    return [
        f"{name} goes {distance:.1f} m from the roads, but {GROUND_NOTE} {width:g} m."
        for name, distance in distances.items()
    ]


def _rewrite_header(root: etree._Element, source: Path) -> None:
    for unused in root.iter("ParameterDeclarations", "CatalogLocations"):
        unused.clear()
    for unused in root.findall("VariableDeclarations") + root.findall("MonitorDeclarations"):
        root.remove(unused)
    header = root.find("FileHeader")
    if header is None:
        raise InputError(f"{source}: has no <FileHeader>.")
    header.set("revMajor", "1")
    header.set("revMinor", str(_MINOR_REVISION))
    # ScenarioRunner names files after the description, and a leading 'CARLA:' would change the axes.
    header.set("description", "cornercase")
    for child in list(header):
        header.remove(child)
    header.text = None


def _expand_selections(root: etree._Element) -> None:
    """Replace references to entity selections by their members, since ScenarioRunner has no selections."""
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


def _remove_later_attributes(root: etree._Element) -> None:
    """Remove attributes that OpenSCENARIO 1.0 does not have and that do not change the meaning of other attributes."""
    for tag, names in _LATER_ATTRIBUTES.items():
        for element in root.iter(tag):
            for name in names:
                element.attrib.pop(name, "")


def _resolve_expressions(element: etree._Element, scope: Scope) -> None:
    """Replace parameters and expressions in attributes by their values, and catalog references by their entries."""
    if not isinstance(element.tag, str) or element.tag == "ParameterDeclarations":
        return
    inner = scope.nested_scope(element) if element.find("ParameterDeclarations") is not None else scope
    for name, text in element.attrib.items():
        if "$" not in str(text) or name == "parameterRef":
            continue
        if name == "name":
            # In 1.0, a $ in a name would be read as a parameter reference; remove it.
            element.set(name, str(text).translate(_PARAMETER_CHARACTERS))
        else:
            element.set(name, inner.read_text(element, str(name)))
    for child in element:
        if child.tag == "CatalogReference":
            # ScenarioRunner would search catalogs next to the new file, and cannot read later versions.
            entry, entry_scope = inner.resolve_catalog_reference(child)
            resolved_entry = etree.fromstring(etree.tostring(entry, with_tail=False))
            element.replace(child, resolved_entry)
            # The scope contains these values, or those that the reference assigns.
            for declarations in resolved_entry.findall("ParameterDeclarations"):
                declarations.clear()
            _resolve_expressions(resolved_entry, entry_scope)
        else:
            _resolve_expressions(child, inner)


def _trim_numbers(root: etree._Element) -> None:
    """Remove surrounding spaces, plus signs and exponents from numbers in attributes.

    ScenarioRunner cannot read numbers that contain them. A number in a ``Property`` only loses the spaces; names and
    references are left as they are.
    """
    for element in root.iter("*"):
        for name, text in element.attrib.items():
            if name != "name" and not str(name).endswith("Ref") and _NUMBER_PATTERN.fullmatch(str(text).strip()):
                number = str(text).strip()
                # ScenarioRunner before 0.9.16 takes other numbers for names of parameters.
                is_plain = (
                    element.tag == "Property"
                    or number[-1].isalpha()
                    or _PLAIN_NUMBER_PATTERN.fullmatch(number) is not None
                )
                element.set(name, number if is_plain else f"{Decimal(number):f}")


def _rewrite_entities(root: etree._Element, ego: str, actor_plan: MovementPlan, notes: list[str]) -> None:
    for holder in root.iterfind("Entities/ScenarioObject"):
        name = holder.get("name", "")
        for controlled in holder.findall("ObjectController"):
            driver = controlled.find(f"Controller/Properties/Property[@name='{DRIVER_PROPERTY}']")
            # ScenarioRunner ignores these, but would use their properties as the entity's own.
            holder.remove(controlled)
            if driver is not None and name not in actor_plan.sampled:
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
        thing = holder.find("MiscObject")
        if thing is not None and not thing.get("name", "").startswith(_THING_PREFIX):
            # ScenarioRunner before 0.9.16 fails at a name that is none of CARLA's; later ones take this.
            thing.set("name", _DEFAULT_THING)
        for body in holder.iterfind("*"):
            if body.tag in ("Pedestrian", "MiscObject"):
                # 1.0 requires a mass, which has no effect.
                body.set("mass", body.get("mass", "80"))
                if body.find("Properties") is None:
                    etree.SubElement(body, "Properties")


def _rewrite_conditions(root: etree._Element, source: Path, notes: list[str]) -> None:
    for element in root.iter():
        rule = element.get("rule") if isinstance(element.tag, str) else None
        if rule in _RULES_IN_1_0:
            element.set("rule", _RULES_IN_1_0[str(rule)])
            notes.append(f"'{rule}' became '{_RULES_IN_1_0[str(rule)]}', which may be true a time step later.")
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


def _add_final_speeds(root: etree._Element, scenario: ScenarioFile, notes: list[str]) -> None:
    """Add a final speed to synchronize actions without one, since ScenarioRunner requires a final speed."""
    for action in root.iter("SynchronizeAction"):
        final_speed = action.find("FinalSpeed")
        if final_speed is not None and final_speed.find("*/SteadyState") is not None:
            raise InputError(
                f"{scenario.path}, line {action.sourceline}: <FinalSpeed> of <SynchronizeAction> has a steady state;"
                " remove the steady state, since ScenarioRunner reads OpenSCENARIO 1.0, which has none."
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
