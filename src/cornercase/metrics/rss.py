"""Responsibility-sensitive safety."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from cornercase._common.errors import InputError, suggestion
from cornercase._common.typing import FloatArray
from cornercase.metrics._parts.boxes import boxes, velocity
from cornercase.metrics._parts.numbers import checked
from cornercase.metrics.base import Metric
from cornercase.recordings import Recording

Term = Literal["both", "longitudinal", "lateral"]


class Rss(Metric):
    """Distance by which the ego keeps, or falls short of, the minimum of responsibility-sensitive safety.

    Along and across the ego's heading the gap between the boxes is compared with the minimum that lets both
    react and brake. Where the lateral minimum is violated the value in m is the longitudinal surplus, elsewhere
    the larger of the two; so it is below 0 exactly in a dangerous situation, in which both minima are violated.
    Lower is more critical.

    Along the heading, of two that go the same way the rear one, with speed v_r, needs

        [v_r ρ + a ρ²/2 + (v_r + ρ a)² / (2 b_min) - v_f² / (2 b_max)]₊,

    two that come towards each other both need their way during ρ and until they stand, the ego with
    ``correct_braking`` and the other with ``min_braking`` (`longitudinal_minimum`, `opposite_minimum`); across
    it see `lateral_minimum`. Two that stand need what they may start in the time ρ. Not defined where one of
    the two does not exist. Cap: 100 m, most critical value: -500 m, which is the score of a recording in which both
    touch.

    Parameters
    ----------
    response_time : float, default 1.0
        ρ in s.
    acceleration : float, default 3.5
        Greatest acceleration a during the response, in m/s².
    min_braking, max_braking : float, default 4.0 and 8.0
        Deceleration that a rear vehicle keeps at least, and a front one at most, in m/s².
    correct_braking : float, default 3.0
        Least deceleration of one that is on its own side and meets an oncoming one, in m/s².
    lateral_acceleration, lateral_braking : float, default 0.2 and 0.8
        As above, across the heading, in m/s².
    lateral_margin : float, default 0.1
        Room for wavering μ, in m.
    term : {"both", "longitudinal", "lateral"}, default "both"
        Which surplus to give.

    Raises
    ------
    InputError
        An option is negative or not finite, or there is no such term.

    Notes
    -----
    Source: S. Shalev-Shwartz, S. Shammah, A. Shashua, "On a formal model of safe and scalable self-driving
    cars", arXiv:1708.06374, definitions 1, 2, 6 and 8, in the frame of the ego instead of the lane's.
    """

    name = "rss"
    unit = "m"
    lower_is_critical = True
    cap = 100.0
    most_critical = contact = -500.0
    critical = 0.0
    source = "Shalev-Shwartz et al. 2017, in the frame of the ego"

    def __init__(
        self,
        response_time: float = 1.0,
        acceleration: float = 3.5,
        min_braking: float = 4.0,
        max_braking: float = 8.0,
        correct_braking: float = 3.0,
        lateral_acceleration: float = 0.2,
        lateral_braking: float = 0.8,
        lateral_margin: float = 0.1,
        term: Term = "both",
    ) -> None:
        checked(self.name, response_time=response_time, acceleration=acceleration)
        checked(self.name, lateral_acceleration=lateral_acceleration, lateral_margin=lateral_margin)
        for braking in (min_braking, max_braking, correct_braking, lateral_braking):
            if not 0.0 < braking < np.inf:
                raise InputError(f"{self.name} cannot take a braking of {braking} m/s²; give one above 0.")
        if term not in get_args(Term):
            raise InputError(f"{self.name} has no term '{term}'; {suggestion(term, get_args(Term))}")
        self.response_time, self.acceleration = response_time, acceleration
        self.min_braking, self.max_braking, self.correct_braking = min_braking, max_braking, correct_braking
        self.lateral_acceleration, self.lateral_braking = lateral_acceleration, lateral_braking
        self.lateral_margin = lateral_margin
        self.term = term

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        heading = recording.heading[recording.index(ego)]
        forward = np.stack([np.cos(heading), np.sin(heading)], -1)
        left = np.stack([-forward[:, 1], forward[:, 0]], -1)
        along = self._along(recording, ego, other, forward)
        across = self._across(recording, ego, other, left)
        both = np.where(across < 0.0, along, np.maximum(along, across))
        chosen = {"both": both, "longitudinal": along, "lateral": across}[self.term]
        return np.where(np.isnan(along + across), np.nan, chosen)

    def _along(self, recording: Recording, ego: str, other: str, axis: FloatArray) -> FloatArray:
        gap, ahead = _gap(recording, ego, other, axis)
        mine, others = ((velocity(recording, name) * axis).sum(-1) for name in (ego, other))
        # Seen along the line from the ego to the other.
        mine, others = np.where(ahead, mine, -mine), np.where(ahead, others, -others)
        rear = longitudinal_minimum(
            np.maximum(mine, 0.0), others, self.response_time, self.acceleration, self.min_braking, self.max_braking
        )
        front = longitudinal_minimum(
            np.maximum(-others, 0.0), -mine, self.response_time, self.acceleration, self.min_braking, self.max_braking
        )
        opposite = opposite_minimum(
            mine, -others, self.response_time, self.acceleration, self.correct_braking, self.min_braking
        )
        towards = (mine >= 0.0) & (others < 0.0)
        surplus: FloatArray = gap - np.where(towards, opposite, np.where(mine >= 0.0, rear, front))
        return surplus

    def _across(self, recording: Recording, ego: str, other: str, axis: FloatArray) -> FloatArray:
        gap, is_left = _gap(recording, ego, other, axis)
        mine, others = ((velocity(recording, name) * axis).sum(-1) for name in (ego, other))
        mine, others = np.where(is_left, mine, -mine), np.where(is_left, -others, others)
        minimum = lateral_minimum(
            mine, others, self.response_time, self.lateral_acceleration, self.lateral_braking, self.lateral_margin
        )
        return gap - minimum


def _gap(recording: Recording, ego: str, other: str, axis: FloatArray) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Gap between the boxes' projections (negative where they overlap), and whether the other lies towards +."""
    a, b = ((boxes(recording, name) * axis[:, None]).sum(-1) for name in (ego, other))
    positive = b.max(-1) + b.min(-1) >= a.max(-1) + a.min(-1)
    return np.where(positive, b.min(-1) - a.max(-1), a.min(-1) - b.max(-1)), positive


