"""Reference drivers in the three scenarios of UN Regulation No. 157, simulated at 10 Hz without a scenario file."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.drivers.references.r157._models import (
    GRAVITY,
    REFERENCES,
    URGENT_TIME_TO_COLLISION,
    BrakingReaction,
    RelativeMotion,
    time_to_collision,
)

TIME_STEP: Final = 0.1
"""Time step in s."""

MAX_STEPS: Final = 350
"""Maximum number of time steps of a run."""

LENGTH, WIDTH = 4.3, 1.9
"""Length and width of a car in m."""

STANDING_LENGTH: Final = 5.0
"""Length in m of the standing car in a cut-out."""

LANE: Final = 3.5
"""Lane width in m."""

WANDERING: Final = 0.375
"""Offset in m from the lane centre from which a car cuts in or out; UN Regulation No. 157, Annex 4, Appendix 3."""

# Increase of the lateral speed in m/s per time step, at 1.5 m/s².
_LATERAL_SPEED_STEP = 0.15


class EncounterOutcome(NamedTuple):
    """Results of N simulated encounters of a reference driver with another car.

    Attributes
    ----------
    crash : ndarray of bool, shape (N,)
        True if the ego touches another vehicle.
    proactive, critical : ndarray of float64, shape (N,)
        Fuzzy surrogate safety metrics of the driver ``fsm``; 0 for other drivers. In cut-ins and decelerations, the
        largest values before a crash. In cut-outs, the values with respect to the standing car at the instant when
        the car ahead leaves the middle of its lane; 0 if the car ahead crashes.
    gap : ndarray of float64, shape (N,)
        Initial gap in m to the car ahead.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase.drivers import drive_deceleration
    >>> outcome = drive_deceleration("fsm", np.array([20.0, 30.0]), np.array([0.3, 0.9]))
    >>> outcome.crash, outcome.critical.round(2), outcome.gap
    (array([False, False]), array([0., 1.]), array([40.42857143, 74.71428571]))
    """

    crash: BoolArray
    proactive: FloatArray
    critical: FloatArray
    gap: FloatArray


def drive_cut_in(
    name: str, speed: FloatArray, other_speed: FloatArray, gap: FloatArray, lateral_speed: FloatArray
) -> EncounterOutcome:
    """Simulate a reference driver while a car cuts in from the next lane.

    The other car moves from the middle of the next lane to the middle of the ego's lane at a constant lateral speed.
    To reach this speed in the middle of the next lane, the other car accelerates laterally before, with 1.5 m/s².

    Parameters
    ----------
    name : str
        Name of a reference driver.
    speed, other_speed : ndarray of float64, shape (N,)
        Initial speed of the ego, and speed of the other car, in m/s.
    gap : ndarray of float64, shape (N,)
        Bumper-to-bumper gap in m when the other car has just reached its lateral speed, in the middle of the next lane.
    lateral_speed : ndarray of float64, shape (N,)
        Final lateral speed of the other car in m/s.

    Returns
    -------
    EncounterOutcome
        A run of ``cc-human`` ends without a crash if the time to collision at the cut-in is above 2 s.

    References
    ----------
    UN Regulation No. 157, Annex 4, Appendix 3.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase.drivers import drive_cut_in
    >>> ego, other, gap = np.full(2, 20.0), np.full(2, 15.0), np.array([30.0, 5.0])
    >>> drive_cut_in("cc-human", ego, other, gap, lateral_speed=np.ones(2)).crash
    array([False,  True])
    """
    reference, n = REFERENCES[name], len(speed)
    rising, ramp_distance = _lateral_ramp(lateral_speed)
    x, v, a = np.zeros(n), speed.copy(), np.zeros(n)
    other_x = gap + LENGTH + (speed - other_speed) * TIME_STEP * rising.sum(axis=0)
    lateral_distance = LANE + ramp_distance
    reaction, false = BrakingReaction(reference, n), np.zeros(n, dtype=np.bool_)
    crash, over, intruded = false.copy(), false.copy(), false.copy()
    proactive, critical, start = np.zeros(n), np.zeros(n), other_x - LENGTH
    for i in range(MAX_STEPS):
        current_lateral_speed = (
            np.where(rising[i], i * _LATERAL_SPEED_STEP, lateral_speed) if i < len(rising) else lateral_speed
        )
        current_lateral_speed = np.where(lateral_distance <= 0.0, 0.0, current_lateral_speed)
        touches = (np.abs(other_x - x) < LENGTH) & (np.abs(lateral_distance) < WIDTH) & ~over
        crash, over = crash | touches, over | touches
        current_gap = (other_x - LENGTH / 2) - (x + LENGTH / 2)
        view = RelativeMotion(
            current_gap,
            lateral_distance - WIDTH,
            current_lateral_speed,
            v,
            other_speed,
            a,
            np.full(n, 2 * LENGTH),
            false,
        )
        if name == "cc-human":
            begins = (view.lateral_gap < 0.0) & ~intruded
            intruded |= begins
            over |= begins & (time_to_collision(view) > URGENT_TIME_TO_COLLISION)
        assessment = reference.assess(view)
        proactive = np.where(over, proactive, np.maximum(proactive, assessment.proactive))
        critical = np.where(over, critical, np.maximum(critical, assessment.critical))
        v, a = _speed_after_step(v, reaction.acceleration(assessment.unsafe, assessment.deceleration, TIME_STEP))
        x, other_x, lateral_distance = (
            x + v * TIME_STEP,
            other_x + other_speed * TIME_STEP,
            lateral_distance - current_lateral_speed * TIME_STEP,
        )
    return EncounterOutcome(crash, proactive, critical, start)


def drive_cut_out(name: str, speed: FloatArray, front_gap: FloatArray, lateral_speed: FloatArray) -> EncounterOutcome:
    """Simulate a reference driver behind a car that leaves the lane in front of a standing car.

    A car that cuts out and hits the standing car stops immediately.

    Parameters
    ----------
    name : str
        Name of a reference driver.
    speed : ndarray of float64, shape (N,)
        Speed in m/s of the ego and of the car that it follows.
    front_gap : ndarray of float64, shape (N,)
        Initial gap in m from the followed car to the standing car, defined for a standing car of 4.3 m length. The
        simulated standing car has the same centre, but is 5 m long.
    lateral_speed : ndarray of float64, shape (N,)
        Lateral speed in m/s of the car that cuts out, constant from the first instant.

    Returns
    -------
    EncounterOutcome
        Results by encounter.

    References
    ----------
    UN Regulation No. 157, Annex 4, Appendix 3.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase.drivers import drive_cut_out
    >>> speed, front_gap = np.full(2, 30.0), np.array([20.0, 60.0])
    >>> drive_cut_out("cc-human", speed, front_gap, lateral_speed=np.ones(2)).crash
    array([ True, False])
    """
    reference, n = REFERENCES[name], len(speed)
    start = reference.following_gap(speed)
    x, v, a, other_v, none = np.zeros(n), speed.copy(), np.zeros(n), speed.copy(), np.zeros(n)
    other_x, lateral_distance = start + LENGTH, np.zeros(n)
    # The gap is defined for a car of the usual length; the standing car is longer.
    standing_x, half = other_x + LENGTH + front_gap, (LENGTH + STANDING_LENGTH) / 2
    always, in_lane = np.ones(n, dtype=np.bool_), np.full(n, -WIDTH)
    reaction, crash, hit, is_recorded = BrakingReaction(reference, n), ~always, ~always, ~always
    proactive, critical = np.zeros(n), np.zeros(n)
    for _ in range(MAX_STEPS):
        hit = hit | ((standing_x - other_x < half) & (lateral_distance < WIDTH))
        crash = crash | (standing_x - x < half) | (hit & (other_x - x < LENGTH) & (lateral_distance < WIDTH))
        other_v = np.where(hit, 0.0, other_v)
        leaves = (lateral_distance > WANDERING) | hit
        lengths = np.full(n, 2 * half)
        view = RelativeMotion(
            (standing_x - STANDING_LENGTH / 2) - (x + LENGTH / 2), in_lane, none, v, none, a, lengths, always
        )
        to_standing = reference.assess(view)
        gap = (other_x - LENGTH / 2) - (x + LENGTH / 2)
        view = RelativeMotion(gap, lateral_distance - WIDTH, none, v, other_v, a, np.full(n, 2 * LENGTH), always)
        to_other = reference.assess(view)
        first = leaves & ~is_recorded & ~hit
        proactive[first], critical[first] = to_standing.proactive[first], to_standing.critical[first]
        is_recorded |= leaves
        unsafe = np.where(hit, to_other.unsafe, to_standing.unsafe & leaves)
        deceleration = np.where(hit, to_other.deceleration, to_standing.deceleration)
        v, a = _speed_after_step(v, reaction.acceleration(unsafe, deceleration, TIME_STEP))
        x, other_x = x + v * TIME_STEP, other_x + other_v * TIME_STEP
        lateral_distance = lateral_distance + np.where(hit, 0.0, lateral_speed) * TIME_STEP
    return EncounterOutcome(crash, np.where(hit, 0.0, proactive), np.where(hit, 0.0, critical), start)


def drive_deceleration(name: str, speed: FloatArray, deceleration: FloatArray) -> EncounterOutcome:
    """Simulate a reference driver behind a car that brakes at a constant rate to a standstill.

    The run ends after 34.9 s at the latest.

    Parameters
    ----------
    name : str
        Name of a reference driver.
    speed : ndarray of float64, shape (N,)
        Initial speed in m/s of both cars.
    deceleration : ndarray of float64, shape (N,)
        Deceleration of the car ahead, in units of 9.81 m/s².

    Returns
    -------
    EncounterOutcome
        Results by encounter.

    References
    ----------
    UN Regulation No. 157, Annex 4, Appendix 3.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase.drivers import drive_deceleration
    >>> drive_deceleration("rss", np.full(2, 30.0), deceleration=np.array([0.5, 1.0])).crash
    array([False,  True])
    """
    reference, n = REFERENCES[name], len(speed)
    start = reference.following_gap(speed)
    x, v, a, other_x, other_v = np.zeros(n), speed.copy(), np.zeros(n), start + LENGTH, speed.copy()
    reaction, crash, always = BrakingReaction(reference, n), np.zeros(n, dtype=np.bool_), np.ones(n, dtype=np.bool_)
    proactive, critical = np.zeros(n), np.zeros(n)
    for _ in range(MAX_STEPS - 1):
        crash = crash | (other_x - x < LENGTH)
        gap = (other_x - LENGTH / 2) - (x + LENGTH / 2)
        view = RelativeMotion(gap, np.full(n, -WIDTH), np.zeros(n), v, other_v, a, np.full(n, 2 * LENGTH), always)
        assessment = reference.assess(view)
        proactive = np.where(crash, proactive, np.maximum(proactive, assessment.proactive))
        critical = np.where(crash, critical, np.maximum(critical, assessment.critical))
        v, a = _speed_after_step(v, reaction.acceleration(assessment.unsafe, assessment.deceleration, TIME_STEP))
        other_v = np.maximum(other_v - deceleration * GRAVITY * TIME_STEP, 0.0)
        x, other_x = x + v * TIME_STEP, other_x + other_v * TIME_STEP
    return EncounterOutcome(crash, proactive, critical, start)


def _lateral_ramp(lateral_speed: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Return how a car reaches its lateral speed: a mask of the time steps in which the speed rises, (steps, N).

    The second result is the lateral distance in m that the car covers in these time steps, (N,).
    """
    steps = np.ceil(lateral_speed / _LATERAL_SPEED_STEP)
    instants = np.arange(max(int(steps.max(initial=0.0)), 1))[:, None]
    rising = instants < steps
    return rising, (rising * instants).sum(axis=0) * _LATERAL_SPEED_STEP * TIME_STEP


def _speed_after_step(speed: FloatArray, acceleration: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the speed after a time step, at least 0, and the acceleration that leads to it."""
    risen = np.maximum(speed + acceleration * TIME_STEP, 0.0)
    return risen, (risen - speed) / TIME_STEP
