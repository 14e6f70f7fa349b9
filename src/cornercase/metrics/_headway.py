"""Metrics of an ego that follows another entity: headway, time headway, potential time to collision."""

from __future__ import annotations

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics._base import Metric
from cornercase.metrics._geometry.leader import LeaderGap, time_to_travel_distance
from cornercase.recordings import Recording


class Headway(Metric):
    """Distance that the ego could go straight on until its box touches the box of the other entity.

    For one car behind another on one lane this is the gap from front to rear bumper, in m. It depends on positions and
    headings only, and is 0 if the boxes touch. Not defined if the other entity is beside or behind the ego, or one of
    the two does not exist. Least critical value (cap): 100 m.

    Source: L. Westhofen et al., "Criticality metrics for automated driving: a review and suitability analysis of the
    state of the art", Archives of Computational Methods in Engineering 30 (2023), headway.

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate("examples/r157/cut_out.xosc")
    >>> cc.measure(recording, "Ego", "Other", [cc.metrics.Headway()])
    metric  score  unit  critical is
    hw      15.13  m     low
    """

    name = "hw"
    unit = "m"
    lower_is_critical = True
    cap = 100.0
    source = "Headway, as in Westhofen et al. 2023"

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        return LeaderGap.from_recording(recording, ego, other).gap


class Thw(Metric):
    """Time headway: time until the ego reaches the present position of the other entity's rear.

    ``gap / v`` in s, with the gap of `Headway` and the ego's speed v. It is 0 if the boxes touch, and inf for a
    standing ego. The speed of the other entity does not matter. Not defined if the other entity is not ahead of the
    ego, or one of the two does not exist. Least critical value (cap): 10 s.

    Source: J. R. Jansson, "Collision avoidance theory with application to automotive collision mitigation", Linköping
    University (2005), with the gap between boxes.

    Parameters
    ----------
    accelerating : bool, default False
        Let the ego keep its present acceleration until it stands. The value is inf if the ego stops before it has
        closed the gap.

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate("examples/r157/cut_out.xosc")
    >>> cc.measure(recording, "Ego", "Other", [cc.metrics.Thw()])
    metric  score  unit  critical is
    thw     2      s     low
    """

    name = "thw"
    unit = "s"
    lower_is_critical = True
    cap = 10.0
    default_threshold = 0.9
    source = "Jansson 2005, gap between boxes"

    def __init__(self, accelerating: bool = False) -> None:
        self.accelerating = accelerating

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        pair = LeaderGap.from_recording(recording, ego, other)
        acceleration = pair.acceleration if self.accelerating else np.zeros_like(pair.speed)
        return time_to_travel_distance(pair.gap, pair.speed, acceleration)


class Pttc(Metric):
    """Potential time to collision: the entity ahead keeps its acceleration until it stands, the ego keeps its speed.

    The smallest t >= 0 in s with ``gap = (v - v_other) t - a_other t² / 2``, with the speeds v of the ego and v_other
    of the entity ahead, and its acceleration a_other. An entity that brakes to a stop does not move backwards. The
    value is 0 if the boxes touch, and inf if the ego never reaches the other entity. If the other entity drives at
    constant speed, the value is the time to collision. A standing entity is an obstacle. Not defined if the other
    entity is not ahead of the ego, or one of the two does not exist. Least critical value (cap): 10 s.

    Source: H. Wakabayashi et al., "Traffic conflict analysis using vehicle tracking system/digital VCR and proposal of
    a new conflict indicator", Infrastructure Planning Review 20 (2003). Here, a braking leader stops, and does not
    reverse.

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate("examples/r157/cut_out.xosc")
    >>> cc.measure(recording, "Ego", "Other", [cc.metrics.Pttc()])
    metric  score  unit  critical is
    pttc    2.021  s     low
    """

    name = "pttc"
    unit = "s"
    lower_is_critical = True
    cap = 10.0
    source = "Wakabayashi et al. 2003"

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        pair = LeaderGap.from_recording(recording, ego, other)
        speed, acceleration = pair.leader_speed, pair.leader_acceleration
        brakes = speed * acceleration < 0.0
        # A standing leader with negative acceleration holds its brake; it does not start to reverse.
        acceleration = np.where((speed == 0.0) & (acceleration < 0.0), 0.0, acceleration)
        stop_time = np.where(brakes, -speed / np.where(brakes, acceleration, 1.0), np.inf)
        time_before_stop = time_to_travel_distance(
            pair.gap, pair.closing_speed, -acceleration, stops_at_zero_speed=False
        )
        stop_distance = np.where(brakes, 0.5 * speed * np.where(brakes, stop_time, 0.0), 0.0)
        time_to_stopped = time_to_travel_distance(pair.gap + stop_distance, pair.speed, np.zeros_like(stop_distance))
        return np.where(
            np.isnan(time_before_stop),
            np.nan,
            np.where(time_before_stop <= stop_time, time_before_stop, np.fmax(time_to_stopped, stop_time)),
        )
