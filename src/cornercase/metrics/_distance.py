"""Metrics of the distance between two bounding boxes, and between their centres."""

from __future__ import annotations

import numpy as np

from cornercase._common.geometry.boxes import box_distance
from cornercase._common.typing import FloatArray
from cornercase.metrics._base import Metric
from cornercase.metrics._geometry.boxes import box_corners_over_time
from cornercase.recordings import Recording


class Distance(Metric):
    """Distance between the centres of two bounding boxes.

    ``|p_other - p_ego|`` in the plane, in m; 0 if the centres coincide. It depends on positions only, also for standing
    entities. A recording in which the boxes touch scores 0, although their centres are still apart. So a collision
    never counts as less critical than a narrow pass. The gap between the boxes is `Clearance`. Not defined if one of
    the two does not exist. Least critical value (cap): 100 m.

    Source: Euclidean distance, as an objective in Schütt, Otten and Sax, "Clustering-based criticality analysis for
    testing of automated driving systems" (2023), scenario 2.

    Parameters
    ----------
    severity : bool, default False
        Score collisions below 0, harder ones lower (`Metric.score_with_contact`).

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate(
    ...     "examples/x_intersection/x_intersection.xosc", {"ego_start": 44.0}, drivers={"Ego": "aggressive"}
    ... )
    >>> cc.measure(recording, "Ego", "Pedestrian", [cc.metrics.Distance()])
    metric    score  unit  critical is
    distance  7.21   m     low
    """

    name = "distance"
    unit = "m"
    lower_is_critical = True
    cap = 100.0
    contact_score = 0.0
    source = "Euclidean distance between the centres of the bounding boxes"

    def __init__(self, severity: bool = False) -> None:
        self.severity = severity

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        offset = recording.box_center(other) - recording.box_center(ego)
        return np.hypot(offset[:, 0], offset[:, 1])


class Clearance(Metric):
    """Gap between the two bounding boxes.

    The smallest distance between the boxes in the plane, in m; 0 if they touch or overlap. It depends on positions and
    headings only, also for standing entities. Not defined if one of the two does not exist. Least critical value (cap):
    100 m.

    Source: Euclidean distance of the boxes as convex polygons.

    Parameters
    ----------
    severity : bool, default False
        Score collisions below 0, harder ones lower (`Metric.score_with_contact`).

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate("examples/r157/cut_out.xosc")
    >>> cc.measure(recording, "Ego", "Other", [cc.metrics.Clearance()])
    metric     score  unit  critical is
    clearance  15.13  m     low
    """

    name = "clearance"
    unit = "m"
    lower_is_critical = True
    cap = 100.0
    default_threshold = 1.0
    contact_score = 0.0
    source = "Euclidean distance of the bounding boxes"

    def __init__(self, severity: bool = False) -> None:
        self.severity = severity

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        return box_distance(box_corners_over_time(recording, ego), box_corners_over_time(recording, other))
