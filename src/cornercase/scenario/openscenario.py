"""OpenSCENARIO XML files: what stands in one, and concrete copies of it."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

from lxml import etree

from cornercase._common import arguments
from cornercase._common.errors import InputError, suggestion
from cornercase._common.ledger import Label, Notice
from cornercase._common.places import line_of, place_of, placed
from cornercase._common.recorded_xml import adapt, children, named, unrecorded, was_read
from cornercase.scenario.axes import left_handed_header
from cornercase.scenario.catalogs import Catalogs, holds_catalog
from cornercase.scenario.dialects import note_version, other_format
from cornercase.scenario.expressions import names_in
from cornercase.scenario.maps import find_map, is_network_address, map_name, way_to_map
from cornercase.scenario.openpass import (
    PROFILES_FILE,
    has_profiles,
    note_profile,
    profile_names,
    profiles_file,
    vehicle_models,
)
from cornercase.scenario.parameter import Value
from cornercase.scenario.xml import XmlFiles, parse_xml

DRIVER_PROPERTY = "cornercase.driver"
"""Property of a controller that names the driver of an entity."""

# Of a file and of a path, in bytes and in characters; no system takes more.
_LONGEST_NAME = 255
_LONGEST_PATH = 4000
# Blocks of which a file has at most one, with what they stand in below the root.
_ONCE = (
    ("FileHeader",), ("ParameterDeclarations",), ("VariableDeclarations",), ("CatalogLocations",), ("RoadNetwork",),
    ("Entities",), ("Storyboard",), ("Storyboard", "Init"), ("RoadNetwork", "LogicFile"),
)  # fmt: skip


class Scenario:
    """An OpenSCENARIO scenario file, and the catalogs and road files that belong to it.

    Each of these files is read once, when it is first needed. A copy in another process knows only the path and the
    fingerprint: it reads the files again when they are needed there, and refuses them where they have changed.

    Parameters
    ----------
    path : path
    fingerprint : str, optional
        What `fingerprint` has to give; by default that of the files as they are.
    roads : sequence of str
        Road files that a varied parameter names, besides the one that the file itself names.

    Attributes
    ----------
    path : Path
    kept : dict
        What others have made of it and keep, by its type.
    """

    def __init__(self, path: Path | str, fingerprint: str | None = None, roads: Sequence[str] = ()) -> None:
        self.path = Path(path)
        self._roads = tuple(roads)
        self.kept: dict[type, Any] = {}
        self._files = XmlFiles()
        self._fingerprint = fingerprint
        # Where road files were, by what the file calls them: they stay there, whatever becomes of the folders.
        self._roads_at: dict[str, Path] = {}

    @classmethod
    def read(cls, path: Path | str) -> Scenario:
        """Read a scenario file.

        Parameters
        ----------
        path : path

        Returns
        -------
        Scenario

        Raises
        ------
        InputError
            The file is missing, is not XML, or is not a scenario.
        """
        scenario = cls(arguments.path("scenario", path))
        scenario._require_scenario(scenario.root)
        return scenario

    def __repr__(self) -> str:
        return f"Scenario({str(self.path)!r})"

    def __reduce__(self) -> tuple[type[Scenario], tuple[Path, str, tuple[str, ...]]]:
        return Scenario, (self.path, self.fingerprint(), self._roads)

    def naming(self, roads: Sequence[str]) -> Scenario:
        """Return the same scenario, to which the road files belong that a varied parameter names.

        Parameters
        ----------
        roads : sequence of str
            As the scenario would name them.

        Returns
        -------
        Scenario
        """
        other = Scenario(self.path, None, roads)
        other._files = self._files
        other._roads_at = self._roads_at
        return other

    @cached_property
    def root(self) -> etree._Element:
        """Root of the scenario file, ``OpenSCENARIO``; not to be changed."""
        if self._fingerprint is not None and self._digest() != self._fingerprint:
            raise InputError(
                f"{self.path}: this file, its road file or a catalog has changed since it was read; run the command"
                " again."
            )
        return self._document

    @cached_property
    def _document(self) -> etree._Element:
        return self._files.root(self.path)

    def as_written(self) -> etree._Element:
        """Return the root of the scenario file as it stands there, with all that breaks the standard.

        Returns
        -------
        lxml element
        """
        return parse_xml(self._files.content(self.path), self.path)

    def xml(self, path: Path) -> etree._Element:
        """Return the root of a file that belongs to the scenario, as `read_xml` does.

        Parameters
        ----------
        path : Path

        Returns
        -------
        lxml element
            Not to be changed.
        """
        return self._files.root(path)

    def add_files(self, files: XmlFiles) -> None:
        """Count more files among those of the scenario, such as that of a parameter space.

        Parameters
        ----------
        files : XmlFiles
        """
        self._files.update(files)

    def read_parts(self) -> list[tuple[Path, etree._Element]]:
        """Give what of the scenario's files was read, as the elements that hold it.

        Returns
        -------
        list of (Path, lxml element)
            The root of the scenario file, the catalog entries that were asked for, and the roots of road files and of
            files that belong to it.
        """
        found = []
        for path, root in self._files.parsed().items():
            catalog = etree.ElementBase.find(root, "Catalog") if root.tag == "OpenSCENARIO" else None
            if catalog is None:
                found.append((path, root))
            else:
                found += [(path, entry) for entry in children(catalog) if was_read(entry)]
        return found

    def _require_scenario(self, root: etree._Element) -> None:
        if other := other_format(root):
            raise InputError(f"{place_of(root, str(self.path))}: {other}.")
        if root.tag != "OpenSCENARIO":
            raise InputError(
                f"{place_of(root, str(self.path))}: the root element is <{root.tag}>; an OpenSCENARIO file starts with"
                " <OpenSCENARIO>."
            )
        header = root.find("FileHeader")
        if header is not None and header.get("revMajor", "1").strip() == "0":
            raise InputError(
                f"{place_of(header, str(self.path))}: <FileHeader>: the file is of OpenSCENARIO"
                f" 0.{header.get('revMinor', '9')}, whose files are built in another way; bring it to 1.0 with ASAM's"
                " migration script, which comes with OpenSCENARIO 1.0."
            )
        if (distribution := root.find("ParameterValueDistribution")) is not None:
            place = f"{place_of(distribution, str(self.path))}: <{distribution.tag}>"
            raise InputError(f"{place}: is a parameter value distribution, not a scenario; give it as `space`.")
        note_version(root)
        self._refuse_repeated(root)
        for needed in ("Entities", "Storyboard"):
            if root.find(needed) is None:
                raise InputError(
                    f"{place_of(root, str(self.path))}: <{root.tag}> has no <{needed}>, so there is nothing to run."
                )
        # Refuses what has no name of its own.
        _ = self.entities

    def _refuse_repeated(self, root: etree._Element) -> None:
        """Refuse the second block of a kind of which a file has one; the first would count for some of its readers."""
        for *above, tag in _ONCE:
            blocks = [one for one in unrecorded(root, *above) for one in children(one) if one.tag == tag]
            if len(blocks) > 1:
                raise InputError(
                    f"{place_of(blocks[1], str(self.path))}: <{tag}>: is there a second time, after line"
                    f" {blocks[0].sourceline}; keep one."
                )

    @property
    def is_left_handed(self) -> bool:
        """Whether its positions are in CARLA's left-handed axes, instead of those of the road file."""
        return left_handed_header(self.root) is not None

    def axes_notices(self) -> tuple[Notice, ...]:
        """Say that positions are turned, where its axes are left-handed.

        Returns
        -------
        tuple of Notice
        """
        header = left_handed_header(self.root)
        if header is None:
            return ()
        why = (
            "the description begins with 'CARLA:', so that positions are in left-handed axes, as ScenarioRunner reads"
            " them; they are turned to the axes of the road file, in which recordings are, too"
        )
        rule = "positions are in right-handed axes, x east and y north, with headings counter-clockwise"
        return (Notice(("signs of y and headings",), why, self.path, (line_of(header),), Label.ADAPTED, rule),)

    @cached_property
    def entities(self) -> tuple[str, ...]:
        """Names of all entities, in the file's order."""
        objects = list(self.root.iterfind("Entities/ScenarioObject"))
        names = tuple(e.get("name", "") for e in objects)
        known: set[str] = {""}
        for one, name in zip(objects, names, strict=True):
            if name in known:
                raise InputError(f"{place_of(one, str(self.path))}: every <ScenarioObject> needs a name of its own.")
            known.add(name)
        return names

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        """Names of all declared parameters."""
        declared = self.root.iterfind("ParameterDeclarations/ParameterDeclaration")
        return tuple(dict.fromkeys(e.get("name", "") for e in declared))

    @cached_property
    def path_parameters(self) -> frozenset[str]:
        """Names of the declared parameters that say where the road file or a folder of catalogs is."""
        folders = (e.get("path", "") for e in self.root.iterfind("CatalogLocations//Directory"))
        texts = {self.logic_file(), *folders}
        return frozenset(name for name in self.parameters if f"${name}" in texts)

    @cached_property
    def drivers(self) -> dict[str, str]:
        """Driver that a controller property asks for, by entity."""
        asked = {e.get("name", ""): self._driver_of(e) for e in self.root.iterfind("Entities/ScenarioObject")}
        return {name: driver for name, driver in asked.items() if driver is not None}

    def may_drive(self, entity: str) -> bool:
        """Tell whether the file names a driver of cornercase for an entity, or for anybody while its storyboard runs.

        Parameters
        ----------
        entity : str

        Returns
        -------
        bool
            True also where an action assigns a controller of a catalog, which may have a driver.
        """
        # A loop without names does not count as reading.
        actions = (one for one in self.root.iter() if one.tag == "AssignControllerAction")
        below = (one for action in actions for one in action.iter())
        named_there = any(one.tag == "CatalogReference" or one.attrib.get("name") == DRIVER_PROPERTY for one in below)
        return entity in self.drivers or named_there

    def _driver_of(self, scenario_object: etree._Element) -> str | None:
        driver = driver_property(scenario_object)
        if driver is not None:
            return driver
        # A controller of a catalog counts where the file names it itself, not by a parameter.
        for reference in unrecorded(scenario_object, "ObjectController", "CatalogReference"):
            catalog, name = (str(reference.attrib.get(key, "")) for key in ("catalogName", "entryName"))
            entries = [one for each in self._catalogs.named(catalog) for one in unrecorded(each, "Controller")]
            for entry in entries:
                driver = driver_of(entry) if entry.attrib.get("name") == name else None
                if driver is not None:
                    self.catalog_entry(reference.get("catalogName", ""), reference.get("entryName", ""))
                    return driver
        return None

    def require_entity(self, name: str, role: str) -> None:
        """Refuse a name that no entity has.

        Parameters
        ----------
        name : str
        role : str
            What the entity is to be, for the message.

        Raises
        ------
        InputError
            There is no entity called `name`.
        """
        if name not in self.entities:
            raise InputError(f"{self.path}: has no entity '{name}' to be the {role}; {suggestion(name, self.entities)}")

    def require_parameters(self, names: tuple[str, ...] | list[str]) -> None:
        """Refuse parameters that the file does not declare.

        Parameters
        ----------
        names : tuple or list of str

        Raises
        ------
        InputError
            A parameter is not declared.
        """
        for name in names:
            if name not in self.parameters:
                raise InputError(f"{self.path}: declares no parameter '{name}'; {suggestion(name, self.parameters)}")

    def beside(self, reference: str, what: str) -> Path:
        """Return the path of a file or folder that the scenario refers to.

        Parameters
        ----------
        reference : str
            As it stands in the file, relative to the file.
        what : str
            What it is, for the message.

        Returns
        -------
        Path

        Raises
        ------
        InputError
            It is a network address, or no name that a file can have.
        """
        if any(len(part.encode()) > _LONGEST_NAME for part in Path(reference).parts) or len(reference) > _LONGEST_PATH:
            raise InputError(f"{self.path}: the {what} '{reference[:60]}…' is not a valid file name.")
        if is_network_address(reference):
            raise InputError(f"{self.path}: the {what} '{reference}' is a network address; name a local file.")
        return self.path.parent / reference.replace("\\", "/")

    def catalog_entry(self, catalog: str, entry: str) -> etree._Element:
        """Return the element that a catalog holds under a name.

        Parameters
        ----------
        catalog, entry : str

        Returns
        -------
        lxml element

        Raises
        ------
        InputError
            No catalog of that name lies in the catalog locations, it lacks the entry, or several have it and differ.
        """
        file = profiles_file(catalog)
        return self._of_profile(self.path.parent / file, entry) if file else self._catalogs.entry(catalog, entry)

    def _of_profile(self, file: Path, profile: str) -> etree._Element:
        """Vehicle model of an agent profile of openPASS."""
        what = f"'{profile}' of {file.name} is an agent profile of openPASS, a vehicle with a driver and sensors"
        way = "name a vehicle of a catalog of OpenSCENARIO as the entity"
        if not file.is_file():
            raise InputError(
                f"{self.path}: {what}, but the file does not lie beside the scenario; put it there, or {way}."
            )
        profiles = self._files.root(file)
        models = vehicle_models(profiles, profile)
        if models is None:
            raise InputError(
                f"{file}: has no agent profile '{profile}'; {suggestion(profile, profile_names(profiles))}"
            )
        if not models:
            raise InputError(f"{self.path}: {what}, but has no vehicle model; {way}.")
        entry = self._catalogs.entry_anywhere(models[0])
        if entry is None:
            raise InputError(f"{self.path}: {what}; its vehicle model '{models[0]}' is in no catalog; {way}.")
        note_profile(self._document, profile, models)
        return entry

    @cached_property
    def _catalogs(self) -> Catalogs:
        return Catalogs(self.path, ((file, self._files.root(file)) for file in self._catalog_files))

    def catalog_files(self) -> list[Path]:
        """Return all files in the catalog locations.

        Returns
        -------
        list of Path
            In the order of the locations and then of their names.
        """
        return list(self._catalog_files)

    @cached_property
    def _catalog_files(self) -> list[Path]:
        files: list[Path] = []
        for directory in self._document.iterfind("CatalogLocations//Directory"):
            with placed(directory, str(self.path)):
                folder = self.beside(self._parameter_text(directory.get("path", ""), {}), "catalog location")
            found = self._catalogs_in(folder) if folder.is_dir() else [folder]
            files += [file for file in found if file.is_file() and file not in files]
        return files

    def _catalogs_in(self, folder: Path) -> list[Path]:
        """Files of a folder that hold a catalog; scenarios may lie there, too."""
        every = [file for file in sorted(folder.glob("*.xosc")) if file.is_file()]
        return [file for file in every if holds_catalog(self._files.content(file))]

    @cached_property
    def profiles_files(self) -> tuple[Path, ...]:
        """Files with agent profiles of openPASS that it names; it need not be there."""
        return (self.path.with_name(PROFILES_FILE),) if has_profiles(self._document) else ()

    def logic_file(self) -> str:
        """Return the road file as the scenario names it.

        Returns
        -------
        str
            Possibly a parameter, ``"$Road"``; empty where there is none.
        """
        file = self._document.find("RoadNetwork/LogicFile")
        return "" if file is None else file.get("filepath", "")

    def road_file(self, values: Mapping[str, Value] | None = None) -> Path | None:
        """Return the path of the road file.

        Parameters
        ----------
        values : mapping of str to float or str, optional
            Where a parameter names the road file, its value is taken from here, else from its declaration.

        Returns
        -------
        Path or None
            None where there is none.
        """
        reference = self.road_reference(values)
        return self.road_at(reference) if reference else None

    def road_reference(self, values: Mapping[str, Value] | None = None) -> str:
        """Return the road file as the scenario names it with values.

        Parameters
        ----------
        values : mapping of str to float or str, optional
            As for `road_file`.

        Returns
        -------
        str
            Empty where there is none.
        """
        return self._parameter_text(self.logic_file(), values or {})

    def road_at(self, reference: str) -> Path:
        """Return the path of a road file that the scenario names.

        Parameters
        ----------
        reference : str
            As it stands in the file.

        Returns
        -------
        Path
            Where nothing is at the place that it names, the map of that name beside the scenario or in a folder of
            maps, if there is one.

        Raises
        ------
        InputError
            As in `beside`, or what is to be a folder of maps is none.
        """
        if reference in self._roads_at:
            return self._roads_at[reference]
        path = self.beside(reference, "road file")
        found = path if path.is_file() else find_map(reference, self.path.parent)
        if found is None:
            return path
        self._roads_at[reference] = found
        if found == path:
            return path
        for element in self._document.iterfind("RoadNetwork/LogicFile"):
            why = f"'{reference}' is not a file there; it was found by its name, as {found}"
            adapt(element, "filepath of <LogicFile>", why, "filepath is the path of a file, from that of the scenario")
        return found

    def present_road(self, reference: str) -> Path:
        """Return the path of a road file as `road_at` does, and refuse one that is not there.

        Parameters
        ----------
        reference : str
            As it stands in the file.

        Returns
        -------
        Path

        Raises
        ------
        InputError
            As in `road_at`, or there is no such file.
        """
        path = self.road_at(reference)
        if reference not in self._roads_at and not path.exists():
            line = next((e.sourceline for e in self._document.iterfind("RoadNetwork/LogicFile")), 0)
            raise InputError(f"{self.path}, line {line}: {self._without_road(reference)}.")
        return path

    def missing_road(self) -> str:
        """Say which of its road files is not there.

        Returns
        -------
        str
            A part of a sentence, without a full stop; empty where all are.
        """
        reference = self.missing_reference()
        return self._without_road(reference) if reference else ""

    def missing_reference(self) -> str:
        """Return the first of its road files that is not there, as the scenario names it.

        Returns
        -------
        str
            Empty where all are there.
        """
        references = (self.road_reference(), *self._roads)
        return next((one for one in references if one and not self.road_at(one).exists()), "")

    def _without_road(self, reference: str) -> str:
        named = self.beside(reference, "road file") if Path(reference).suffix else f"'{reference}'"
        return f"there is no road file {named}; {way_to_map(reference)}"

    def road_near(self, path: Path) -> Path:
        """Return where a road file of the scenario would be found beside it, wherever it is.

        Parameters
        ----------
        path : Path
            As `road_at` returns it.

        Returns
        -------
        Path
        """
        references = (self.road_reference(), *self._roads)
        found = next((one for one in references if one and self.road_at(one) == path), "")
        near = self.path.parent / f"{map_name(found)}.xodr"
        return path if not found or self.beside(found, "road file") == path else near

    def road_files(self) -> tuple[Path, ...]:
        """Return the paths of all road files that belong to the scenario.

        Returns
        -------
        tuple of Path
            That which it names, and those of `naming`; its fingerprint counts them.
        """
        road = self.road_file()
        named = [self.road_at(one) for one in self._roads]
        return tuple(dict.fromkeys([*([] if road is None else [road]), *named]))

    def fingerprint(self) -> str:
        """Return a digest of the scenario and all files that it is known to read, as they were when they were read.

        Returns
        -------
        str
            SHA-256.
        """
        if self._fingerprint is None:
            self._fingerprint = self._digest()
        return self._fingerprint

    def files(self) -> tuple[Path, ...]:
        """Return the paths of all files that the fingerprint counts.

        Returns
        -------
        tuple of Path
            The scenario file is the first; some may not be there.
        """
        return (self.path, *self._catalog_files, *self.profiles_files, *self.road_files())

    @property
    def varied_roads(self) -> tuple[str, ...]:
        """Road files that a varied parameter names, as the scenario would name them."""
        return self._roads

    def contents(self) -> dict[Path, bytes]:
        """Return the content of all files that the fingerprint counts, as they were when they were read.

        Returns
        -------
        dict of Path to bytes
            The scenario file is the first one.

        Raises
        ------
        InputError
            A file cannot be read, or has changed since.
        """
        files = {file: self._files.content(file) for file in self.files() if file.is_file()}
        if self._digest() != self.fingerprint():
            raise InputError(f"{self.path}: its files have changed since they were read; run the command again.")
        return files

    def is_same(self, other: Scenario) -> bool:
        """Tell whether another scenario has the same path, and its files the same content.

        Parameters
        ----------
        other : Scenario

        Returns
        -------
        bool
        """
        return self is other or (self.path == other.path and self.fingerprint() == other.fingerprint())

    def _digest(self) -> str:
        digest = hashlib.sha256()
        for file in self.files():
            if file.is_file():
                digest.update(self._files.digest(file))
        return digest.hexdigest()

    def _parameter_text(self, text: str, values: Mapping[str, Value]) -> str:
        for name in names_in(text):
            if name in values:
                return str(values[name])
            for e in self._document.iterfind("ParameterDeclarations/ParameterDeclaration"):
                if e.get("name") == name:
                    return e.get("value", "")
        return text


def driver_property(scenario_object: etree._Element) -> str | None:
    """Name of the driver that a controller of a ``ScenarioObject``, which stands in the file itself, asks for."""
    drivers = (driver_of(one) for one in unrecorded(scenario_object, "ObjectController", "Controller"))
    return next((driver for driver in drivers if driver is not None), None)


def driver_of(controller: etree._Element) -> str | None:
    """Name of the driver that a property of a ``Controller`` asks for; any other controller does not count as read."""
    item = named(unrecorded(controller, "Properties", "Property"), DRIVER_PROPERTY)
    return None if item is None else item.get("value")
