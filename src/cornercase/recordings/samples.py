"""Create recordings from samples of entities, and check values of untrusted files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray
from cornercase.recordings.recording import Collision, Recording

# Pairs of an entity and an instant: 1 GB.
_MOST: Final = 20_000_000
_FARTHEST: Final = 1e9
# Longest box in m.
_LONGEST: Final = 10_000.0
# Largest time in s.
_LATEST: Final = 1e12


@dataclass
class EntitySamples:
    """Samples of one entity, by time in s; kind and box as in `Recording`.

    A sample has x and y of the box center in m, heading in rad, speed and acceleration; NaN for unknown values.
    """

    kind: str
    length: float
    width: float
    samples: dict[float, tuple[float, float, float, float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class EntityBox:
    """Kind and bounding box of an entity, if the file of its motion lacks them; as in `Recording`."""

    kind: str
    length: float
    width: float


def box_center(x: float, y: float, heading: float, ahead: float, left: float = 0.0) -> tuple[float, float]:
    """Return the center of a box that is `ahead` and `left` m from a point with a heading."""
    # Invalid headings are refused when the recording is created.
    cos, sin = (math.cos(heading), math.sin(heading)) if math.isfinite(heading) else (math.nan, math.nan)
    return x + ahead * cos - left * sin, y + ahead * sin + left * cos


def require_size(path: Path, entities: int, instants: int) -> None:
    """Raise `InputError` if a recording would take too much memory."""
    if entities * instants > _MOST:
        raise InputError(
            f"{path}: has {entities} entities and {instants} instants; at most {_MOST} pairs of both are read."
        )


def require_box(path: Path, name: str, length: float, width: float, center_x: float = 0.0) -> None:
    """Raise `InputError` for an impossible bounding box."""
    if not (0.0 <= length <= _LONGEST and 0.0 <= width <= _LONGEST and abs(center_x) <= _LONGEST):
        raise InputError(
            f"{path}: entity {name} has a box of {length} m x {width} m; lengths from 0 to {_LONGEST:g} m are read."
        )


def require_times(path: Path, time: FloatArray) -> None:
    """Raise `InputError` for times that are not finite or too large."""
    if not np.isfinite(time).all():
        raise InputError(f"{path}: has a time that is not finite.")
    if len(time) and (latest := float(np.abs(time).max())) > _LATEST:
        raise InputError(f"{path}: has a time of {latest:g} s, at most {_LATEST:g} s are read.")


def require_motion(path: Path, motion: FloatArray) -> None:
    """Raise `InputError` for impossible motion, shape (5, N); NaN is allowed."""
    worst = np.nanmax(np.abs(motion), initial=0.0, axis=1)
    for name, largest in zip(("position", "position", "heading", "speed", "acceleration"), worst.tolist(), strict=True):
        if largest > _FARTHEST:
            raise InputError(f"{path}: has a {name} of {largest:g}, at most {_FARTHEST:g} is read.")


@np.errstate(all="ignore")
def recording_of(path: Path, tracks: dict[str, EntitySamples], collisions: Sequence[Collision] = ()) -> Recording:
    """Create a recording from samples of entities, by name.

    Reference points are the box centers. Missing speeds and accelerations are differences along the heading.
    """
    time = np.unique([t for track in tracks.values() for t in track.samples])
    if not len(time):
        raise InputError(f"{path}: holds no moving entity with a position.")
    require_times(path, time)
    require_size(path, len(tracks), len(time))
    motion = np.full((5, len(tracks), len(time)), np.nan)
    for row, (name, track) in enumerate(tracks.items()):
        require_box(path, name, track.length, track.width)
        at = np.searchsorted(time, list(track.samples))
        motion[:, row, at] = np.array(list(track.samples.values())).T
        require_motion(path, motion[:, row])
        x, y, heading, speed, acceleration = motion[:, row]
        exists = np.flatnonzero(np.isfinite(x))
        if np.isnan(speed[exists]).any():
            along = np.cos(heading) * _rate(time, x, exists) + np.sin(heading) * _rate(time, y, exists)
            speed[exists] = np.where(np.isnan(speed), along, speed)[exists]
        if np.isnan(acceleration[exists]).any():
            acceleration[exists] = np.where(np.isnan(acceleration), _rate(time, speed, exists), acceleration)[exists]
    return Recording(
        time=time,
        names=tuple(tracks),
        kinds=tuple(track.kind for track in tracks.values()),
        x=motion[0],
        y=motion[1],
        heading=motion[2],
        speed=motion[3],
        acceleration=motion[4],
        length=np.array([track.length for track in tracks.values()]),
        width=np.array([track.width for track in tracks.values()]),
        center_x=np.zeros(len(tracks)),
        collisions=tuple(collisions),
    )


def _rate(time: FloatArray, values: FloatArray, exists: np.ndarray[tuple[int], np.dtype[np.int64]]) -> FloatArray:
    rate = np.zeros_like(values)
    if len(exists) > 1:
        rate[exists] = np.gradient(values[exists], time[exists])
    return rate
