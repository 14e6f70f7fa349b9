"""Positions, speeds and directions of entities as time series without missing values."""

from __future__ import annotations

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.recordings._recording import Recording


def position_series(recording: Recording, entity: str, fallback_entity: str | None = None) -> FloatArray:
    """Return the center of an entity's box in m at T instants, shape (T, 2).

    If the entity never exists, `fallback_entity` takes its place.
    """
    center = recording.box_center(entity)
    if fallback_entity is not None and not np.isfinite(center).all(axis=1).any():
        return position_series(recording, fallback_entity)
    return _fill_missing_instants(center)


def speed_series(recording: Recording, entity: str) -> FloatArray:
    """Return the speed of an entity in m/s at T instants, shape (T, 1)."""
    return _fill_missing_instants(recording.speed[recording.entity_index(entity)][:, None])


def relative_position_series(recording: Recording, ego: str, other: str) -> FloatArray:
    """Return the position of the other entity in the ego's coordinate frame in m at T instants, shape (T, 2)."""
    x, y = (position_series(recording, other, ego) - position_series(recording, ego)).T
    heading = _fill_missing_instants(recording.heading[recording.entity_index(ego)][:, None])[:, 0]
    cos, sin = np.cos(heading), np.sin(heading)
    return np.column_stack((cos * x + sin * y, cos * y - sin * x))


def bearing_series(recording: Recording, ego: str, other: str) -> FloatArray:
    """Return the direction from the ego to the other entity as unit vectors at T instants, shape (T, 2).

    The vector is zero if both are at the same point.
    """
    relative = relative_position_series(recording, ego, other)
    distance = np.hypot(relative[:, :1], relative[:, 1:])
    return np.divide(relative, distance, out=np.zeros_like(relative), where=distance > 0.0)


def _fill_missing_instants(values: FloatArray) -> FloatArray:
    """Fill instants at which an entity does not exist with its last earlier values, or with its first values.

    All values are 0 if the entity never exists.
    """
    exists = np.isfinite(values).all(axis=1)
    if exists.all():
        return values
    if not exists.any():
        return np.nan_to_num(values)
    last = np.maximum.accumulate(np.where(exists, np.arange(len(values)), -1))
    return np.asarray(values[np.where(last < 0, np.argmax(exists), last)])
