"""The driven entity and the others, in the form that a driver's compiled decisions take."""

from __future__ import annotations

from typing import NamedTuple

from cornercase._common.typing import BoolArray, FloatArray


class Driven(NamedTuple):
    """The driven entity in N scenarios.

    Attributes
    ----------
    distance : ndarray of float64, shape (N,)
        Place along its path in m.
    x, y, heading, speed : ndarray of float64, shape (N,)
        Motion of its reference point in m, rad and m/s.
    target_speed : ndarray of float64, shape (N,)
        m/s; infinite or NaN where the scenario asks for none.
    half_length, half_width, center_x : float
        Its box in m.
    """

    distance: FloatArray
    x: FloatArray
    y: FloatArray
    heading: FloatArray
    speed: FloatArray
    target_speed: FloatArray
    half_length: float
    half_width: float
    center_x: float


class Boxes(NamedTuple):
    """What does not change about A other entities.

    Attributes
    ----------
    half_length, half_width, center_x : ndarray of float64, shape (A,)
        m.
    vulnerable : ndarray of bool, shape (A,)
        Pedestrians and cyclists.
    """

    half_length: FloatArray
    half_width: FloatArray
    center_x: FloatArray
    vulnerable: BoolArray


class Conflicts(NamedTuple):
    """With whom the driven entity has a conflict, in N scenarios with A others.

    Attributes
    ----------
    since : ndarray of float64, shape (N, A)
        Time in s since when the other's way conflicts with its own; infinite where it does not.
    yielding : ndarray of bool, shape (N, A)
        To whom the driver gives way.
    """

    since: FloatArray
    yielding: BoolArray
