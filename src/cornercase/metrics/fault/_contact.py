"""First contact of two boxes: its time and point, and the side of each box that is hit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.geometry.boxes import box_corners, boxes_overlap
from cornercase._common.typing import FloatArray
from cornercase.metrics._outcome import Side
from cornercase.metrics.fault._party import Party, boxes_touch
from cornercase.recordings import Recording

_MAX_DELAY: Final = 1.0
"""Longest time in s by which a simulator may report a contact after its boxes touch."""

_TOUCHING_GAP: Final = 0.5
"""Gap in m up to which boxes count as touching at a reported contact: shapes of a simulator differ from boxes."""

_CORNER: Final = 0.15
"""Distance in m from two sides within which a contact is at their corner."""

_N_REFINEMENTS, _N_PARTS = 3, 16
"""Number of times that the step with the contact is divided, and number of parts of each division."""


@dataclass(frozen=True)
class Contact:
    """The first contact of two boxes: time in s, point in m, and the side of each box that is hit."""

    time: float
    point: tuple[float, float]
    sides: tuple[Side, Side]


def find_contact(recording: Recording, names: tuple[str, str], reported: float) -> Contact | str:
    """Find the contact that a simulator reports at the time `reported` in s.

    If boxes and motion do not show the contact, return a sentence that says why.
    """
    parties = [Party.from_recording(recording, name, reported + _MAX_DELAY) for name in names]
    if not all(len(party.time) for party in parties):
        return "their motion is unknown"
    begin = max(float(party.time[0]) for party in parties)
    index = int(np.abs(recording.time - reported).argmin())
    times = recording.time[(recording.time >= max(begin, reported - _MAX_DELAY) - 1e-9)][: index + 1]
    times = times[times <= recording.time[index] + 1e-9]
    if not len(times) or any(float(party.time[-1]) < times[-1] - _MAX_DELAY for party in parties):
        return "their motion at the contact is unknown"
    first, second = parties
    touches = boxes_touch(first, first.poses_at(times), second, second.poses_at(times))
    if not touches[-1]:
        low = high = float(times[-1])
        if not boxes_overlap(*(_corners_with_margin(party, high, 0.5 * _TOUCHING_GAP) for party in parties)):
            return "their boxes do not touch in the recording"
        low = float(times[-2]) if len(times) > 1 else high
    else:
        if touches.all():
            return "they touch from the beginning"
        start = len(touches) - int(np.argmin(touches[::-1]))
        low, high = float(times[start - 1]), float(times[start])
        for _ in range(_N_REFINEMENTS):
            grid = np.linspace(low, high, _N_PARTS + 1)
            start = int(boxes_touch(first, first.poses_at(grid), second, second.poses_at(grid))[1:].argmax())
            low, high = float(grid[start]), float(grid[start + 1])
    boxes = [_corners_with_margin(party, high, 0.01 if touches[-1] else 0.5 * _TOUCHING_GAP) for party in parties]
    point = _overlap_center(*boxes)
    # The motion before the contact: a simulator may have changed it at the contact.
    before = low if touches[-1] else min(low, high)
    velocities = [party.velocity_at(before) for party in parties]
    sides = tuple(_side_hit(party, high, point, velocities[1 - k] - velocities[k]) for k, party in enumerate(parties))
    return Contact(high, (float(point[0]), float(point[1])), (sides[0], sides[1]))


def _corners_with_margin(party: Party, time: float, margin: float) -> FloatArray:
    """Return the corners of the box of a party at a time in s, with a margin in m around the box, shape (4, 2)."""
    x, y, heading = (np.interp(time, party.time, values) for values in (party.x, party.y, party.heading))
    return box_corners(x, y, heading, party.size[0] + 2.0 * margin, party.size[1] + 2.0 * margin)


def _overlap_center(box: FloatArray, other: FloatArray) -> FloatArray:
    """Return the mean of the corners of the overlap of two boxes, shape (2,) (Sutherland and Hodgman clipping)."""
    overlap = list(box)
    for k in range(4):
        start, edge = other[k], other[(k + 1) % 4] - other[k]
        inside = [edge[0] * (p - start)[1] - edge[1] * (p - start)[0] for p in overlap]
        clipped = []
        for p, at, q, after in zip(overlap, inside, overlap[1:] + overlap[:1], inside[1:] + inside[:1], strict=True):
            if at >= 0.0:
                clipped.append(p)
            if at * after < 0.0:
                clipped.append(p + at / (at - after) * (q - p))
        overlap = clipped or overlap
    return np.asarray(np.mean(overlap, axis=0))


def _side_hit(party: Party, time: float, point: FloatArray, approach: FloatArray) -> Side:
    """Return the side of the party's box that is nearest to the point of contact.

    Near a corner, two sides are near: return the one towards which the other entity moves faster. `approach` is the
    velocity of the other entity relative to the party in m/s.
    """
    x, y, heading = (float(np.interp(time, party.time, values)) for values in (party.x, party.y, party.heading))
    cos, sin = np.cos(heading), np.sin(heading)
    ahead, left = cos * (point[0] - x) + sin * (point[1] - y), cos * (point[1] - y) - sin * (point[0] - x)
    along, across = cos * approach[0] + sin * approach[1], cos * approach[1] - sin * approach[0]
    half_length, half_width = 0.5 * party.size[0], 0.5 * party.size[1]
    sides: tuple[tuple[Side, float, float], ...] = (
        ("front", half_length - ahead, -along),
        ("rear", half_length + ahead, along),
        ("left", half_width - left, -across),
        ("right", half_width + left, across),
    )
    nearest = min(inside for _, inside, _ in sides)
    return max((side for side in sides if side[1] <= nearest + _CORNER), key=lambda side: side[2])[0]
