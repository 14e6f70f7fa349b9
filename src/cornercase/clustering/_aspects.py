"""Aspects: time series, such as the ego's trajectory, by which two scenarios are compared."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Final

import numpy as np

from cornercase._common.registry import Registry
from cornercase._common.typing import FloatArray
from cornercase.recordings import Recording
from cornercase.recordings._entity_series import (
    bearing_series,
    position_series,
    relative_position_series,
    speed_series,
)

EGO_TRAJECTORY: Final = "ego-trajectory"
"""Name of the aspect of the paper: the ego's trajectory."""

# Fixed, so that distances mean the same in every study, and chosen without data: a speed difference counts as the
# difference in distance after a driver's look-ahead time (s), and waiting counts as driving at a slow speed (m/s).
_LOOK_AHEAD_TIME: Final = 3.0
_SLOW_SPEED: Final = 5.0


class Aspect(ABC):
    """An aspect of behaviour by which scenarios are compared, as a time series.

    A subclass sets `name` and `unit`, and defines `series`. The distance of two scenarios is the Dynamic Time Warping
    distance between their series.

    Attributes
    ----------
    name : str
        Name, also on the command line, such as ``"ego-speed"``.
    unit : str
        Unit of all channels of the series; ``"1"`` for none. Distances of scenarios have the same unit, since Dynamic
        Time Warping adds up differences of series.

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
    ...         return recording.acceleration[recording.entity_index(ego)][:, None]
    """

    name: str
    unit: str

    @abstractmethod
    def series(self, recording: Recording, ego: str, other: str) -> FloatArray:
        """Return the time series that is compared.

        Parameters
        ----------
        recording : Recording
        ego, other : str
            Names of two entities.

        Returns
        -------
        ndarray of float64, shape (T, k)
            Finite values of k channels at each of the T instants, in the unit of the aspect.

        Raises
        ------
        InputError
            There is no entity of that name.
        """


class EgoTrajectory(Aspect):
    """Position of the ego, as in the paper: the centre of its box, x and y in m.

    Dynamic Time Warping matches positions at any time, so waiting costs nothing.
    """

    name, unit = EGO_TRAJECTORY, "m"

    def series(self, recording: Recording, ego: str, other: str) -> FloatArray:
        """Return the ego's position, shape (T, 2)."""
        return position_series(recording, ego)


class EgoSpeed(Aspect):
    """Speed of the ego in m/s, regardless of the position."""

    name, unit = "ego-speed", "m/s"

    def series(self, recording: Recording, ego: str, other: str) -> FloatArray:
        """Return the ego's speed, shape (T, 1)."""
        return speed_series(recording, ego)


class EgoMotion(Aspect):
    """Position and speed of the ego on one scale: x, y, and the distance travelled in 3 s at this speed, in m."""

    name, unit = "ego-motion", "m"

    def series(self, recording: Recording, ego: str, other: str) -> FloatArray:
        """Return the ego's position and scaled speed, shape (T, 3)."""
        return np.hstack((position_series(recording, ego), _LOOK_AHEAD_TIME * speed_series(recording, ego)))


class JointPositions(Aspect):
    """Positions of the ego and the other entity at the same time, as one point: x, y of both, in m."""

    name, unit = "interaction", "m"

    def series(self, recording: Recording, ego: str, other: str) -> FloatArray:
        """Return both positions, shape (T, 4)."""
        return np.hstack((position_series(recording, ego), position_series(recording, other, ego)))


class RelativePosition(Aspect):
    """Position of the other entity as seen from the ego: ahead and to the left, in m."""

    name, unit = "relative", "m"

    def series(self, recording: Recording, ego: str, other: str) -> FloatArray:
        """Return how far the other entity is ahead of the ego, and to the left of the ego, shape (T, 2)."""
        return relative_position_series(recording, ego, other)


class Bearing(Aspect):
    """Direction in which the ego sees the other entity, as a unit vector (ahead, left), regardless of the distance.

    While ego and other entity pass each other, the direction turns to the left or to the right; the sense of this turn
    shows who was first. Before and after passing, the direction hardly changes. The direction is the null vector if
    both are at the same point, or if the other entity never appears.
    """

    name, unit = "bearing", "1"

    def series(self, recording: Recording, ego: str, other: str) -> FloatArray:
        """Return the direction, shape (T, 2)."""
        return bearing_series(recording, ego, other)


class EgoProgress(Aspect):
    """Distance travelled by the ego along its own path, and time scaled by 5 m/s, both in m.

    Time is part of the series: the farther two instants are apart in time, the more their matching costs. So waiting
    counts. Where the path lies on the map does not count.
    """

    name, unit = "behaviour", "m"

    def series(self, recording: Recording, ego: str, other: str) -> FloatArray:
        """Return the distance travelled and the scaled time, shape (T, 2)."""
        position = position_series(recording, ego)
        steps = np.hypot(*np.diff(position, axis=0).T)
        return np.column_stack((np.r_[0.0, np.cumsum(steps)], _SLOW_SPEED * (recording.time - recording.time[0])))


ASPECTS: Final[Registry[Aspect]] = Registry("aspect", "cornercase.aspects", Aspect)
"""Aspects by name.

Scenarios can also be compared by each metric of a study: by its course, the values over time.
"""

for _class in (EgoTrajectory, EgoSpeed, EgoMotion, JointPositions, RelativePosition, Bearing, EgoProgress):
    ASPECTS.register(_class.name, _class)
