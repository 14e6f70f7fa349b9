"""Metric of responsibility-sensitive safety (RSS), and its least safe gaps."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.typing import FloatArray
from cornercase.metrics._base import Metric
from cornercase.metrics._geometry.boxes import box_corners_over_time, velocity_vectors
from cornercase.metrics._geometry.numeric import check_nonnegative_options
from cornercase.recordings import Recording

Term = Literal["both", "longitudinal", "lateral"]


class Rss(Metric):
    """Distance by which the ego keeps, or violates, the minimum gap of responsibility-sensitive safety.

    The gap between the boxes, along and across the ego's heading, is compared with the minimum that lets both entities
    react and brake. The surplus is the gap less this minimum. If the lateral minimum is violated, the value in m is the
    longitudinal surplus, otherwise the larger surplus. So the value is below 0 exactly in a dangerous situation, in
    which both minima are violated. Lower is more critical.

    If both go in the same direction, with speeds v_r of the rear and v_f of the front entity, the rear one needs

        [v_r ρ + a ρ²/2 + (v_r + ρ a)² / (2 b_min) - v_f² / (2 b_max)]₊.

    The brackets [ ]₊ mean that a negative result counts as 0. If both come towards each other, the minimum is the sum
    of the distances in which each accelerates for the response time ρ and then brakes until it stands. Here the ego
    brakes with ``correct_braking`` and the other entity with ``min_braking``. Two standing entities need the distance
    in which one of them accelerates for ρ and then brakes. Across the heading, both drift towards each other for ρ and
    then brake. Not defined if one of the two does not exist. Least critical value (cap): 100 m. Most critical value:
    -500 m, which is also the score of a recording in which both touch.

    Source: S. Shalev-Shwartz, S. Shammah, A. Shashua, "On a formal model of safe and scalable self-driving cars",
    arXiv:1708.06374, definitions 1, 2, 6 and 8, in the frame of the ego instead of the lane.

    Parameters
    ----------
    response_time : float, default 1.0
        ρ in s.
    acceleration : float, default 3.5
        Greatest acceleration a during the response, in m/s².
    min_braking, max_braking : float, default 4.0 and 8.0
        Least deceleration b_min of a rear vehicle and greatest deceleration b_max of a front vehicle, in m/s².
    correct_braking : float, default 3.0
        Least deceleration of a vehicle on its own side that meets an oncoming vehicle, in m/s².
    lateral_acceleration, lateral_braking : float, default 0.2 and 0.8
        Greatest acceleration during the response, and least deceleration afterwards, across the heading in m/s².
    lateral_margin : float, default 0.1
        Margin μ for lateral fluctuations, in m.
    term : {"both", "longitudinal", "lateral"}, default "both"
        Surplus to give: the longitudinal or the lateral surplus alone, or by default their combination as above.

    Raises
    ------
    InputError
        A number is negative or not finite, a deceleration is 0, or `term` is none of the three.

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate("examples/r157/cut_out.xosc")
    >>> cc.measure(recording, "Ego", "Other", [cc.metrics.Rss()])
    metric  score   unit  critical is
    rss     -60.23  m     low
    """

    name = "rss"
    unit = "m"
    lower_is_critical = True
    cap = 100.0
    bound = contact_score = -500.0
    default_threshold = 0.0
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
        check_nonnegative_options(self.name, response_time=response_time, acceleration=acceleration)
        check_nonnegative_options(self.name, lateral_acceleration=lateral_acceleration, lateral_margin=lateral_margin)
        for braking in (min_braking, max_braking, correct_braking, lateral_braking):
            if not 0.0 < braking < np.inf:
                raise InputError(f"{self.name} cannot take a braking of {braking} m/s²; give a number above 0.")
        if term not in get_args(Term):
            raise InputError(f"{self.name} has no term '{term}'; {suggest_name(term, get_args(Term))}")
        self.response_time, self.acceleration = response_time, acceleration
        self.min_braking, self.max_braking, self.correct_braking = min_braking, max_braking, correct_braking
        self.lateral_acceleration, self.lateral_braking = lateral_acceleration, lateral_braking
        self.lateral_margin = lateral_margin
        self.term = term

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        heading = recording.heading[recording.entity_index(ego)]
        forward = np.stack([np.cos(heading), np.sin(heading)], -1)
        left = np.stack([-forward[:, 1], forward[:, 0]], -1)
        along = self._longitudinal_surplus(recording, ego, other, forward)
        across = self._lateral_surplus(recording, ego, other, left)
        both = np.where(across < 0.0, along, np.maximum(along, across))
        chosen = {"both": both, "longitudinal": along, "lateral": across}[self.term]
        return np.where(np.isnan(along + across), np.nan, chosen)

    def _longitudinal_surplus(self, recording: Recording, ego: str, other: str, axis: FloatArray) -> FloatArray:
        gap, ahead = _projected_gap(recording, ego, other, axis)
        ego_speed, other_speed = ((velocity_vectors(recording, name) * axis).sum(-1) for name in (ego, other))
        # Speeds are positive in the direction from the ego to the other.
        ego_speed, other_speed = np.where(ahead, ego_speed, -ego_speed), np.where(ahead, other_speed, -other_speed)
        rear = min_longitudinal_gap(
            np.maximum(ego_speed, 0.0),
            other_speed,
            self.response_time,
            self.acceleration,
            self.min_braking,
            self.max_braking,
        )
        front = min_longitudinal_gap(
            np.maximum(-other_speed, 0.0),
            -ego_speed,
            self.response_time,
            self.acceleration,
            self.min_braking,
            self.max_braking,
        )
        opposite = min_oncoming_gap(
            ego_speed, -other_speed, self.response_time, self.acceleration, self.correct_braking, self.min_braking
        )
        towards = (ego_speed >= 0.0) & (other_speed < 0.0)
        surplus: FloatArray = gap - np.where(towards, opposite, np.where(ego_speed >= 0.0, rear, front))
        return surplus

    def _lateral_surplus(self, recording: Recording, ego: str, other: str, axis: FloatArray) -> FloatArray:
        gap, is_left = _projected_gap(recording, ego, other, axis)
        ego_speed, other_speed = ((velocity_vectors(recording, name) * axis).sum(-1) for name in (ego, other))
        ego_speed, other_speed = np.where(is_left, ego_speed, -ego_speed), np.where(is_left, -other_speed, other_speed)
        minimum = min_lateral_gap(
            ego_speed,
            other_speed,
            self.response_time,
            self.lateral_acceleration,
            self.lateral_braking,
            self.lateral_margin,
        )
        return gap - minimum


def _projected_gap(
    recording: Recording, ego: str, other: str, axis: FloatArray
) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Return the gap between the boxes along `axis`, and whether the other entity lies in the direction of `axis`.

    The gap is negative if the projections of the boxes on the axis overlap.
    """
    a, b = ((box_corners_over_time(recording, name) * axis[:, None]).sum(-1) for name in (ego, other))
    positive = b.max(-1) + b.min(-1) >= a.max(-1) + a.min(-1)
    return np.where(positive, b.min(-1) - a.max(-1), a.min(-1) - b.max(-1)), positive


