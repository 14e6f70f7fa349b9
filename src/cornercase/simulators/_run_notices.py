"""Warnings about finished runs, and about scenarios in which the ego has no driver."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.io.support_table import issue_notice_warning
from cornercase.recordings import Recording
from cornercase.roads._network import RoadNetwork
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators._base import Simulator
from cornercase.simulators.builtin._prepared_file import PreparedScenario

# Distance in m to the nearest lane from which pedestrians and misc objects are far from the road; for others, it is the
# `NEAR_DISTANCE` of `cornercase.roads._lane_distance`.
_FAR_FROM_LANE: Final = 50.0
# Not checked: they follow their vehicle, or are on rails.
_UNCHECKED_TYPES: Final = ("trailer", "semitrailer", "train", "tram")
_OFF_ROAD_TYPES: Final = ("pedestrian", "misc")
# Time in s between samples, and number of runs to check: wrong positions show in the first ones.
_SAMPLE_INTERVAL: Final = 1.0
_MAX_CHECKED_RUNS: Final = 1000
# Further entities are only counted.
_MAX_NAMED_ENTITIES: Final = 3


@dataclass
class _FarEntity:
    """An entity that is far from every road in `runs` runs; distance, time and label are of the first such run."""

    away: float
    time: float
    is_at_start: bool
    label: str
    runs: int = 0

    def describe(self, name: str, checked: str) -> str:
        """Return a clause of a warning; `checked` says which runs were checked, such as ``"40 runs"``."""
        where = f" of {self.label}" if self.label else ""
        more = f", and so in {self.runs - 1} more of {checked}" if self.runs > 1 else ""
        return f"{name} is {self.away:.0f} m from the nearest lane at {self.time:.2f} s{where}{more}"


class RunNotices:
    """Collector of notices on runs; the notices are issued as warnings when all runs have ended."""

    def __init__(self, simulator: Simulator) -> None:
        self._duration = simulator.settings.get("duration")
        self._n_runs = self._n_cut_off = 0
        self._n_checked = 0
        self._far_entities: dict[str, _FarEntity] = {}

    def add_run(self, recording: Recording, get_scenario: Callable[[], ScenarioFile], label: str = "") -> None:
        """Check the recording of a run; `get_scenario` is only called if the run's scenario is needed.

        `label` names the run in messages, such as ``scenario 3``; empty for a single run.
        """
        self._n_runs += 1
        self._n_cut_off += recording.is_truncated is True
        is_checked = recording.is_truncated is not None and self._n_runs <= _MAX_CHECKED_RUNS
        network = _road_network_if_read(get_scenario()) if is_checked else None
        if network is None:
            return
        self._n_checked += 1
        for name, away, time in find_entities_far_from_roads(network, recording):
            is_at_start = time <= float(recording.time[0])
            self._far_entities.setdefault(name, _FarEntity(away, time, is_at_start, label)).runs += 1

    def issue_warnings(self) -> None:
        """Issue the collected notices as `NoticeWarning`."""
        if self._far_entities:
            entities = self._far_entities
            checked = f"{'the first ' if self._n_runs > _MAX_CHECKED_RUNS else ''}{self._n_checked} runs"
            descriptions = [entity.describe(name, checked) for name, entity in entities.items()]
            more = (
                f"; and {len(descriptions) - _MAX_NAMED_ENTITIES} more are far"
                if len(descriptions) > _MAX_NAMED_ENTITIES
                else ""
            )
            advice = []
            if any(not entity.is_at_start for entity in entities.values()):
                advice.append("to find all that leave it, search with `critical_if` 'ego leaves the road'")
            if any(entity.is_at_start for entity in entities.values()):
                advice.append("check that the road file, its axes and the positions in the scenario match")
            issue_notice_warning(
                f"far from every road: {'; '.join(descriptions[:_MAX_NAMED_ENTITIES])}{more}; {', and '.join(advice)}"
            )
        if self._n_cut_off:
            runs = "the run was" if self._n_runs == 1 else f"{self._n_cut_off} of {self._n_runs} runs were"
            # A user's simulator may lack this option.
            limit = f", {self._duration:g} s," if isinstance(self._duration, int | float) else ""
            more = "; use a longer `duration` to see the rest" if limit else ""
            issue_notice_warning(
                f"cut off: {runs} ended by the maximum duration{limit} before the scenario came to its end{more}"
            )


def find_entities_far_from_roads(network: RoadNetwork, recording: Recording) -> list[tuple[str, float, float]]:
    """List entities far from every road, checked once a second, as (name, distance in m, first such time in s)."""
    indices = [a for a, object_type in enumerate(recording.object_types) if object_type not in _UNCHECKED_TYPES]
    if not indices or len(recording.time) == 0:
        return []
    first, last = recording.time[[0, -1]].tolist()
    # Rounding may put the last sample beyond the end.
    instants = np.minimum(np.arange(first, last + 1e-9, _SAMPLE_INTERVAL), last)
    samples = np.unique(np.searchsorted(recording.time, instants))
    x, y = (coordinates[indices][:, samples] for coordinates in (recording.x, recording.y))
    distances = network.distance_from_lanes(x.ravel(), y.ravel()).reshape(x.shape)
    result = []
    for a, row in zip(indices, distances, strict=True):
        far = np.flatnonzero(row > (_FAR_FROM_LANE if recording.object_types[a] in _OFF_ROAD_TYPES else 0.0))
        if far.size:
            result.append((recording.names[a], float(row[far[0]]), float(recording.time[samples[far[0]]])))
    return result


def find_driver_in_files(simulator: Simulator, scenarios: Iterable[ScenarioFile], ego: str) -> str | None:
    """Return the driver of the ego, if all scenario files name the same driver.

    Returns ``""`` if no file names a driver: the storyboard then moves the ego. Returns None if the driver is unknown:
    the files name several drivers, a scenario may choose a driver during the run, or the simulator drives the ego
    itself.
    """
    if simulator.name.partition(":")[0] != "builtin":
        return None
    files = list(scenarios)
    if not any(scenario.may_have_driver(ego) for scenario in files):
        return ""
    drivers = {scenario.drivers.get(ego) for scenario in files}
    # A parameter may hold the name.
    return next((name for name in drivers if len(drivers) == 1 and name and not name.startswith("$")), None)


def warn_if_ego_has_no_driver(simulator: Simulator, scenarios: Iterable[ScenarioFile], ego: str) -> None:
    """Warn if the builtin simulator is used and the ego has no driver in any of the scenarios."""
    drivers = simulator.settings.get("drivers")
    if (isinstance(drivers, dict) and ego in drivers) or find_driver_in_files(simulator, scenarios, ego) != "":
        return
    issue_notice_warning(
        f"nobody drives {ego}: it follows the scenario and does not react; give it a driver with `drivers`, as in"
        f" {{{ego!r}: 'normal'}}"
    )


def _road_network_if_read(scenario: ScenarioFile) -> RoadNetwork | None:
    """Return the road network of a scenario; None if this process has not read it, or has read more than one."""
    networks = list(PreparedScenario.from_scenario(scenario).networks.values())
    return networks[0] if len(networks) == 1 else None
