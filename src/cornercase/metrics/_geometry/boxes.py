"""Bounding boxes of the entities in a recording, and the velocities of the entities."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.geometry.boxes import box_corners, boxes_overlap
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.recordings import Recording

_RELATIVE_TOLERANCE: Final = 1e-9
_MIN_SPEED: Final = 1e-9  # m/s; a slower relative motion is a rounding error (30 years for a metre)


def box_corners_over_time(recording: Recording, name: str) -> FloatArray:
    """Return the corners of an entity's bounding box at each of T instants in m, shape (T, 4, 2).

    NaN at instants at which the entity does not exist.
    """
    return _box_corners_at(recording, recording.entity_index(name), recording.box_center(name), slice(None))


def boxes_touch_over_time(recording: Recording, ego: str, other: str) -> BoolArray:
    """Return whether the bounding boxes of two entities touch at each instant, shape (T,).

    False if one of the entities does not exist.
    """
    rows = [recording.entity_index(ego), recording.entity_index(other)]
    centers = recording.box_center(ego), recording.box_center(other)
    distance = np.hypot(*(centers[1] - centers[0]).T)
    # Fast rejection: the centres of touching boxes are at most both half diagonals apart.
    reach = 0.5 * np.hypot(recording.length[rows], recording.width[rows]).sum()
    near = np.flatnonzero(distance <= reach * (1.0 + _RELATIVE_TOLERANCE))
    touch = np.zeros(len(distance), dtype=np.bool_)
    if len(near):
        corners, other_corners = (
            _box_corners_at(recording, i, center, near) for i, center in zip(rows, centers, strict=True)
        )
        touch[near] = boxes_overlap(corners, other_corners)
    return touch


def _box_corners_at(recording: Recording, row: int, center: FloatArray, instants: IntArray | slice) -> FloatArray:
    x, y, heading = center[instants, 0], center[instants, 1], recording.heading[row, instants]
    return box_corners(x, y, heading, recording.length[row], recording.width[row])


def velocity_vectors(recording: Recording, name: str) -> FloatArray:
    """Return the velocity of an entity along its heading at each instant in m/s, shape (T, 2).

    NaN if the entity does not exist.
    """
    i = recording.entity_index(name)
    heading = recording.heading[i]
    forward: FloatArray = recording.speed[i][:, None] * np.stack([np.cos(heading), np.sin(heading)], -1)
    return forward


def relative_velocity(recording: Recording, ego: str, other: str) -> FloatArray:
    """Return the velocity of the other relative to the ego in m/s, shape (T, 2), with rounding errors set to 0."""
    return zero_rounding_errors(velocity_vectors(recording, other) - velocity_vectors(recording, ego))


def zero_rounding_errors(relative_velocities: FloatArray) -> FloatArray:
    """Return relative velocities, shape (T, 2), with values that are only rounding errors set to exactly 0."""
    speed = np.hypot(relative_velocities[:, 0], relative_velocities[:, 1])
    return np.where((speed <= _MIN_SPEED)[:, None], 0.0, relative_velocities)
