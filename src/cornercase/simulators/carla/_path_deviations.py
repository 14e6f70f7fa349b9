"""Entities that ScenarioRunner's own controls would move off their path, and initial heights of entities."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from cornercase._common.geometry.boxes import wrap_angle
from cornercase._common.text.element_locations import format_location
from cornercase._common.typing import FloatArray
from cornercase.recordings import Recording
from cornercase.roads._network import RoadNetwork
from cornercase.roads._reference_line import read_finite_number
from cornercase.scenario._file import ScenarioFile

# Maximum offset in m and direction difference in rad for an entity that follows a lane.
_MAX_OFFSET, _MAX_ANGLE = 0.3, 0.2
# Stride of the samples to check.
_STRIDE: Final = 4


def find_deviating_entities(
    recording: Recording, road: Path | None, scenario: ScenarioFile, *, knows_left_hand_traffic: bool = False
) -> dict[str, str]:
    """Return the entities that ScenarioRunner's own controls would move along another path, with the reasons.

    The controls move a vehicle along the middle of the nearest lane in its direction, and choose an arbitrary branch at
    junctions. They move a walker straight ahead. Entities that stay within 0.3 m of their start are left out. `road` is
    the path of the road file; `scenario` caches its content. `knows_left_hand_traffic`: whether CARLA supports
    left-hand traffic.
    """
    network = None if road is None else RoadNetwork.from_xml(scenario.get_root(road), road)
    reasons = {}
    for k, name in enumerate(recording.names):
        samples = np.flatnonzero(np.isfinite(recording.x[k]))[::_STRIDE]
        x, y, heading = (values[k][samples] for values in (recording.x, recording.y, recording.heading))
        if np.hypot(x - x[0], y - y[0]).max() < _MAX_OFFSET:
            continue
        if recording.object_types[k] == "misc":
            reason = "ScenarioRunner moves no objects"
        elif recording.object_types[k] == "pedestrian":
            reason = "ScenarioRunner moves a walker straight ahead" if _is_not_straight(x, y, heading) else ""
        elif network is None:
            reason = "ScenarioRunner follows lanes, and there are none"
        else:
            reason = _describe_lane_deviation(network, x, y, heading, knows_left_hand_traffic=knows_left_hand_traffic)
        if reason:
            reasons[name] = reason
    return reasons


def _is_not_straight(x: FloatArray, y: FloatArray, heading: FloatArray) -> bool:
    lateral = (y - y[0]) * np.cos(heading[0]) - (x - x[0]) * np.sin(heading[0])
    forward = np.diff(x) * np.cos(heading[0]) + np.diff(y) * np.sin(heading[0])
    return bool(
        (np.abs(lateral) > _MAX_OFFSET).any()
        or (forward < -1e-3).any()
        or (_angle_between(heading, heading[0]) > _MAX_ANGLE).any()
    )


def _describe_lane_deviation(
    network: RoadNetwork, x: FloatArray, y: FloatArray, heading: FloatArray, *, knows_left_hand_traffic: bool
) -> str:
    positions = network.locate(x, y)
    roads = [network.roads[road] for road in np.unique(positions.road).tolist()]
    if not knows_left_hand_traffic and not all(road.is_right_hand_traffic for road in roads):
        return "CARLA before 0.9.16 takes left-hand traffic for right-hand traffic"
    if (np.abs(positions.offset) > _MAX_OFFSET).any():
        return "ScenarioRunner keeps to the middle of the lane"
    for road, lane in {(int(road), int(lane)) for road, lane in zip(positions.road, positions.lane, strict=True)}:
        rows = (positions.road == road) & (positions.lane == lane)
        *_, direction = network.lane_to_xy_heading(road, lane, positions.s[rows], positions.offset[rows])
        if (_angle_between(direction, heading[rows]) > _MAX_ANGLE).any():
            return "ScenarioRunner drives in the direction of the lane"
        if network.roads[road].junction != "-1" and not rows[0]:
            return "ScenarioRunner may take another branch at a junction"
    return ""


def _angle_between(heading: FloatArray, other_heading: FloatArray) -> FloatArray:
    """Return the absolute angles between headings in rad."""
    return np.abs(wrap_angle(heading - other_heading))


def initial_heights(recording: Recording, road: Path | None, scenario: ScenarioFile) -> FloatArray:
    """Return the initial height of each entity in m, from the elevation of its road."""
    elevations = np.zeros(len(recording.names))
    if road is None:
        return elevations
    root = scenario.get_root(road)
    profiles = {
        road_element.get("id", ""): [
            [
                read_finite_number(entry, key, f"{format_location(entry, str(road))}, road {road_element.get('id')}")
                for key in "sabcd"
            ]
            for entry in road_element.iterfind("{*}elevationProfile/{*}elevation")
        ]
        for road_element in root.iterfind("{*}road")
    }
    network = RoadNetwork.from_xml(root, road)
    positions = network.locate(recording.x[:, 0], recording.y[:, 0])
    for k, (index, s) in enumerate(zip(positions.road, positions.s, strict=True)):
        segments = [entry for entry in profiles.get(network.roads[int(index)].road_id, []) if entry[0] <= s]
        if segments:
            start, a, b, c, d = max(segments)
            ds = float(s) - start
            elevations[k] = a + b * ds + c * ds**2 + d * ds**3
    return elevations
