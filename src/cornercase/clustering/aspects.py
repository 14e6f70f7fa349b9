"""Aspects: what of two scenarios is compared, by name."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Final

import numpy as np

from cornercase._common.registry import Registry
from cornercase._common.typing import FloatArray
from cornercase.recordings import Recording

EGO_TRAJECTORY: Final = "ego-trajectory"
"""Name of the aspect of the paper: where the ego goes."""

# Fixed, so that two scenarios are as far apart in every study, and chosen without data: a difference of speed counts as
# the way that it makes in the time that drivers look ahead, a second of waiting as the way of a slow vehicle.
_LOOK_AHEAD: Final = 3.0
_SLOW: Final = 5.0


class Aspect(ABC):
    """What of a scenario is compared with other scenarios.

    A subclass names itself, says its unit, and defines `series`. Scenarios are then compared by Dynamic Time Warping.

    Attributes
    ----------
    name : str
        As on the command line: ``"ego-speed"``.
    unit : str
        Of all channels of the series, and so of the distance of two scenarios, which is a sum along the best path;
        ``"1"`` for none.

    See Also
    --------
    cornercase.clustering.ASPECTS : Aspects by name, also those of other packages.

    Examples
    --------
    >>> from cornercase.clustering import Aspect
    >>> class Acceleration(Aspect):
    ...
    ...     name, unit = "ego-acceleration", "m/s^2"
    ...
    ...     def series(self, recording, ego, other):
    ...         return recording.acceleration[recording.index(ego)][:, None]
    """

    name: str
    unit: str

    @abstractmethod
    def series(self, recording: Recording, ego: str, other: str) -> FloatArray:
        """Give what is compared.

        Parameters
        ----------
        recording : Recording
        ego, other : str
            Names of two entities.

        Returns
        -------
        ndarray of float64, shape (T, k)
            Finite at each instant, in the aspect's unit.

        Raises
        ------
        InputError
            There is no entity of that name.
        """


class EgoTrajectory(Aspect):
    """The place of the ego, as in the paper: the centre of its box, x and y in m.

    Dynamic Time Warping matches places whenever they were reached, so that waiting costs nothing.
    """

    name, unit = EGO_TRAJECTORY, "m"

    def series(self, recording: Recording, ego: str, other: str) -> FloatArray:
        """Give the ego's place, shape (T, 2)."""
        return _place(recording, ego)


class EgoSpeed(Aspect):
    """The speed of the ego in m/s, wherever it is."""

    name, unit = "ego-speed", "m/s"

    def series(self, recording: Recording, ego: str, other: str) -> FloatArray:
        """Give the ego's speed, shape (T, 1)."""
        return _speed(recording, ego)


class EgoMotion(Aspect):
    """Place and speed of the ego on one scale: x, y, and the way that its speed makes in 3 s, in m."""

    name, unit = "ego-motion", "m"

    def series(self, recording: Recording, ego: str, other: str) -> FloatArray:
        """Give the ego's place and scaled speed, shape (T, 3)."""
        return np.hstack((_place(recording, ego), _LOOK_AHEAD * _speed(recording, ego)))


class Interaction(Aspect):
    """The places of ego and other at the same time, jointly: x, y, x, y in m."""

    name, unit = "interaction", "m"

    def series(self, recording: Recording, ego: str, other: str) -> FloatArray:
        """Give both places, shape (T, 4)."""
        return np.hstack((_place(recording, ego), _place(recording, other, ego)))


class Relative(Aspect):
    """Where the other is as the ego sees it: ahead and to the left, in m."""

    name, unit = "relative", "m"

    def series(self, recording: Recording, ego: str, other: str) -> FloatArray:
        """Give the other's place in the ego's frame, shape (T, 2)."""
        return _seen(recording, ego, other)


class Bearing(Aspect):
    """The direction in which the ego sees the other, as a unit vector ahead and to the left, however far it is.

    When the two pass each other it turns one way or the other, so that it tells who was first; before and after, it
    hardly changes. Where they are in one place, or the other never exists, it is the null vector.
    """

    name, unit = "bearing", "1"

    def series(self, recording: Recording, ego: str, other: str) -> FloatArray:
        """Give the direction, shape (T, 2)."""
        seen = _seen(recording, ego, other)
        away = np.hypot(seen[:, :1], seen[:, 1:])
        return np.divide(seen, away, out=np.zeros_like(seen), where=away > 0.0)


class Behaviour(Aspect):
    """The place of the ego on its own path over time: the way that it has made, and 5 m for each second, in m.

    What is matched at different times costs so much for each second between, so that waiting counts, and where the
    path lies does not.
    """

    name, unit = "behaviour", "m"

    def series(self, recording: Recording, ego: str, other: str) -> FloatArray:
        """Give the ego's way and the scaled time, shape (T, 2)."""
        place = _place(recording, ego)
        steps = np.hypot(*np.diff(place, axis=0).T)
        return np.column_stack((np.r_[0.0, np.cumsum(steps)], _SLOW * (recording.time - recording.time[0])))


ASPECTS: Final[Registry[Aspect]] = Registry("aspect", "cornercase.aspects", Aspect)
"""Aspects by name; the course of each metric of a study is one, too."""

for _class in (EgoTrajectory, EgoSpeed, EgoMotion, Interaction, Relative, Bearing, Behaviour):
    ASPECTS.register(_class.name, _class)


def _place(recording: Recording, entity: str, instead: str | None = None) -> FloatArray:
    """Centre of an entity's box, shape (T, 2); that of another one if it never exists."""
    center = recording.center(entity)
    if instead is not None and not np.isfinite(center).all(axis=1).any():
        return _place(recording, instead)
    return _held(center)


def _speed(recording: Recording, entity: str) -> FloatArray:
    return _held(recording.speed[recording.index(entity)][:, None])


def _seen(recording: Recording, ego: str, other: str) -> FloatArray:
    """Place of the other in the ego's frame, shape (T, 2)."""
    x, y = (_place(recording, other, ego) - _place(recording, ego)).T
    heading = _held(recording.heading[recording.index(ego)][:, None])[:, 0]
    cos, sin = np.cos(heading), np.sin(heading)
    return np.column_stack((cos * x + sin * y, cos * y - sin * x))


def _held(values: FloatArray) -> FloatArray:
    """Fill instants at which an entity does not exist: it stays as it was last, and begins as it will first be."""
    exists = np.isfinite(values).all(axis=1)
    if not exists.any():
        return np.nan_to_num(values)
    last = np.maximum.accumulate(np.where(exists, np.arange(len(values)), -1))
    return np.asarray(values[np.where(last < 0, np.argmax(exists), last)])
