"""A scenario file with everything that its batches share."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.places import without_file
from cornercase.roads import RoadNetwork
from cornercase.scenario import Declaration, Scenario, Scope, Value, read_declarations, unusable_values, value_text

# Bytes per scenario: of a trajectory, of a vertex, of sampled curves per km, of what a driver gets of a trajectory.
_TRAJECTORY: Final = 1_000
_VERTEX: Final = 250
_CURVES: Final = {"Clothoid": 64_000, "ClothoidSpline": 64_000, "Nurbs": 2_000_000}
_DRIVEN_TRAJECTORY: Final = 250_000
# Bytes of storyboard elements.
_ELEMENTS: Final = {"Condition": 60, "Action": 150, "Event": 150}


class UnusableError(InputError):
    """A scenario file cannot be used with some values; `names` are the parameters that may be the cause."""

    def __init__(self, words: str, names: set[str]) -> None:
        super().__init__(words)
        self.names = names

    def __reduce__(self) -> tuple[type[UnusableError], tuple[str, set[str]]]:
        # Needed to send it from a worker process.
        return UnusableError, (str(self), self.names)


class PreparedScenario:
    """A scenario file with what its batches share.

    `split_parameters`: parameters that shape the storyboard, so all scenarios of a batch have the same values of them.
    `checked_elements`: ids of the elements that were checked for unsupported parts.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.splitting: set[str] = set()
        self._own_error: str | None = None
        self.looked_at: set[int] = set()
        self.networks: dict[Path, RoadNetwork] = {}

    @classmethod
    def of(cls, scenario: Scenario) -> PreparedScenario:
        """The prepared file of a scenario, cached on it."""
        if cls not in scenario.kept:
            scenario.kept[cls] = cls(scenario)
        prepared: PreparedScenario = scenario.kept[cls]
        return prepared

    def scope(self, values: Sequence[Mapping[str, Value]]) -> Scope:
        """Parameters of the file for scenarios with these values."""
        return Scope.of_file(str(self.scenario.path), self.scenario.root, values, self.scenario.catalog_entry)

    def unusable(self, values: Sequence[Mapping[str, Value]]) -> dict[int, str]:
        """Reasons, by index, why a scenario has a value that its parameter cannot have."""
        return unusable_values(self.declarations, values)

    def what_is_wrong(self, error: InputError, values: Mapping[str, Value], build: Callable[[], object]) -> str:
        """Describe what is wrong with one scenario, for a sentence that names the file itself.

        `error` came with the scenario's values; `build` reads the file with its own values. Raises `error` if the file
        cannot be used whatever the values are.
        """
        names = error.names if isinstance(error, UnusableError) else set(values)
        given = {name: value_text(values[name]) for name in names if name in values}
        if not given:
            raise error
        # With the file's own values the error is the same; other values may avoid it.
        if any(self._own_values.get(name) != text for name, text in given.items()):
            if self._own_error is None:
                try:
                    build()
                except InputError as error_with_own_values:
                    self._own_error = str(error_with_own_values)
            if self._own_error == str(error):
                raise error
        return without_file(str(self.scenario.path), str(error).removesuffix("."))

    @cached_property
    def _own_values(self) -> dict[str, str]:
        """The file's own parameter values as texts; empty if they cannot be evaluated."""
        try:
            values = self.scope([{}]).values
        except InputError:
            return {}
        return {name: value_text(value) for name, value in values.items()}

    def bytes_for(self, instants: int, driven: bool) -> int:
        """Estimated memory of one scenario until its recording is made."""
        entities, trajectories, elements = self._held
        driven_bytes = _DRIVEN_TRAJECTORY * len(trajectories) if driven else 0
        # Five recorded quantities of each entity and instant, and its state.
        return 8 * entities * (5 * instants + 100 + entities) + sum(trajectories) + driven_bytes + elements

    @cached_property
    def _held(self) -> tuple[int, tuple[int, ...], int]:
        """Number of entities, bytes of each followed trajectory, and bytes of the storyboard's elements."""
        roots = [self.scenario.root]
        has_catalogs = any(element.tag == "CatalogReference" for element in roots[0].iter())
        roots += [self.scenario.xml(file) for file in self.scenario.catalog_files()] if has_catalogs else []
        bytes_by_name: dict[str | None, int] = {}
        for element in (e for root in roots[1:] for e in root.iter() if e.tag == "Trajectory"):
            bytes_by_name[element.get("name")] = max(_bytes_of(element), bytes_by_name.get(element.get("name"), 0))
        followed = tuple(
            max(_bytes_of(element), _referred(element, bytes_by_name))
            for root in roots
            for element in root.iter()
            if element.tag == "FollowTrajectoryAction"
        )
        tags = Counter(element.tag for root in roots for element in root.iter())
        return tags["ScenarioObject"], followed, sum(size * tags[tag] for tag, size in _ELEMENTS.items())

    @cached_property
    def declarations(self) -> tuple[Declaration, ...]:
        """Declarations of the file's parameters."""
        return read_declarations(self.scenario.root, str(self.scenario.path))

    def network(self, reference: str) -> RoadNetwork:
        """Road network of a referenced file, cached; `InputError` if it cannot be used."""
        path = self.scenario.present_road(reference)
        if path not in self.networks:
            self.networks[path] = RoadNetwork.of_xml(self.scenario.xml(path), path)
        return self.networks[path]


def _bytes_of(trajectory: etree._Element) -> int:
    tags = Counter(element.tag for element in trajectory.iter())
    curves = sum(size * tags[tag] for tag, size in _CURVES.items())
    return _TRAJECTORY + _VERTEX * (tags["Vertex"] + tags["ControlPoint"]) + curves


def _referred(following: etree._Element, named: Mapping[str | None, int]) -> int:
    """Estimated memory of a followed trajectory of a catalog: the largest one if it is not known which."""
    entries = [reference.get("entryName", "") for reference in following.iter() if reference.tag == "CatalogReference"]
    largest = max(named.values(), default=0)
    return max((named.get(entry, largest) for entry in entries), default=0)
