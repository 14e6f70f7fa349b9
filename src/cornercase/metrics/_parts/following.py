"""One entity following another: the gap on the ego's way, and how both move along it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cornercase._common.geometry import first_contact
from cornercase._common.typing import FloatArray
from cornercase.metrics._parts.boxes import boxes
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
        # At 1 m/s, the time to contact in s is the gap in m.
        gap = first_contact(boxes(recording, ego), boxes(recording, other), -direction)
        along = sign * np.cos(recording.heading[j] - heading)
        return cls(
            np.where(np.isfinite(gap), gap, np.nan),
            sign * recording.speed[i],
            along * recording.speed[j],
            sign * recording.acceleration[i],
            along * recording.acceleration[j],
        )


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
