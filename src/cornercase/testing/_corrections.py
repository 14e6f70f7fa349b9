"""Corrections of a recording; each undoes a common mistake of a simulator, or of the code that connects it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.recordings import Recording

_FOOT: Final = 0.3048
# Time steps by which a recording may be late or early.
_MAX_SHIFT: Final = 4
# Relative drifts of a clock that are tried.
_DRIFTS: Final = [sign * 0.001 * k for k in range(1, 101) for sign in (1, -1)]
# m by which equal positions may differ in files of single precision.
_SAME_POSITION: Final = 1e-3
# m and m/s; smaller differences do not count.
_SMALL_OFFSET, _SMALL_CHANGE = 0.1, 0.05
_ARRAYS: Final = ("x", "y", "heading", "speed", "acceleration")


def box_centers(recording: Recording) -> tuple[FloatArray, FloatArray]:
    """Return x and y in m of the centers of bounding boxes, shape (N, T) each: N entities, T instants."""
    ahead = recording.center_x[:, None]
    return recording.x + ahead * np.cos(recording.heading), recording.y + ahead * np.sin(recording.heading)


def iter_corrections(own: Recording, expected: Recording) -> Iterator[tuple[str, Recording]]:
    """Yield possible mistakes in the recording `own`, each as a clause and with the corrected recording."""
    if own.collisions != expected.collisions:
        verb = "lost" if len(own.collisions) < len(expected.collisions) else "invented or at another time"
        yield f"collisions are {verb}", replace(own, collisions=expected.collisions)
    yield "headings are clockwise", replace(own, heading=-own.heading)
    yield "headings are in degrees", replace(own, heading=np.deg2rad(own.heading))
    yield "y is mirrored", replace(own, y=-own.y, heading=-own.heading)
    yield "y of positions alone is mirrored", replace(own, y=-own.y)
    yield "positions are in feet", replace(own, x=_FOOT * own.x, y=_FOOT * own.y)
    in_metres = replace(own, **{name: _FOOT * getattr(own, name) for name in ("x", "y", "speed", "acceleration")})
    yield "lengths are in feet", in_metres
    # Positions may be in feet, but the offsets to the boxes in metres.
    for _, moved in _iter_reference_point_corrections(in_metres, expected):
        yield "lengths are in feet", moved
    yield "speeds are in km/h", replace(own, speed=own.speed / 3.6)
    yield "speeds are in km/h", replace(own, speed=own.speed / 3.6, acceleration=own.acceleration / 3.6)
    yield "braking is positive", replace(own, acceleration=np.gradient(own.speed, own.time, axis=1))
    yield "the last frame is that before", _without_repeated_end(own)
    yield from _iter_time_shift_corrections(own)
    yield from _iter_reference_point_corrections(own, expected)
    yield from _iter_speed_change_corrections(own, expected)
    drift = min(_DRIFTS, key=partial(_measure_drift_error, own, expected))
    faster = "fast" if drift > 0.0 else "slow"
    yield f"its clock is {abs(drift):.1%} too {faster}", _correct_drift(own, drift)


def _correct_drift(own: Recording, drift: float) -> Recording:
    return replace(own, time=own.time / (1.0 + drift))


def _measure_drift_error(own: Recording, expected: Recording, drift: float) -> float:
    """Return the largest distance in m between own and expected positions, after correction of a clock `drift`."""
    time = own.time / (1.0 + drift)
    at = expected.time[expected.time <= time[-1]]
    rows = [own.entity_index(name) for name in expected.names]
    distances = [
        np.array([np.interp(at, time, values) for values in own_center[rows]]) - expected_center[:, : len(at)]
        for own_center, expected_center in zip(box_centers(own), box_centers(expected), strict=True)
    ]
    return float(np.max(np.hypot(*distances), initial=0.0))


def _without_repeated_end(own: Recording) -> Recording:
    """Return the recording without the last instants, at which no entity moves any more."""
    moves = np.flatnonzero((np.abs(np.diff(own.x)) + np.abs(np.diff(own.y)) > _SAME_POSITION).any(axis=0))
    count = int(moves[-1]) + 2 if moves.size else len(own.time)
    return replace(own, time=own.time[:count], **{name: getattr(own, name)[:, :count] for name in _ARRAYS})


def _iter_time_shift_corrections(own: Recording) -> Iterator[tuple[str, Recording]]:
    step = float(np.median(np.diff(own.time)))
    for count in range(1, _MAX_SHIFT + 1):
        steps = "a time step" if count == 1 else f"{count} time steps"
        for sign, word in ((1, "late"), (-1, "early")):
            yield f"it is {steps} ({count * step:g} s) {word}", replace(own, time=own.time - sign * count * step)


def _iter_reference_point_corrections(own: Recording, expected: Recording) -> Iterator[tuple[str, Recording]]:
    """Yield the recording with each entity moved along its heading, by the estimated error of its reference point."""
    rows = [own.entity_index(name) for name in expected.names]
    shifts, offsets = np.zeros(len(own.names)), np.zeros(len(own.names))
    (x, y), (expected_x, expected_y) = box_centers(own), box_centers(expected)
    for row, e in zip(rows, range(len(expected.names)), strict=True):
        dx = np.interp(expected.time, own.time, x[row]) - expected_x[e]
        dy = np.interp(expected.time, own.time, y[row]) - expected_y[e]
        along = np.cos(expected.heading[e]) * dx + np.sin(expected.heading[e]) * dy
        shifts[row], offsets[row] = float(np.median(along)), expected.center_x[e]
    if (np.abs(shifts) < _SMALL_OFFSET).all():
        return
    moved = replace(
        own,
        x=own.x - shifts[:, None] * np.cos(own.heading),
        y=own.y - shifts[:, None] * np.sin(own.heading),
    )
    if (np.abs(np.abs(shifts) - np.abs(offsets)) < _SMALL_OFFSET).all():
        words = "taken for the centre of the box" if shifts.sum() < 0.0 else "that of the centre of the box"
        yield f"the reference point is {words}", moved
    amounts = ", ".join(f"{name} {shift:+.2f} m" for name, shift in zip(own.names, shifts, strict=True))
    yield f"boxes are about another point of their vehicles ({amounts} ahead)", moved


def _iter_speed_change_corrections(own: Recording, expected: Recording) -> Iterator[tuple[str, Recording]]:
    """Yield the recording with the expected motion of an entity, for each entity that wrongly keeps its first speed."""
    for name in expected.names:
        row, e = own.entity_index(name), expected.entity_index(name)
        changes = np.ptp(expected.speed[e])
        if np.ptp(own.speed[row]) < _SMALL_CHANGE < changes:
            columns = {key: getattr(own, key).copy() for key in _ARRAYS}
            own_x, own_y = box_centers(expected)
            ahead = own.center_x[row]
            heading = np.interp(own.time, expected.time, np.unwrap(expected.heading[e]))
            columns["x"][row] = np.interp(own.time, expected.time, own_x[e]) - ahead * np.cos(heading)
            columns["y"][row] = np.interp(own.time, expected.time, own_y[e]) - ahead * np.sin(heading)
            columns["heading"][row] = heading
            for key in ("speed", "acceleration"):
                columns[key][row] = np.interp(own.time, expected.time, getattr(expected, key)[e])
            yield f"{name} ignores changes of its speed", replace(own, collisions=expected.collisions, **columns)
