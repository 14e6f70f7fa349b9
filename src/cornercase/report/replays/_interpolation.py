"""Interpolation of motion between recorded instants, and the geometry of what a driver sees."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from cornercase._common.geometry.boxes import box_corners, wrap_angle
from cornercase._common.typing import FloatArray
from cornercase.drivers._kernels.visibility import EYE_AHEAD, find_visible_others
from cornercase.recordings import Recording

# Distance in m at which a shadow ends.
_SHADOW_LENGTH: Final = 2000.0
# Times that differ by less than this, in s, are equal.
_TIME_TOLERANCE: Final = 1e-6


class Motion(NamedTuple):
    """Poses, speeds and sizes of the boxes of A entities, interpolated at F times."""

    x: FloatArray  # centre in m, shape (A, F); NaN while an entity does not exist
    y: FloatArray
    heading: FloatArray  # rad, shape (A, F)
    speed: FloatArray  # m/s, shape (A, F)
    length: FloatArray  # m, shape (A,)
    width: FloatArray

    def corners(self, entity: int, time_index: int) -> FloatArray:
        """Return the corners of a box at `time_index`, in m, shape (4, 2)."""
        size = self.length[entity], self.width[entity]
        return box_corners(
            self.x[entity, time_index], self.y[entity, time_index], self.heading[entity, time_index], *size
        )

    def eye_position(self, entity: int, time_index: int) -> FloatArray:
        """Return the eye position of an entity's driver at `time_index`, in m, shape (2,)."""
        heading, ahead = self.heading[entity, time_index], EYE_AHEAD * self.length[entity]
        x, y = self.x[entity, time_index], self.y[entity, time_index]
        return np.array([x + ahead * np.cos(heading), y + ahead * np.sin(heading)])

    def existing_entities(self, time_index: int) -> list[int]:
        """Return the indices of the entities that exist at `time_index`."""
        return [int(entity) for entity in np.flatnonzero(np.isfinite(self.x[:, time_index] + self.y[:, time_index]))]


def interpolate_motion(recording: Recording, times: FloatArray) -> Motion:
    """Interpolate all boxes linearly at times in s, shape (F,); outside the recording, boxes stand still."""
    instants = recording.time
    first = np.clip(np.searchsorted(instants, times + _TIME_TOLERANCE, "right") - 1, 0, len(instants) - 1)
    second = np.minimum(first + 1, len(instants) - 1)
    interval = np.where(second > first, instants[second] - instants[first], 1.0)
    share = np.clip((times - instants[first]) / interval, 0.0, 1.0)

    def interpolate(values: FloatArray, is_angle: bool = False) -> FloatArray:
        before, after = values[:, first], values[:, second]
        step = wrap_angle(after - before) if is_angle else after - before
        # An entity that appears or disappears between two instants stays at the one where it exists.
        nearest = np.where(share < 0.5, before, after)
        return np.where(np.isfinite(before + after), before + share * step, nearest)

    heading = interpolate(recording.heading, is_angle=True)
    ahead = recording.center_x[:, None]
    return Motion(
        interpolate(recording.x) + ahead * np.cos(heading),
        interpolate(recording.y) + ahead * np.sin(heading),
        heading,
        interpolate(recording.speed),
        recording.length,
        recording.width,
    )


def is_visible(motion: Motion, driver: int, target: int, time_index: int) -> bool:
    """Return whether the driver of an entity sees the `target`, by the same rule as drivers in the simulation."""
    obstacles = [entity for entity in motion.existing_entities(time_index) if entity not in (driver, target)]
    watched = [target, *obstacles]
    poses = np.stack((motion.x[:, time_index], motion.y[:, time_index], motion.heading[:, time_index]))
    boxes = np.stack((motion.length, motion.width, np.zeros(len(motion.length))))
    return bool(
        find_visible_others(poses[None, :, driver], boxes[:, driver], poses[None, :, watched], boxes[:, watched])[0, 0]
    )


def hidden_area(motion: Motion, driver: int, obstacle: int, time_index: int) -> FloatArray | None:
    """Return the area that a box hides from a driver: corners in m, shape (4, 2); None if the eye is in the box."""
    eye = motion.eye_position(driver, time_index)
    corners = motion.corners(obstacle, time_index) - eye
    direction = np.array([motion.x[obstacle, time_index], motion.y[obstacle, time_index]]) - eye
    angles = np.arctan2(direction[0] * corners[:, 1] - direction[1] * corners[:, 0], corners @ direction)
    right, left = corners[angles.argmin()], corners[angles.argmax()]
    if float(np.ptp(angles)) >= np.pi or not direction.any():
        return None
    far = [corner * (_SHADOW_LENGTH / max(float(np.hypot(*corner)), 1e-9)) for corner in (right, left)]
    return np.array([right, far[0], far[1], left]) + eye


def contact_point(recording: Recording, time: float, first: int, second: int) -> FloatArray:
    """Return the point, in m, shape (2,), where the boxes of two entities touch at `time`, in s.

    The point is midway between two points: on each box, the point nearest to the centre of the other box.
    """
    motion = interpolate_motion(recording, np.array([time]))
    return 0.5 * (_nearest_point_of_box(motion, first, second) + _nearest_point_of_box(motion, second, first))


def _nearest_point_of_box(motion: Motion, box: int, target: int) -> FloatArray:
    heading = motion.heading[box, 0]
    turn = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    center = np.array([motion.x[box, 0], motion.y[box, 0]])
    half = np.array([0.5 * motion.length[box], 0.5 * motion.width[box]])
    offset = turn @ (np.array([motion.x[target, 0], motion.y[target, 0]]) - center)
    return np.asarray(center + turn.T @ np.clip(offset, -half, half))