def longitudinal_minimum(
    rear: FloatArray,
    front: FloatArray,
    response_time: float,
    acceleration: float,
    min_braking: float,
    max_braking: float,
) -> FloatArray:
    """Least safe gap of two that go the same way (definition 1).

    Parameters
    ----------
    rear, front : ndarray of float64, shape (...)
        Speeds in m/s; a negative one of the front counts as 0.
    response_time, acceleration, min_braking, max_braking : float
        As in `Rss`.

    Returns
    -------
    ndarray of float64, shape (...)
        m.
    """
    reached = rear + response_time * acceleration
    way: FloatArray = rear * response_time + 0.5 * acceleration * response_time**2 + reached**2 / (2.0 * min_braking)
    return np.maximum(way - np.maximum(front, 0.0) ** 2 / (2.0 * max_braking), 0.0)


def opposite_minimum(
    correct: FloatArray,
    wrong: FloatArray,
    response_time: float,
    acceleration: float,
    correct_braking: float,
    min_braking: float,
) -> FloatArray:
    """Least safe gap of two that come towards each other (definition 2).

    Parameters
    ----------
    correct, wrong : ndarray of float64, shape (...)
        Speeds towards each other in m/s, of the one on its own side and of the other.
    response_time, acceleration, correct_braking, min_braking : float
        As in `Rss`.

    Returns
    -------
    ndarray of float64, shape (...)
        m.
    """
    way = np.zeros_like(correct)
    for speed, braking in ((correct, correct_braking), (wrong, min_braking)):
        reached = speed + response_time * acceleration
        way = way + 0.5 * (speed + reached) * response_time + reached**2 / (2.0 * braking)
    return way


def lateral_minimum(
    one: FloatArray,
    two: FloatArray,
    response_time: float,
    acceleration: float,
    braking: float,
    margin: float,
) -> FloatArray:
    """Least safe lateral gap (definition 6): both drift towards each other during the response, then brake.

    Parameters
    ----------
    one, two : ndarray of float64, shape (...)
        Lateral speeds of both towards the other, in m/s.
    response_time : float
        s.
    acceleration, braking : float
        Lateral, in m/s².
    margin : float
        m.

    Returns
    -------
    ndarray of float64, shape (...)
        m, at least `margin`.
    """
    way = np.zeros_like(one)
    for speed in (one, two):
        reached = speed + response_time * acceleration
        # One that still moves away afterwards gives room while it brakes.
        way = way + 0.5 * (speed + reached) * response_time + reached * np.abs(reached) / (2.0 * braking)
    minimum: FloatArray = margin + np.maximum(way, 0.0)
    return minimum
