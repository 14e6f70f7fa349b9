"""Create recordings from samples of the motion of entities, and check values from untrusted files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.recordings._recording import Collision, Recording

# Pairs of an entity and an instant: 1 GB.
_MAX_SAMPLES: Final = 20_000_000
_MAX_MOTION_VALUE: Final = 1e9
# Longest box in m.
_MAX_BOX_SIZE: Final = 10_000.0
# Largest time in s.
_MAX_TIME: Final = 1e12


@dataclass
class EntitySamples:
    """Samples of the motion of one entity, with its object type and the size of its box in m as in `Recording`.

    `samples` has for each time in s: x and y of the box center in m, heading in rad, speed in m/s and acceleration in
    m/s². An unknown speed or acceleration is NaN.
    """

    object_type: str
    length: float
    width: float
    samples: dict[float, tuple[float, float, float, float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class EntityBox:
    """Object type and box size in m of an entity, as in `Recording`, for files that contain only the motion.

    `ahead` is how far in m the center of the box is ahead of the position that the file contains; None if unknown.
    """

    object_type: str
    length: float
    width: float
    ahead: float | None = None


def box_center_from_point(x: float, y: float, heading: float, ahead: float, left: float = 0.0) -> tuple[float, float]:
    """Return the center of a box that is `ahead` m in front of a reference point, and `left` m to its left."""
    # Invalid headings are refused when the recording is created.
    cos, sin = (math.cos(heading), math.sin(heading)) if math.isfinite(heading) else (math.nan, math.nan)
    return x + ahead * cos - left * sin, y + ahead * sin + left * cos


def require_loadable_size(path: Path, n_entities: int, n_instants: int) -> None:
    """Raise `InputError` if a recording of this size would take too much memory."""
    if n_entities * n_instants > _MAX_SAMPLES:
        raise InputError(
            f"{path}: has {n_entities} entities and {n_instants} instants; at most {_MAX_SAMPLES}"
            f" states (entities times instants) are read."
        )


def require_valid_box(path: Path, name: str, length: float, width: float, center_x: float = 0.0) -> None:
    """Raise `InputError` for an impossible bounding box."""
    if not (0.0 <= length <= _MAX_BOX_SIZE and 0.0 <= width <= _MAX_BOX_SIZE and abs(center_x) <= _MAX_BOX_SIZE):
        raise InputError(
            f"{path}: entity {name} has a box of {length} m x {width} m; lengths from 0 to"
            f" {_MAX_BOX_SIZE:g} m are read."
        )


def require_valid_times(path: Path, time: FloatArray) -> None:
    """Raise `InputError` for times that are not finite or too large."""
    if not np.isfinite(time).all():
        raise InputError(f"{path}: has a time that is not finite.")
    if len(time) and (latest := float(np.abs(time).max())) > _MAX_TIME:
        raise InputError(f"{path}: has a time of {latest:g} s; times up to {_MAX_TIME:g} s are read.")


def require_valid_motion(path: Path, motion: FloatArray) -> None:
    """Raise `InputError` if motion has impossibly large values; NaN is allowed.

    `motion`, shape (5, N), has the five values of N samples: x, y, heading, speed and acceleration.
    """
    worst = np.nanmax(np.abs(motion), initial=0.0, axis=1)
    for name, largest in zip(("position", "position", "heading", "speed", "acceleration"), worst.tolist(), strict=True):
        if largest > _MAX_MOTION_VALUE:
            raise InputError(f"{path}: has a {name} of {largest:g}; values up to {_MAX_MOTION_VALUE:g} are read.")


@np.errstate(all="ignore")
def recording_from_samples(
    path: Path, samples_by_entity: dict[str, EntitySamples], collisions: Sequence[Collision] = ()
) -> Recording:
    """Create a recording from samples of the motion of entities, by entity name.

    The reference points of the recording are the box centers. Missing speeds are derived from the positions, along the
    heading. Missing accelerations are derived from the speeds.
    """
    time = np.unique([t for track in samples_by_entity.values() for t in track.samples])
    if not len(time):
        raise InputError(f"{path}: holds no moving entity with a position.")
    require_valid_times(path, time)
    require_loadable_size(path, len(samples_by_entity), len(time))
    motion = np.full((5, len(samples_by_entity), len(time)), np.nan)
    for row, (name, track) in enumerate(samples_by_entity.items()):
        require_valid_box(path, name, track.length, track.width)
        at = np.searchsorted(time, list(track.samples))
        motion[:, row, at] = np.array(list(track.samples.values())).T
        require_valid_motion(path, motion[:, row])
        x, y, heading, speed, acceleration = motion[:, row]
        exists = np.flatnonzero(np.isfinite(x))
        if np.isnan(speed[exists]).any():
            along = np.cos(heading) * _time_derivative(time, x, exists) + np.sin(heading) * _time_derivative(
                time, y, exists
            )
            speed[exists] = np.where(np.isnan(speed), along, speed)[exists]
        if np.isnan(acceleration[exists]).any():
            acceleration[exists] = np.where(
                np.isnan(acceleration), _time_derivative(time, speed, exists), acceleration
            )[exists]
    return Recording(
        time=time,
        names=tuple(samples_by_entity),
        object_types=tuple(track.object_type for track in samples_by_entity.values()),
        x=motion[0],
        y=motion[1],
        heading=motion[2],
        speed=motion[3],
        acceleration=motion[4],
        length=np.array([track.length for track in samples_by_entity.values()]),
        width=np.array([track.width for track in samples_by_entity.values()]),
        center_x=np.zeros(len(samples_by_entity)),
        collisions=tuple(collisions),
    )


def _time_derivative(
    time: FloatArray, values: FloatArray, exists: np.ndarray[tuple[int], np.dtype[np.int64]]
) -> FloatArray:
    rate = np.zeros_like(values)
    if len(exists) > 1:
        rate[exists] = np.gradient(values[exists], time[exists])
    return rate
