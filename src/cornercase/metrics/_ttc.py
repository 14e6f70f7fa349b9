"""Metric of the time to collision."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from cornercase._common.geometry.boxes import time_to_contact
from cornercase._common.typing import FloatArray
from cornercase.metrics._base import Metric
from cornercase.metrics._geometry.boxes import box_corners_over_time, relative_velocity, zero_rounding_errors
from cornercase.recordings import Recording


class Ttc(Metric):
    """Time until the two bounding boxes first touch if both go straight on.

    Each box keeps its heading and its speed. The value is the smallest t >= 0 in s at which the boxes share a point,
    computed exactly with separating axes in the plane. For an entity that follows another on one lane this is gap / Δv.
    Crossing and oncoming paths need no special case.

    The value is 0 if the boxes touch now, and inf if they never do (equal speeds, moving apart, passing by). Two
    standing entities give inf unless they touch. A single standing entity is an obstacle. Not defined if one of the two
    does not exist. Least critical value (cap): 10 s.

    Source: J. C. Hayward, "Near-miss determination through use of a scale of danger", Highway Research Record 384
    (1972), with the contact of the boxes in two dimensions instead of the gap on one lane.

    Parameters
    ----------
    accelerating : bool, default False
        Let both keep their present acceleration along the heading, instead of their speed, until they stand. An entity
        that brakes does not reverse.
    severity : bool, default False
        Score collisions below 0, harder ones lower (`Metric.score_with_contact`).

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate("examples/r157/cut_out.xosc")
    >>> cc.measure(recording, "Ego", "Other", [cc.metrics.Ttc()])
    metric  score  unit  critical is
    ttc     2.021  s     low
    """

    name = "ttc"
    unit = "s"
    lower_is_critical = True
    cap = 10.0
    default_threshold = 1.5
    contact_score = 0.0
    source = "Hayward 1972, boxes in the plane"

    def __init__(self, accelerating: bool = False, severity: bool = False) -> None:
        self.accelerating, self.severity = accelerating, severity

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        a, b = box_corners_over_time(recording, ego), box_corners_over_time(recording, other)
        if not self.accelerating:
            return time_to_contact(a, b, relative_velocity(recording, ego, other))
        ego_motion, other_motion = _StraightMotion(recording, ego), _StraightMotion(recording, other)
        first = np.full(len(recording.time), np.nan)
        # Both accelerations are constant between the times at which an entity stops.
        zeros = np.zeros_like(first)
        stops = np.sort(np.stack([zeros, ego_motion.stop_time, other_motion.stop_time, zeros + np.inf]), 0)
        for begin, end in pairwise(stops):
            start = np.where(np.isfinite(begin), begin, 0.0)
            contact = time_to_contact(
                a + ego_motion.displacement(start)[:, None, :],
                b + other_motion.displacement(start)[:, None, :],
                zero_rounding_errors(other_motion.velocity_at(start) - ego_motion.velocity_at(start)),
                other_motion.acceleration_at(start) - ego_motion.acceleration_at(start),
                np.where(np.isfinite(begin), end - start, -1.0),
            )
            first = np.fmin(first, begin + contact)
        is_unknown = np.isnan(a + b).any((1, 2)) | np.isnan(
            ego_motion.speed + other_motion.speed + ego_motion.acceleration_along + other_motion.acceleration_along
        )
        return np.where(is_unknown, np.nan, first)


class _StraightMotion:
    """Straight motion of one entity, predicted from each instant.

    The acceleration is constant until the entity stands.
    """

    def __init__(self, recording: Recording, name: str) -> None:
        i = recording.entity_index(name)
        heading = recording.heading[i]
        self.direction = np.stack([np.cos(heading), np.sin(heading)], -1)
        self.speed = recording.speed[i]
        acceleration = recording.acceleration[i]
        self.acceleration_along = np.where((self.speed == 0.0) & (acceleration < 0.0), 0.0, acceleration)
        slows = self.speed * self.acceleration_along < 0.0
        self.stop_time = np.where(slows, -self.speed / np.where(slows, self.acceleration_along, 1.0), np.inf)

    def displacement(self, time: FloatArray) -> FloatArray:
        moving = np.minimum(time, self.stop_time)
        return self._along_heading(self.speed * moving + 0.5 * self.acceleration_along * moving**2)

    def velocity_at(self, time: FloatArray) -> FloatArray:
        return self._along_heading(np.where(time < self.stop_time, self.speed + self.acceleration_along * time, 0.0))

    def acceleration_at(self, time: FloatArray) -> FloatArray:
        return self._along_heading(np.where(time < self.stop_time, self.acceleration_along, 0.0))

    def _along_heading(self, length: FloatArray) -> FloatArray:
        vector: FloatArray = length[:, None] * self.direction
        return vector
