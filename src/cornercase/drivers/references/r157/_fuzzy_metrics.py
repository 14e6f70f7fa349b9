"""Fuzzy surrogate safety metrics of Mattas et al. (2020), for the fuzzy safety model."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray

REACTION_TIME: Final = 0.75
"""Reaction time of the driver in s."""

COMFORTABLE_DECELERATION, HARD_DECELERATION, OTHER_DECELERATION = 4.0, 6.0, 7.0
"""Decelerations in m/s²: comfortable and hard braking of the driver, and hard braking of the vehicle ahead."""

SAFETY_MARGIN: Final = 2.0
"""Safety margin in m: the gap at rest, and the margin that is added to the comfortable distance."""

# Time in s by which the driver must have passed before the other vehicle comes in.
_LATERAL_RESERVE = 0.1


def proactive_metric(gap: FloatArray, speed: FloatArray, other_speed: FloatArray) -> FloatArray:
    """Return the proactive fuzzy surrogate safety metric (PFS): how unsafe the gap is if the leader brakes hard.

    The metric is 0 if comfortable braking is enough, and 1 if hard braking is not enough. `gap` is the bumper-to-bumper
    gap in m, speeds are in m/s. Mattas et al., Fuzzy Surrogate Safety Metrics for real-time assessment of rear-end
    collision risk, Accident Analysis & Prevention 148 (2020) 105794.
    """
    room = gap - SAFETY_MARGIN
    lead = other_speed**2 / (2.0 * OTHER_DECELERATION)
    safe = speed * REACTION_TIME + speed**2 / (2.0 * COMFORTABLE_DECELERATION) - lead + SAFETY_MARGIN
    unsafe = speed * REACTION_TIME + speed**2 / (2.0 * HARD_DECELERATION) - lead
    return _linear_membership(room, safe, unsafe)


def critical_metric(
    gap: FloatArray, speed: FloatArray, other_speed: FloatArray, acceleration: FloatArray
) -> FloatArray:
    """Return the critical fuzzy surrogate safety metric (CFS): how unsafe the gap is if the leader keeps its speed.

    The metric is 0 if comfortable braking after the reaction time is enough, and 1 if hard braking is not enough.
    During the reaction time the driver keeps its acceleration, but not less than -4 m/s². `gap` is in m, speeds in m/s,
    `acceleration` in m/s². See Mattas et al. (2020), as in `proactive_metric`.
    """
    a = np.maximum(acceleration, -COMFORTABLE_DECELERATION)
    closing, remaining = speed - other_speed, speed + a * REACTION_TIME - other_speed
    meanwhile = (speed + a * REACTION_TIME / 2.0 - other_speed) * REACTION_TIME
    with np.errstate(divide="ignore", invalid="ignore"):
        is_enough = gap >= closing**2 / np.abs(2.0 * a)
    braking = _linear_membership(
        gap,
        meanwhile + remaining**2 / (2.0 * COMFORTABLE_DECELERATION),
        meanwhile + remaining**2 / (2.0 * HARD_DECELERATION),
    )
    return np.where(closing <= 0.0, 0.0, np.where(remaining < 0.0, np.where(is_enough, 0.0, 1.0), braking))


def is_laterally_safe(
    gap: FloatArray,
    lateral_gap: FloatArray,
    approach_speed: FloatArray,
    closing_speed: FloatArray,
    total_length: FloatArray,
) -> BoolArray:
    """Return whether a vehicle next to the driver's path stays out of the path until 0.1 s after the driver has passed.

    Both keep their speeds.

    `gap` and `lateral_gap` are the gaps between the boxes in m, negative if they overlap. `approach_speed` (towards the
    path) and `closing_speed` are in m/s. `total_length` is the length of both boxes in m. See UN Regulation No. 157,
    01 series of amendments, Annex 3, Appendix 3, performance model 2.
    """
    is_next_to = lateral_gap > 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        late = lateral_gap / approach_speed > (gap + total_length) / closing_speed + _LATERAL_RESERVE
    return np.asarray(is_next_to & (late | (approach_speed <= 0.0)))


def _linear_membership(value: FloatArray, safe: FloatArray, unsafe: FloatArray) -> FloatArray:
    """Return a fuzzy membership: 0 for a value of `safe` or more, 1 below `unsafe`, linear in between."""
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (value - safe) / (unsafe - safe)
    return np.where(value >= safe, 0.0, np.where(value < unsafe, 1.0, share))
