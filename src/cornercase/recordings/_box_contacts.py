"""Find collisions from the boxes of a recording, for files that do not name who has collided."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from cornercase._common.geometry.boxes import box_corners, box_distance
from cornercase._common.typing import FloatArray
from cornercase.recordings._recording import Collision, Recording

# Largest gap in m between two boxes at which a count of a collision sensor is attributed to them.
_SENSOR_REACH: Final = 1.0


def find_collisions(recording: Recording, sensing_entity: str, hits: Sequence[float] = ()) -> tuple[Collision, ...]:
    """Return the first contact of each pair of boxes, in order of time.

    `hits` are times in s at which a collision sensor of the entity `sensing_entity` counted a contact. A hit is a
    collision with the entity that is nearest at that time, unless the gap is more than 1 m.
    """
    ahead = recording.center_x[:, None]
    x = recording.x + ahead * np.cos(recording.heading)
    y = recording.y + ahead * np.sin(recording.heading)
    corners = box_corners(x, y, recording.heading, recording.length[:, None], recording.width[:, None])
    first = dict[tuple[int, int], float]()
    gaps = dict[tuple[int, int], FloatArray]()
    for pair in itertools.combinations(range(len(recording.names)), 2):
        gaps[pair] = gap = box_distance(corners[pair[0]], corners[pair[1]])
        touching = np.flatnonzero(gap <= 0.0)
        if touching.size:
            first[pair] = float(recording.time[touching[0]])
    e = recording.names.index(sensing_entity)
    for hit in hits:
        t = int(np.searchsorted(recording.time, hit))
        near = {pair: float(gap[t]) for pair, gap in gaps.items() if e in pair and gap[t] <= _SENSOR_REACH}
        if near:
            pair = min(near, key=near.__getitem__)
            first[pair] = min(first.get(pair, hit), hit)
    return tuple(
        Collision(time, (recording.names[a], recording.names[b]))
        for (a, b), time in sorted(first.items(), key=lambda item: item[1])
    )


def cut_after(recording: Recording, end: float) -> Recording:
    """Return the part of a recording up to the time `end` in s."""
    count = int((recording.time <= end + 1e-9).sum())
    return replace(
        recording,
        time=recording.time[:count],
        **{name: getattr(recording, name)[:, :count] for name in ("x", "y", "heading", "speed", "acceleration")},
        collisions=tuple(collision for collision in recording.collisions if collision.time <= end + 1e-9),
    )
