"""OpenSCENARIO scenario files."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

from lxml import etree

from cornercase._common import validation
from cornercase._common.errors import InputError, suggest_name
from cornercase._common.io.support_table import Notice, NoticeLabel
from cornercase._common.io.tracked_xml import (
    find_by_name,
    find_untracked,
    is_read,
    iter_children_untracked,
    note_adaptation,
)
from cornercase._common.text.element_locations import add_location_to_input_errors, format_location, line_number
from cornercase.scenario._catalogs import Catalogs, looks_like_catalog
from cornercase.scenario._expressions import parameter_names_in
from cornercase.scenario._left_handed_axes import find_left_handed_header
from cornercase.scenario._maps import describe_how_to_get_map, find_map, is_network_address, map_name
from cornercase.scenario._openpass import (
    PROFILES_FILE,
    agent_profile_names,
    profiles_file_name,
    record_profile_replacement,
    uses_agent_profiles,
    vehicle_models_of_profile,
)
from cornercase.scenario._other_formats import describe_other_xml_format, record_later_version
from cornercase.scenario._parameter import Value
from cornercase.scenario._scope import Scope
from cornercase.scenario._xml import XmlFileCache, parse_xml

DRIVER_PROPERTY = "cornercase.driver"
"""Controller property that names the driver of an entity."""

# Limits of file systems: bytes of a file name, characters of a path.
_MAX_FILE_NAME_BYTES = 255
_MAX_PATH_LENGTH = 4000
# Blocks that may occur once, as paths from the root.
_UNIQUE_BLOCKS = (
    ("FileHeader",), ("ParameterDeclarations",), ("VariableDeclarations",), ("CatalogLocations",), ("RoadNetwork",),
    ("Entities",), ("Storyboard",), ("Storyboard", "Init"), ("RoadNetwork", "LogicFile"),
)  # fmt: skip


class ScenarioFile:
    """A scenario file, with its catalogs and road files.

    Each file is read once, when it is first needed. A pickled copy holds only the path, the fingerprint and
    `varied_roads`. The copy reads the files again, and raises `InputError` if they have changed.

    `varied_roads` are the additional road files that a varied parameter can select, written as in ``<LogicFile>``.
    `cache` has objects that other modules derived from the file, by the type of the object.
    """

    def __init__(self, path: Path | str, fingerprint: str | None = None, varied_roads: Sequence[str] = ()) -> None:
        self.path = Path(path)
        self._varied_roads = tuple(varied_roads)
        self.cache: dict[type, Any] = {}
        self._files = XmlFileCache()
        self._fingerprint = fingerprint
        # Paths of road files that were found, by reference; fixed from then on.
        self._found_roads: dict[str, Path] = {}

    @classmethod
    def read(cls, path: Path | str) -> ScenarioFile:
        """Read a scenario file; raises `InputError` if it is missing, is not XML, or is not a scenario."""
        scenario = cls(validation.check_path("scenario", path))
        scenario._require_valid_root(scenario.root)
        return scenario

    def __repr__(self) -> str:
        return f"<ScenarioFile {str(self.path)!r}>"

    def __reduce__(self) -> tuple[type[ScenarioFile], tuple[Path, str, tuple[str, ...]]]:
        return ScenarioFile, (self.path, self.fingerprint(), self._varied_roads)

    def with_varied_roads(self, varied_roads: Sequence[str]) -> ScenarioFile:
        """Return the scenario with additional road files, which a varied parameter can select."""
        copy = ScenarioFile(self.path, None, varied_roads)
        copy._files = self._files
        copy._found_roads = self._found_roads
        return copy

    @cached_property
    def root(self) -> etree._Element:
        """Root element, ``OpenSCENARIO``; do not change it."""
        if self._fingerprint is not None and self._compute_fingerprint() != self._fingerprint:
            raise InputError(
                f"{self.path}: this file, its road file or a catalog has changed since it was read; run the command"
                " again."
            )
        return self._unchecked_root

    @cached_property
    def _unchecked_root(self) -> etree._Element:
        return self._files.get_root(self.path)

    def parse_unnormalized(self) -> etree._Element:
        """Parse the file again, without correcting violations of the standard."""
        return parse_xml(self._files.read_bytes(self.path), self.path)

    def get_root(self, path: Path) -> etree._Element:
        """Return the root of a file that belongs to the scenario; do not change it."""
        return self._files.get_root(path)

    def add_files(self, files: XmlFileCache) -> None:
        """Add files to the files of the scenario, for example the file of a parameter space."""
        self._files.update(files)

    def used_elements(self) -> list[tuple[Path, etree._Element]]:
        """Return a path and an element for each parsed file: its root element.

        For a catalog file, return a pair for each used catalog entry instead.
        """
        parts = []
        for path, root in self._files.parsed_roots().items():
            catalog = etree.ElementBase.find(root, "Catalog") if root.tag == "OpenSCENARIO" else None
            if catalog is None:
                parts.append((path, root))
            else:
                parts += [(path, entry) for entry in iter_children_untracked(catalog) if is_read(entry)]
        return parts

    def _require_valid_root(self, root: etree._Element) -> None:
        if description := describe_other_xml_format(root):
            raise InputError(f"{format_location(root, str(self.path))}: {description}.")
        if root.tag != "OpenSCENARIO":
            raise InputError(
                f"{format_location(root, str(self.path))}: the root element is <{root.tag}>; an"
                f" OpenSCENARIO file starts with"
                " <OpenSCENARIO>."
            )
        header = root.find("FileHeader")
        if header is not None and header.get("revMajor", "1").strip() == "0":
            raise InputError(
                f"{format_location(header, str(self.path))}: <FileHeader>: the file is of OpenSCENARIO"
                f" 0.{header.get('revMinor', '9')}, which has another structure; convert it to 1.0 with ASAM's"
                " migration script, which comes with OpenSCENARIO 1.0."
            )
        if (distribution := root.find("ParameterValueDistribution")) is not None:
            location = f"{format_location(distribution, str(self.path))}: <{distribution.tag}>"
            raise InputError(f"{location}: is a parameter value distribution, not a scenario; give it as `space`.")
        record_later_version(root)
        self._refuse_repeated_blocks(root)
        for needed in ("Entities", "Storyboard"):
            if root.find(needed) is None:
                raise InputError(
                    f"{format_location(root, str(self.path))}: <{root.tag}> has no <{needed}>, so"
                    f" there is nothing to run."
                )
        # Raises if names are not unique.
        _ = self.entities

    def _refuse_repeated_blocks(self, root: etree._Element) -> None:
        """Raise `InputError` if an element such as ``Storyboard`` occurs twice: tools disagree which one counts."""
        for *parents, tag in _UNIQUE_BLOCKS:
            blocks = [
                block
                for block in find_untracked(root, *parents)
                for block in iter_children_untracked(block)
                if block.tag == tag
            ]
            if len(blocks) > 1:
                raise InputError(
                    f"{format_location(blocks[1], str(self.path))}: <{tag}>: repeats the one in line"
                    f" {blocks[0].sourceline}; keep one."
                )

    @property
    def has_left_handed_axes(self) -> bool:
        """True if the scenario has positions in CARLA's left-handed axes; road files have right-handed axes."""
        return find_left_handed_header(self.root) is not None

    def left_handed_axes_notices(self) -> tuple[Notice, ...]:
        """Return a notice that positions are mirrored; empty if the axes of the scenario are right-handed."""
        header = find_left_handed_header(self.root)
        if header is None:
            return ()
        reason = (
            "the description begins with 'CARLA:', so positions are in left-handed axes, as in ScenarioRunner; they are"
            " converted to the axes of the road file, which recordings use too"
        )
        rule = "positions are in right-handed axes, x east and y north, with headings counter-clockwise"
        return (
            Notice(("signs of y and headings",), reason, self.path, (line_number(header),), NoticeLabel.ADAPTED, rule),
        )

    @cached_property
    def entities(self) -> tuple[str, ...]:
        """Names of all entities, in the order of the file."""
        objects = list(self.root.iterfind("Entities/ScenarioObject"))
        names = tuple(e.get("name", "") for e in objects)
        seen: set[str] = {""}
        for element, name in zip(objects, names, strict=True):
            if name in seen:
                raise InputError(
                    f"{format_location(element, str(self.path))}: every <ScenarioObject> needs a unique name."
                )
            seen.add(name)
        return names

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        """Names of all declared parameters."""
        declared = self.root.iterfind("ParameterDeclarations/ParameterDeclaration")
        return tuple(dict.fromkeys(e.get("name", "") for e in declared))

    @cached_property
    def path_parameters(self) -> frozenset[str]:
        """Names of the declared parameters that contain the path of the road file or of a catalog folder."""
        folders = (e.get("path", "") for e in self.root.iterfind("CatalogLocations//Directory"))
        texts = {self.road_file_as_written(), *folders}
        return frozenset(name for name in self.parameters if f"${name}" in texts)

    @cached_property
    def drivers(self) -> dict[str, str]:
        """For each entity, the driver that its controller requests by the property ``cornercase.driver``.

        Entities without such a controller are left out.
        """
        drivers = {e.get("name", ""): self._requested_driver(e) for e in self.root.iterfind("Entities/ScenarioObject")}
        return {name: driver for name, driver in drivers.items() if driver is not None}

    def may_have_driver(self, entity: str) -> bool:
        """Return whether the file may give an entity a driver of cornercase, at the start or in the storyboard.

        If a storyboard action assigns a controller with a driver, or any controller of a catalog, return True for every
        entity.
        """
        # Iterating over all elements does not mark them as used.
        actions = (element for element in self.root.iter() if element.tag == "AssignControllerAction")
        descendants = (element for action in actions for element in action.iter())
        named_there = any(
            element.tag == "CatalogReference" or element.attrib.get("name") == DRIVER_PROPERTY
            for element in descendants
        )
        return entity in self.drivers or named_there

    def _requested_driver(self, scenario_object: etree._Element) -> str | None:
        driver = requested_driver(scenario_object)
        if driver is not None:
            return driver
        # Catalog controllers count only if referred to literally, not by a parameter.
        for reference in find_untracked(scenario_object, "ObjectController", "CatalogReference"):
            catalog, name = (str(reference.attrib.get(key, "")) for key in ("catalogName", "entryName"))
            entries = [
                controller
                for element in self._catalogs.find_catalogs(catalog)
                for controller in find_untracked(element, "Controller")
            ]
            for entry in entries:
                driver = driver_of_controller(entry) if entry.attrib.get("name") == name else None
                if driver is not None:
                    self.find_catalog_entry(reference.get("catalogName", ""), reference.get("entryName", ""))
                    return driver
        return None

    def require_entity(self, name: str, role: str) -> None:
        """Raise `InputError` if no entity has the given name; the message says that it is to be the `role`."""
        if name not in self.entities:
            raise InputError(
                f"{self.path}: has no entity '{name}' to be the {role}; {suggest_name(name, self.entities)}"
            )

    def require_declared(self, names: tuple[str, ...] | list[str]) -> None:
        """Raise `InputError` if a name is neither a declared parameter nor a driver option, ``ENTITY.OPTION``."""
        for name in names:
            if name in self.parameters or self.parse_driver_option_names([name]):
                continue
            entity, dot, option = name.partition(".")
            possible = {*self.parameters, *(f"{other}.{option}" for other in self.entities if dot)}
            also = f", and has no entity '{entity}' with a driver" if dot else ""
            raise InputError(f"{self.path}: declares no parameter '{name}'{also}; {suggest_name(name, possible)}")

    def parse_driver_option_names(self, names: Iterable[str]) -> dict[str, tuple[str, str]]:
        """Return entity and option for each name of a driver option, such as ``Ego.reaction``.

        Other names, and names that the file declares as parameters, are left out.
        """
        targets = {}
        for name in names:
            if "." in name and name not in self.parameters:
                entities = [entity for entity in self.entities if name.startswith(f"{entity}.")]
                if entities and (option := name.removeprefix(f"{max(entities, key=len)}.")):
                    targets[name] = max(entities, key=len), option
        return targets

    def resolve_path(self, reference: str, description: str) -> Path:
        """Resolve a path that is relative to the folder of the scenario file.

        `reference` is the path as written in the file. `description` says in messages what the path is for. Raises
        `InputError` for network addresses and invalid file names.
        """
        if (
            any(len(part.encode()) > _MAX_FILE_NAME_BYTES for part in Path(reference).parts)
            or len(reference) > _MAX_PATH_LENGTH
        ):
            raise InputError(f"{self.path}: the {description} '{reference[:60]}…' is not a valid file name.")
        if is_network_address(reference):
            raise InputError(f"{self.path}: the {description} '{reference}' is a network address; name a local file.")
        return self.path.parent / reference.replace("\\", "/")

    def find_catalog_entry(self, catalog_name: str, entry_name: str) -> etree._Element:
        """Return an entry of a catalog.

        If the catalog is the profiles file of openPASS, return the catalog vehicle that replaces the agent profile.
        """
        file = profiles_file_name(catalog_name)
        return (
            self._vehicle_of_agent_profile(self.path.parent / file, entry_name)
            if file
            else self._catalogs.find_entry(catalog_name, entry_name)
        )

    def scope(self, values: Sequence[Mapping[str, Value]]) -> Scope:
        """Return a reader of attributes for concrete scenarios; `values` has the parameter values of each scenario."""
        return Scope.from_file(str(self.path), self.root, values, self.find_catalog_entry)

    def _vehicle_of_agent_profile(self, profiles_path: Path, profile: str) -> etree._Element:
        """Return the catalog entry of the most probable vehicle model of an openPASS agent profile."""
        description = (
            f"'{profile}' of {profiles_path.name} is an agent profile of openPASS, a vehicle with a driver and sensors"
        )
        hint = "use a vehicle of an OpenSCENARIO catalog"
        if not profiles_path.is_file():
            raise InputError(
                f"{self.path}: {description}, but {profiles_path.name} is not next to the scenario; put it there,"
                f" or {hint}."
            )
        profiles = self._files.get_root(profiles_path)
        models = vehicle_models_of_profile(profiles, profile)
        if models is None:
            raise InputError(
                f"{profiles_path}: has no agent profile '{profile}';"
                f" {suggest_name(profile, agent_profile_names(profiles))}"
            )
        if not models:
            raise InputError(f"{self.path}: {description}, but this profile has no vehicle model; {hint}.")
        entry = self._catalogs.find_entry_in_any_catalog(models[0])
        if entry is None:
            raise InputError(f"{self.path}: {description}; its vehicle model '{models[0]}' is in no catalog; {hint}.")
        record_profile_replacement(self._unchecked_root, profile, models)
        return entry

    @cached_property
    def _catalogs(self) -> Catalogs:
        return Catalogs(self.path, ((file, self._files.get_root(file)) for file in self._catalog_files))

    def catalog_files(self) -> list[Path]:
        """Return the catalog files of all catalog locations: location by location, and each location sorted by name."""
        return list(self._catalog_files)

    @cached_property
    def _catalog_files(self) -> list[Path]:
        files: list[Path] = []
        for directory in self._unchecked_root.iterfind("CatalogLocations//Directory"):
            with add_location_to_input_errors(directory, str(self.path)):
                folder = self.resolve_path(self.replace_parameter(directory.get("path", ""), {}), "catalog location")
            candidates = self._list_catalogs(folder) if folder.is_dir() else [folder]
            files += [file for file in candidates if file.is_file() and file not in files]
        return files

    def _list_catalogs(self, folder: Path) -> list[Path]:
        """Return the files of a folder that hold a catalog; scenario files in the same folder are left out."""
        scenario_files = [file for file in sorted(folder.glob("*.xosc")) if file.is_file()]
        return [file for file in scenario_files if looks_like_catalog(self._files.read_bytes(file))]

    @cached_property
    def profiles_files(self) -> tuple[Path, ...]:
        """Path of openPASS's ``ProfilesCatalog.xml``, even if it does not exist; empty if no agent profile is used."""
        return (self.path.with_name(PROFILES_FILE),) if uses_agent_profiles(self._unchecked_root) else ()

    def road_file_as_written(self) -> str:
        """Return the text by which the scenario names its road file: a path, or a parameter such as ``"$Road"``.

        The text is empty if the scenario names no road file.
        """
        file = self._unchecked_root.find("RoadNetwork/LogicFile")
        return "" if file is None else file.get("filepath", "")

    def road_path_for(self, values: Mapping[str, Value] | None = None) -> Path | None:
        """Return the path of the road file; None if the scenario names none.

        If a parameter selects the road file, its value is that of `values`, or else its declared value.
        """
        reference = self.road_reference_for(values)
        return self.road_path(reference) if reference else None

    def road_reference_for(self, values: Mapping[str, Value] | None = None) -> str:
        """Return the text by which the scenario names its road file, with a parameter replaced by its value.

        The value is that of `values`, or else the declared value. The text is empty if no road file is named.
        """
        return self.replace_parameter(self.road_file_as_written(), values or {})

    def road_path(self, reference: str) -> Path:
        """Return the path of a road file that is written as `reference` in the scenario.

        If that file does not exist, return the road file of the map with this name, if the scenario's folder or a map
        folder has one.
        """
        if reference in self._found_roads:
            return self._found_roads[reference]
        path = self.resolve_path(reference, "road file")
        map_file = path if path.is_file() else find_map(reference, self.path.parent)
        if map_file is None:
            return path
        self._found_roads[reference] = map_file
        if map_file == path:
            return path
        for element in self._unchecked_root.iterfind("RoadNetwork/LogicFile"):
            reason = f"'{reference}' does not exist; the map of that name is used: {map_file}"
            note_adaptation(element, "filepath of <LogicFile>", reason, "filepath is a path relative to the scenario")
        return map_file

    def existing_road_path(self, reference: str) -> Path:
        """Return the same path as `road_path`; raises `InputError` if the file does not exist."""
        path = self.road_path(reference)
        if reference not in self._found_roads and not path.exists():
            line = next((e.sourceline for e in self._unchecked_root.iterfind("RoadNetwork/LogicFile")), 0)
            raise InputError(f"{self.path}, line {line}: {self._describe_road_as_missing(reference)}.")
        return path

    def describe_missing_road(self) -> str:
        """Describe which road file is missing, as a part of a sentence; empty if no road file is missing."""
        reference = self.first_missing_road_file()
        return self._describe_road_as_missing(reference) if reference else ""

    def first_missing_road_file(self) -> str:
        """Return the first road file that does not exist, as written in the scenario; empty if all exist."""
        references = (self.road_reference_for(), *self._varied_roads)
        return next((reference for reference in references if reference and not self.road_path(reference).exists()), "")

    def _describe_road_as_missing(self, reference: str) -> str:
        description = self.resolve_path(reference, "road file") if Path(reference).suffix else f"'{reference}'"
        return f"there is no road file {description}; {describe_how_to_get_map(reference)}"

    def road_path_without_map_folders(self, path: Path) -> Path:
        """Return where a road file belongs in a copy of the scenario that works without map folders.

        For a road file that was found by the name of a map, return a path in the folder of the scenario. Return any
        other path unchanged.
        """
        references = (self.road_reference_for(), *self._varied_roads)
        reference = next((name for name in references if name and self.road_path(name) == path), "")
        default = self.path.parent / f"{map_name(reference)}.xodr"
        return path if not reference or self.resolve_path(reference, "road file") == path else default

    def road_paths(self) -> tuple[Path, ...]:
        """Return the paths of the road file and of all road files that a varied parameter can select."""
        road = self.road_path_for()
        varied = [self.road_path(reference) for reference in self._varied_roads]
        return tuple(dict.fromkeys([*([] if road is None else [road]), *varied]))

    def fingerprint(self) -> str:
        """Return the SHA-256 of all files of the scenario, as they were first read."""
        if self._fingerprint is None:
            self._fingerprint = self._compute_fingerprint()
        return self._fingerprint

    def all_paths(self) -> tuple[Path, ...]:
        """Return the paths of all files that the fingerprint includes, the scenario file first; some may not exist."""
        return (self.path, *self._catalog_files, *self.profiles_files, *self.road_paths())

    @property
    def varied_roads(self) -> tuple[str, ...]:
        """Additional road files that a varied parameter can select, written as in ``<LogicFile>``."""
        return self._varied_roads

    def read_all_files(self) -> dict[Path, bytes]:
        """Return the content of all files that the fingerprint includes, the scenario file first.

        Raises `InputError` if a file has changed since it was read.
        """
        files = {file: self._files.read_bytes(file) for file in self.all_paths() if file.is_file()}
        if self._compute_fingerprint() != self.fingerprint():
            raise InputError(f"{self.path}: its files have changed since they were read; run the command again.")
        return files

    def has_same_content(self, other: ScenarioFile) -> bool:
        """Return whether another scenario has the same path and the same file contents."""
        return self is other or (self.path == other.path and self.fingerprint() == other.fingerprint())

    def _compute_fingerprint(self) -> str:
        digest = hashlib.sha256()
        for file in self.all_paths():
            if file.is_file():
                digest.update(self._files.sha256(file))
        return digest.hexdigest()

    def file_references(self) -> tuple[str, ...]:
        """Return the texts by which the scenario names its road files and catalog folders, with parameters replaced."""
        directories = self._unchecked_root.iterfind("CatalogLocations//Directory")
        folders = (self.replace_parameter(directory.get("path", ""), {}) for directory in directories)
        return (self.road_reference_for(), *self._varied_roads, *folders)

    def replace_parameter(self, text: str, values: Mapping[str, Value]) -> str:
        """Return the text of an attribute, or the value of the parameter that it refers to, directly or indirectly.

        The value is that of `values`, or else the declared value.
        """
        if not parameter_names_in(text):
            return text
        declared = self._unchecked_root.iterfind("ParameterDeclarations/ParameterDeclaration")
        remaining: dict[str, Value] = {**{e.get("name", ""): e.get("value", "") for e in declared}, **values}
        while names := parameter_names_in(text) & remaining.keys():
            text = str(remaining.pop(min(names)))
        return text


def requested_driver(scenario_object: etree._Element) -> str | None:
    """Return the driver that a controller inside a ``ScenarioObject`` requests; None if there is no such controller."""
    drivers = (
        driver_of_controller(controller)
        for controller in find_untracked(scenario_object, "ObjectController", "Controller")
    )
    return next((driver for driver in drivers if driver is not None), None)


def driver_of_controller(controller: etree._Element) -> str | None:
    """Return the driver that a ``Controller`` requests; None if no driver is requested.

    Only a controller that requests a driver is marked as used.
    """
    item = find_by_name(find_untracked(controller, "Properties", "Property"), DRIVER_PROPERTY)
    return None if item is None else item.get("value")
