"""Worst time to collision."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from cornercase.errors import InputError
from cornercase.metrics.base import PairMetric, velocity
from cornercase.recording import Recording
from cornercase.typing import FloatArray

_VULNERABLE = frozenset({"bicycle", "pedestrian", "wheelchair", "animal"})
_ITERATIONS = 100


class Wttc(PairMetric):
    """Time to collision if both entities do the worst that physics allows.

    Each entity may accelerate in any direction by at most ``a``: after a time t it is somewhere in a circle
    that moves on with its present velocity and grows by ``a t²/2``. The value is the smallest t >= 0 in s
    with

        |Δp + Δv t| = R + (a_ego + a_other) t² / 2,

    where Δp and Δv are the differences of the box centres and of the velocities along the headings, and R is
    the sum of the half diagonals, so that the circles enclose the boxes. It never exceeds the time to
    collision.

    0 when the circles touch now. Two standing entities give sqrt(2 (d - R) / (a_ego + a_other)). Not defined
    where one of the two does not exist. Never inf as long as one can accelerate. Cap: 10 s.

    Parameters
    ----------
    vehicle_acceleration : float, default 6.9
        Greatest acceleration in m/s² of everything not named below.
    vulnerable_acceleration : float, default 2.5
        Greatest acceleration in m/s² of bicycles, pedestrians, wheelchairs and animals.

    Notes
    -----
    Source: W. Wachenfeld, P. Junietz, R. Wenzel, H. Winner, "The worst-time-to-collision metric for situation
    identification", IEEE Intelligent Vehicles Symposium (2016).
    """

    name = "wttc"
    unit = "s"
    lower_is_critical = True
    cap = 10.0
    source = "Wachenfeld et al. 2016"

    def __init__(self, vehicle_acceleration: float = 6.9, vulnerable_acceleration: float = 2.5) -> None:
        if not (vehicle_acceleration >= 0.0 and vulnerable_acceleration >= 0.0):
            raise InputError(
                f"wttc cannot take the greatest accelerations {vehicle_acceleration} and "
                f"{vulnerable_acceleration} m/s²; give numbers that are not negative."
            )
        self.vehicle_acceleration = vehicle_acceleration
        self.vulnerable_acceleration = vulnerable_acceleration

    def _course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        rows = [recording.index(ego), recording.index(other)]
        radius = 0.5 * sum(float(np.hypot(recording.length[i], recording.width[i])) for i in rows)
        return worst_contact(
            recording.center(other) - recording.center(ego),
            velocity(recording, other) - velocity(recording, ego),
            radius,
            sum(self._limit(recording.kinds[i]) for i in rows),
        )

    def _limit(self, kind: str) -> float:
        return self.vulnerable_acceleration if kind.lower() in _VULNERABLE else self.vehicle_acceleration


def worst_contact(
    position: FloatArray, velocity: FloatArray, radius: npt.ArrayLike, acceleration: npt.ArrayLike
) -> FloatArray:
    """Smallest t >= 0 with |position + velocity t| = radius + acceleration t²/2, for all elements at once.

    Squared, the equation is a quartic h(t) = 0 without a cubic term. For t >= 0 it is concave up to one
    inflection and convex from there on. A root in the concave part lies before the only maximum, whose place
    is known in closed form; from the left of it Newton's method runs into the root without overshooting, also
    where two roots fall together. If the maximum stays below 0, the only root lies in the convex part, and
    Newton's method reaches it from a bound on the right.

    Parameters
    ----------
    position, velocity : ndarray of float64, shape (..., 2)
        Of one circle relative to the other, in m and m/s.
    radius : array_like of float, shape (...)
        Sum of both radii in m.
    acceleration : array_like of float, shape (...)
        Sum of both greatest accelerations in m/s², not negative; 0 gives the time to collision of the
        circles.

    Returns
    -------
    ndarray of float64, shape (...)
        s; 0 where the circles touch now, inf for never, NaN where an input is.
    """
    distance = np.hypot(position[..., 0], position[..., 1])
    speed = np.hypot(velocity[..., 0], velocity[..., 1])
    closing = -(position * velocity).sum(-1)
    radius, growth = np.asarray(radius, dtype=np.float64), np.asarray(acceleration, dtype=np.float64)
    distance, speed, closing, radius, growth = np.broadcast_arrays(distance, speed, closing, radius, growth)

    apart = (distance - radius) * (distance + radius)
    touch = apart <= 0.0
    quartic = 0.25 * growth**2
    square = radius * growth - speed**2

    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        top = _maximum(-square, growth, closing)
        peak = ((quartic * top**2 + square) * top + 2.0 * closing) * top - apart
        # A grazing contact is one: what rounding may have taken from the maximum is given back.
        early = peak >= -1e-14 * (distance**2 + (speed * top) ** 2)
        curvature = -2.0 * square - 12.0 * quartic * top**2
        from_left = np.where(curvature > 0.0, top - np.sqrt(2.0 * np.maximum(peak, 0.0) / curvature), 0.0)
        from_right = (speed + np.sqrt(speed**2 + 2.0 * growth * np.maximum(distance - radius, 0.0))) / growth
        time = np.where(early, np.clip(from_left, 0.0, top), from_right)
        for _ in range(_ITERATIONS):
            value = ((quartic * time**2 + square) * time + 2.0 * closing) * time - apart
            slope = (4.0 * quartic * time**2 + 2.0 * square) * time + 2.0 * closing
            step = np.where((value < 0.0) == early, value / slope, 0.0)
            moved = np.where(early, np.fmin(time - step, top), np.fmax(time - step, 0.0))
            settled = touch | ~(np.abs(moved - time) > 4e-15 * time)
            time = moved
            if settled.all():
                break

    time = np.where(early | (growth > 0.0), time, np.inf)
    time = np.where(touch, 0.0, time)
    return np.where(np.isnan(distance + speed + radius + growth), np.nan, time)


def _maximum(bend: FloatArray, growth: FloatArray, closing: FloatArray) -> FloatArray:
    """Where growth² t⁴/4 - bend t² + 2 closing t is largest up to its inflection; NaN if it only falls."""
    rises = (bend > 0.0) & (closing > 0.0)
    bend = np.where(rises, bend, 1.0)
    third = 2.0 / 3.0 * bend
    sine = closing * growth / third**1.5
    # As the growth vanishes, the inflection goes to infinity and the maximum to that of a parabola.
    cubic = 2.0 * np.sqrt(third) / growth * np.sin(np.arcsin(np.clip(sine, 0.0, 1.0)) / 3.0)
    return np.where(rises, np.where(sine > 1e-8, cubic, closing / bend), np.nan)
