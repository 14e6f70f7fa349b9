"""Metrics of one entity that follows another: headway, time headway, potential time to collision."""

from __future__ import annotations

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.metrics._parts.following import Following, time_to_cover
from cornercase.metrics.base import Metric
from cornercase.recordings import Recording


class Headway(Metric):
    """Distance that the ego could go straight on until its box touches that of the other.

    For one car behind another on one lane this is the gap from front to rear bumper, in m. It depends on
    positions and headings only; 0 when the boxes touch. Not defined where the other is not in the ego's way
    (beside or behind it) or one of the two does not exist. Cap: 100 m.

    Notes
    -----
    Source: L. Westhofen et al., "Criticality metrics for automated driving: a review and suitability analysis
    of the state of the art", Archives of Computational Methods in Engineering 30 (2023), headway.
    """

    name = "hw"
    unit = "m"
    lower_is_critical = True
    cap = 100.0
    source = "Headway, as in Westhofen et al. 2023"

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        return Following.of(recording, ego, other).gap


class Thw(Metric):
    """Time headway: when the ego reaches the place where the rear of the other is now.

    ``gap / v`` in s, with the gap of `Headway` and the ego's speed v; 0 when the boxes touch, inf for a
    standing ego. The other's speed plays no part, so a standing one is nothing special. Not defined where the
    other is not in the ego's way or one of the two does not exist. Cap: 10 s.

    Parameters
    ----------
    accelerating : bool, default False
        Let the ego keep its present acceleration until it stands; inf where it stops before.

    Notes
    -----
    Source: J. R. Jansson, "Collision avoidance theory with application to automotive collision mitigation",
    Linköping University (2005), with the gap between boxes.
    """

    name = "thw"
    unit = "s"
    lower_is_critical = True
    cap = 10.0
    critical = 0.9
    source = "Jansson 2005, gap between boxes"

    def __init__(self, accelerating: bool = False) -> None:
        self.accelerating = accelerating

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        pair = Following.of(recording, ego, other)
        acceleration = pair.acceleration if self.accelerating else np.zeros_like(pair.speed)
        return time_to_cover(pair.gap, pair.speed, acceleration)


class Pttc(Metric):
    """Potential time to collision: the leader keeps its acceleration until it stands, the ego its speed.

    The smallest t >= 0 in s with ``gap = (v - v_other) t - a_other t² / 2``; once a braking leader has come
    to its stop it stays there. 0 when the boxes touch, inf when the ego never reaches the other. With a leader
    of constant speed it is the time to collision; a standing leader is an obstacle. Not defined where the
    other is not in the ego's way or one of the two does not exist. Cap: 10 s.

    Notes
    -----
    Source: H. Wakabayashi et al., "Traffic conflict analysis using vehicle tracking system/digital VCR and
    proposal of a new conflict indicator", Infrastructure Planning Review 20 (2003); the leader does not
    reverse by braking.
    """

    name = "pttc"
    unit = "s"
    lower_is_critical = True
    cap = 10.0
    source = "Wakabayashi et al. 2003"

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        pair = Following.of(recording, ego, other)
        speed, rate = pair.leader_speed, pair.leader_acceleration
        slows = speed * rate < 0.0
        # At a speed of 0 the sign of the acceleration is that of the brake, not of a start backwards.
        rate = np.where((speed == 0.0) & (rate < 0.0), 0.0, rate)
        stop = np.where(slows, -speed / np.where(slows, rate, 1.0), np.inf)
        moving = time_to_cover(pair.gap, pair.closing, -rate, stops=False)
        way = np.where(slows, 0.5 * speed * np.where(slows, stop, 0.0), 0.0)
        standing = time_to_cover(pair.gap + way, pair.speed, np.zeros_like(way))
        return np.where(np.isnan(moving), np.nan, np.where(moving <= stop, moving, np.fmax(standing, stop)))
