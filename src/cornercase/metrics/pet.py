"""Post-encroachment time and encroachment time, from the recorded motion."""

from __future__ import annotations

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics._parts.conflict_area import TOUCH, Area, Stay, checked_area, visits
from cornercase.metrics.base import Metric
from cornercase.recordings import Recording


class Pet(Metric):
    """Time between one entity leaving the conflict area and the other entering it, as recorded.

    ``t_in(second) - t_out(first)`` in s. The conflict area is the overlap of the areas that both bounding boxes sweep
    in the whole recording, on tracks of any shape. Each connected stretch of the tracks on which the boxes would meet,
    regardless of time, has an area of its own; the smallest value counts. An entity is in the area while its box
    touches it. Between two instants the corners go straight and the speed changes evenly.

    The value is known only afterwards and belongs to the recording as a whole: the course has it at all instants.

    Not defined (NaN throughout) without a conflict area, if the second enters before the first has left (so in each
    collision), and if the first never leaves. A recording in which both touch scores 0. An entity that stands outside
    of the other's swept area gives no conflict, one that stands inside does not leave. A recording that ends before the
    second enters has no conflict area. Never negative unless `signed`. Cap: 10 s.

    Source: B. L. Allen, B. T. Shin, P. J. Cooper, "Analysis of traffic conflicts and collisions", Transportation
    Research Record 667 (1978).

    Parameters
    ----------
    area : tuple of five float, optional
        Rectangle to use as the conflict area, such as the shared part of two lanes: x and y of its centre in m, heading
        in rad, length and width in m.
    signed : bool, default False
        If both were in the area at once, give the (negative) time by which the second came too early instead of NaN. An
        entity that has not left counts as leaving when its recording ends.
    severity : bool, default False
        Score collisions below 0, by how hard they are (`Metric.score_with_contact`).
    """

    name = "pet"
    unit = "s"
    lower_is_critical = True
    cap = 10.0
    critical = 1.5
    contact = 0.0
    source = "Allen, Shin and Cooper 1978, areas swept by the boxes"

    def __init__(self, area: Area | None = None, signed: bool = False, severity: bool = False) -> None:
        self.area = checked_area(self.name, area)
        self.signed, self.severity = signed, severity

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        values = [value for pair in visits(recording, ego, other, self.area) for value in self._gaps(*pair)]
        return np.full(len(recording.time), min(values, default=np.nan))

    def _gaps(self, one: Stay, two: Stay) -> list[float]:
        gaps = [
            second.enters - first.leaves
            for first, second in ((one, two), (two, one))
            if first.left and second.enters >= first.leaves - TOUCH
        ]
        if gaps or not self.signed:
            return [max(gap, 0.0) for gap in gaps]
        return [max(one.enters - two.leaves, two.enters - one.leaves)]


class EncroachmentTime(Metric):
    """How long the ego is in the conflict area, as recorded.

    ``t_out - t_in`` in s for the conflict area of `Pet`; of several areas or visits the longest counts. It depends on
    the area that the other sweeps, not on when. It is known only afterwards, so the course has the value at all
    instants. inf if the ego comes to a stop in the area. Not defined (NaN throughout) without a conflict area, and if
    the recording ends while the ego drives through it. Cap: 0, most critical value: 60 s, which is the score of a
    recording in which both touch.

    Source: B. L. Allen, B. T. Shin, P. J. Cooper, "Analysis of traffic conflicts and collisions", Transportation
    Research Record 667 (1978).

    Parameters
    ----------
    area : tuple of five float, optional
        Rectangle to use as the conflict area, as in `Pet`.
    """

    name = "encroachment-time"
    unit = "s"
    lower_is_critical = False
    cap = 0.0
    most_critical = contact = 60.0
    source = "Allen, Shin and Cooper 1978, areas swept by the boxes"

    def __init__(self, area: Area | None = None) -> None:
        self.area = checked_area(self.name, area)

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        durations = [
            stay.leaves - stay.enters if stay.left else np.inf
            for stay, _ in visits(recording, ego, other, self.area)
            if stay.left or stay.stands
        ]
        return np.full(len(recording.time), max(durations, default=np.nan))
