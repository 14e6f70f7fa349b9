"""Where boxes are between instants, and what the ego sees of them."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from cornercase._common.geometry import box_corners, within_half_turn
from cornercase._common.typing import FloatArray
from cornercase.drivers import EYE_AHEAD, in_sight
from cornercase.recordings import Recording

# So far away a shadow ends, in m.
_FAR: Final = 2000.0
# Times that differ by less, in s, are the same.
_SAME: Final = 1e-6


class Motion(NamedTuple):
    """Boxes of A entities at F times.

    Attributes
    ----------
    x, y, heading, speed : ndarray of float64, shape (A, F)
        Centre of the box in m, rad, m/s; NaN where an entity does not exist.
    length, width : ndarray of float64, shape (A,)
        Of the boxes, in m.
    """

    x: FloatArray
    y: FloatArray
    heading: FloatArray
    speed: FloatArray
    length: FloatArray
    width: FloatArray

    def corners(self, entity: int, k: int) -> FloatArray:
        """Corners of a box at the k-th time, in m, shape (4, 2)."""
        size = self.length[entity], self.width[entity]
        return box_corners(self.x[entity, k], self.y[entity, k], self.heading[entity, k], *size)

    def eye(self, entity: int, k: int) -> FloatArray:
        """Where a driver looks from at the k-th time, in m, shape (2,)."""
        heading, ahead = self.heading[entity, k], EYE_AHEAD * self.length[entity]
        x, y = self.x[entity, k], self.y[entity, k]
        return np.array([x + ahead * np.cos(heading), y + ahead * np.sin(heading)])

    def there(self, k: int) -> list[int]:
        """Entities that exist at the k-th time."""
        return [int(entity) for entity in np.flatnonzero(np.isfinite(self.x[:, k] + self.y[:, k]))]


def motion_at(recording: Recording, times: FloatArray) -> Motion:
    """Find where boxes are at any times; before the first and after the last instant they stand still.

    Parameters
    ----------
    recording : Recording
        Of A entities.
    times : ndarray of float64, shape (F,)
        s.

    Returns
    -------
    Motion
        Straight on between instants.
    """
    instants = recording.time
    first = np.clip(np.searchsorted(instants, times + _SAME, "right") - 1, 0, len(instants) - 1)
    second = np.minimum(first + 1, len(instants) - 1)
    apart = np.where(second > first, instants[second] - instants[first], 1.0)
    share = np.clip((times - instants[first]) / apart, 0.0, 1.0)

    def between(values: FloatArray, turns: bool = False) -> FloatArray:
        one, other = values[:, first], values[:, second]
        step = within_half_turn(other - one) if turns else other - one
        # Who comes or goes between two instants is where it is at that one at which it exists.
        nearest = np.where(share < 0.5, one, other)
        return np.where(np.isfinite(one + other), one + share * step, nearest)

    heading = between(recording.heading, turns=True)
    ahead = recording.center_x[:, None]
    return Motion(
        between(recording.x) + ahead * np.cos(heading),
        between(recording.y) + ahead * np.sin(heading),
        heading,
        between(recording.speed),
        recording.length,
        recording.width,
    )


def sees(motion: Motion, driver: int, target: int, k: int) -> bool:
    """Say whether a driver can see an entity, as `cornercase.drivers` finds it.

    Parameters
    ----------
    motion : Motion
        Of all entities.
    driver, target : int
        Both exist.
    k : int
        Number of the time.

    Returns
    -------
    bool
        Whether the line to a corner or to the centre of the target's box meets no third box.
    """
    third = [one for one in motion.there(k) if one not in (driver, target)]
    watched = [target, *third]
    poses = np.stack((motion.x[:, k], motion.y[:, k], motion.heading[:, k]))
    boxes = np.stack((motion.length, motion.width, np.zeros(len(motion.length))))
    return bool(in_sight(poses[None, :, driver], boxes[:, driver], poses[None, :, watched], boxes[:, watched])[0, 0])


def shadow(motion: Motion, driver: int, other: int, k: int) -> FloatArray | None:
    """Find the area that a box hides from a driver.

    Parameters
    ----------
    motion : Motion
        Of all entities.
    driver, other : int
        Both exist.
    k : int
        Number of the time.

    Returns
    -------
    ndarray of float64, shape (4, 2), or None
        Corners in m; None where the box stands around the eye, and hides nothing.
    """
    eye = motion.eye(driver, k)
    corners = motion.corners(other, k) - eye
    middle = np.array([motion.x[other, k], motion.y[other, k]]) - eye
    angles = np.arctan2(middle[0] * corners[:, 1] - middle[1] * corners[:, 0], corners @ middle)
    right, left = corners[angles.argmin()], corners[angles.argmax()]
    if float(np.ptp(angles)) >= np.pi or not middle.any():
        return None
    far = [one * (_FAR / max(float(np.hypot(*one)), 1e-9)) for one in (right, left)]
    return np.array([right, far[0], far[1], left]) + eye


def contact(recording: Recording, time: float, one: int, other: int) -> FloatArray:
    """Find where two boxes touch.

    Parameters
    ----------
    recording : Recording
        Both are in it.
    time : float
        s.
    one, other : int
        The entities.

    Returns
    -------
    ndarray of float64, shape (2,)
        Midway between the points of each that are nearest to the other's centre, in m.
    """
    motion = motion_at(recording, np.array([time]))
    return 0.5 * (_nearest(motion, one, other) + _nearest(motion, other, one))


def _nearest(motion: Motion, box: int, point: int) -> FloatArray:
    heading = motion.heading[box, 0]
    turn = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    center = np.array([motion.x[box, 0], motion.y[box, 0]])
    half = np.array([0.5 * motion.length[box], 0.5 * motion.width[box]])
    way = turn @ (np.array([motion.x[point, 0], motion.y[point, 0]]) - center)
    return np.asarray(center + turn.T @ np.clip(way, -half, half))
