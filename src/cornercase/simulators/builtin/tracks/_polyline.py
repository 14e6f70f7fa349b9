"""Trajectories through vertices."""

from __future__ import annotations

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.simulators.builtin.track_kernels._track_layout import (
    AT_CORNERS,
    POLYLINE_TRACK,
    VERTEX_TOLERANCE,
    TrackTable,
    make_trajectory_table,
)
from cornercase.simulators.builtin.tracks._track import Trajectory, is_uniform


class Polyline(Trajectory):
    """A trajectory along straight lines through V vertices, in N scenarios.

    `x`, `y` (m), `heading` (rad) and `time` (s, not decreasing) have shape (N, V). If the heading is NaN, it is the
    direction of the segment. A `closed` polyline is a loop. `heading_interpolation` says where the heading changes:
    over whole segments (`ALONG_SEGMENTS`), near vertices (`AT_CORNERS`), or abruptly (`AT_VERTICES`). By default the
    speed is constant on each segment. With `begin_speed` (N,) in m/s, the acceleration on each segment is constant
    instead, so that the entity reaches the next vertex at its time.

    Attributes (N, V): `distance` of vertices along the line in m; `vertex_headings` in rad, unwrapped; `speeds` at
    vertices in m/s; `accelerations` in m/s² on the segments that begin at vertices. `directions` (N, V - 1): directions
    of segments in rad. `is_uniform`: True if all arrays are the same in all scenarios.
    """

    _scenario_arrays = (
        "x", "y", "heading", "_time", "distance", "_total_length", "lengths", "directions", "vertex_headings",
        "speeds", "accelerations",
    )  # fmt: skip

    def __init__(
        self,
        x: FloatArray,
        y: FloatArray,
        heading: FloatArray,
        time: FloatArray | None = None,
        closed: bool = False,
        heading_interpolation: int = AT_CORNERS,
        begin_speed: FloatArray | None = None,
    ) -> None:
        if closed:
            x, y, heading = (np.concatenate([a, a[:, :1]], axis=1) for a in (x, y, heading))
        # Kernels read rows of these arrays in place.
        x, y, heading = (np.ascontiguousarray(a) for a in (x, y, heading))
        self.x, self.y, self.heading = x, y, heading
        self._time = None if time is None else np.ascontiguousarray(time)
        self.version = 0
        self.closed, self.heading_interpolation = closed, heading_interpolation
        legs = np.hypot(np.diff(x), np.diff(y))
        self.distance = np.concatenate([np.zeros((len(x), 1)), np.cumsum(legs, axis=1)], axis=1)
        self._total_length = self.distance[:, -1]
        self.lengths = np.full(len(x), np.inf) if closed else self._total_length
        self.directions = _segment_directions(x, y, legs)
        # At the last vertex, a line without headings keeps its direction.
        ends = np.concatenate([self.directions, self.directions[:, -1:]], axis=1)
        facing = np.where(np.isnan(heading), ends, heading)
        # At half a turn, rounding would decide on the direction. As in esmini, a line straight up or down counts as
        # slightly to the right.
        nudged = np.where(
            np.isnan(heading) & (np.abs(np.cos(ends)) < VERTEX_TOLERANCE),
            ends - VERTEX_TOLERANCE * np.sin(ends),
            facing,
        )
        self.vertex_headings = _unwrap_shortest(facing, nudged)
        self.speeds, self.accelerations = None, None
        if time is not None:
            self.speeds, self.accelerations = _speeds_and_accelerations(legs, np.diff(time), begin_speed)
        self._update_uniformity()

    def _update_uniformity(self) -> None:
        self.is_uniform = is_uniform(
            self.x, self.y, self.heading, self._time, self.vertex_headings, self.speeds, self.accelerations
        )

    def copy_scenarios_from(self, other: Trajectory, rows: BoolArray) -> None:
        super().copy_scenarios_from(other, rows)
        self._update_uniformity()

    @property
    def times(self) -> FloatArray | None:
        return self._time

    def _make_table(self) -> TrackTable:
        arrays = (
            self.distance, self.x, self.y, self.heading, self.directions, self.vertex_headings,
            self._time, self.speeds, self.accelerations,
        )  # fmt: skip
        return make_trajectory_table(POLYLINE_TRACK, self.is_uniform, arrays)._replace(
            is_closed=np.array([self.closed]), heading_interpolation=np.array([self.heading_interpolation])
        )

    def curvature_at(self, distance: FloatArray, rows: IntArray) -> FloatArray:
        return np.zeros_like(distance)

    def nearest_distance(
        self, x: FloatArray, y: FloatArray, rows: IntArray, after: FloatArray | None = None
    ) -> FloatArray:
        px, py, distance = self.x[rows], self.y[rows], self.distance[rows]
        dx, dy = np.diff(px), np.diff(py)
        squared = np.maximum(dx * dx + dy * dy, 1e-30)
        fraction = np.clip(((x[:, None] - px[:, :-1]) * dx + (y[:, None] - py[:, :-1]) * dy) / squared, 0.0, 1.0)
        gap = np.hypot(px[:, :-1] + fraction * dx - x[:, None], py[:, :-1] + fraction * dy - y[:, None])
        best = gap.argmin(axis=1)
        rows_of_x = np.arange(len(x))
        return np.asarray(distance[rows_of_x, best] + fraction[rows_of_x, best] * np.diff(distance)[rows_of_x, best])


