"""Party to a collision: an entity with its recorded motion until the contact, and how it would go on."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from cornercase._common.geometry.boxes import box_corners
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.recordings import Recording

Poses = tuple[FloatArray, FloatArray, FloatArray]
"""x and y of centres in m, and headings in rad."""

_LOOK_BACK: Final = 10.0

STANDING_SPEED: Final = 0.1
"""Speed in m/s below which an entity stands."""


@dataclass(frozen=True, eq=False)
class Party:
    """Motion of an entity at T instants until a contact; after the contact, speed and direction stay the same.

    `time` in s; `x` and `y` of the box's centre in m; `heading` in rad, without jumps by 2π; `speed` in m/s, negative
    when reversing; shape (T,) each. `size` is length and width in m.
    """

    name: str
    object_type: str
    time: FloatArray
    x: FloatArray
    y: FloatArray
    heading: FloatArray
    speed: FloatArray
    size: tuple[float, float]

    @classmethod
    def from_recording(cls, recording: Recording, name: str, end: float, look_back: float = _LOOK_BACK) -> Party:
        """Create a party from its recorded motion in the time before `end`, of the length `look_back`; both in s.

        If the entity was absent in between, only its motion since then is used. The party has no instants if its
        motion is unknown.
        """
        i = recording.entity_index(name)
        center = recording.box_center(name)
        is_known = np.isfinite(center).all(axis=1) & np.isfinite(recording.heading[i] + recording.speed[i])
        is_recent = (recording.time <= end + 1e-9) & (recording.time >= end - look_back)
        # The entity may have vanished and come again: use the time since it came last.
        instants = np.flatnonzero(is_known & is_recent)
        if len(instants):
            gaps = np.flatnonzero(np.diff(instants) > 1)
            instants = instants[gaps[-1] + 1 :] if len(gaps) else instants
        return cls(
            name,
            recording.object_types[i].lower(),
            recording.time[instants],
            center[instants, 0],
            center[instants, 1],
            _unwrap_headings(recording.heading[i, instants]),
            recording.speed[i, instants],
            (float(recording.length[i]), float(recording.width[i])),
        )

    @property
    def is_pedestrian(self) -> bool:
        """True if the party is a person on foot or in a wheelchair, or an animal."""
        return self.object_type in ("pedestrian", "wheelchair", "animal")

    @cached_property
    def distance(self) -> FloatArray:
        """Distance driven up to each instant in m, shape (T,)."""
        return np.append(0.0, np.cumsum(np.hypot(np.diff(self.x), np.diff(self.y))))

    def speed_at(self, time: float) -> float:
        """Return the speed in m/s, negative when reversing; `time` is in s."""
        return float(np.interp(time, self.time, self.speed))

    def direction_at(self, time: float) -> float:
        """Return the direction of motion in rad, for a standing party its heading; `time` is in s."""
        heading = float(np.interp(time, self.time, self.heading))
        return heading + np.pi if self.speed_at(time) < -STANDING_SPEED else heading

    def velocity_at(self, time: float) -> FloatArray:
        """Return the velocity in m/s, shape (2,); `time` is in s."""
        heading = np.interp(time, self.time, self.heading)
        return self.speed_at(time) * np.array([np.cos(heading), np.sin(heading)])

    def poses_at(self, time: FloatArray) -> Poses:
        """Return the poses of the box at n times in s, shape (n,).

        After its last recorded instant, the party goes straight on at constant speed.
        """
        after = np.maximum(time - self.time[-1], 0.0)
        velocity = self.velocity_at(float(self.time[-1]))
        return (
            np.interp(time, self.time, self.x) + velocity[0] * after,
            np.interp(time, self.time, self.y) + velocity[1] * after,
            np.interp(time, self.time, self.heading),
        )

    def poses_along(self, distance: FloatArray) -> Poses:
        """Return the poses of the box after driven distances in m, an array of any shape, along the path of the party.

        Beyond the end of the path, the party goes straight on.
        """
        beyond = np.maximum(distance - self.distance[-1], 0.0)
        end = self.direction_at(float(self.time[-1]))
        return (
            np.interp(distance, self.distance, self.x) + np.cos(end) * beyond,
            np.interp(distance, self.distance, self.y) + np.sin(end) * beyond,
            np.interp(distance, self.distance, self.heading),
        )

    def corners(self, poses: Poses) -> FloatArray:
        """Return the corners of the box at given poses, shape (..., 4, 2)."""
        return box_corners(*poses, *self.size)


def _unwrap_headings(heading: FloatArray) -> FloatArray:
    """Remove jumps by 2π from headings in rad; a quick check first, since most headings have no jumps."""
    return np.unwrap(heading) if len(heading) > 1 and np.abs(heading[1:] - heading[:-1]).max() > np.pi else heading


def iter_obstacles(
    recording: Recording, names: tuple[str, str], end: float, look_back: float = _LOOK_BACK
) -> Iterator[Party]:
    """Yield the motion of all entities except the two in `names`; `end` and `look_back` as in `Party.from_recording`.

    Entities whose motion is unknown are left out.
    """
    for name in recording.names:
        if name not in names and len((party := Party.from_recording(recording, name, end, look_back)).time):
            yield party


def boxes_touch(first: Party, poses: Poses, second: Party, other_poses: Poses) -> BoolArray:
    """Return whether the boxes of two entities touch at given poses; the two arrays of poses are broadcast.

    Only boxes that are close to each other are compared exactly, by the separating axis theorem.
    """
    reach = 0.5 * (math.hypot(*first.size) + math.hypot(*second.size))
    dx, dy = other_poses[0] - poses[0], other_poses[1] - poses[1]
    touches: BoolArray = dx**2 + dy**2 <= reach**2 * (1.0 + 1e-9)
    if touches.any():
        dx, dy = dx[touches], dy[touches]
        heading, other_heading = (np.broadcast_to(values[2], touches.shape)[touches] for values in (poses, other_poses))
        cos, sin = np.abs(np.cos(other_heading - heading)), np.abs(np.sin(other_heading - heading))
        overlap = np.ones(len(dx), dtype=np.bool_)
        for axis, (length, width), (other_length, other_width) in (
            (heading, first.size, second.size),
            (other_heading, second.size, first.size),
        ):
            along, across = np.cos(axis), np.sin(axis)
            overlap &= np.abs(dx * along + dy * across) <= 0.5 * (length + other_length * cos + other_width * sin)
            overlap &= np.abs(dy * along - dx * across) <= 0.5 * (width + other_length * sin + other_width * cos)
        touches[touches] = overlap
    return touches
