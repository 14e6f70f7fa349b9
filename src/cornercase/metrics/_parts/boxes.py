"""Bounding boxes of a recording, and how they move."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.geometry import box_corners
from cornercase._common.typing import FloatArray
from cornercase.recordings import Recording

_ALIKE: Final = 1e-9
"""Relative speeds in m/s that are rounding: they take 30 years for a metre."""


def boxes(recording: Recording, name: str) -> FloatArray:
    """Corners of an entity's bounding box in m, shape (T, 4, 2), NaN where it does not exist."""
    i = recording.index(name)
    center = recording.center(name)
    return box_corners(center[:, 0], center[:, 1], recording.heading[i], recording.length[i], recording.width[i])


def velocity(recording: Recording, name: str) -> FloatArray:
    """Speed along the heading as a vector in m/s, shape (T, 2), NaN where the entity does not exist."""
    i = recording.index(name)
    heading = recording.heading[i]
    forward: FloatArray = recording.speed[i][:, None] * np.stack([np.cos(heading), np.sin(heading)], -1)
    return forward


def relative_velocity(recording: Recording, ego: str, other: str) -> FloatArray:
    """Velocity of the other seen from the ego in m/s, shape (T, 2), exactly 0 where only rounding sets them apart."""
    return without_rounding(velocity(recording, other) - velocity(recording, ego))


def without_rounding(relative: FloatArray) -> FloatArray:
    """Return relative velocities (T, 2) with those set to 0 that are rounding."""
    size = np.hypot(relative[:, 0], relative[:, 1])
    return np.where((size <= _ALIKE)[:, None], 0.0, relative)