def _unwrap_shortest(heading: FloatArray, nudged: FloatArray) -> FloatArray:
    """Return headings in rad with full turns added, so that each change is at most half a turn.

    If a change is half a turn, `nudged` (slightly changed headings) decides on the direction.
    """
    turns = np.round((np.unwrap(np.mod(nudged, 2 * np.pi), axis=1) - heading) / (2 * np.pi))
    return np.asarray(heading + 2 * np.pi * (turns - turns[:, :1]))


def _segment_directions(x: FloatArray, y: FloatArray, segment_lengths: FloatArray) -> FloatArray:
    """Return the unwrapped directions of segments in rad, shape (N, V - 1).

    A segment of length 0 gets the direction of the segment before, or of the first segment with a length.
    """
    dx, dy = np.diff(x), np.diff(y)
    direction = np.arctan2(dy, dx)
    rows, first = np.arange(len(x)), (segment_lengths > VERTEX_TOLERANCE).argmax(axis=1)
    current = direction[rows, first]
    for k in range(direction.shape[1]):
        current = np.where(segment_lengths[:, k] > VERTEX_TOLERANCE, direction[:, k], current)
        direction[:, k] = current
    return np.asarray(np.unwrap(direction, axis=1))


def _speeds_and_accelerations(
    segment_lengths: FloatArray, spans: FloatArray, start_speed: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """Return speeds at vertices (m/s), and accelerations on the segments that begin there (m/s²), shape (N, V) each."""
    has_duration = spans > VERTEX_TOLERANCE
    mean = np.where(has_duration, segment_lengths / np.where(has_duration, spans, 1.0), 0.0)
    if start_speed is None:
        # As in esmini, an entity that starts on the last segment has a speed that falls to 0 until the first step.
        return np.concatenate([mean, np.zeros_like(mean[:, -1:])], axis=1), np.zeros(
            (len(segment_lengths), segment_lengths.shape[1] + 1)
        )
    speeds, rates = [start_speed], []
    for k in range(segment_lengths.shape[1]):
        span = np.where(has_duration[:, k], spans[:, k], 1.0)
        rate = 2.0 * (mean[:, k] - speeds[-1]) / span
        speed = speeds[-1] + rate * span
        # With more time than it needs, the entity would have to go backwards: it stops at the next vertex too early.
        stops = (speed < 0.0) != (speeds[-1] < 0.0)
        has_length = segment_lengths[:, k] > VERTEX_TOLERANCE
        braking = -(speeds[-1] ** 2) / (2.0 * np.where(has_length, segment_lengths[:, k], 1.0))
        rates.append(np.where(has_length & has_duration[:, k], np.where(stops, braking, rate), 0.0))
        speeds.append(np.where(has_length & ~stops, np.where(has_duration[:, k], speed, speeds[-1]), 0.0))
    return np.stack(speeds, axis=1), np.stack([*rates, np.zeros_like(start_speed)], axis=1)
