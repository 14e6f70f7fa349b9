"""What is said of runs once they have ended, and of a study in which nobody drives."""

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

# m from the nearest lane from which somebody who may be beside a road is far from it; for others it is `NEAR`.
_FAR_BESIDE: Final = 50.0
# They follow their vehicle, or drive on rails.
_NOT_ASKED: Final = ("trailer", "semitrailer", "train", "tram")
_BESIDE: Final = ("pedestrian", "misc")
# s between the instants that are looked at, and how many runs are: what is wrong with places shows in the first ones.
_LOOKS: Final = 1.0
_MOST_LOOKED: Final = 1000
# More entities than this are counted.
_MOST_NAMED: Final = 3


class RunNotices:
    """What whoever runs scenarios should know of the runs; said once, when they have ended.

    Parameters
    ----------
    simulator : Simulator
    """

    def __init__(self, simulator: Simulator) -> None:
        self._duration = simulator.settings.get("duration")
        self._runs = self._cut = 0
        # How far entities are from every road, and when, in the first run in which they are.
        self._far: dict[str, tuple[float, float]] = {}

    def look(self, recording: Recording, scenario: Callable[[], Scenario]) -> None:
        """Take notice of a run.

        Parameters
        ----------
        recording : Recording
        scenario : callable
            Gives its scenario; asked only where the simulator reads such files.
        """
        self._runs += 1
        self._cut += recording.cut_off is True
        looked = recording.cut_off is not None and self._runs <= _MOST_LOOKED
        network = _network_of(scenario()) if looked else None
        if network is not None:
            for name, away, time in far_from_roads(network, recording, self._far):
                self._far[name] = (away, time)

    def warn(self) -> None:
        """Say what was noticed, as a `NoticeWarning` of whoever called cornercase."""
        if self._far:
            far = [
                f"{name} is {away:.0f} m from the nearest lane at {t:.2f} s" for name, (away, t) in self._far.items()
            ]
            more = f", and {len(far) - _MOST_NAMED} more are far" if len(far) > _MOST_NAMED else ""
            warn(
                f"far from every road: {', '.join(far[:_MOST_NAMED])}{more}; look whether the road file, its axes and"
                " the positions of the scenario belong together"
            )
        if self._cut:
            runs = "the run was" if self._runs == 1 else f"{self._cut} of {self._runs} runs were"
            # A simulator of one's own may have no such option.
            limit = f", {self._duration:g} s," if isinstance(self._duration, int | float) else ""
            more = "; where it would go on, give a longer `duration`" if limit else ""
            warn(f"cut off: {runs} ended by the longest duration{limit} before the scenario came to its end{more}")


def far_from_roads(
    network: RoadNetwork, recording: Recording, known: Collection[str] = ()
) -> list[tuple[str, float, float]]:
    """Say which entities are far from every road, how far in m, and when first, in s.

    Parameters
    ----------
    network : RoadNetwork
    recording : Recording
        Looked at once a second.
    known : collection of str
        Entities that are not asked.

    Returns
    -------
    list of (str, float, float)
        In the order of the recording. A vehicle is far at 10 m from the nearest lane; a pedestrian or misc object,
        which may be beside a road, at 50 m. Trailers, which follow, and trains are not asked.
    """
    asked = [a for a, kind in enumerate(recording.kinds) if kind not in _NOT_ASKED and recording.names[a] not in known]
    if not asked or len(recording.time) == 0:
        return []
    first, last = recording.time[[0, -1]].tolist()
    looks = np.unique(np.searchsorted(recording.time, np.arange(first, last + 1e-9, _LOOKS)))
    x, y = (part[asked][:, looks] for part in (recording.x, recording.y))
    away = network.distance_from_lanes(x.ravel(), y.ravel()).reshape(x.shape)
    found = []
    for a, one in zip(asked, away, strict=True):
        far = np.flatnonzero(one > (_FAR_BESIDE if recording.kinds[a] in _BESIDE else 0.0))
        if far.size:
            found.append((recording.names[a], float(one[far[0]]), float(recording.time[looks[far[0]]])))
    return found


def warn_if_nobody_drives(simulator: Simulator, scenarios: Iterable[Scenario], ego: str) -> None:
    """Say of runs of the builtin simulator that the ego has no driver in any of them.

    Parameters
    ----------
    simulator : Simulator
    scenarios : iterable of Scenario
    ego : str
    """
    drivers = simulator.settings.get("drivers")
    given = isinstance(drivers, dict) and ego in drivers
    # The others drive the ego themselves, or take no driver.
    if simulator.name.partition(":")[0] != "builtin" or given or any(one.may_drive(ego) for one in scenarios):
        return
    warn(
        f"nobody drives {ego}: it follows the scenario and reacts to nobody; give it a driver by `drivers` {ego}=normal"
    )


def _network_of(scenario: Scenario) -> RoadNetwork | None:
    """The roads of a scenario, if they were read here and are the same for all values."""
    networks = list(PreparedScenario.of(scenario).networks.values())
    return networks[0] if len(networks) == 1 else None
