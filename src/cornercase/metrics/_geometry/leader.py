"""Gap between the ego and a leader (another entity ahead), and how both move along the ego's heading."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cornercase._common.geometry.boxes import time_to_contact
from cornercase._common.typing import FloatArray
from cornercase.metrics._geometry.boxes import box_corners_over_time
from cornercase.recordings import Recording


@dataclass(frozen=True)
class LeaderGap:
    """Gap, speeds and accelerations of the ego and a leader (an entity ahead) at T instants, shape (T,) each.

    All values are along the ego's direction of travel, in m, m/s and m/s². `gap` is how far the ego could go straight
    on until the boxes touch; 0 if they touch now. It is NaN if the other entity is beside or behind the ego, or one of
    the two does not exist. `leader_speed` is negative for an oncoming leader.
    """

    gap: FloatArray
    speed: FloatArray
    leader_speed: FloatArray
    acceleration: FloatArray
    leader_acceleration: FloatArray

    @property
    def closing_speed(self) -> FloatArray:
        """Speed at which the gap shrinks, in m/s."""
        return self.speed - self.leader_speed

    @classmethod
    def from_recording(cls, recording: Recording, ego: str, other: str) -> LeaderGap:
        """Measure the gap along the heading of the ego, or backwards while the ego reverses."""
        i, j = recording.entity_index(ego), recording.entity_index(other)
        sign = np.where(recording.speed[i] < 0.0, -1.0, 1.0)
        heading = recording.heading[i]
        direction = sign[:, None] * np.stack([np.cos(heading), np.sin(heading)], -1)
        # At 1 m/s, the time to contact in s is the gap in m.
        gap = time_to_contact(
            box_corners_over_time(recording, ego), box_corners_over_time(recording, other), -direction
        )
        direction_cosine = sign * np.cos(recording.heading[j] - heading)
        return cls(
            np.where(np.isfinite(gap), gap, np.nan),
            sign * recording.speed[i],
            direction_cosine * recording.speed[j],
            sign * recording.acceleration[i],
            direction_cosine * recording.acceleration[j],
        )


def time_to_travel_distance(
    distance: FloatArray, speed: FloatArray, acceleration: FloatArray, stops_at_zero_speed: bool = True
) -> FloatArray:
    """Return the time in s until a distance is travelled with constant acceleration; inf if never.

    This is the smallest t >= 0 with ``speed t + acceleration t² / 2 = distance``; NaN if an input is NaN. With
    `stops_at_zero_speed`, an entity that brakes to a stop stays there; otherwise it then moves in the other direction.
    """
    discriminant = speed**2 + 2.0 * acceleration * distance
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(np.maximum(discriminant, 0.0))
        # Without cancellation: the sum in the divisor is the larger of the two.
        time = np.where(speed >= 0.0, 2.0 * distance / (speed + root), (root - speed) / acceleration)
    is_reached = (discriminant >= 0.0) & ((speed > 0.0) | (acceleration > 0.0))
    if stops_at_zero_speed:
        is_reached &= speed >= 0.0
    time = np.where(is_reached, time, np.inf)
    time = np.where(distance <= 0.0, 0.0, time)
    return np.where(np.isnan(distance + speed + acceleration), np.nan, time)
