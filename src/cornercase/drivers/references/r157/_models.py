"""Models of the reference drivers of UN Regulation No. 157: which motion is unsafe, and how the driver reacts.

The models depend only on the relative motion along and across the path, not on the scenario or the simulator.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.drivers.references.r157._fuzzy_metrics import (
    COMFORTABLE_DECELERATION,
    HARD_DECELERATION,
    OTHER_DECELERATION,
    REACTION_TIME,
    SAFETY_MARGIN,
    critical_metric,
    is_laterally_safe,
    proactive_metric,
)

GRAVITY: Final = 9.81
"""Gravitational acceleration in m/s²."""

FULL_BRAKING: Final = 0.774 * GRAVITY
"""Deceleration of full braking in m/s²; UN Regulation No. 157, Annex 4, Appendix 3."""

JERK: Final = 12.65
"""Jerk of a brake application in m/s³; full braking is reached within 0.6 s."""

URGENT_TIME_TO_COLLISION: Final = 2.0
"""Time to collision in s at or below which the careful and competent human brakes for a cut-in."""

HUMAN_HEADWAY: Final = 2.0
"""Time headway in s of the careful and competent human."""

RSS_TIME, RSS_ACCELERATION, RSS_BRAKING = 0.75, 3.0, 6.0
"""Response time in s, acceleration during it and braking after it in m/s², of Responsibility-Sensitive Safety."""

# Lateral Responsibility-Sensitive Safety: margin in m, acceleration and braking in m/s².
_RSS_MARGIN, _RSS_LATERAL_ACCELERATION = 0.3, 1.0
# Regulation 5.2.5.2: lateral gap in m at which a cut-in starts, braking in m/s², times in s.
_CUT_IN_LATERAL_GAP, _DECELERATION_157, _DELAY_157, _RESERVE_157 = 0.5, 6.0, 0.35, 0.1
# Deceleration in m/s² of the careful and competent human with its foot off the accelerator, before it brakes.
_ENGINE_BRAKING = 0.4
# Rounding errors must not extend the delay by one step.
_TOLERANCE = 1e-9


class RelativeMotion(NamedTuple):
    """Motion of other entities relative to the path of a driver; arrays of equal shape.

    `gap` and `lateral_gap`: gap in m between the boxes along and across the path. `gap` is negative if the other is
    beside or behind, `lateral_gap` if the boxes overlap laterally. `approach_speed`: speed of the other towards the
    path in m/s. `speed` and `other_speed`: speeds of driver and other along the path in m/s. `acceleration`:
    acceleration of the driver in m/s². `total_length`: sum of the lengths of both boxes along the path in m.
    `was_ahead`: True if the driver approaches an entity that has been in the driver's corridor since it was first seen,
    or that entered the corridor with a time to collision above 2 s.
    """

    gap: FloatArray
    lateral_gap: FloatArray
    approach_speed: FloatArray
    speed: FloatArray
    other_speed: FloatArray
    acceleration: FloatArray
    total_length: FloatArray
    was_ahead: BoolArray


class SafetyAssessment(NamedTuple):
    """Assessment of a `RelativeMotion` by a reference driver; arrays of the same shape.

    `unsafe`: whether the motion is unsafe for the driver. `deceleration`: deceleration in m/s² that the driver wants
    when it brakes. `proactive` and `critical`: fuzzy metrics; 0 unless the driver is ``fsm`` (fuzzy safety model).
    """

    unsafe: BoolArray
    deceleration: FloatArray
    proactive: FloatArray
    critical: FloatArray


@dataclass(frozen=True)
class ReferenceModel:
    """Model of a reference driver.

    `assess` assesses a `RelativeMotion`. `following_gap` returns the gap in m that the driver keeps to a leader of
    equal speed; its argument is this speed in m/s. `delay` is the time in s from the first unsafe instant to
    braking, and `delayed_deceleration` the deceleration in m/s² during the delay. `jerk` in m/s³ limits how fast the
    deceleration builds up.
    """

    title: str
    assess: Callable[[RelativeMotion], SafetyAssessment]
    following_gap: Callable[[FloatArray], FloatArray]
    delay: float
    delayed_deceleration: float = 0.0
    jerk: float = JERK


class BrakingReaction:
    """State of a reference driver's reaction in N simulated scenarios: a delay, then braking.

    The delay begins at the first unsafe instant. The delay stands still while the situation is safe, and never
    restarts. When the situation is safe again, the driver keeps its speed. `reacted` (N,) is True if at least one
    instant so far was unsafe; `delay` (N,) is the time in s that is left of the delay.
    """

    def __init__(self, reference: ReferenceModel, runs: int) -> None:
        self._reference = reference
        self.delay = np.full(runs, reference.delay)
        self._braking = np.zeros(runs)
        self.reacted = np.zeros(runs, dtype=np.bool_)

    def acceleration(self, unsafe: BoolArray, deceleration: FloatArray, time_step: float) -> FloatArray:
        """Advance by a time step; return the acceleration in m/s², which is 0 in scenarios that are not `unsafe`.

        `deceleration` is the deceleration in m/s² that the driver wants when it brakes. The state does not change in
        scenarios that are not `unsafe`.
        """
        model = self._reference
        brakes = unsafe & (self.delay <= _TOLERANCE)
        waits = unsafe & ~brakes
        self.reacted |= unsafe
        self.delay[waits] -= time_step
        risen = np.minimum(self._braking + model.jerk * time_step, deceleration)
        self._braking[brakes] = risen[brakes]
        return np.where(brakes, -self._braking, np.where(waits, -model.delayed_deceleration, 0.0))


def rss_longitudinal_distance(speed: FloatArray, other_speed: FloatArray) -> FloatArray:
    """Return the safe distance in m of Responsibility-Sensitive Safety for two vehicles in the same direction.

    v τ + a τ²/2 + (v + a τ)²/(2 b) - v_other²/(2 b), with v = `speed` and v_other = `other_speed` in m/s, τ = 0.75 s,
    a = 3 m/s² and b = 6 m/s². Shalev-Shwartz, Shammah, Shashua, On a Formal Model of Safe and Scalable Self-driving
    Cars, 2017, Definition 1.
    """
    risen = speed + RSS_ACCELERATION * RSS_TIME
    meanwhile = speed * RSS_TIME + RSS_ACCELERATION * RSS_TIME**2 / 2.0
    return np.asarray(meanwhile + risen**2 / (2.0 * RSS_BRAKING) - other_speed**2 / (2.0 * RSS_BRAKING))


def rss_lateral_distance(approach_speed: FloatArray) -> FloatArray:
    """Return the safe lateral distance in m of Responsibility-Sensitive Safety, for a driver that keeps its path.

    0.3 + (2 u + a τ) τ/2 + (u + a τ)²/(2 a), with the other's speed u = `approach_speed` towards the path in m/s,
    τ = 0.75 s and a = 1 m/s². Shalev-Shwartz, Shammah, Shashua (2017), Definition 6.
    """
    risen = approach_speed + _RSS_LATERAL_ACCELERATION * RSS_TIME
    return _RSS_MARGIN + (approach_speed + risen) * RSS_TIME / 2.0 + risen**2 / (2.0 * _RSS_LATERAL_ACCELERATION)


def time_to_collision(motion: RelativeMotion) -> FloatArray:
    """Return the time in s until the gap closes at constant speeds; infinite if it does not close or is not above 0."""
    closing = motion.speed - motion.other_speed
    closes = (closing > 0.0) & (motion.gap > 0.0)
    return np.where(closes, motion.gap / np.where(closes, closing, 1.0), np.inf)


def min_avoidable_time_to_collision(closing_speed: float) -> float:
    """Return the smallest time to collision in s, when a vehicle cuts in, at which a collision has to be avoided.

    Δv / (2 · 6 m/s²) + 0.35 s, with Δv = `closing_speed` in m/s. UN Regulation No. 157, 5.2.5.2; (EU) 2022/1426 has the
    same condition.
    """
    return closing_speed / (2.0 * _DECELERATION_157) + _DELAY_157


def _assess_cc_human(motion: RelativeMotion) -> SafetyAssessment:
    is_on_path = (motion.lateral_gap < 0.0) & (motion.gap > 0.0)
    urgent = time_to_collision(motion) <= URGENT_TIME_TO_COLLISION
    return _make_assessment(
        is_on_path & (urgent | (motion.was_ahead & (motion.speed > motion.other_speed))), FULL_BRAKING
    )


def _assess_rss(motion: RelativeMotion) -> SafetyAssessment:
    # The driver is behind until its centre has passed the other's.
    is_behind = motion.gap + 0.5 * motion.total_length > 0.0
    is_near = motion.gap < np.maximum(rss_longitudinal_distance(motion.speed, np.maximum(motion.other_speed, 0.0)), 0.0)
    is_laterally_near = motion.lateral_gap < rss_lateral_distance(np.maximum(motion.approach_speed, 0.0))
    return _make_assessment(is_behind & is_near & is_laterally_near, FULL_BRAKING)


def _assess_reg157(motion: RelativeMotion) -> SafetyAssessment:
    min_time = (motion.speed - motion.other_speed) / (2.0 * _DECELERATION_157) + _DELAY_157 + _RESERVE_157
    return _make_assessment(
        (motion.lateral_gap <= _CUT_IN_LATERAL_GAP) & (time_to_collision(motion) <= min_time), _DECELERATION_157
    )


def _assess_fsm(motion: RelativeMotion) -> SafetyAssessment:
    closing, other_speed = motion.speed - motion.other_speed, np.maximum(motion.other_speed, 0.0)
    is_clear = is_laterally_safe(
        motion.gap, motion.lateral_gap, motion.approach_speed, closing, motion.total_length
    ) | (motion.gap <= 0.0)
    proactive = np.where(is_clear, 0.0, proactive_metric(motion.gap, motion.speed, other_speed))
    critical = np.where(is_clear, 0.0, critical_metric(motion.gap, motion.speed, other_speed, motion.acceleration))
    deceleration = np.where(
        critical > 0.0,
        critical * (HARD_DECELERATION - COMFORTABLE_DECELERATION) + COMFORTABLE_DECELERATION,
        proactive * COMFORTABLE_DECELERATION,
    )
    return SafetyAssessment(proactive + critical > 0.0, deceleration, proactive, critical)


def _make_assessment(unsafe: BoolArray, deceleration: float) -> SafetyAssessment:
    zeros = np.zeros(unsafe.shape)
    return SafetyAssessment(unsafe, zeros + deceleration, zeros, zeros)


def _cc_human_following_gap(speed: FloatArray) -> FloatArray:
    return HUMAN_HEADWAY * speed


def _fsm_following_gap(speed: FloatArray) -> FloatArray:
    """Return the smallest gap in m to a leader of equal speed that is safe if the leader brakes hard.

    Two margins of 2 m are added: the gap at rest, and the margin of the comfortable distance.
    """
    stops, other_stops = speed**2 / (2.0 * COMFORTABLE_DECELERATION), speed**2 / (2.0 * OTHER_DECELERATION)
    return np.asarray(speed * REACTION_TIME + stops - other_stops + 2.0 * SAFETY_MARGIN)


def _rss_following_gap(speed: FloatArray) -> FloatArray:
    """Return the smallest gap in m that is safe if the leader brakes during the driver's response time."""
    braked = np.maximum(speed - RSS_BRAKING * RSS_TIME, 0.0)
    return RSS_BRAKING * RSS_TIME**2 / 2.0 + rss_longitudinal_distance(speed, braked)


REFERENCES: Final[Mapping[str, ReferenceModel]] = MappingProxyType(
    {
        "cc-human": ReferenceModel(
            "careful and competent human", _assess_cc_human, _cc_human_following_gap, 0.75, _ENGINE_BRAKING
        ),
        "fsm": ReferenceModel("fuzzy safety model", _assess_fsm, _fsm_following_gap, REACTION_TIME),
        "rss": ReferenceModel("Responsibility-Sensitive Safety", _assess_rss, _rss_following_gap, RSS_TIME),
        "reg157": ReferenceModel(
            "reaction time of 5.2.5.2", _assess_reg157, _cc_human_following_gap, _DELAY_157, jerk=np.inf
        ),
    }
)
"""The reference drivers by name."""
