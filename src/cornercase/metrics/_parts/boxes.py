"""Bounding boxes of a recording, and how they move."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.geometry import box_corners, boxes_overlap
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.recordings import Recording

_RELATIVE_TOLERANCE: Final = 1e-9
_MIN_SPEED: Final = 1e-9  # m/s; a slower relative motion is a rounding error (30 years for a metre)


def boxes(recording: Recording, name: str) -> FloatArray:
    """Corners of an entity's bounding box in m, shape (T, 4, 2), NaN where it does not exist."""
    return _corners(recording, recording.index(name), recording.center(name), slice(None))


def touching(recording: Recording, one: str, other: str) -> BoolArray:
    """Whether two entities' bounding boxes touch, shape (T,); False if one of them does not exist."""
    rows = [recording.index(one), recording.index(other)]
    centers = recording.center(one), recording.center(other)
    distance = np.hypot(*(centers[1] - centers[0]).T)
    # Fast rejection: the centres of touching boxes are at most both half diagonals apart.
    reach = 0.5 * np.hypot(recording.length[rows], recording.width[rows]).sum()
    near = np.flatnonzero(distance <= reach * (1.0 + _RELATIVE_TOLERANCE))
    touch = np.zeros(len(distance), dtype=np.bool_)
    if len(near):
        corners, other_corners = (_corners(recording, i, center, near) for i, center in zip(rows, centers, strict=True))
        touch[near] = boxes_overlap(corners, other_corners)
    return touch


def _corners(recording: Recording, row: int, center: FloatArray, at: IntArray | slice) -> FloatArray:
    x, y, heading = center[at, 0], center[at, 1], recording.heading[row, at]
    return box_corners(x, y, heading, recording.length[row], recording.width[row])


def velocity(recording: Recording, name: str) -> FloatArray:
    """Speed along the heading as a vector in m/s, shape (T, 2), NaN where the entity does not exist."""
    i = recording.index(name)
    heading = recording.heading[i]
    forward: FloatArray = recording.speed[i][:, None] * np.stack([np.cos(heading), np.sin(heading)], -1)
    return forward


def relative_velocity(recording: Recording, ego: str, other: str) -> FloatArray:
    """Velocity of the other relative to the ego in m/s, shape (T, 2), with rounding errors set to exactly 0."""
    return without_rounding(velocity(recording, other) - velocity(recording, ego))


def without_rounding(relative: FloatArray) -> FloatArray:
    """Relative velocities (T, 2) with rounding errors set to 0."""
    speed = np.hypot(relative[:, 0], relative[:, 1])
    return np.where((speed <= _MIN_SPEED)[:, None], 0.0, relative)
