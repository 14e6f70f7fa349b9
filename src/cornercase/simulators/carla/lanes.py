"""Where entities go otherwise than ScenarioRunner's own controls would, and how high roads lie."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from cornercase._common.geometry import within_half_turn
from cornercase._common.places import place_of
from cornercase._common.typing import FloatArray
from cornercase.recordings import Recording
from cornercase.roads import RoadNetwork, read_number
from cornercase.scenario import Scenario

# m from the middle of a lane, and rad from its direction, that still count as following it.
_OFFSET, _TURN = 0.3, 0.2
# Instants from one that is looked at to the next.
_EACH: Final = 4


def strays(recording: Recording, road: Path | None, scenario: Scenario) -> dict[str, str]:
    """Find entities that ScenarioRunner's own controls would take elsewhere.

    They take a vehicle along the middle of the nearest lane in its direction, with any way at a junction, and a walker
    straight ahead.

    Parameters
    ----------
    recording : Recording
    road : Path or None
    scenario : Scenario
        For its road file, which is read once.

    Returns
    -------
    dict of str to str
        Why, by entity; without those that never move.
    """
    network = None if road is None else RoadNetwork.of_xml(scenario.xml(road), road)
    found = {}
    for k, name in enumerate(recording.names):
        there = np.flatnonzero(np.isfinite(recording.x[k]))[::_EACH]
        x, y, heading = (of[k][there] for of in (recording.x, recording.y, recording.heading))
        if np.hypot(x - x[0], y - y[0]).max() < _OFFSET:
            continue
        if recording.kinds[k] == "misc":
            why = "ScenarioRunner moves no objects"
        elif recording.kinds[k] == "pedestrian":
            why = "ScenarioRunner lets a walker go straight ahead" if _bends(x, y, heading) else ""
        elif network is None:
            why = "ScenarioRunner follows lanes, and there are none"
        else:
            why = _leaves_lanes(network, x, y, heading)
        if why:
            found[name] = why
    return found


def _bends(x: FloatArray, y: FloatArray, heading: FloatArray) -> bool:
    across = (y - y[0]) * np.cos(heading[0]) - (x - x[0]) * np.sin(heading[0])
    back = np.diff(x) * np.cos(heading[0]) + np.diff(y) * np.sin(heading[0])
    return bool((np.abs(across) > _OFFSET).any() or (back < -1e-3).any() or (_apart(heading, heading[0]) > _TURN).any())


def _leaves_lanes(network: RoadNetwork, x: FloatArray, y: FloatArray, heading: FloatArray) -> str:
    place = network.locate(x, y)
    if (np.abs(place.offset) > _OFFSET).any():
        return "ScenarioRunner keeps to the middle of the lane"
    for road, lane in {(int(road), int(lane)) for road, lane in zip(place.road, place.lane, strict=True)}:
        rows = (place.road == road) & (place.lane == lane)
        *_, direction = network.world(road, lane, place.s[rows], place.offset[rows])
        if (_apart(direction, heading[rows]) > _TURN).any():
            return "ScenarioRunner drives in the direction of the lane"
        if network.roads[road].junction != "-1" and not rows[0]:
            return "ScenarioRunner takes any way at a junction"
    return ""


def _apart(one: FloatArray, other: FloatArray) -> FloatArray:
    """Angles between directions, in rad."""
    return np.abs(within_half_turn(one - other))


def heights(recording: Recording, road: Path | None, scenario: Scenario) -> FloatArray:
    """Find how high entities begin, by the elevation of the roads that they are on.

    Parameters
    ----------
    recording : Recording
    road : Path or None
    scenario : Scenario

    Returns
    -------
    ndarray of float64, shape (A,)
        m.
    """
    found = np.zeros(len(recording.names))
    if road is None:
        return found
    root = scenario.xml(road)
    profiles = {
        one.get("id", ""): [
            [read_number(of, key, f"{place_of(of, str(road))}, road {one.get('id')}") for key in "sabcd"]
            for of in one.iterfind("{*}elevationProfile/{*}elevation")
        ]
        for one in root.iterfind("{*}road")
    }
    network = RoadNetwork.of_xml(root, road)
    place = network.locate(recording.x[:, 0], recording.y[:, 0])
    for k, (index, s) in enumerate(zip(place.road, place.s, strict=True)):
        before = [of for of in profiles.get(network.roads[int(index)].name, []) if of[0] <= s]
        if before:
            start, a, b, c, d = max(before)
            ds = float(s) - start
            found[k] = a + b * ds + c * ds**2 + d * ds**3
    return found
