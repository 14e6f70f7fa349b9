"""A scenario file, with everything that its batches (scenarios that run together) have in common."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.io.support_table import SupportTable, tag_without_namespace
from cornercase._common.text.element_locations import remove_file_prefix
from cornercase.roads._network import RoadNetwork
from cornercase.scenario import ParameterDeclaration, Value
from cornercase.scenario._constraints import read_declarations
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._types import find_type_errors, format_value

OPENSCENARIO_SUPPORT: Final = SupportTable.from_csv("cornercase.simulators.builtin", "openscenario.csv")
"""Elements and attributes of OpenSCENARIO XML 1.3, and those of earlier versions that are still read."""

# Bytes per scenario: of a trajectory, of a vertex, of a sampled curve, of what a driver gets of a trajectory.
_BYTES_PER_TRAJECTORY: Final = 1_000
_BYTES_PER_VERTEX: Final = 250
_BYTES_PER_CURVE: Final = {"Clothoid": 64_000, "ClothoidSpline": 64_000, "Nurbs": 2_000_000}
_BYTES_PER_DRIVEN_TRAJECTORY: Final = 250_000
# Bytes of storyboard elements.
_BYTES_PER_ELEMENT: Final = {"Condition": 60, "Action": 150, "Event": 150}


class UnusableValuesError(InputError):
    """Error: a scenario file cannot be used with some parameter values; `names` has the suspected parameters."""

    def __init__(self, message: str, names: set[str]) -> None:
        super().__init__(message)
        self.names = names

    def __reduce__(self) -> tuple[type[UnusableValuesError], tuple[str, set[str]]]:
        # Needed to send it from a worker process.
        return UnusableValuesError, (str(self), self.names)


class PreparedScenario:
    """A scenario file, with everything that its batches (scenarios that run together) have in common.

    `split_parameters`: parameters that determine the storyboard, or that a driver needs to be the same; they must be
    equal in all scenarios of a batch.
    """

    def __init__(self, scenario: ScenarioFile) -> None:
        self.scenario = scenario
        self.split_parameters: set[str] = set()
        self._error_with_own_values: str | None = None
        self._checked_elements: set[int] = set()
        self.networks: dict[Path, RoadNetwork] = {}

    @classmethod
    def from_scenario(cls, scenario: ScenarioFile) -> PreparedScenario:
        """Return the prepared form of a scenario file, which is cached on the file."""
        if cls not in scenario.cache:
            scenario.cache[cls] = cls(scenario)
        prepared: PreparedScenario = scenario.cache[cls]
        return prepared

    def check_elements_supported(self) -> None:
        """Raise `InputError` if a file or catalog entry read since the last call holds anything unsupported."""
        for file, element in self.scenario.used_elements():
            # The file holds its elements, so their ids stay valid.
            if id(element) not in self._checked_elements and tag_without_namespace(element) != "OpenDRIVE":
                OPENSCENARIO_SUPPORT.check_supported(element, file)
                self._checked_elements.add(id(element))

    def find_invalid_values(self, values: Sequence[Mapping[str, Value]]) -> dict[int, str]:
        """Return why values do not fit the types of their parameters, by index of the scenario; empty if all fit."""
        return find_type_errors(self.declarations, values)

    def describe_value_error(self, error: InputError, values: Mapping[str, Value], build: Callable[[], object]) -> str:
        """Describe what is wrong with the values of a scenario, as part of a sentence that names the file.

        `error` was raised for these values. `build` reads the file with its default values. If this gives the same
        error, the values are not the cause, and `error` is raised.
        """
        names = error.names if isinstance(error, UnusableValuesError) else set(values)
        given = {name: format_value(values[name]) for name in names if name in values}
        if not given:
            raise error
        # With the file's own values the error is the same; other values may avoid it.
        if any(self._own_values.get(name) != text for name, text in given.items()):
            if self._error_with_own_values is None:
                try:
                    build()
                except InputError as error_with_own_values:
                    self._error_with_own_values = str(error_with_own_values)
            if self._error_with_own_values == str(error):
                raise error
        return remove_file_prefix(str(self.scenario.path), str(error).removesuffix("."))

    @cached_property
    def _own_values(self) -> dict[str, str]:
        """Return the default values of the file's parameters as texts; empty if they cannot be evaluated."""
        try:
            values = self.scenario.scope([{}]).parameter_values
        except InputError:
            return {}
        return {name: format_value(value) for name, value in values.items()}

    def estimate_bytes(self, n_instants: int, has_drivers: bool) -> int:
        """Estimate the memory in bytes of one scenario, until its recording is made."""
        entities, trajectories, elements = self._memory_components
        driven_bytes = _BYTES_PER_DRIVEN_TRAJECTORY * len(trajectories) if has_drivers else 0
        # Five recorded quantities of each entity and instant, and its state.
        return 8 * entities * (5 * n_instants + 100 + entities) + sum(trajectories) + driven_bytes + elements

    @cached_property
    def _memory_components(self) -> tuple[int, tuple[int, ...], int]:
        """Return the number of entities, the bytes of each followed trajectory, and the bytes of the storyboard."""
        roots = [self.scenario.root]
        has_catalogs = any(element.tag == "CatalogReference" for element in roots[0].iter())
        roots += [self.scenario.get_root(file) for file in self.scenario.catalog_files()] if has_catalogs else []
        bytes_by_name: dict[str | None, int] = {}
        for element in (e for root in roots[1:] for e in root.iter() if e.tag == "Trajectory"):
            bytes_by_name[element.get("name")] = max(
                _estimate_trajectory_bytes(element), bytes_by_name.get(element.get("name"), 0)
            )
        followed = tuple(
            max(_estimate_trajectory_bytes(element), _estimate_catalog_trajectory_bytes(element, bytes_by_name))
            for root in roots
            for element in root.iter()
            if element.tag == "FollowTrajectoryAction"
        )
        tags = Counter(element.tag for root in roots for element in root.iter())
        return tags["ScenarioObject"], followed, sum(size * tags[tag] for tag, size in _BYTES_PER_ELEMENT.items())

    @cached_property
    def declarations(self) -> tuple[ParameterDeclaration, ...]:
        return read_declarations(self.scenario.root, str(self.scenario.path))

    def road_network(self, reference: str) -> RoadNetwork:
        """Return the road network in the file to which the scenario refers, cached; `InputError` if it is unusable."""
        path = self.scenario.existing_road_path(reference)
        if path not in self.networks:
            self.networks[path] = RoadNetwork.from_xml(self.scenario.get_root(path), path)
        return self.networks[path]


def _estimate_trajectory_bytes(trajectory: etree._Element) -> int:
    tags = Counter(element.tag for element in trajectory.iter())
    curves = sum(size * tags[tag] for tag, size in _BYTES_PER_CURVE.items())
    return _BYTES_PER_TRAJECTORY + _BYTES_PER_VERTEX * (tags["Vertex"] + tags["ControlPoint"]) + curves


def _estimate_catalog_trajectory_bytes(follow_action: etree._Element, bytes_by_name: Mapping[str | None, int]) -> int:
    """Estimate the memory in bytes of a followed trajectory from a catalog; an unknown entry counts as the largest."""
    entries = [
        reference.get("entryName", "") for reference in follow_action.iter() if reference.tag == "CatalogReference"
    ]
    largest = max(bytes_by_name.values(), default=0)
    return max((bytes_by_name.get(entry, largest) for entry in entries), default=0)
