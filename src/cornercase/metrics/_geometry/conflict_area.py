"""Conflict area of two recorded tracks, and the times at which each entity enters and leaves the area.

The times are not rounded to recorded instants, since scores are compared with thresholds and between simulators.
`cornercase.metrics.ending` uses a faster approximation; a test checks that the approximation agrees with these times.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from cornercase._common.errors import InputError
from cornercase._common.geometry.aabb_tree import build_aabb_tree
from cornercase._common.geometry.boxes import box_corners
from cornercase._common.geometry.overlap_runs import OverlapRuns
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.metrics._geometry.boxes import box_corners_over_time
from cornercase.metrics._geometry.swept_hulls import (
    compute_hull_bounds,
    compute_separating_axes,
    find_overlapping_hulls,
    gap_to_nearest_hull,
)
from cornercase.recordings import Recording

Area = tuple[float, float, float, float, float]

_STILL = 1e-9
"""Largest distance in m by which a corner moves between two instants if the entity stands."""

_ARC = 0.005
"""Largest distance in m by which turning moves a corner in one step.

It limits how far a convex hull exceeds the curved edge of the swept area.
"""

TIME_TOLERANCE = 1e-9
"""Tolerance of times in s."""


@dataclass(frozen=True)
class AreaVisit:
    """One visit to a conflict area, with entry and exit time in s.

    If the entity is still inside at its last instant, `exit_time` is the time of this instant, `has_left` is False, and
    `is_standing` says whether the entity stands at this instant.
    """

    entry_time: float
    exit_time: float
    has_left: bool
    is_standing: bool


def area_visits(recording: Recording, ego: str, other: str, area: Area | None) -> list[tuple[AreaVisit, AreaVisit]]:
    """Return pairs of a visit of the ego and a visit of the other entity to the same conflict area.

    `area` is a rectangle to use as conflict area: x, y, heading, length and width. By default, each connected
    overlap of the areas that both boxes sweep is a conflict area.
    """
    a, b = _SweptArea.from_recording(recording, ego), _SweptArea.from_recording(recording, other)
    if area is None:
        return _visits_of_shared_stretches(a, b)
    rectangle = _SweptArea.from_rectangle(*area)
    return [
        (ego_visit, other_visit)
        for ego_visit, _ in _visits_of_shared_stretches(a, rectangle)
        for other_visit, _ in _visits_of_shared_stretches(b, rectangle)
    ]


def validate_area(metric: str, area: Area | None) -> Area | None:
    """Return the rectangle `area` unchanged; InputError, which names `metric`, if it is invalid."""
    if area is not None and (len(area) != 5 or not np.isfinite(area).all() or min(area[3:]) <= 0.0):
        raise InputError(f"{metric} cannot take the area {area}; give x, y, heading, and a length and width above 0.")
    return area


class _SweptArea:
    """Area that a moving box sweeps in n steps; each step is the convex hull of the box before and after the step.

    A period of standing is one step. `center` (n, 2, 2), `heading`, `time` and `speed` (n, 2) hold the values before
    and after each step. `corners` (n, 8, 2) are the corners of the box before and after each step. `axes` (n, 8, 2)
    are the directions in which the hull of a step could be separated from another hull.
    """

    def __init__(
        self, center: FloatArray, heading: FloatArray, time: FloatArray, speed: FloatArray, size: tuple[float, float]
    ) -> None:
        self.center, self.heading, self.time, self.speed, self.size = center, heading, time, speed, size
        poses = box_corners(center[..., 0], center[..., 1], heading, *size)
        self.corners = poses.reshape(-1, 8, 2)
        self.axes = np.empty_like(self.corners)
        compute_separating_axes(self.corners, self.axes)

    @classmethod
    def from_recording(cls, recording: Recording, name: str) -> _SweptArea:
        i = recording.entity_index(name)
        steps = np.stack(_split_into_moves(box_corners_over_time(recording, name)), -1)
        heading = recording.heading[i][steps]
        turn = np.remainder(heading[:, 1] - heading[:, 0] + np.pi, 2.0 * np.pi) - np.pi
        heading[:, 1] = heading[:, 0] + turn
        speed = np.nan_to_num(np.abs(recording.speed[i][steps]))
        size = (float(recording.length[i]), float(recording.width[i]))
        return cls(recording.box_center(name)[steps], heading, recording.time[steps], speed, size)

    @classmethod
    def from_rectangle(cls, x: float, y: float, heading: float, length: float, width: float) -> _SweptArea:
        zeros = np.zeros((1, 2))
        center = np.full((1, 2, 2), (x, y))
        return cls(center, zeros + heading, zeros, zeros, (length, width))

    def subdivide_turning_steps(self, steps: IntArray) -> _SweptArea:
        """Return the swept area of some steps; steps in which the box turns are split into parts.

        The hulls of short parts follow the curved edge of the swept area closely.
        """
        turn = self.heading[steps, 1] - self.heading[steps, 0]
        parts = np.maximum(np.ceil(0.5 * np.hypot(*self.size) * np.abs(turn) / _ARC), 1.0).astype(np.int64)
        which = np.repeat(np.arange(len(steps)), parts)
        part = np.arange(len(which)) - np.repeat(parts.cumsum() - parts, parts)
        fraction = (part[:, None] + np.array([0.0, 1.0])) / parts[which, None]
        step = steps[which]
        motion = self.center[step, 1] - self.center[step, 0]
        time, speed = _time_and_speed_at_fraction(self.time[step, None], self.speed[step, None], fraction)
        return _SweptArea(
            self.center[step, :1] + fraction[..., None] * motion[:, None],
            self.heading[step, :1] + fraction * turn[which, None],
            time,
            speed,
            self.size,
        )

    def reverse_time(self) -> _SweptArea:
        """Return the same swept area with the steps in reverse order."""
        return _SweptArea(
            self.center[::-1, ::-1], self.heading[::-1, ::-1], self.time[::-1, ::-1], self.speed[::-1, ::-1], self.size
        )


def _find_overlapping_steps(a: _SweptArea, b: _SweptArea) -> OverlapRuns:
    """Find which steps of the swept area `a` overlap which steps of the swept area `b`."""
    bounds = np.empty((len(b.corners), 4))
    compute_hull_bounds(b.corners, bounds)
    overlap_runs = find_overlapping_hulls(
        a.corners, a.axes, *_bounding_circles(a), b.corners, b.axes, *_bounding_circles(b), build_aabb_tree(bounds)
    )
    return OverlapRuns(overlap_runs, (len(a.corners), len(b.corners)))


def _bounding_circles(sweep: _SweptArea) -> tuple[FloatArray, FloatArray]:
    """Return the centres and radii of circles around the hulls."""
    middle = sweep.corners.mean(1)
    offsets = sweep.corners - middle[:, None]
    return middle, np.hypot(offsets[..., 0], offsets[..., 1]).max(1, initial=0.0)


def _visits_of_shared_stretches(a: _SweptArea, b: _SweptArea) -> list[tuple[AreaVisit, AreaVisit]]:
    """Return pairs of visits: box a in the area that box b sweeps, and box b in the area that box a sweeps.

    Each connected overlap of both areas gives one pair.
    """
    pairs = [
        (
            _visit_of_area(a, b, overlap.steps_of_first_path(), overlap.overlaps_of_step),
            _visit_of_area(b, a, overlap.steps_of_second_path(), overlap.overlaps_of_other_step),
        )
        for overlap in _find_overlapping_steps(a, b).connected_components()
    ]
    return [(visit_a, visit_b) for visit_a, visit_b in pairs if visit_a is not None and visit_b is not None]


def _visit_of_area(
    sweep: _SweptArea, area: _SweptArea, steps: IntArray, overlapped_by: Callable[[int], BoolArray]
) -> AreaVisit | None:
    """Return the visit of a moving box to a swept area; None if they do not touch.

    `steps` are the steps of `sweep` that overlap the area, and `overlapped_by` returns the steps of `area` that overlap
    a step of `sweep`.
    """
    entry = _time_of_first_touch(sweep, steps, area, overlapped_by, reverse=False)
    exit_ = _time_of_first_touch(sweep, steps[::-1], area, overlapped_by, reverse=True)
    if entry is None or exit_ is None:
        return None
    has_left = exit_ < sweep.time[-1, 1] - TIME_TOLERANCE
    return AreaVisit(entry, exit_, has_left, not has_left and bool(sweep.speed[-1, 1] <= _STILL))


def _time_of_first_touch(
    sweep: _SweptArea, steps: IntArray, area: _SweptArea, overlapped_by: Callable[[int], BoolArray], reverse: bool
) -> float | None:
    """Return the time at which the box first touches the area; None if the box never touches it.

    `steps` are searched in the given order. Each step with a turn is split into short parts, since the hulls of long
    steps can overlap although the boxes do not touch. With `reverse`, the box moves backwards in time.
    """
    for step in steps.tolist():
        fine, obstacles = (
            sweep.subdivide_turning_steps(np.array([step])),
            area.subdivide_turning_steps(np.flatnonzero(overlapped_by(step))),
        )
        fine = fine.reverse_time() if reverse else fine
        overlaps = _find_overlapping_steps(fine, obstacles)
        touching_parts = overlaps.steps_of_first_path()
        if len(touching_parts):
            part = int(touching_parts[0])
            hit = overlaps.overlaps_of_step(part)
            fraction = _fraction_until_touch(fine.corners[part], obstacles.corners[hit], obstacles.axes[hit])
            return float(_time_and_speed_at_fraction(fine.time[part], fine.speed[part], np.array(fraction))[0])
    return None


def _fraction_until_touch(corners: FloatArray, obstacles: FloatArray, axes: FloatArray) -> float:
    """Return the fraction of a step after which the box first touches any of several convex obstacles."""
    start, motion = corners[:4], corners[4:] - corners[:4]

    def gap(fraction: float) -> float:
        return float(gap_to_nearest_hull(start, motion, fraction, obstacles, axes))

    if gap(0.0) <= 0.0:
        return 0.0
    return float(brentq(gap, 0.0, 1.0, xtol=1e-13)) if gap(1.0) <= 0.0 else 1.0


def _time_and_speed_at_fraction(
    time: FloatArray, speed: FloatArray, fraction: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return time and speed after a fraction of the distance of a step; the speed changes linearly in time.

    `time` and `speed` have shape (..., 2): before and after the step.
    """
    before, after = speed[..., 0], speed[..., 1]
    distance = 0.5 * (before + after) * fraction
    reached = np.sqrt(np.maximum(before**2 + 2.0 * (after - before) * distance, 0.0))
    moves = before + reached > 0.0
    elapsed = np.where(moves, 2.0 * distance / np.where(moves, before + reached, 1.0), fraction)
    return time[..., 0] + elapsed * (time[..., 1] - time[..., 0]), reached


def _split_into_moves(corners: FloatArray) -> tuple[IntArray, IntArray]:
    """Return the first and last instant of each step, shape (n,) each.

    A step is two successive instants of a moving entity, or a whole period of standing.
    """
    exists = np.isfinite(corners).all((1, 2))
    before, after = np.append(False, exists[:-1]), np.append(exists[1:], False)
    start = np.flatnonzero(exists & (after | ~before))
    end = np.where(after[start], start + 1, start)
    still = (np.abs(corners[end] - corners[start]) <= _STILL).all((1, 2))
    continues = still[1:] & still[:-1] & (start[1:] == end[:-1])
    return start[np.append(True, ~continues)[: len(start)]], end[np.append(~continues, True)[: len(end)]]
