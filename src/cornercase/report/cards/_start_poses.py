"""Pose and speed of each entity at its first instant in a recording."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cornercase._common.errors import InputError
from cornercase.recordings import Recording
from cornercase.roads._locator import OFF_ROAD_TOLERANCE
from cornercase.roads._network import RoadNetwork
from cornercase.scenario._file import ScenarioFile


@dataclass(frozen=True)
class StartPose:
    """Pose, speed and size of an entity at the first instant at which it exists.

    `time` is in s, `speed` in m/s, all lengths in m. `x` and `y` are the position of the entity's reference point.
    `heading` is in degrees, from -180 to 180, counter-clockwise from the x-axis. `s` is the distance along the road.
    `offset` is the distance of the reference point from the centre of the lane, positive to the left as seen along s.
    If the reference point is on no road, or the road is unknown, `road` and `lane` are empty, and `s` and `offset` are
    NaN.
    """

    name: str
    object_type: str
    time: float
    x: float
    y: float
    heading: float
    speed: float
    length: float
    width: float
    road: str = ""
    lane: str = ""
    s: float = math.nan
    offset: float = math.nan


def list_start_poses(recording: Recording, network: RoadNetwork | None) -> list[StartPose]:
    """List the start poses of the entities of a recording; entities that never exist are left out."""
    poses = []
    for k, name in enumerate(recording.names):
        present = np.flatnonzero(np.isfinite(recording.x[k]) & np.isfinite(recording.y[k]))
        if not len(present):
            continue
        i = int(present[0])
        x, y = float(recording.x[k, i]), float(recording.y[k, i])
        heading = math.degrees(math.remainder(float(recording.heading[k, i]), math.tau))
        poses.append(
            StartPose(
                name, recording.object_types[k], float(recording.time[i]), x, y, heading, float(recording.speed[k, i]),
                float(recording.length[k]), float(recording.width[k]), *_locate(network, x, y),
            )
        )  # fmt: skip
    return poses


def read_network(scenario: ScenarioFile | None, values: dict[str, float | str]) -> RoadNetwork | None:
    """Return the road network of a concrete scenario; None if it cannot be read."""
    if scenario is None:
        return None
    try:
        path = scenario.road_path_for(values)
        # Studies may be untrusted: a parameter value must not lead to an arbitrary file.
        if path is None or path not in scenario.road_paths():
            return None
        return RoadNetwork.from_xml(scenario.get_root(path), path)
    except InputError:
        return None


def _locate(network: RoadNetwork | None, x: float, y: float) -> tuple[str, str, float, float]:
    nowhere = "", "", math.nan, math.nan
    if network is None:
        return nowhere
    located = network.locate(np.array([x]), np.array([y]))
    road, lane, s = network.roads[int(located.road[0])], int(located.lane[0]), float(located.s[0])
    offset = float(located.offset[0])
    cx, cy, _ = (float(value[0]) for value in road.lane_pose_at(lane, np.array([s])))
    beyond_end = abs(math.hypot(x - cx, y - cy) - abs(offset))
    # Beyond the end of its road, or far from the lane.
    if beyond_end > OFF_ROAD_TOLERANCE or abs(offset) > 2.0 * OFF_ROAD_TOLERANCE:
        return nowhere
    return road.road_id, str(lane), s, offset
