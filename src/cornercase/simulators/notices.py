"""Warnings about finished runs, and about scenarios without a driver of the ego."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from typing import Final

import numpy as np

from cornercase._common.ledger import warn
from cornercase.recordings import Recording
from cornercase.roads import RoadNetwork
from cornercase.scenario import Scenario
from cornercase.simulators.base import Simulator
from cornercase.simulators.builtin.prepared import PreparedScenario

# Distance in m to the nearest lane from which pedestrians and misc objects are far from the road; for others: `NEAR`.
_FAR_BESIDE: Final = 50.0
# Not checked: they follow their vehicle, or are on rails.
_NOT_ASKED: Final = ("trailer", "semitrailer", "train", "tram")
_BESIDE: Final = ("pedestrian", "misc")
# Time in s between samples, and number of runs to check: wrong positions show in the first ones.
_LOOKS: Final = 1.0
_MOST_LOOKED: Final = 1000
# Further entities are only counted.
_MOST_NAMED: Final = 3


class RunNotices:
    """Collects what users should know about runs, and warns once at the end."""

    def __init__(self, simulator: Simulator) -> None:
        self._duration = simulator.settings.get("duration")
        self._runs = self._cut = 0
        # By entity: distance to the nearest lane and time in the first run in which it is far.
        self._far: dict[str, tuple[float, float]] = {}

    def look(self, recording: Recording, scenario: Callable[[], Scenario]) -> None:
        """Check a recording; `scenario` returns its scenario, called only if the simulator reads such files."""
        self._runs += 1
        self._cut += recording.cut_off is True
        is_checked = recording.cut_off is not None and self._runs <= _MOST_LOOKED
        network = _network_of(scenario()) if is_checked else None
        if network is not None:
            for name, away, time in far_from_roads(network, recording, self._far):
                self._far[name] = (away, time)

    def warn(self) -> None:
        """Issue the collected notices as `NoticeWarning`."""
        if self._far:
            descriptions = [
                f"{name} is {away:.0f} m from the nearest lane at {t:.2f} s" for name, (away, t) in self._far.items()
            ]
            more = f", and {len(descriptions) - _MOST_NAMED} more are far" if len(descriptions) > _MOST_NAMED else ""
            warn(
                f"far from every road: {', '.join(descriptions[:_MOST_NAMED])}{more}; check that the road file, its"
                " axes and the positions in the scenario match"
            )
        if self._cut:
            runs = "the run was" if self._runs == 1 else f"{self._cut} of {self._runs} runs were"
            # A user's simulator may lack this option.
            limit = f", {self._duration:g} s," if isinstance(self._duration, int | float) else ""
            more = "; use a longer `duration` to see the rest" if limit else ""
            warn(f"cut off: {runs} ended by the maximum duration{limit} before the scenario came to its end{more}")


def far_from_roads(
    network: RoadNetwork, recording: Recording, known: Collection[str] = ()
) -> list[tuple[str, float, float]]:
    """List entities far from every road as (name, distance in m, first time in s), in the order of the recording.

    Checked once a second. Far means 10 m from the nearest lane, or 50 m for pedestrians and misc objects, which may be
    beside a road. Trailers, trains and names in `known` are skipped.
    """
    indices = [
        a
        for a, object_type in enumerate(recording.kinds)
        if object_type not in _NOT_ASKED and recording.names[a] not in known
    ]
    if not indices or len(recording.time) == 0:
        return []
    first, last = recording.time[[0, -1]].tolist()
    samples = np.unique(np.searchsorted(recording.time, np.arange(first, last + 1e-9, _LOOKS)))
    x, y = (coordinates[indices][:, samples] for coordinates in (recording.x, recording.y))
    distances = network.distance_from_lanes(x.ravel(), y.ravel()).reshape(x.shape)
    result = []
    for a, row in zip(indices, distances, strict=True):
        far = np.flatnonzero(row > (_FAR_BESIDE if recording.kinds[a] in _BESIDE else 0.0))
        if far.size:
            result.append((recording.names[a], float(row[far[0]]), float(recording.time[samples[far[0]]])))
    return result


def warn_if_nobody_drives(simulator: Simulator, scenarios: Iterable[Scenario], ego: str) -> None:
    """Warn if the builtin simulator runs scenarios in none of which the ego has a driver."""
    drivers = simulator.settings.get("drivers")
    has_driver = isinstance(drivers, dict) and ego in drivers
    # Other simulators drive the ego themselves, or have no drivers.
    if (
        simulator.name.partition(":")[0] != "builtin"
        or has_driver
        or any(scenario.may_drive(ego) for scenario in scenarios)
    ):
        return
    warn(
        f"nobody drives {ego}: it follows the scenario and does not react; give it a driver with `drivers` {ego}=normal"
    )


def _network_of(scenario: Scenario) -> RoadNetwork | None:
    """Road network of a scenario, if it was read here and is the same for all parameter values."""
    networks = list(PreparedScenario.of(scenario).networks.values())
    return networks[0] if len(networks) == 1 else None
