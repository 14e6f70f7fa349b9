"""Paths of drivers along lanes, and along neighbouring lanes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cornercase._common.geometry.boxes import is_facing_forward
from cornercase.drivers._base import DrivenPath

if TYPE_CHECKING:
    from cornercase.roads._lane_path import LanePath
    from cornercase.roads._network import RoadNetwork


@dataclass(frozen=True, eq=False)
class PathAlongLanes(DrivenPath):
    """A path that follows lanes of the road file."""

    lane_path: LanePath


def driven_path(lane_path: LanePath) -> PathAlongLanes:
    """Return a lane's path for drivers; the path is cached, so that speed plans along it are computed only once."""
    if "driven path" not in lane_path.cache:
        columns = (lane_path.distance, lane_path.x, lane_path.y, lane_path.heading, lane_path.curvature)
        lane_path.cache["driven path"] = PathAlongLanes(*columns, lane_path)
    path: PathAlongLanes = lane_path.cache["driven path"]
    return path


def find_neighbouring_path(
    network: RoadNetwork, x: float, y: float, heading: float, lanes_to_left: int
) -> DrivenPath | None:
    """Return the path along a lane next to the lane at a pose; None if no lane for this direction is there.

    `lanes_to_left` is 1 for the next lane to the left, -1 for the next to the right.
    """
    location = network.locate(np.array([x]), np.array([y]))
    number, lane, s = int(location.road[0]), int(location.lane[0]), location.s
    road = network.roads[number]
    is_along = bool(is_facing_forward(heading - road.reference_pose(s)[2])[0])
    # Lane numbers grow to the left, seen along s.
    target = lane + (lanes_to_left if is_along else -lanes_to_left)
    if target == 0:
        target = -lane
    neighbour = road.sections[int(road.section_at(s)[0])][1].get(target)
    if neighbour is None or not neighbour.is_drivable or bool(road.is_traffic_forward(target, s)[0]) != is_along:
        return None
    path = network.lane_path_from(number, target, float(s[0]), is_along)
    return None if path is None else driven_path(path)
