"""The fuzzy surrogate safety metrics of Mattas et al. (2020), by which the fuzzy safety model brakes."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray

REACTION_TIME: Final = 0.75
"""s."""

COMFORTABLE, HARD, OF_THE_OTHER = 4.0, 6.0, 7.0
"""Decelerations in m/s²: of the driver, comfortable and hard, and of the one ahead."""

SAFETY_MARGIN: Final = 2.0
"""m, both from the one ahead at rest and of the comfortable distance."""

_LATERAL_RESERVE = 0.1


def proactive_metric(gap: FloatArray, speed: FloatArray, other_speed: FloatArray) -> FloatArray:
    """Proactive fuzzy surrogate safety metric (PFS), for one ahead that brakes hard.

    Parameters
    ----------
    gap : ndarray of float64, shape (...)
        m between the boxes along the path.
    speed, other_speed : ndarray of float64, shape (...)
        m/s along the path, of the driver and of the one ahead.

    Returns
    -------
    ndarray of float64, shape (...)
        From 0, where comfortable braking is enough, to 1, where hard braking is not.

    References
    ----------
    Mattas et al., Fuzzy Surrogate Safety Metrics for real-time assessment of rear-end collision risk, Accident Analysis
    & Prevention 148 (2020) 105794.
    """
    room = gap - SAFETY_MARGIN
    lead = other_speed**2 / (2.0 * OF_THE_OTHER)
    safe = speed * REACTION_TIME + speed**2 / (2.0 * COMFORTABLE) - lead + SAFETY_MARGIN
    unsafe = speed * REACTION_TIME + speed**2 / (2.0 * HARD) - lead
    return _between(room, safe, unsafe)


def critical_metric(
    gap: FloatArray, speed: FloatArray, other_speed: FloatArray, acceleration: FloatArray
) -> FloatArray:
    """Critical fuzzy surrogate safety metric (CFS), for one ahead that keeps its speed.

    Parameters
    ----------
    gap : ndarray of float64, shape (...)
        m between the boxes along the path.
    speed, other_speed : ndarray of float64, shape (...)
        m/s along the path, of the driver and of the one ahead.
    acceleration : ndarray of float64, shape (...)
        Of the driver in m/s², which it keeps for its reaction time; it counts down to -4.

    Returns
    -------
    ndarray of float64, shape (...)
        From 0, where comfortable braking after the reaction time is enough, to 1, where hard braking is not.

    References
    ----------
    Mattas et al. (2020), as in `proactive_metric`.
    """
    a = np.maximum(acceleration, -COMFORTABLE)
    closing, left = speed - other_speed, speed + a * REACTION_TIME - other_speed
    meanwhile = (speed + a * REACTION_TIME / 2.0 - other_speed) * REACTION_TIME
    with np.errstate(divide="ignore", invalid="ignore"):
        enough = gap >= closing**2 / np.abs(2.0 * a)
    braking = _between(gap, meanwhile + left**2 / (2.0 * COMFORTABLE), meanwhile + left**2 / (2.0 * HARD))
    return np.where(closing <= 0.0, 0.0, np.where(left < 0.0, np.where(enough, 0.0, 1.0), braking))


def passes_clear(
    gap: FloatArray, lateral_gap: FloatArray, inward: FloatArray, closing: FloatArray, lengths: FloatArray
) -> BoolArray:
    """Whether who comes in from the side comes too late to be met.

    Parameters
    ----------
    gap, lateral_gap : ndarray of float64, shape (...)
        m between the boxes along and across the path, negative where they overlap.
    inward : ndarray of float64, shape (...)
        Speed of the other towards the path in m/s.
    closing : ndarray of float64, shape (...)
        Speed at which the gap closes in m/s.
    lengths : ndarray of float64, shape (...)
        m of both boxes together.

    Returns
    -------
    ndarray of bool, shape (...)
        It is beside, and either does not come in, or takes longer for it than the driver to pass it, and 0.1 s more.

    References
    ----------
    UN Regulation No. 157, 01 series of amendments, Annex 3, Appendix 3: lateral safety check of performance model 2.
    """
    beside = lateral_gap > 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        late = lateral_gap / inward > (gap + lengths) / closing + _LATERAL_RESERVE
    return np.asarray(beside & (late | (inward <= 0.0)))


def _between(value: FloatArray, safe: FloatArray, unsafe: FloatArray) -> FloatArray:
    """0 from `safe` on, 1 below `unsafe`, linear between."""
    with np.errstate(divide="ignore", invalid="ignore"):
        part = (value - safe) / (unsafe - safe)
    return np.where(value >= safe, 0.0, np.where(value < unsafe, 1.0, part))
