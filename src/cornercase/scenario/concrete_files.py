"""Concrete scenarios as files of their own."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.files import portable_name, read_file, written_whole
from cornercase._common.texts import plain_text
from cornercase.scenario.axes import LEFT_HANDED, left_handed_header
from cornercase.scenario.declared_types import typed_value, value_text
from cornercase.scenario.openscenario import DRIVER_PROPERTY, Scenario
from cornercase.scenario.parameter import Value
from cornercase.scenario.xml import parse_xml

# Initial actions that say who moves an entity.
_CONTROLLERS: Final = ("ControllerAction", "AssignControllerAction", "ActivateControllerAction")


@dataclass(frozen=True)
class ConcreteFile:
    """A concrete scenario as the content of a file, and what has to lie beside it.

    Attributes
    ----------
    content : bytes
        XML in UTF-8.
    beside : tuple of (Path, str, str)
        Files that it names: where each is, where it has to be from the folder of the file, and its root element.
    """

    content: bytes
    beside: tuple[tuple[Path, str, str], ...]


def write_concrete(
    scenario: Scenario,
    values: Mapping[str, Value],
    target: Path,
    drivers: Mapping[str, str] | None = None,
    description: str | None = None,
) -> tuple[Path, ...]:
    """Write a concrete scenario that runs by itself.

    The road file and the catalogs are copied beside it, unless they are there already.

    Parameters
    ----------
    scenario : Scenario
        The logical scenario's file.
    values : mapping of str to float or str
        Values of parameters, written into their declarations.
    target : Path
    drivers : mapping of str to str, optional
        Driver presets by entity, written as controller properties.
    description : str, optional
        Replaces the description in the file's header.

    Returns
    -------
    tuple of Path
        The file, and those beside it that it needs.

    Raises
    ------
    InputError
        A parameter or entity does not exist, or the target cannot be written.
    """
    made = fill_concrete(scenario, values, target, drivers, description)
    for source, place, root in made.beside:
        copy_beside(source, target.parent / place, root)
    with written_whole(target) as temporary:
        temporary.write_bytes(made.content)
    return target, *(target.parent / place for _, place, _ in made.beside)


def fill_concrete(
    scenario: Scenario,
    values: Mapping[str, Value],
    target: Path,
    drivers: Mapping[str, str] | None = None,
    description: str | None = None,
) -> ConcreteFile:
    """Give what `write_concrete` writes, and write nothing.

    Parameters
    ----------
    scenario : Scenario
        The logical scenario's file.
    values : mapping of str to float or str
        Values of parameters, written into their declarations.
    target : Path
        For messages.
    drivers : mapping of str to str, optional
        Driver presets by entity, written as controller properties.
    description : str, optional
        Replaces the description in the file's header.

    Returns
    -------
    ConcreteFile

    Raises
    ------
    InputError
        A parameter or entity does not exist, or XML cannot hold a value.
    """
    scenario.require_parameters(list(values))
    tree = etree.ElementTree(etree.fromstring(etree.tostring(scenario.root)))
    root = tree.getroot()
    header = root.find("FileHeader")
    if description is not None and header is not None:
        # It also says in which axes the file is.
        axes = "" if left_handed_header(root) is None else LEFT_HANDED
        _set(header, "description", plain_text(axes + description), target)
    for declaration in root.iterfind("ParameterDeclarations/ParameterDeclaration"):
        name = declaration.get("name", "")
        if name in values:
            _set(declaration, "value", _typed_text(values[name], declaration, scenario.path), target)
    for name, driver in (drivers or {}).items():
        scenario.require_entity(name, "driven entity")
        for element in root.iterfind("Entities/ScenarioObject"):
            if element.get("name") == name:
                _set_driver(element, driver, target)
        _keep_driver(root, name)
    buffer = io.BytesIO()
    profiles = ((file, file.name, "Profiles") for file in scenario.profiles_files)
    beside = (*_road_beside(scenario, root), *_catalogs_beside(scenario, root), *profiles)
    tree.write(buffer, encoding="utf-8", xml_declaration=True, pretty_print=True)
    return ConcreteFile(buffer.getvalue(), beside)


def _road_beside(scenario: Scenario, root: etree._Element) -> Iterator[tuple[Path, str, str]]:
    """Let the scenario name its road beside it."""
    logic_file = root.find("RoadNetwork/LogicFile")
    if logic_file is not None and logic_file.get("filepath"):
        holder, attribute = _holder(root, logic_file, "filepath")
        source = scenario.present_road(holder.get(attribute, ""))
        holder.set(attribute, source.name)
        yield source, source.name, "OpenDRIVE"


def _catalogs_beside(scenario: Scenario, root: etree._Element) -> Iterator[tuple[Path, str, str]]:
    """Let the scenario name its catalogs in a folder beside it."""
    taken: dict[str, Path] = {}
    for directory in root.iterfind("CatalogLocations//Directory"):
        holder, attribute = _holder(root, directory, "path")
        folder = scenario.beside(holder.get(attribute, ""), "catalog location")
        # "..", too, is the name of a folder.
        name = plain = portable_name(folder.stem if folder.is_file() else folder.name)
        # Two folders may have one name.
        while taken.setdefault(name, folder) != folder:
            name = f"{plain}-{len(taken) + 1}"
        # The location may be a file itself, as openPASS writes it.
        held = scenario.catalog_files()
        for file in [folder] if folder.is_file() else [one for one in sorted(folder.glob("*.xosc")) if one in held]:
            yield file, f"catalogs/{name}/{file.name}", "OpenSCENARIO"
        holder.set(attribute, f"catalogs/{name}")


def _holder(root: etree._Element, element: etree._Element, attribute: str) -> tuple[etree._Element, str]:
    """Where a path really stands: in the attribute, or in the declaration of the parameter that it names."""
    text = element.get(attribute, "")
    for declaration in root.iterfind("ParameterDeclarations/ParameterDeclaration"):
        if text == f"${declaration.get('name')}":
            return declaration, "value"
    return element, attribute


def _typed_text(value: Value, declaration: etree._Element, path: Path) -> str:
    """Write a value as one of the type that its parameter is declared with."""
    if isinstance(value, str) and value.lstrip().startswith("$"):
        return value
    try:
        return value_text(typed_value(value, declaration.get("parameterType", "string")))
    except ValueError as why:
        raise InputError(f"{path}: the parameter {declaration.get('name')} is '{value}', {why}.") from None


def _set(element: etree._Element, attribute: str, text: str, target: Path) -> None:
    try:
        element.set(attribute, text)
    except ValueError:
        raise InputError(f"{target}: cannot be written, since XML cannot hold {plain_text(text)!r}.") from None


def _set_driver(scenario_object: etree._Element, driver: str, target: Path) -> None:
    for controller in scenario_object.iterfind("ObjectController/Controller"):
        for item in controller.iterfind("Properties/Property"):
            if item.get("name") == DRIVER_PROPERTY:
                _set(item, "value", driver, target)
                return
    holder = etree.SubElement(scenario_object, "ObjectController")
    controller = etree.SubElement(holder, "Controller", name=f"driver of {scenario_object.get('name')}")
    item = etree.SubElement(etree.SubElement(controller, "Properties"), "Property", name=DRIVER_PROPERTY)
    _set(item, "value", driver, target)


def _keep_driver(root: etree._Element, entity: str) -> None:
    """Leave out what gives an entity another controller as it begins: its driver stays in charge, as it was chosen."""
    for private in root.findall("Storyboard/Init/Actions/Private"):
        if private.get("entityRef") == entity:
            for action in private.findall("PrivateAction"):
                if any(action.find(tag) is not None for tag in _CONTROLLERS):
                    private.remove(action)
            actions = private.getparent()
            if actions is not None and not private.findall("PrivateAction"):
                actions.remove(private)


def copy_beside(source: Path, target: Path, root: str) -> None:
    """Copy an XML file that a scenario needs, unless it is there already.

    Parameters
    ----------
    source, target : Path
    root : str
        Tag of its root element.

    Raises
    ------
    InputError
        As `read_beside`, or it cannot be written.
    """
    content = read_beside(source, root)
    if target.exists() and target.read_bytes() == content:
        return
    with written_whole(target) as temporary:
        temporary.write_bytes(content)


def read_beside(source: Path, root: str) -> bytes:
    """Read an XML file that a scenario needs, to copy it.

    A scenario may come from a stranger and name any file, so only one that is what it is needed for is copied.

    Parameters
    ----------
    source : Path
    root : str
        Tag of its root element.

    Returns
    -------
    bytes

    Raises
    ------
    InputError
        There is no such file, or it is of another kind.
    """
    if not source.is_file():
        raise InputError(f"{source}: is needed by the scenario but is not there.")
    content = read_file(source)
    found = parse_xml(content, source).tag
    if found != root:
        raise InputError(f"{source}: the root element is <{found}>; the scenario needs a file with <{root}> there.")
    return content
