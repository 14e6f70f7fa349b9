"""What all batches of a scenario file share."""

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

# What a trajectory takes, its vertices, the samples of its curves of a kilometre, and what of it a driver gets, in
# bytes for each scenario.
_TRAJECTORY: Final = 1_000
_VERTEX: Final = 250
_CURVES: Final = {"Clothoid": 64_000, "ClothoidSpline": 64_000, "Nurbs": 2_000_000}
_DRIVEN_TRAJECTORY: Final = 250_000
# What elements of a storyboard take.
_ELEMENTS: Final = {"Condition": 60, "Action": 150, "Event": 150}


class UnusableError(InputError):
    """A scenario file cannot be used with the values of some scenarios.

    Parameters
    ----------
    words : str
    names : set of str
        Parameters that it may be because of.

    Attributes
    ----------
    names : set of str
    """

    def __init__(self, words: str, names: set[str]) -> None:
        super().__init__(words)
        self.names = names

    def __reduce__(self) -> tuple[type[UnusableError], tuple[str, set[str]]]:
        # As a worker process sends it.
        return UnusableError, (str(self), self.names)


class PreparedScenario:
    """A scenario file with what its batches need, which is made once.

    Parameters
    ----------
    scenario : Scenario

    Attributes
    ----------
    scenario : Scenario
    splitting : set of str
        Parameters found to shape the storyboard: scenarios of one batch have the same values of them.
    looked_at : set of int
        Elements of whose parts is known that none is refused, by their ``id``.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.splitting: set[str] = set()
        self._own_error: str | None = None
        self.looked_at: set[int] = set()
        self.networks: dict[Path, RoadNetwork] = {}

    @classmethod
    def of(cls, scenario: Scenario) -> PreparedScenario:
        """Prepared file of a scenario, the same each time."""
        if cls not in scenario.kept:
            scenario.kept[cls] = cls(scenario)
        kept: PreparedScenario = scenario.kept[cls]
        return kept

    def scope(self, values: Sequence[Mapping[str, Value]]) -> Scope:
        """Parameters of the file for scenarios with these values."""
        return Scope.of_file(str(self.scenario.path), self.scenario.root, values, self.scenario.catalog_entry)

    def unusable(self, values: Sequence[Mapping[str, Value]]) -> dict[int, str]:
        """By place of the scenarios in which one cannot be that of its parameter, why, without a full stop."""
        return unusable_values(self.declarations, values)

    def what_is_wrong(self, error: InputError, values: Mapping[str, Value], build: Callable[[], object]) -> str:
        """Say what is wrong with one scenario, as a part of a sentence that names the file itself.

        Parameters
        ----------
        error : InputError
            What was raised when the file was read with the values of the scenario.
        values : mapping of str to float or str
        build : callable
            Reads the file with its own values, as it was read for the scenario.

        Returns
        -------
        str

        Raises
        ------
        InputError
            The `error`: the file cannot be used whatever the values of its parameters are.
        """
        names = error.names if isinstance(error, UnusableError) else set(values)
        given = {name: value_text(values[name]) for name in names if name in values}
        if not given:
            raise error
        # With the file's own values it says of course the same, and another value may mend it.
        if any(self._own_values.get(name) != text for name, text in given.items()):
            if self._own_error is None:
                try:
                    build()
                except InputError as own:
                    self._own_error = str(own)
            if self._own_error == str(error):
                raise error
        return without_file(str(self.scenario.path), str(error).removesuffix("."))

    @cached_property
    def _own_values(self) -> dict[str, str]:
        """Values of the parameters as the file has them, as texts; none where they cannot be evaluated."""
        try:
            found = self.scope([{}]).values
        except InputError:
            return {}
        return {name: value_text(value) for name, value in found.items()}

    def bytes_for(self, instants: int, driven: bool) -> int:
        """About how much memory one scenario takes while it runs, and until its recording is made."""
        entities, trajectories, elements = self._held
        one = _DRIVEN_TRAJECTORY * len(trajectories) if driven else 0
        # Five quantities of each entity at each instant, and its state.
        return 8 * entities * (5 * instants + 100 + entities) + sum(trajectories) + one + elements

    @cached_property
    def _held(self) -> tuple[int, tuple[int, ...], int]:
        """Number of entities, and bytes of each trajectory that is followed and of the elements of the storyboard."""
        roots = [self.scenario.root]
        referred = any(element.tag == "CatalogReference" for element in roots[0].iter())
        roots += [self.scenario.xml(file) for file in self.scenario.catalog_files()] if referred else []
        named: dict[str | None, int] = {}
        for element in (one for root in roots[1:] for one in root.iter() if one.tag == "Trajectory"):
            named[element.get("name")] = max(_bytes_of(element), named.get(element.get("name"), 0))
        followed = tuple(
            max(_bytes_of(element), _referred(element, named))
            for root in roots
            for element in root.iter()
            if element.tag == "FollowTrajectoryAction"
        )
        tags = Counter(element.tag for root in roots for element in root.iter())
        return tags["ScenarioObject"], followed, sum(each * tags[tag] for tag, each in _ELEMENTS.items())

    @cached_property
    def declarations(self) -> tuple[Declaration, ...]:
        """Those of its parameters."""
        return read_declarations(self.scenario.root, str(self.scenario.path))

    def network(self, reference: str) -> RoadNetwork:
        """Roads of the file that the scenario refers to so.

        Raises
        ------
        InputError
            The file cannot be used.
        """
        path = self.scenario.present_road(reference)
        if path not in self.networks:
            self.networks[path] = RoadNetwork.of_xml(self.scenario.xml(path), path)
        return self.networks[path]


def _bytes_of(trajectory: etree._Element) -> int:
    """About how much memory a trajectory takes in one scenario."""
    tags = Counter(element.tag for element in trajectory.iter())
    curves = sum(each * tags[tag] for tag, each in _CURVES.items())
    return _TRAJECTORY + _VERTEX * (tags["Vertex"] + tags["ControlPoint"]) + curves


def _referred(following: etree._Element, named: Mapping[str | None, int]) -> int:
    """About how much memory a trajectory of a catalog takes that is followed, if one is; the largest may be meant."""
    entries = [one.get("entryName", "") for one in following.iter() if one.tag == "CatalogReference"]
    largest = max(named.values(), default=0)
    return max((named.get(entry, largest) for entry in entries), default=0)
