"""One entity following another: the gap on the ego's way, headway, time headway, potential time to collision."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cornercase._common.geometry import first_contact
from cornercase._common.typing import FloatArray
from cornercase.metrics.base import PairMetric, boxes
from cornercase.recordings import Recording


@dataclass(frozen=True)
class Following:
    """An ego and the other in its way, along the direction in which the ego drives; each of shape (T,).

    Attributes
    ----------
    gap : ndarray of float64
        How far the ego could go straight on until the boxes touch, in m; 0 when they touch now. NaN where the
        other is not in the ego's way (beside it, behind it), so that nobody follows, and where one does not
        exist.
    speed, leader_speed : ndarray of float64
        m/s; that of an oncoming leader is negative.
    acceleration, leader_acceleration : ndarray of float64
        m/s².
    """

    gap: FloatArray
    speed: FloatArray
    leader_speed: FloatArray
    acceleration: FloatArray
    leader_acceleration: FloatArray

    @property
    def closing(self) -> FloatArray:
        """Speed at which the gap shrinks, in m/s."""
        return self.speed - self.leader_speed

    @classmethod
    def of(cls, recording: Recording, ego: str, other: str) -> Following:
        """Look from the ego along its heading, or backwards where it reverses."""
        i, j = recording.index(ego), recording.index(other)
        sign = np.where(recording.speed[i] < 0.0, -1.0, 1.0)
        heading = recording.heading[i]
        direction = sign[:, None] * np.stack([np.cos(heading), np.sin(heading)], -1)
        # Seen from an ego that moves on by 1 m/s the other comes nearer by as much; time is then the gap in m.
        gap = first_contact(boxes(recording, ego), boxes(recording, other), -direction)
        along = sign * np.cos(recording.heading[j] - heading)
        return cls(
            np.where(np.isfinite(gap), gap, np.nan),
            sign * recording.speed[i],
            along * recording.speed[j],
            sign * recording.acceleration[i],
            along * recording.acceleration[j],
        )


class Headway(PairMetric):
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

    def _course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        return Following.of(recording, ego, other).gap


class Thw(PairMetric):
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

    def _course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        pair = Following.of(recording, ego, other)
        acceleration = pair.acceleration if self.accelerating else np.zeros_like(pair.speed)
        return time_to_cover(pair.gap, pair.speed, acceleration)


class Pttc(PairMetric):
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

    def _course(self, recording: Recording, ego: str, other: str) -> FloatArray:
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


def time_to_cover(way: FloatArray, speed: FloatArray, acceleration: FloatArray, stops: bool = True) -> FloatArray:
    """Smallest t >= 0 with speed t + acceleration t²/2 = way.

    Parameters
    ----------
    way : ndarray of float64, shape (...)
        m, not negative.
    speed, acceleration : ndarray of float64, shape (...)
        m/s and m/s².
    stops : bool
        Whether braking ends in standing; otherwise the motion turns round.

    Returns
    -------
    ndarray of float64, shape (...)
        s; inf for never, NaN where an input is.
    """
    discriminant = speed**2 + 2.0 * acceleration * way
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(np.maximum(discriminant, 0.0))
        # Without cancellation: the sum in the divisor is the larger of the two.
        time = np.where(speed >= 0.0, 2.0 * way / (speed + root), (root - speed) / acceleration)
    reached = (discriminant >= 0.0) & ((speed > 0.0) | (acceleration > 0.0))
    if stops:
        reached &= speed >= 0.0
    time = np.where(reached, time, np.inf)
    time = np.where(way <= 0.0, 0.0, time)
    return np.where(np.isnan(way + speed + acceleration), np.nan, time)