def min_longitudinal_gap(
    rear_speed: FloatArray,
    front_speed: FloatArray,
    response_time: float,
    acceleration: float,
    min_braking: float,
    max_braking: float,
) -> FloatArray:
    """Return the least safe gap in m if both go in the same direction (definition 1 of RSS).

    Speeds are in m/s; a negative speed of the front entity counts as 0.
    """
    response_speed = rear_speed + response_time * acceleration
    distance: FloatArray = (
        rear_speed * response_time + 0.5 * acceleration * response_time**2 + response_speed**2 / (2.0 * min_braking)
    )
    return np.maximum(distance - np.maximum(front_speed, 0.0) ** 2 / (2.0 * max_braking), 0.0)


def min_oncoming_gap(
    correct_side_speed: FloatArray,
    wrong_side_speed: FloatArray,
    response_time: float,
    acceleration: float,
    correct_braking: float,
    min_braking: float,
) -> FloatArray:
    """Return the least safe gap in m if both come towards each other (definition 2 of RSS).

    `correct_side_speed` is the speed of the vehicle on its own side of the road, `wrong_side_speed` is the speed of the
    other vehicle. Both are the speeds towards each other in m/s.
    """
    distance = np.zeros_like(correct_side_speed)
    for speed, braking in ((correct_side_speed, correct_braking), (wrong_side_speed, min_braking)):
        response_speed = speed + response_time * acceleration
        distance = distance + 0.5 * (speed + response_speed) * response_time + response_speed**2 / (2.0 * braking)
    return distance


def min_lateral_gap(
    ego_speed: FloatArray,
    other_speed: FloatArray,
    response_time: float,
    acceleration: float,
    braking: float,
    margin: float,
) -> FloatArray:
    """Return the least safe lateral gap in m (definition 6 of RSS).

    Both drift towards each other during the response, then brake. `ego_speed` and `other_speed` are the lateral speeds
    towards each other in m/s. The gap is at least `margin`.
    """
    distance = np.zeros_like(ego_speed)
    for speed in (ego_speed, other_speed):
        response_speed = speed + response_time * acceleration
        # An entity that still moves away afterwards increases the gap while it brakes.
        distance = (
            distance
            + 0.5 * (speed + response_speed) * response_time
            + response_speed * np.abs(response_speed) / (2.0 * braking)
        )
    minimum: FloatArray = margin + np.maximum(distance, 0.0)
    return minimum
