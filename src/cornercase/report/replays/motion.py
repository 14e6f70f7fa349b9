"""Interpolate motion between instants, and compute what the ego sees."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from cornercase._common.geometry import box_corners, within_half_turn
from cornercase._common.typing import FloatArray
from cornercase.drivers import EYE_AHEAD, in_sight
from cornercase.recordings import Recording

# Distance in m at which a shadow ends.
_FAR: Final = 2000.0
# Times that differ by less than this, in s, are equal.
_SAME: Final = 1e-6


class Motion(NamedTuple):
    """Boxes of A entities at F times."""

    x: FloatArray  # centre in m, shape (A, F); NaN while an entity does not exist
    y: FloatArray
    heading: FloatArray  # rad, shape (A, F)
    speed: FloatArray  # m/s, shape (A, F)
    length: FloatArray  # m, shape (A,)
    width: FloatArray

    def corners(self, entity: int, k: int) -> FloatArray:
        """Return the corners of a box at `time_index`, in m, shape (4, 2)."""
        size = self.length[entity], self.width[entity]
        return box_corners(self.x[entity, k], self.y[entity, k], self.heading[entity, k], *size)

    def eye(self, entity: int, k: int) -> FloatArray:
        """Return the eye position of a driver at `time_index`, in m, shape (2,)."""
        heading, ahead = self.heading[entity, k], EYE_AHEAD * self.length[entity]
        x, y = self.x[entity, k], self.y[entity, k]
        return np.array([x + ahead * np.cos(heading), y + ahead * np.sin(heading)])

    def there(self, k: int) -> list[int]:
        """Return the entities that exist at `time_index`."""
        return [int(entity) for entity in np.flatnonzero(np.isfinite(self.x[:, k] + self.y[:, k]))]


def motion_at(recording: Recording, times: FloatArray) -> Motion:
    """Interpolate all boxes linearly at times in s, shape (F,); they stand still outside the recording."""
    instants = recording.time
    first = np.clip(np.searchsorted(instants, times + _SAME, "right") - 1, 0, len(instants) - 1)
    second = np.minimum(first + 1, len(instants) - 1)
    interval = np.where(second > first, instants[second] - instants[first], 1.0)
    share = np.clip((times - instants[first]) / interval, 0.0, 1.0)

    def between(values: FloatArray, turns: bool = False) -> FloatArray:
        before, after = values[:, first], values[:, second]
        step = within_half_turn(after - before) if turns else after - before
        # An entity that appears or disappears between two instants stays at the one where it exists.
        nearest = np.where(share < 0.5, before, after)
        return np.where(np.isfinite(before + after), before + share * step, nearest)

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
    """Return whether a driver sees an entity at `time_index`, by the same rule as the drivers."""
    obstacles = [entity for entity in motion.there(k) if entity not in (driver, target)]
    watched = [target, *obstacles]
    poses = np.stack((motion.x[:, k], motion.y[:, k], motion.heading[:, k]))
    boxes = np.stack((motion.length, motion.width, np.zeros(len(motion.length))))
    return bool(in_sight(poses[None, :, driver], boxes[:, driver], poses[None, :, watched], boxes[:, watched])[0, 0])


def shadow(motion: Motion, driver: int, other: int, k: int) -> FloatArray | None:
    """Return the area a box hides from a driver, corners in m, shape (4, 2); None if the box surrounds the eye."""
    eye = motion.eye(driver, k)
    corners = motion.corners(other, k) - eye
    direction = np.array([motion.x[other, k], motion.y[other, k]]) - eye
    angles = np.arctan2(direction[0] * corners[:, 1] - direction[1] * corners[:, 0], corners @ direction)
    right, left = corners[angles.argmin()], corners[angles.argmax()]
    if float(np.ptp(angles)) >= np.pi or not direction.any():
        return None
    far = [corner * (_FAR / max(float(np.hypot(*corner)), 1e-9)) for corner in (right, left)]
    return np.array([right, far[0], far[1], left]) + eye


def contact(recording: Recording, time: float, one: int, other: int) -> FloatArray:
    """Return where two boxes touch, in m, shape (2,): midway between the points nearest to the other's centre."""
    motion = motion_at(recording, np.array([time]))
    return 0.5 * (_nearest(motion, one, other) + _nearest(motion, other, one))


def _nearest(motion: Motion, box: int, point: int) -> FloatArray:
    heading = motion.heading[box, 0]
    turn = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    center = np.array([motion.x[box, 0], motion.y[box, 0]])
    half = np.array([0.5 * motion.length[box], 0.5 * motion.width[box]])
    offset = turn @ (np.array([motion.x[point, 0], motion.y[point, 0]]) - center)
    return np.asarray(center + turn.T @ np.clip(offset, -half, half))
