"""Closest encounter: how near both come if they go straight on, and when."""

from __future__ import annotations

import numpy as np

from cornercase._common.geometry import box_distance, first_contact
from cornercase._common.typing import FloatArray
from cornercase.metrics._parts.boxes import boxes, relative_velocity
from cornercase.metrics.base import Metric
from cornercase.recordings import Recording

_TIE = 1e-9
"""Gaps in m that are the same but for rounding."""


class Dce(Metric):
    """Distance of closest encounter: the smallest gap between the boxes if both go straight on.

    Each box keeps its heading and its speed along it; the value is the smallest gap in m at this instant or
    later. 0 when the boxes will touch or do so now, the present gap where the two move apart or both stand.
    Not defined where one of the two does not exist. Cap: 100 m.

    Parameters
    ----------
    centers : bool, default False
        Measure between the centres of the boxes instead.
    severity : bool, default False
        Let the score go on below 0 among collisions, by how hard they are (`Metric.score_of_contact`).

    Notes
    -----
    Source: J. Eggert, "Predictive risk estimation for intelligent ADAS functions", IEEE ITSC (2014).
    """

    name = "dce"
    unit = "m"
    lower_is_critical = True
    cap = 100.0
    critical = 1.0
    contact = 0.0
    source = "Eggert 2014, boxes in the plane"

    def __init__(self, centers: bool = False, severity: bool = False) -> None:
        self.centers, self.severity = centers, severity

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        return closest_encounter(recording, ego, other, self.centers)[0]


class Ttce(Metric):
    """Time to closest encounter: when the gap between the boxes is smallest if both go straight on.

    The first t >= 0 in s at which the gap of `Dce` is reached: the time to collision where the boxes will
    touch, 0 where the two move apart or both stand. Not defined where one of the two does not exist. It says
    when, not how near: read it beside `Dce`. Cap: 10 s.

    Parameters
    ----------
    centers : bool, default False
        Measure between the centres of the boxes instead.

    Notes
    -----
    Source: J. Eggert, "Predictive risk estimation for intelligent ADAS functions", IEEE ITSC (2014).
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
    """Smallest gap from now on, and when it is first reached.

    Parameters
    ----------
    recording : Recording
    ego, other : str
    centers : bool
        Between the centres, not the boxes.

    Returns
    -------
    ndarray of float64, shape (T,)
        m; NaN where one does not exist.
    ndarray of float64, shape (T,)
        s.
    """
    way = relative_velocity(recording, ego, other)
    if centers:
        return _nearest((recording.center(other) - recording.center(ego))[:, None], way)
    a, b = boxes(recording, ego), boxes(recording, other)
    # Of two convex shapes, one of which moves straight on, the nearest points are corners at the time when
    # they are nearest, or the shapes are nearest now.
    apart = (b[:, None] - a[:, :, None]).reshape(len(a), 16, 2)
    gap, time = _nearest(apart, way)
    now = box_distance(a, b)
    time = np.where(now <= gap + _TIE, 0.0, time)
    gap = np.minimum(now, gap)
    contact = first_contact(a, b, way)
    meets = np.isfinite(contact)
    return np.where(meets, 0.0, gap), np.where(meets, contact, time)


def _nearest(points: FloatArray, way: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Smallest distance to the origin of points (T, n, 2) that move by `way` (T, 2), and when first."""
    square = (way**2).sum(-1)
    moves = square > 0.0
    times = -(points * way[:, None]).sum(-1) / np.where(moves, square, 1.0)[:, None]
    times = np.maximum(np.where(moves[:, None], times, 0.0), 0.0)
    places = points + times[..., None] * way[:, None]
    distances = np.hypot(places[..., 0], places[..., 1])
    gap = distances.min(-1)
    # Sides that pass each other in parallel are as near at several corners; the first of them counts.
    first = np.where(distances <= gap[:, None] + _TIE, times, np.inf).min(-1)
    return gap, np.where(np.isnan(gap), np.nan, first)
