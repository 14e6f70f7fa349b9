"""Metrics of the gap time: difference of the times at which both entities reach the crossing of their tracks."""

from __future__ import annotations

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics._base import Metric
from cornercase.metrics._geometry.crossing import REACH, distances_to_crossing
from cornercase.metrics._geometry.numeric import check_nonnegative_options, divide_by_positive_or_inf
from cornercase.recordings import Recording


class GapTime(Metric):
    """Difference of the times at which both entities reach the crossing of their tracks at present speeds.

    ``|d / v - d_other / v_other|`` in s. d and d_other are the distances from the centres of the ego's and the other's
    box to the crossing along the tracks, as in `TrajectoryDistance`; v and v_other are the present speeds. The value is
    0 if both arrive together, and inf if at least one of them stands before the crossing. An entity that stands on the
    crossing has arrived. Not defined if no crossing lies ahead of both, if the tracks do not cross, or if one of the
    two does not exist. Least critical value (cap): 10 s.

    Source: gap time, B. L. Allen, B. T. Shin, P. J. Cooper, "Analysis of traffic conflicts and collisions",
    Transportation Research Record 667 (1978), predicted with constant speeds.

    Parameters
    ----------
    ahead : float, default 100.0
        Length in m by which each track goes straight on after the recording.

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate(
    ...     "examples/x_intersection/x_intersection.xosc", {"ego_start": 44.0}, drivers={"Ego": "aggressive"}
    ... )
    >>> cc.measure(recording, "Ego", "Pedestrian", [cc.metrics.GapTime()])
    metric    score  unit  critical is
    gap-time  1.945  s     low
    """

    name = "gap-time"
    unit = "s"
    lower_is_critical = True
    cap = 10.0
    source = "Allen, Shin and Cooper 1978, predicted"

    def __init__(self, ahead: float = 100.0) -> None:
        check_nonnegative_options(self.name, ahead=ahead)
        self.ahead = ahead

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        ego_times, other_times = _arrival_times(recording, ego, other, self.ahead)
        return _time_difference(ego_times, other_times)


class Spret(GapTime):
    """Difference of the squared times at which both entities reach the crossing of their tracks.

    ``|t² - t_other²|`` in s², with the times t and t_other until the ego and the other entity reach the crossing. The
    value is the gap time multiplied by the sum of both times, so the same gap time is more critical if both arrive
    sooner. Times, special values and undefined cases are the same as for `GapTime`. Least critical value (cap): 100 s².

    Source: squared predicted relative encroachment time, as in Westhofen et al. 2023.

    Parameters
    ----------
    ahead : float, default 100.0
        As in `GapTime`.

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate(
    ...     "examples/x_intersection/x_intersection.xosc", {"ego_start": 44.0}, drivers={"Ego": "aggressive"}
    ... )
    >>> cc.measure(recording, "Ego", "Pedestrian", [cc.metrics.Spret()])
    metric  score  unit  critical is
    spret   7.602  s²    low
    """

    name = "spret"
    unit = "s²"
    cap = 100.0
    source = "Squared predicted relative encroachment time, as in Westhofen et al. 2023"

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        ego_times, other_times = _arrival_times(recording, ego, other, self.ahead)
        return _time_difference(ego_times**2, other_times**2)


def _arrival_times(recording: Recording, ego: str, other: str, ahead: float) -> tuple[FloatArray, FloatArray]:
    distances = distances_to_crossing(recording, ego, other, ahead)
    speeds = (np.abs(recording.speed[recording.entity_index(name)]) for name in (ego, other))
    ego_times, other_times = (_arrival_time(distance, speed) for distance, speed in zip(distances, speeds, strict=True))
    return ego_times, other_times


def _arrival_time(distance: FloatArray, speed: FloatArray) -> FloatArray:
    time = np.where(speed > 0.0, divide_by_positive_or_inf(distance, speed), np.where(distance > REACH, np.inf, 0.0))
    return np.where(np.isnan(distance + speed), np.nan, time)


def _time_difference(ego_times: FloatArray, other_times: FloatArray) -> FloatArray:
    with np.errstate(invalid="ignore"):
        gap = np.abs(ego_times - other_times)
    # Two standing entities never arrive, so they do not arrive together.
    return np.where(np.isinf(ego_times) & np.isinf(other_times), np.inf, gap)
