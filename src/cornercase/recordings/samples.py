"""Samples of many entities, in any order, as a recording."""

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
# Of a box in m: no ship or train is longer.
_LONGEST: Final = 10_000.0
# s: a thousand times the age of the clocks of computers.
_LATEST: Final = 1e12


@dataclass
class EntitySamples:
    """What is known of one entity.

    Attributes
    ----------
    kind : str
        As in `Recording`.
    length, width : float
        Bounding box in m.
    samples : dict of float to tuple of float
        x, y of the box centre in m, heading in rad, speed and acceleration along it in m/s and m/s², by time
        in s; a NaN for what the file does not say.
    """

    kind: str
    length: float
    width: float
    samples: dict[float, tuple[float, float, float, float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class EntityBox:
    """What an entity is, where the file of its motion does not tell.

    Attributes
    ----------
    kind : str
        As in `Recording`.
    length, width : float
        Bounding box in m.
    """

    kind: str
    length: float
    width: float


def box_center(x: float, y: float, heading: float, ahead: float, left: float = 0.0) -> tuple[float, float]:
    """Tell where the centre of a box is.

    Parameters
    ----------
    x, y : float
        Point that moves with the box, in m.
    heading : float
        rad.
    ahead, left : float
        How far the centre lies ahead of and to the left of the point, in m.

    Returns
    -------
    x, y : float
        m.
    """
    # What is no direction is refused when the recording is put together.
    cos, sin = (math.cos(heading), math.sin(heading)) if math.isfinite(heading) else (math.nan, math.nan)
    return x + ahead * cos - left * sin, y + ahead * sin + left * cos


def require_size(path: Path, entities: int, instants: int) -> None:
    """Refuse a recording that would take too much memory: of few rows at many times of many entities.

    Parameters
    ----------
    path : Path
        For messages.
    entities, instants : int
        Numbers of both.

    Raises
    ------
    InputError
        Their product is above 20 million.
    """
    if entities * instants > _MOST:
        raise InputError(
            f"{path}: has {entities} entities and {instants} instants; at most {_MOST} pairs of both are read."
        )


def require_box(path: Path, name: str, length: float, width: float, center_x: float = 0.0) -> None:
    """Refuse a bounding box that nothing on earth has.

    Parameters
    ----------
    path : Path
        For the message.
    name : str
        Whose it is.
    length, width, center_x : float
        As in `Recording`, in m.

    Raises
    ------
    InputError
        One is not finite or negative, or is beyond 10 km.
    """
    if not (0.0 <= length <= _LONGEST and 0.0 <= width <= _LONGEST and abs(center_x) <= _LONGEST):
        raise InputError(
            f"{path}: entity {name} has a box of {length} m x {width} m; lengths from 0 to {_LONGEST:g} m are read."
        )


def require_times(path: Path, time: FloatArray) -> None:
    """Refuse times that are none.

    Parameters
    ----------
    path : Path
        For the message.
    time : ndarray of float64
        s.

    Raises
    ------
    InputError
        One is not finite, or farther from 0 than any clock.
    """
    if not np.isfinite(time).all():
        raise InputError(f"{path}: has a time that is not finite.")
    if len(time) and (latest := float(np.abs(time).max())) > _LATEST:
        raise InputError(f"{path}: has a time of {latest:g} s, at most {_LATEST:g} s are read.")


def require_motion(path: Path, motion: FloatArray) -> None:
    """Refuse motion that nothing on earth has.

    Parameters
    ----------
    path : Path
        For the message.
    motion : ndarray of float64, shape (5, N)
        x, y, heading, speed and acceleration; NaN where nothing is.

    Raises
    ------
    InputError
        One is infinite or far beyond all that moves.
    """
    worst = np.nanmax(np.abs(motion), initial=0.0, axis=1)
    for name, most in zip(("position", "position", "heading", "speed", "acceleration"), worst.tolist(), strict=True):
        if most > _FARTHEST:
            raise InputError(f"{path}: has a {name} of {most:g}, at most {_FARTHEST:g} is read.")


@np.errstate(all="ignore")
def recording_of(path: Path, tracks: dict[str, EntitySamples], collisions: Sequence[Collision] = ()) -> Recording:
    """Put tracks on one time axis.

    Parameters
    ----------
    path : Path
        For messages.
    tracks : dict of str to EntitySamples
        By the names that the entities get.
    collisions : sequence of Collision
        In order of time.

    Returns
    -------
    Recording
        Its reference points are the box centres. Speeds and accelerations that the file does not give are
        differences of positions along the heading, and of speeds.

    Raises
    ------
    InputError
        No entity, a box without size or a time that is not finite.
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
            way = np.cos(heading) * _rate(time, x, exists) + np.sin(heading) * _rate(time, y, exists)
            speed[exists] = np.where(np.isnan(speed), way, speed)[exists]
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
