"""Metrics post-encroachment time and encroachment time, from the recorded motion."""

from __future__ import annotations

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics._base import Metric
from cornercase.metrics._geometry.conflict_area import TIME_TOLERANCE, Area, AreaVisit, area_visits, validate_area
from cornercase.recordings import Recording


class Pet(Metric):
    """Time between one entity leaving the conflict area and the other entering it, as recorded.

    ``t_in(second) - t_out(first)`` in s. The conflict area is the overlap of the areas that both bounding boxes sweep
    in the whole recording, on tracks of any shape. Each connected stretch of the tracks on which the boxes would touch,
    regardless of time, has its own conflict area, and the smallest value counts. An entity is in the area while its box
    touches the area. Between two instants the corners go straight and the speed changes linearly.

    The value is known only after the recording and belongs to the recording as a whole: the course has this value at
    all instants.

    The value is not defined (NaN at all instants) if there is no conflict area, if the first entity never leaves the
    area, or if the second enters before the first has left. So it is not defined in a collision; a recording in which
    both touch scores 0. An entity that stands outside of the other's swept area gives no conflict area. An entity that
    stands inside does not leave. A recording that ends before the second entity enters has no conflict area. The value
    is never negative unless `signed`. Least critical value (cap): 10 s.

    Source: B. L. Allen, B. T. Shin, P. J. Cooper, "Analysis of traffic conflicts and collisions", Transportation
    Research Record 667 (1978).

    Parameters
    ----------
    area : tuple of five float, optional
        Rectangle to use as the conflict area, such as the shared part of two lanes: x and y of its centre in m, heading
        in rad, length and width in m.
    signed : bool, default False
        If both were in the area at once, give the (negative) time by which the second came too early, instead of NaN.
        An entity that has not left counts as leaving at its last instant.
    severity : bool, default False
        Score collisions below 0, harder ones lower (`Metric.score_with_contact`).

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate(
    ...     "examples/x_intersection/x_intersection.xosc", {"ego_start": 44.0}, drivers={"Ego": "aggressive"}
    ... )
    >>> cc.measure(recording, "Ego", "Pedestrian", [cc.metrics.Pet()])
    metric  score  unit  critical is
    pet     2.558  s     low
    """

    name = "pet"
    unit = "s"
    lower_is_critical = True
    cap = 10.0
    default_threshold = 1.5
    contact_score = 0.0
    source = "Allen, Shin and Cooper 1978, areas swept by the boxes"

    def __init__(self, area: Area | None = None, signed: bool = False, severity: bool = False) -> None:
        self.area = validate_area(self.name, area)
        self.signed, self.severity = signed, severity

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        values = [value for pair in area_visits(recording, ego, other, self.area) for value in self._time_gaps(*pair)]
        return np.full(len(recording.time), min(values, default=np.nan))

    def _time_gaps(self, ego_visit: AreaVisit, other_visit: AreaVisit) -> list[float]:
        gaps = [
            second.entry_time - first.exit_time
            for first, second in ((ego_visit, other_visit), (other_visit, ego_visit))
            if first.has_left and second.entry_time >= first.exit_time - TIME_TOLERANCE
        ]
        if gaps or not self.signed:
            return [max(gap, 0.0) for gap in gaps]
        return [max(ego_visit.entry_time - other_visit.exit_time, other_visit.entry_time - ego_visit.exit_time)]


class EncroachmentTime(Metric):
    """Time that the ego spends in the conflict area, as recorded.

    ``t_out - t_in`` in s. The conflict area is the overlap of the areas that both bounding boxes sweep in the whole
    recording, as in `Pet`. It depends on where the other entity goes, not on when. If there are several areas or
    visits, the longest visit counts. The value is known only after the recording, so the course has it at all instants.
    The value is inf if the ego stands in the area at the end. It is not defined (NaN at all instants) if there is no
    conflict area, or if the recording ends while the ego drives through the area. Least critical value (cap): 0. Most
    critical value: 60 s, which is also the score of a recording in which both touch.

    Source: B. L. Allen, B. T. Shin, P. J. Cooper, "Analysis of traffic conflicts and collisions", Transportation
    Research Record 667 (1978).

    Parameters
    ----------
    area : tuple of five float, optional
        Rectangle to use as the conflict area, as in `Pet`.

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate(
    ...     "examples/x_intersection/x_intersection.xosc", {"ego_start": 44.0}, drivers={"Ego": "aggressive"}
    ... )
    >>> cc.measure(recording, "Ego", "Pedestrian", [cc.metrics.EncroachmentTime()])
    metric             score   unit  critical is
    encroachment-time  0.5814  s     high
    """

    name = "encroachment-time"
    unit = "s"
    lower_is_critical = False
    cap = 0.0
    bound = contact_score = 60.0
    source = "Allen, Shin and Cooper 1978, areas swept by the boxes"

    def __init__(self, area: Area | None = None) -> None:
        self.area = validate_area(self.name, area)

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        durations = [
            stay.exit_time - stay.entry_time if stay.has_left else np.inf
            for stay, _ in area_visits(recording, ego, other, self.area)
            if stay.has_left or stay.is_standing
        ]
        return np.full(len(recording.time), max(durations, default=np.nan))
