"""Conflict area of two recorded tracks, and when each entity was in it.

Exact, also between two instants, since scores computed from it are compared with thresholds and between simulators.
Clustering uses a faster approximation with boxes (`cornercase.clustering`); a test checks that both agree.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from cornercase._common.box_tree import box_tree
from cornercase._common.errors import InputError
from cornercase._common.geometry import box_corners
from cornercase._common.meetings import Meetings
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.metrics._parts.boxes import boxes
from cornercase.metrics._parts.hulls import fill_axes, fill_bounds, find_meetings, least_gap
from cornercase.recordings import Recording

Area = tuple[float, float, float, float, float]

_STILL = 1e-9
"""Largest move of a corner in m between two instants of an entity that stands."""

_ARC = 0.005
"""Largest move of a corner in m by turning in one step; bounds how far a hull exceeds the curved edge."""

TOUCH = 1e-9
"""Tolerance of times in s."""


@dataclass(frozen=True)
class Stay:
    """One visit to a conflict area.

    `entry_time` and `exit_time` are in s; if the entity is still inside when its recording ends, `exit_time` is that
    time. `has_left`: whether it left; `is_standing`: whether it stood in the area at the end instead.
    """

    enters: float
    leaves: float
    left: bool
    stands: bool


def visits(recording: Recording, ego: str, other: str, area: Area | None) -> list[tuple[Stay, Stay]]:
    """Visits of the ego and of the other to each conflict area that they share.

    `area` is a rectangle to use as conflict area; None for the overlap of the areas that both boxes sweep.
    """
    a, b = _Sweep.of(recording, ego), _Sweep.of(recording, other)
    if area is None:
        return _stays(a, b)
    rectangle = _Sweep.of_area(*area)
    return [
        (ego_visit, other_visit) for ego_visit, _ in _stays(a, rectangle) for other_visit, _ in _stays(b, rectangle)
    ]


def checked_area(metric: str, area: Area | None) -> Area | None:
    """Return the rectangle, or raise InputError if it is invalid."""
    if area is not None and (len(area) != 5 or not np.isfinite(area).all() or min(area[3:]) <= 0.0):
        raise InputError(f"{metric} cannot take {area} for its area; give x, y, heading, length > 0, width > 0.")
    return area


class _Sweep:
    """Area that a box sweeps, as n convex hulls of the box before and after a step; a span of standing is one step.

    `center` (n, 2, 2), `heading`, `time` and `speed` (n, 2) hold the values before and after each step, `corners` (n,
    8, 2) and `axes` (n, 8, 2) those of the hulls.
    """

    def __init__(
        self, center: FloatArray, heading: FloatArray, time: FloatArray, speed: FloatArray, size: tuple[float, float]
    ) -> None:
        self.center, self.heading, self.time, self.speed, self.size = center, heading, time, speed, size
        poses = box_corners(center[..., 0], center[..., 1], heading, *size)
        self.corners = poses.reshape(-1, 8, 2)
        self.axes = np.empty_like(self.corners)
        fill_axes(self.corners, self.axes)

    @classmethod
    def of(cls, recording: Recording, name: str) -> _Sweep:
        i = recording.index(name)
        steps = np.stack(_steps(boxes(recording, name)), -1)
        heading = recording.heading[i][steps]
        turn = np.remainder(heading[:, 1] - heading[:, 0] + np.pi, 2.0 * np.pi) - np.pi
        heading[:, 1] = heading[:, 0] + turn
        speed = np.nan_to_num(np.abs(recording.speed[i][steps]))
        size = (float(recording.length[i]), float(recording.width[i]))
        return cls(recording.center(name)[steps], heading, recording.time[steps], speed, size)

    @classmethod
    def of_area(cls, x: float, y: float, heading: float, length: float, width: float) -> _Sweep:
        zeros = np.zeros((1, 2))
        center = np.full((1, 2, 2), (x, y))
        return cls(center, zeros + heading, zeros, zeros, (length, width))

    def divided(self, steps: IntArray) -> _Sweep:
        """Select steps, splitting those that turn, so that the hulls follow the curve."""
        turn = self.heading[steps, 1] - self.heading[steps, 0]
        parts = np.maximum(np.ceil(0.5 * np.hypot(*self.size) * np.abs(turn) / _ARC), 1.0).astype(np.int64)
        which = np.repeat(np.arange(len(steps)), parts)
        part = np.arange(len(which)) - np.repeat(parts.cumsum() - parts, parts)
        fraction = (part[:, None] + np.array([0.0, 1.0])) / parts[which, None]
        step = steps[which]
        motion = self.center[step, 1] - self.center[step, 0]
        time, speed = _interpolate(self.time[step, None], self.speed[step, None], fraction)
        return _Sweep(
            self.center[step, :1] + fraction[..., None] * motion[:, None],
            self.heading[step, :1] + fraction * turn[which, None],
            time,
            speed,
            self.size,
        )

    def backwards(self) -> _Sweep:
        """The same sweep in reverse order."""
        return _Sweep(
            self.center[::-1, ::-1], self.heading[::-1, ::-1], self.time[::-1, ::-1], self.speed[::-1, ::-1], self.size
        )


def _meeting(a: _Sweep, b: _Sweep) -> Meetings:
    """Find which steps of `a` overlap which of `b`."""
    bounds = np.empty((len(b.corners), 4))
    fill_bounds(b.corners, bounds)
    overlap_runs = find_meetings(a.corners, a.axes, *_circle(a), b.corners, b.axes, *_circle(b), box_tree(bounds))
    return Meetings(overlap_runs, (len(a.corners), len(b.corners)))


def _circle(sweep: _Sweep) -> tuple[FloatArray, FloatArray]:
    """Centres and radii of circles around the hulls."""
    middle = sweep.corners.mean(1)
    offsets = sweep.corners - middle[:, None]
    return middle, np.hypot(offsets[..., 0], offsets[..., 1]).max(1, initial=0.0)


def _stays(a: _Sweep, b: _Sweep) -> list[tuple[Stay, Stay]]:
    """Visits of `a` to what `b` sweeps and of `b` to what `a` sweeps, for each connected stretch of both."""
    pairs = [
        (_stay(a, b, overlap.steps(), overlap.met_by), _stay(b, a, overlap.others(), overlap.meeting))
        for overlap in _meeting(a, b).places()
    ]
    return [(visit_a, visit_b) for visit_a, visit_b in pairs if visit_a is not None and visit_b is not None]


def _stay(sweep: _Sweep, area: _Sweep, steps: IntArray, met_by: Callable[[int], BoolArray]) -> Stay | None:
    """Visit of the box of `sweep` to the steps of `area` that its own `steps` overlap."""
    entry = _first_touch(sweep, steps, area, met_by, backwards=False)
    exit_ = _first_touch(sweep, steps[::-1], area, met_by, backwards=True)
    if entry is None or exit_ is None:
        return None
    has_left = exit_ < sweep.time[-1, 1] - TOUCH
    return Stay(entry, exit_, has_left, not has_left and bool(sweep.speed[-1, 1] <= _STILL))


def _first_touch(
    sweep: _Sweep, steps: IntArray, area: _Sweep, met_by: Callable[[int], BoolArray], backwards: bool
) -> float | None:
    """Time of the first touch in the given order of steps; None if only the hulls of curved steps overlapped."""
    for step in steps.tolist():
        fine, obstacles = sweep.divided(np.array([step])), area.divided(np.flatnonzero(met_by(step)))
        fine = fine.backwards() if backwards else fine
        overlaps = _meeting(fine, obstacles)
        touching_parts = overlaps.steps()
        if len(touching_parts):
            part = int(touching_parts[0])
            hit = overlaps.met_by(part)
            fraction = _share(fine.corners[part], obstacles.corners[hit], obstacles.axes[hit])
            return float(_interpolate(fine.time[part], fine.speed[part], np.array(fraction))[0])
    return None


def _share(corners: FloatArray, obstacles: FloatArray, axes: FloatArray) -> float:
    """Fraction of a step after which the box first touches one of some convex shapes."""
    start, motion = corners[:4], corners[4:] - corners[:4]

    def gap(fraction: float) -> float:
        return float(least_gap(start, motion, fraction, obstacles, axes))

    if gap(0.0) <= 0.0:
        return 0.0
    return float(brentq(gap, 0.0, 1.0, xtol=1e-13)) if gap(1.0) <= 0.0 else 1.0


def _interpolate(time: FloatArray, speed: FloatArray, share: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Time and speed (...) after a fraction of a step's length (..., 2); the speed changes linearly in time."""
    before, after = speed[..., 0], speed[..., 1]
    distance = 0.5 * (before + after) * share
    reached = np.sqrt(np.maximum(before**2 + 2.0 * (after - before) * distance, 0.0))
    moves = before + reached > 0.0
    elapsed = np.where(moves, 2.0 * distance / np.where(moves, before + reached, 1.0), share)
    return time[..., 0] + elapsed * (time[..., 1] - time[..., 0]), reached


def _steps(box: FloatArray) -> tuple[IntArray, IntArray]:
    """First and last instant of each move and of each span of standing, (n,) each."""
    exists = np.isfinite(box).all((1, 2))
    before, after = np.append(False, exists[:-1]), np.append(exists[1:], False)
    start = np.flatnonzero(exists & (after | ~before))
    end = np.where(after[start], start + 1, start)
    still = (np.abs(box[end] - box[start]) <= _STILL).all((1, 2))
    continues = still[1:] & still[:-1] & (start[1:] == end[:-1])
    return start[np.append(True, ~continues)[: len(start)]], end[np.append(~continues, True)[: len(end)]]
