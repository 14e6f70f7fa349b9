"""Metric of the worst time to collision."""

# Compiled functions have no static types.
# mypy: disable-error-code="call-arg"

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.metrics._base import Metric
from cornercase.metrics._geometry import wttc_kernel
from cornercase.recordings import Recording

_VULNERABLE_TYPES = frozenset({"bicycle", "pedestrian", "wheelchair", "animal"})


class Wttc(Metric):
    """Time to collision if both entities do the worst that physics allows.

    Each entity may accelerate in any direction by at most ``a``. So after a time t the entity is somewhere in a circle
    that moves on with the present velocity of the entity and grows by ``a t²/2``. The value is the smallest t >= 0 in s
    with ::

        |Δp + Δv t| = R + (a_ego + a_other) t² / 2.

    Δp and Δv are the differences of the box centres and of the velocities along the headings. R is the sum of the half
    diagonals, so that the circles enclose the boxes. The value never exceeds the time to collision.

    The value is 0 if the circles touch now, and finite as long as an entity can accelerate. Two standing entities at a
    distance d give sqrt(2 (d - R) / (a_ego + a_other)). Not defined if one of the two does not exist. Least critical
    value (cap): 10 s.

    Source: W. Wachenfeld, P. Junietz, R. Wenzel, H. Winner, "The worst-time-to-collision metric for situation
    identification", IEEE Intelligent Vehicles Symposium (2016).

    Parameters
    ----------
    vehicle_acceleration : float, default 6.9
        Greatest acceleration in m/s² of vehicles, and of all types of entities that are not listed below.
    vulnerable_acceleration : float, default 2.5
        Greatest acceleration in m/s² of bicycles, pedestrians, wheelchairs and animals.
    severity : bool, default False
        Score collisions below 0, harder ones lower (`Metric.score_with_contact`).

    Raises
    ------
    InputError
        An acceleration is negative.

    Examples
    --------
    >>> import cornercase as cc
    >>> recording = cc.simulate(
    ...     "examples/x_intersection/x_intersection.xosc", {"ego_start": 44.0}, drivers={"Ego": "aggressive"}
    ... )
    >>> cc.measure(recording, "Ego", "Pedestrian", [cc.metrics.Wttc()])
    metric  score  unit  critical is
    wttc    1.009  s     low
    """

    name = "wttc"
    unit = "s"
    lower_is_critical = True
    cap = 10.0
    default_threshold = 1.0
    contact_score = 0.0
    source = "Wachenfeld et al. 2016"

    def __init__(
        self, vehicle_acceleration: float = 6.9, vulnerable_acceleration: float = 2.5, severity: bool = False
    ) -> None:
        if not (vehicle_acceleration >= 0.0 and vulnerable_acceleration >= 0.0):
            raise InputError(
                f"wttc cannot take the greatest accelerations {vehicle_acceleration} and "
                f"{vulnerable_acceleration} m/s²; give numbers that are not negative."
            )
        self.vehicle_acceleration = vehicle_acceleration
        self.vulnerable_acceleration = vulnerable_acceleration
        self.severity = severity

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        rows = [recording.entity_index(ego), recording.entity_index(other)]
        course = np.empty(len(recording.time))
        wttc_kernel.wttc_of_recording(
            *map(np.ascontiguousarray, (recording.x, recording.y, recording.heading, recording.speed)),
            np.ascontiguousarray(recording.center_x),
            *rows,
            0.5 * sum(math.hypot(recording.length[i], recording.width[i]) for i in rows),
            sum(self._greatest_acceleration(recording.object_types[i]) for i in rows),
            course,
        )
        return course

    def _greatest_acceleration(self, object_type: str) -> float:
        return self.vulnerable_acceleration if object_type.lower() in _VULNERABLE_TYPES else self.vehicle_acceleration


def earliest_circle_contact(
    position: FloatArray, velocity: FloatArray, radius: npt.ArrayLike, acceleration: npt.ArrayLike
) -> FloatArray:
    """Return the smallest t >= 0 in s with ``|position + velocity t| = radius + acceleration t² / 2``, elementwise.

    `position` and `velocity`, shape (..., 2), describe one circle relative to another. `radius` is the sum of
    both radii in m, `acceleration` the sum of both greatest accelerations in m/s²; with 0 the result is the time to
    collision of the circles. The result is 0 if the circles touch now, inf if they never do, and NaN if an input is
    NaN.

    The squared equation is h(t) = (radius + acceleration t² / 2)² - |position + velocity t|² = 0, a quartic without a
    cubic term. For t >= 0, h is concave before its only inflection and convex after it. Newton's method finds the only
    maximum of h from the left. If h reaches 0 there, the first root is not later than the maximum, and Newton's method
    reaches this root from the left without overshooting, even if two roots coincide. If the maximum is below 0, the
    only root lies in the convex part, and Newton's method reaches it from a bound on the right.
    """
    radius, growth = np.asarray(radius, dtype=np.float64), np.asarray(acceleration, dtype=np.float64)
    position, velocity = np.asarray(position, dtype=np.float64), np.asarray(velocity, dtype=np.float64)
    shape = np.broadcast_shapes(position.shape[:-1], velocity.shape[:-1], radius.shape, growth.shape)
    roots = np.empty(math.prod(shape))
    wttc_kernel.wttc_of_circles(
        *(np.ascontiguousarray(np.broadcast_to(vector, (*shape, 2)).reshape(-1, 2)) for vector in (position, velocity)),
        *(np.ascontiguousarray(np.broadcast_to(number, shape).ravel()) for number in (radius, growth)),
        roots,
    )
    return roots.reshape(shape)
