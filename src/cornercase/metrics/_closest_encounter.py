"""Metrics of the closest encounter: the smallest gap if both entities go straight on, and when it occurs."""

from __future__ import annotations

import numpy as np

from cornercase._common.geometry.boxes import box_distance, time_to_contact
from cornercase._common.typing import FloatArray
from cornercase.metrics._base import Metric
from cornercase.metrics._geometry.boxes import box_corners_over_time, relative_velocity
from cornercase.recordings import Recording

_GAP_TOLERANCE = 1e-9
"""Difference in m up to which two gaps count as equal."""


class Dce(Metric):
    """Distance of closest encounter: the smallest gap between the boxes if both go straight on.

    Each box keeps its heading and its speed. The value is the smallest gap in m from this instant on. It is 0 if the
    boxes touch now or will touch. It is the present gap if both stand or move apart. Not defined if one of the two does
    not exist. Least critical value (cap): 100 m.

    Source: J. Eggert, "Predictive risk estimation for intelligent ADAS functions", IEEE ITSC (2014).

    Parameters
    ----------
    centers : bool, default False
        Measure between the centres of the boxes instead of their edges.
    severity : bool, default False
        Score collisions below 0, harder ones lower (`Metric.score_with_contact`).

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate(
    ...     "examples/x_intersection/x_intersection.xosc", {"ego_start": 44.0}, drivers={"Ego": "aggressive"}
    ... )
    >>> cc.measure(recording, "Ego", "Pedestrian", [cc.metrics.Dce()])
    metric  score  unit  critical is
    dce     5.412  m     low
    """

    name = "dce"
    unit = "m"
    lower_is_critical = True
    cap = 100.0
    default_threshold = 1.0
    contact_score = 0.0
    source = "Eggert 2014, boxes in the plane"

    def __init__(self, centers: bool = False, severity: bool = False) -> None:
        self.centers, self.severity = centers, severity

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        return closest_encounter(recording, ego, other, self.centers)[0]


class Ttce(Metric):
    """Time to closest encounter: when the gap between the boxes is smallest if both go straight on.

    The first t >= 0 in s at which the gap has its smallest value (`Dce`). If the boxes will touch, this is the time to
    collision. The value is 0 if both stand or move apart. Not defined if one of the two does not exist. The value says
    when both come closest, not how close, so use it together with `Dce`. Least critical value (cap): 10 s.

    Source: J. Eggert, "Predictive risk estimation for intelligent ADAS functions", IEEE ITSC (2014).

    Parameters
    ----------
    centers : bool, default False
        Measure between the centres of the boxes instead of their edges.

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate("examples/r157/cut_out.xosc")
    >>> cc.measure(recording, "Ego", "Other", [cc.metrics.Ttce()])
    metric  score  unit  critical is
    ttce    0      s     low
    """

    name = "ttce"
    unit = "s"
    lower_is_critical = True
    cap = 10.0
    source = "Eggert 2014, boxes in the plane"

    def __init__(self, centers: bool = False) -> None:
        self.centers = centers

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        return closest_encounter(recording, ego, other, self.centers)[1]


def closest_encounter(recording: Recording, ego: str, other: str, centers: bool) -> tuple[FloatArray, FloatArray]:
    """Return the smallest gap in m from each instant on, and the time in s until then, shape (T,) each.

    Both entities are assumed to go straight on from the instant. Values are NaN if an entity does not exist. With
    `centers`, the gap is measured between the centres of the boxes.
    """
    velocity = relative_velocity(recording, ego, other)
    if centers:
        return _closest_approach_to_origin((recording.box_center(other) - recording.box_center(ego))[:, None], velocity)
    a, b = box_corners_over_time(recording, ego), box_corners_over_time(recording, other)
    # If one of two convex shapes moves straight on, they are nearest now, or their nearest points then are corners.
    corner_offsets = (b[:, None] - a[:, :, None]).reshape(len(a), 16, 2)
    gap, time = _closest_approach_to_origin(corner_offsets, velocity)
    present_gap = box_distance(a, b)
    time = np.where(present_gap <= gap + _GAP_TOLERANCE, 0.0, time)
    gap = np.minimum(present_gap, gap)
    contact = time_to_contact(a, b, velocity)
    collides = np.isfinite(contact)
    return np.where(collides, 0.0, gap), np.where(collides, contact, time)


def _closest_approach_to_origin(points: FloatArray, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how close the nearest of n moving points comes to the origin, and when it first is that close.

    `points`, shape (T, n, 2), are the positions at T instants. All points move at the same `velocity`, shape (T, 2).
    """
    squared_speed = (velocity**2).sum(-1)
    moves = squared_speed > 0.0
    times = -(points * velocity[:, None]).sum(-1) / np.where(moves, squared_speed, 1.0)[:, None]
    times = np.maximum(np.where(moves[:, None], times, 0.0), 0.0)
    closest_points = points + times[..., None] * velocity[:, None]
    distances = np.hypot(closest_points[..., 0], closest_points[..., 1])
    gap = distances.min(-1)
    # For parallel sides several corners are equally near; the first time counts.
    first = np.where(distances <= gap[:, None] + _GAP_TOLERANCE, times, np.inf).min(-1)
    return gap, np.where(np.isnan(gap), np.nan, first)
