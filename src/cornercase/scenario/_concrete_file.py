"""Write concrete scenarios as files that run on their own."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.io.files import atomic_write, make_portable_file_name, read_file
from cornercase._common.text.sanitize import escape_control_characters
from cornercase.scenario._file import DRIVER_PROPERTY, ScenarioFile
from cornercase.scenario._left_handed_axes import LEFT_HANDED_PREFIX, find_left_handed_header
from cornercase.scenario._parameter import Value
from cornercase.scenario._types import convert_to_type, format_value
from cornercase.scenario._xml import parse_xml

# Initial actions that set the controller of an entity.
_CONTROLLER_ACTIONS: Final = ("ControllerAction", "AssignControllerAction", "ActivateControllerAction")


@dataclass(frozen=True)
class ConcreteFile:
    """Content of a concrete scenario file (XML in UTF-8), and the companion files that it needs.

    `companions` has three items for each companion file: its present path, its new path relative to the folder of the
    concrete file, and the tag of its root element.
    """

    content: bytes
    companions: tuple[tuple[Path, str, str], ...]


def write_concrete_file(
    scenario: ScenarioFile,
    values: Mapping[str, Value],
    target: Path,
    drivers: Mapping[str, str] | None = None,
    description: str | None = None,
) -> tuple[Path, ...]:
    """Write a concrete scenario, and copies of its road file, catalogs and profiles beside it; return all paths.

    `drivers` maps the names of entities to driver presets, with options as in ``"PRESET:reaction=0.3"``. `description`
    replaces the description in the file header.
    """
    concrete = build_concrete_file(scenario, values, target, drivers, description)
    for source, relative, root in concrete.companions:
        copy_companion_file(source, target.parent / relative, root)
    with atomic_write(target) as temporary:
        temporary.write_bytes(concrete.content)
    return target, *(target.parent / relative for _, relative, _ in concrete.companions)


def build_concrete_file(
    scenario: ScenarioFile,
    values: Mapping[str, Value],
    target: Path,
    drivers: Mapping[str, str] | None = None,
    description: str | None = None,
) -> ConcreteFile:
    """Build the content that `write_concrete_file` writes, but write nothing; `target` is only for error messages."""
    scenario.require_declared(list(values))
    root = deepcopy(scenario.root)
    header = root.find("FileHeader")
    if description is not None and header is not None:
        # The prefix declares the axes of the file.
        axes = "" if find_left_handed_header(root) is None else LEFT_HANDED_PREFIX
        _set_attribute(header, "description", escape_control_characters(axes + description), target)
    for declaration in root.iterfind("ParameterDeclarations/ParameterDeclaration"):
        name = declaration.get("name", "")
        if name in values:
            _set_attribute(declaration, "value", _format_typed_value(values[name], declaration, scenario.path), target)
    for name, driver in (drivers or {}).items():
        scenario.require_entity(name, "driven entity")
        for element in root.iterfind("Entities/ScenarioObject"):
            if element.get("name") == name:
                _set_driver_property(element, driver, target)
        _remove_initial_controllers(scenario, root, name, values)
    buffer = io.BytesIO()
    profiles = ((file, file.name, "Profiles") for file in scenario.profiles_files)
    companions = (*_relocate_road_file(scenario, root, values), *_relocate_catalogs(scenario, root, values), *profiles)
    etree.ElementTree(root).write(buffer, encoding="utf-8", xml_declaration=True, pretty_print=True)
    return ConcreteFile(buffer.getvalue(), companions)


def _relocate_road_file(
    scenario: ScenarioFile, root: etree._Element, values: Mapping[str, Value]
) -> Iterator[tuple[Path, str, str]]:
    """Change the path of the road file to its bare file name, and yield the item for `ConcreteFile.companions`."""
    logic_file = root.find("RoadNetwork/LogicFile")
    if logic_file is not None and logic_file.get("filepath"):
        holder, attribute = _find_path_attribute(root, logic_file, "filepath")
        source = scenario.existing_road_path(scenario.road_reference_for(values))
        holder.set(attribute, source.name)
        yield source, source.name, "OpenDRIVE"


def _relocate_catalogs(
    scenario: ScenarioFile, root: etree._Element, values: Mapping[str, Value]
) -> Iterator[tuple[Path, str, str]]:
    """Change catalog locations to subfolders of ``catalogs``; yield an item for `ConcreteFile.companions` per file."""
    folders: dict[str, Path] = {}
    changed: set[etree._Element] = set()
    for directory in root.iterfind("CatalogLocations//Directory"):
        holder, attribute = _find_path_attribute(root, directory, "path")
        if holder in changed:
            continue
        changed.add(holder)
        reference = scenario.replace_parameter(directory.get("path", ""), values)
        folder = scenario.resolve_path(reference, "catalog location")
        # ".." is a folder name, too.
        name = base = make_portable_file_name(folder.stem if folder.is_file() else folder.name)
        # Folders may have the same name.
        suffixes = count(len(folders) + 1)
        while folders.setdefault(name, folder) != folder:
            name = f"{base}-{next(suffixes)}"
        # openPASS writes files as catalog locations.
        catalog_files = scenario.catalog_files()
        for file in (
            [folder]
            if folder.is_file()
            else [candidate for candidate in sorted(folder.glob("*.xosc")) if candidate in catalog_files]
        ):
            yield file, f"catalogs/{name}/{file.name}", "OpenSCENARIO"
        holder.set(attribute, f"catalogs/{name}")


def _find_path_attribute(root: etree._Element, element: etree._Element, attribute: str) -> tuple[etree._Element, str]:
    """Return the element and the attribute that hold a path.

    These are `element` and `attribute`. If the attribute refers to a parameter, they are the declaration of this
    parameter, and ``value``. If it is declared several times, the last declaration counts.
    """
    text = element.get(attribute, "")
    declarations = root.findall("ParameterDeclarations/ParameterDeclaration")
    for declaration in reversed(declarations):
        if text == f"${declaration.get('name')}":
            return declaration, "value"
    return element, attribute


def _format_typed_value(value: Value, declaration: etree._Element, path: Path) -> str:
    """Format a value as the declared type of its parameter."""
    if isinstance(value, str) and value.lstrip().startswith("$"):
        return value
    try:
        return format_value(convert_to_type(value, declaration.get("parameterType", "string")))
    except ValueError as why:
        raise InputError(f"{path}: the parameter {declaration.get('name')} is '{value}', {why}.") from None


def _set_attribute(element: etree._Element, attribute: str, text: str, target: Path) -> None:
    try:
        element.set(attribute, text)
    except ValueError:
        raise InputError(
            f"{target}: cannot be written, since XML cannot contain {escape_control_characters(text)!r}."
        ) from None


def _set_driver_property(scenario_object: etree._Element, driver: str, target: Path) -> None:
    for controller in scenario_object.iterfind("ObjectController/Controller"):
        for item in controller.iterfind("Properties/Property"):
            if item.get("name") == DRIVER_PROPERTY:
                _set_attribute(item, "value", driver, target)
                return
    holder = etree.SubElement(scenario_object, "ObjectController")
    controller = etree.SubElement(holder, "Controller", name=f"driver of {scenario_object.get('name')}")
    item = etree.SubElement(etree.SubElement(controller, "Properties"), "Property", name=DRIVER_PROPERTY)
    _set_attribute(item, "value", driver, target)


def _remove_initial_controllers(
    scenario: ScenarioFile, root: etree._Element, entity: str, values: Mapping[str, Value]
) -> None:
    """Remove the actions in ``Init`` on controllers of an entity: they would replace the entity's new driver.

    Actions of a selection that contains the entity stay.
    """
    for private in root.findall("Storyboard/Init/Actions/Private"):
        if scenario.replace_parameter(private.get("entityRef", ""), values) == entity:
            for action in private.findall("PrivateAction"):
                if any(action.find(tag) is not None for tag in _CONTROLLER_ACTIONS):
                    private.remove(action)
            actions = private.getparent()
            if actions is not None and not private.findall("PrivateAction"):
                actions.remove(private)


def copy_companion_file(source: Path, target: Path, root_tag: str) -> None:
    """Copy an XML file that a scenario needs, unless an identical copy exists.

    Raises `InputError` if its root element does not have the tag `root_tag`.
    """
    content = read_required_xml(source, root_tag)
    if target.exists() and target.read_bytes() == content:
        return
    with atomic_write(target) as temporary:
        temporary.write_bytes(content)


def read_required_xml(source: Path, root_tag: str) -> bytes:
    """Return the content of an XML file that a scenario needs.

    Raises `InputError` if its root element does not have the tag `root_tag`. Otherwise an untrusted scenario could have
    any file of this machine copied.
    """
    if not source.is_file():
        raise InputError(f"{source}: the scenario needs this file, but it does not exist.")
    content = read_file(source)
    tag = parse_xml(content, source).tag
    if tag != root_tag:
        raise InputError(f"{source}: the root element is <{tag}>; the scenario needs a file with <{root_tag}>.")
    return content
