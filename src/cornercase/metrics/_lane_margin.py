"""Metric of the distance of the ego from the edge of its lane, or from the edge of the road."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.metrics._base import Metric
from cornercase.metrics._geometry.boxes import box_corners_over_time
from cornercase.metrics._recorded_roads import read_recorded_roads
from cornercase.recordings import Recording
from cornercase.roads._edge_distance import lane_margins, road_margins

_EDGES = ("lane", "road")


class LaneMargin(Metric):
    """Distance in m from the outermost corner of the ego's box to the edge of its lane; negative beyond it.

    The lane of the ego is the drivable lane below the centre of its box. If several lanes overlap there, as in
    junctions, lanes for traffic in the ego's direction are preferred, and among these the lane with the largest
    distance counts. If there is no lane below the centre, the nearest lane counts. The other entity does not matter.
    Not defined if the roads are unknown, or if the ego does not exist. Recordings of simulated runs know their roads;
    for a recording from a file, give the roads with ``roads``. Least critical value (cap): 2 m; most critical value:
    -10 m.

    Source: distance to the lane boundary, as for lane departure warning in ISO 17361:2017.

    Parameters
    ----------
    edge : {"lane", "road"}, default "lane"
        Edge of the ego's lane, or outer edge of all drivable lanes side by side.
    roads : str, optional
        OpenDRIVE file; by default the file of the scenario.

    Raises
    ------
    InputError
        `edge` is neither ``"lane"`` nor ``"road"``, or the file cannot be read.

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate(
    ...     "examples/x_intersection/x_intersection.xosc", {"ego_start": 44.0}, drivers={"Ego": "aggressive"}
    ... )
    >>> cc.measure(recording, "Ego", "Pedestrian", [cc.metrics.LaneMargin()])
    metric       score    unit  critical is
    lane-margin  0.04756  m     low
    """

    name = "lane-margin"
    unit = "m"
    lower_is_critical = True
    cap = 2.0
    bound = -10.0
    default_threshold = 0.0
    ego_only = True
    source = "distance to the lane boundary, ISO 17361:2017"

    def __init__(self, edge: str = "lane", roads: str = "") -> None:
        if edge not in _EDGES:
            raise InputError(f"The metric '{type(self).name}': its option `edge` is '{edge}'; give lane or road.")
        self.edge, self.roads = edge, roads

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        recording.entity_index(other)
        center, heading = recording.box_center(ego), recording.heading[recording.entity_index(ego)]
        file = Path(self.roads) if self.roads else recording.road_file
        if file is None:
            return np.full(len(recording.time), np.nan)
        network, corners = read_recorded_roads(file), box_corners_over_time(recording, ego)
        if self.edge == "road":
            return road_margins(network, center[:, 0], center[:, 1], corners)
        return lane_margins(network, center[:, 0], center[:, 1], heading, corners)
