"""The reference drivers of UN Regulation No. 157: what they consider unsafe, and how they react.

They depend only on the relative motion along and across the path, whatever scenario or simulator it comes from.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.drivers.references.fuzzy import (
    COMFORTABLE,
    HARD,
    OF_THE_OTHER,
    REACTION_TIME,
    SAFETY_MARGIN,
    critical_metric,
    passes_clear,
    proactive_metric,
)

GRAVITY: Final = 9.81
"""m/s²."""

FULL_BRAKING: Final = 0.774 * GRAVITY
"""m/s²; UN Regulation No. 157, Annex 4, Appendix 3."""

JERK: Final = 12.65
"""m/s³; reaches full braking within 0.6 s."""

URGENT: Final = 2.0
"""Time to collision in s at or below which the careful and competent human brakes for a cut-in."""

HUMAN_HEADWAY: Final = 2.0
"""Time headway in s of the careful and competent human."""

RSS_TIME, RSS_ACCELERATION, RSS_BRAKING = 0.75, 3.0, 6.0
"""Response time in s, acceleration during it and braking after it in m/s², of Responsibility-Sensitive Safety."""

# Lateral Responsibility-Sensitive Safety: margin in m, acceleration and braking in m/s².
_RSS_MARGIN, _RSS_ASIDE = 0.3, 1.0
# Regulation 5.2.5.2: lateral gap in m at which a cut-in starts, braking in m/s², times in s.
_CUTTING_IN, _BRAKING_157, _DELAY_157, _RESERVE_157 = 0.5, 6.0, 0.35, 0.1
# Deceleration in m/s² of the careful and competent human with its foot off the accelerator, before it brakes.
_ENGINE_BRAKING = 0.4
# Rounding errors must not extend the delay by one step.
_HAIR = 1e-9


class View(NamedTuple):
    """Motion of others relative to the path of a driver; arrays of equal shape.

    `gap` and `lateral_gap`: m between the boxes along and across the path; `gap` is negative if the other is beside or
    behind, `lateral_gap` if they overlap. `approach_speed`: speed of the other towards the path in m/s. `speed`,
    `other_speed`: m/s along the path. `acceleration`: of the driver in m/s². `total_length`: both box lengths together
    in m. `was_ahead`: the other has been in the corridor since it was first seen, or entered it early enough not to be
    a cut-in.
    """

    gap: FloatArray
    lateral_gap: FloatArray
    inward: FloatArray
    speed: FloatArray
    other_speed: FloatArray
    acceleration: FloatArray
    lengths: FloatArray
    ahead: BoolArray


class Alarm(NamedTuple):
    """Assessment of a `RelativeMotion` by a reference driver; arrays of the same shape.

    `deceleration`: wanted once it brakes, in m/s². `proactive`, `critical`: fuzzy metrics; 0 for other models than
    `fsm`.
    """

    unsafe: BoolArray
    deceleration: FloatArray
    proactive: FloatArray
    critical: FloatArray


@dataclass(frozen=True)
class Reference:
    """A reference driver.

    `assess` assesses a `RelativeMotion`. `following_gap` gives the gap in m at which it follows a leader of equal speed
    in m/s. `delay`: s from the first unsafe instant to braking; `delayed_deceleration`: m/s² meanwhile; `jerk`: m/s³.
    """

    title: str
    judge: Callable[[View], Alarm]
    following: Callable[[FloatArray], FloatArray]
    delay: float
    delayed_deceleration: float = 0.0
    jerk: float = JERK


class Reaction:
    """Progress of a reference driver's reaction in a number of runs.

    The delay starts at the first unsafe instant, elapses in unsafe instants only, and never restarts. While it is safe
    again, the speed is kept. `reacted`: whether it ever was unsafe, shape (N,).
    """

    def __init__(self, reference: Reference, runs: int) -> None:
        self._reference = reference
        self._delay = np.full(runs, reference.delay)
        self._braking = np.zeros(runs)
        self.reacted = np.zeros(runs, dtype=np.bool_)

    def acceleration(self, unsafe: BoolArray, deceleration: FloatArray, time_step: float) -> FloatArray:
        """Advance by a time step; return the acceleration in m/s², 0 if it is safe.

        `deceleration` in m/s² is what the driver wants once it brakes. Safe runs do not change.
        """
        model = self._reference
        brakes = unsafe & (self._delay <= _HAIR)
        waits = unsafe & ~brakes
        self.reacted |= unsafe
        self._delay[waits] -= time_step
        risen = np.minimum(self._braking + model.jerk * time_step, deceleration)
        self._braking[brakes] = risen[brakes]
        return np.where(brakes, -self._braking, np.where(waits, -model.delayed_deceleration, 0.0))


def rss_distance(speed: FloatArray, other_speed: FloatArray) -> FloatArray:
    """Safe longitudinal distance in m of Responsibility-Sensitive Safety, for the same direction.

    v τ + a τ²/2 + (v + a τ)²/(2 b) - v_other²/(2 b), with τ 0.75 s, a 3 m/s² and b 6 m/s². Shalev-Shwartz, Shammah,
    Shashua, On a Formal Model of Safe and Scalable Self-driving Cars, 2017, Definition 1.
    """
    risen = speed + RSS_ACCELERATION * RSS_TIME
    meanwhile = speed * RSS_TIME + RSS_ACCELERATION * RSS_TIME**2 / 2.0
    return np.asarray(meanwhile + risen**2 / (2.0 * RSS_BRAKING) - other_speed**2 / (2.0 * RSS_BRAKING))


def rss_lateral_distance(inward: FloatArray) -> FloatArray:
    """Safe lateral distance in m of Responsibility-Sensitive Safety, for a driver that keeps its path.

    0.3 + (2 u + a τ) τ/2 + (u + a τ)²/(2 a), with the other's speed towards the path u, τ 0.75 s and a 1 m/s².
    Shalev-Shwartz, Shammah, Shashua (2017), Definition 6.
    """
    risen = inward + _RSS_ASIDE * RSS_TIME
    return _RSS_MARGIN + (inward + risen) * RSS_TIME / 2.0 + risen**2 / (2.0 * _RSS_ASIDE)


def time_to_collision(view: View) -> FloatArray:
    """Time in s until the gap closes at constant speeds; infinite if it does not."""
    closing = view.speed - view.other_speed
    closes = (closing > 0.0) & (view.gap > 0.0)
    return np.where(closes, view.gap / np.where(closes, closing, 1.0), np.inf)


def _human_judges(view: View) -> Alarm:
    in_the_way = (view.lateral_gap < 0.0) & (view.gap > 0.0)
    urgent = time_to_collision(view) <= URGENT
    return _alarm(in_the_way & (urgent | (view.ahead & (view.speed > view.other_speed))), FULL_BRAKING)


def _rss_judges(view: View) -> Alarm:
    # The driver is behind until its centre has passed the other's.
    is_behind = view.gap + 0.5 * view.lengths > 0.0
    is_near = view.gap < np.maximum(rss_distance(view.speed, np.maximum(view.other_speed, 0.0)), 0.0)
    is_laterally_near = view.lateral_gap < rss_lateral_distance(np.maximum(view.inward, 0.0))
    return _alarm(is_behind & is_near & is_laterally_near, FULL_BRAKING)


def _regulation_judges(view: View) -> Alarm:
    min_time = (view.speed - view.other_speed) / (2.0 * _BRAKING_157) + _DELAY_157 + _RESERVE_157
    return _alarm((view.lateral_gap <= _CUTTING_IN) & (time_to_collision(view) <= min_time), _BRAKING_157)


def _fuzzy_judges(view: View) -> Alarm:
    closing, other_speed = view.speed - view.other_speed, np.maximum(view.other_speed, 0.0)
    is_clear = passes_clear(view.gap, view.lateral_gap, view.inward, closing, view.lengths) | (view.gap <= 0.0)
    proactive = np.where(is_clear, 0.0, proactive_metric(view.gap, view.speed, other_speed))
    critical = np.where(is_clear, 0.0, critical_metric(view.gap, view.speed, other_speed, view.acceleration))
    deceleration = np.where(critical > 0.0, critical * (HARD - COMFORTABLE) + COMFORTABLE, proactive * COMFORTABLE)
    return Alarm(proactive + critical > 0.0, deceleration, proactive, critical)


def _alarm(unsafe: BoolArray, deceleration: float) -> Alarm:
    zeros = np.zeros(unsafe.shape)
    return Alarm(unsafe, zeros + deceleration, zeros, zeros)


def _human_follows(speed: FloatArray) -> FloatArray:
    return HUMAN_HEADWAY * speed


def _fuzzy_follows(speed: FloatArray) -> FloatArray:
    """Gap that is just safe if the leader brakes as hard as it can, with both margins."""
    stops, other_stops = speed**2 / (2.0 * COMFORTABLE), speed**2 / (2.0 * OF_THE_OTHER)
    return np.asarray(speed * REACTION_TIME + stops - other_stops + 2.0 * SAFETY_MARGIN)


def _rss_follows(speed: FloatArray) -> FloatArray:
    """Gap that is still safe if the leader brakes during the response time."""
    braked = np.maximum(speed - RSS_BRAKING * RSS_TIME, 0.0)
    return RSS_BRAKING * RSS_TIME**2 / 2.0 + rss_distance(speed, braked)


REFERENCES: Final[Mapping[str, Reference]] = MappingProxyType(
    {
        "cc-human": Reference("careful and competent human", _human_judges, _human_follows, 0.75, _ENGINE_BRAKING),
        "fsm": Reference("fuzzy safety model", _fuzzy_judges, _fuzzy_follows, REACTION_TIME),
        "rss": Reference("Responsibility-Sensitive Safety", _rss_judges, _rss_follows, RSS_TIME),
        "reg157": Reference("reaction time of 5.2.5.2", _regulation_judges, _human_follows, _DELAY_157, jerk=np.inf),
    }
)
"""The reference drivers by name."""
