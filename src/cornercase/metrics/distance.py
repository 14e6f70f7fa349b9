"""Distance between centres, and between boxes."""

from __future__ import annotations

import numpy as np

from cornercase._common.geometry import box_distance
from cornercase._common.typing import FloatArray
from cornercase.metrics._parts.boxes import boxes
from cornercase.metrics.base import Metric
from cornercase.recordings import Recording


class Distance(Metric):
    """Distance between the centres of two bounding boxes.

    ``|p_other - p_ego|`` in the plane, in m. It depends on positions only, so standing entities are nothing
    special; 0 when the centres coincide. Boxes that touch still have a positive distance: their gap is
    `Clearance`. A recording in which they touch scores 0, so that none counts as less critical than one in which
    narrow boxes pass each other.

    Not defined where one of the two does not exist. Cap: 100 m.

    Parameters
    ----------
    severity : bool, default False
        Let the score go on below 0 among collisions, by how hard they are (`Metric.score_of_contact`).

    Notes
    -----
    Source: Euclidean distance, as an objective in Schütt, Otten and Sax, "Clustering-based
    criticality analysis for testing of automated driving systems" (2023), scenario 2.
    """

    name = "distance"
    unit = "m"
    lower_is_critical = True
    cap = 100.0
    contact = 0.0
    source = "Euclidean distance between the centres of the bounding boxes"

    def __init__(self, severity: bool = False) -> None:
        self.severity = severity

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        gap = recording.center(other) - recording.center(ego)
        return np.hypot(gap[:, 0], gap[:, 1])


class Clearance(Metric):
    """Gap between the two bounding boxes.

    The smallest distance of two of their points in the plane, in m; 0 where they touch or overlap. It depends
    on positions and headings only, so standing entities are nothing special. Not defined where one of the two
    does not exist. Cap: 100 m.

    Parameters
    ----------
    severity : bool, default False
        Let the score go on below 0 among collisions, by how hard they are (`Metric.score_of_contact`).

    Notes
    -----
    Source: Euclidean distance of the boxes as convex polygons.
    """

    name = "clearance"
    unit = "m"
    lower_is_critical = True
    cap = 100.0
    critical = 1.0
    contact = 0.0
    source = "Euclidean distance of the bounding boxes"

    def __init__(self, severity: bool = False) -> None:
        self.severity = severity

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        return box_distance(boxes(recording, ego), boxes(recording, other))
