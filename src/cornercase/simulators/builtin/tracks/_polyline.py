"""Trajectories through vertices."""

from __future__ import annotations

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.simulators.builtin.track_kernels._track_layout import CORNER_HALF_LENGTH, VERTEX_TOLERANCE
from cornercase.simulators.builtin.tracks._track import ALONG_SEGMENTS, AT_CORNERS, Trajectory, is_uniform


class Polyline(Trajectory):
    """A trajectory through V vertices.

    `x`, `y` (m), `heading` (rad; NaN: direction of the segment) and `time` (s, not decreasing) have shape (N, V). A
    `closed` one is a loop. `heading_interpolation` says where the heading changes: over whole segments, near corners,
    or at the vertices. With `begin_speed`, (N,), in m/s, acceleration is constant on each segment, so that the next
    vertex is reached in time; without it, speed is.

    Attributes at vertices, (N, V): `distance` along the line in m; `vertex_headings`, unwrapped heading in rad;
    `speeds` in m/s, and `accelerations`, accelerations in m/s² on the segment that begins there. `directions`, (N, V -
    1), in rad. `is_uniform`: all of that is the same in all scenarios.
    """

    _scenario_arrays = (
        "x",
        "y",
        "heading",
        "_time",
        "distance",
        "_total_length",
        "lengths",
        "directions",
        "vertex_headings",
        "speeds",
        "accelerations",
    )

    def __init__(
        self,
        x: FloatArray,
        y: FloatArray,
        heading: FloatArray,
        time: FloatArray | None = None,
        closed: bool = False,
        heading_interpolation: str = AT_CORNERS,
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
        # The direction of half a turn would depend on rounding: as in esmini, straight up or down counts as slightly
        # right.
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

    def copy_rows_from(self, other: Trajectory, rows: BoolArray) -> None:
        super().copy_rows_from(other, rows)
        self._update_uniformity()

    @property
    def times(self) -> FloatArray | None:
        return self._time

    def pose_at(
        self, distance: FloatArray, offset: FloatArray, rows: IntArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        distance = self._wrap_closed(distance, rows)
        clipped, segment, fraction = self._locate_on_segment(distance, rows, 0.0)
        x0, y0 = self.x[rows, segment], self.y[rows, segment]
        x = x0 + fraction * (self.x[rows, segment + 1] - x0)
        y = y0 + fraction * (self.y[rows, segment + 1] - y0)
        beyond = distance - clipped
        if beyond.any() or offset.any():
            direction = self.directions[rows, segment]
            cos, sin = np.cos(direction), np.sin(direction)
            x, y = x + beyond * cos - offset * sin, y + beyond * sin + offset * cos
        return x, y, self._heading_at(distance, rows)

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

    def has_heading_at(self, distance: FloatArray, rows: IntArray) -> BoolArray:
        distance = self._wrap_closed(distance, rows)
        _, segment, _ = self._locate_on_segment(distance, rows)
        # On a segment, the vertex at its beginning counts.
        vertex = np.where(distance > self._total_length[rows] - VERTEX_TOLERANCE, self.heading.shape[1] - 1, segment)
        return np.asarray(~np.isnan(self.heading[rows, vertex]))

    def direction_at(self, distance: FloatArray, rows: IntArray) -> FloatArray:
        distance = self._wrap_closed(distance, rows)
        return np.asarray(self.directions[rows, self._locate_on_segment(distance, rows)[1]])

    def _wrap_closed(self, distance: FloatArray, rows: IntArray) -> FloatArray:
        return np.mod(distance, self._total_length[rows]) if self.closed else distance

    def distance_at_time(self, time: FloatArray) -> FloatArray:
        assert self._time is not None
        assert self.speeds is not None
        assert self.accelerations is not None
        rows = np.arange(len(time))
        segment = (self._time[:, 1:-1] <= time[:, None]).sum(axis=1)
        elapsed = np.maximum(time - self._time[rows, segment], 0.0)
        speed, rate = self.speeds[rows, segment], self.accelerations[rows, segment]
        begin, length = self.distance[rows, segment], self.distance[rows, segment + 1] - self.distance[rows, segment]
        span = self._time[rows, segment + 1] - self._time[rows, segment]
        at_constant_speed = begin + np.clip(elapsed / np.where(span > 0.0, span, np.inf), 0.0, 1.0) * length
        # An entity that brakes to a stop waits there for the rest of the segment's time.
        stops = rate < 0.0
        elapsed = np.where(stops, np.minimum(elapsed, -speed / np.where(stops, rate, 1.0)), elapsed)
        accelerated = begin + speed * elapsed + 0.5 * rate * elapsed**2
        distance = np.where(rate == 0.0, at_constant_speed, accelerated)
        return np.asarray(np.where(time > self._time[:, -1], self._total_length, distance))

    def time_and_speed_at(self, distance: FloatArray) -> tuple[FloatArray, FloatArray]:
        assert self._time is not None
        assert self.speeds is not None
        rows = np.arange(len(distance))
        _, segment, fraction = self._locate_on_segment(distance, rows)
        t0, t1 = self._time[rows, segment], self._time[rows, segment + 1]
        v0, v1 = self.speeds[rows, segment], self.speeds[rows, segment + 1]
        return t0 + fraction * (t1 - t0), v0 + fraction * (v1 - v0)

    def _locate_on_segment(
        self, distance: FloatArray, rows: IntArray, tolerance: float = VERTEX_TOLERANCE
    ) -> tuple[FloatArray, IntArray, FloatArray]:
        """Distance clipped to the line, its segment, and the fraction of the segment.

        A segment begins `tolerance` after its vertex.
        """
        table = self.distance[rows]
        clipped = np.clip(distance, 0.0, table[:, -1])
        segment = (table[:, 1:-1] + tolerance <= clipped[:, None]).sum(axis=1)
        indices = np.arange(len(rows))
        span = table[indices, segment + 1] - table[indices, segment]
        fraction = (clipped - table[indices, segment]) / np.where(span > 0, span, 1.0)
        return clipped, segment, np.where(span > 0, fraction, 0.0)

    def _heading_at(self, distance: FloatArray, rows: IntArray) -> FloatArray:
        clipped, segment, fraction = self._locate_on_segment(distance, rows)
        current, after = self.vertex_headings[rows, segment], self.vertex_headings[rows, segment + 1]
        table, indices, last = self.distance[rows], np.arange(len(rows)), self.distance.shape[1] - 2
        at_end = clipped > table[:, -1] - VERTEX_TOLERANCE
        if self.heading_interpolation == ALONG_SEGMENTS:
            return np.asarray(current + np.where(at_end, 1.0, fraction) * (after - current))
        heading = current
        if self.heading_interpolation == AT_CORNERS:
            before = self.vertex_headings[rows, np.maximum(segment - 1, 0)]
            span = table[indices, segment + 1] - table[indices, segment]
            reach = np.maximum(np.minimum(CORNER_HALF_LENGTH, 0.5 * span), VERTEX_TOLERANCE)
            since_start = clipped - table[indices, segment]
            until_end = span - since_start
            begins, ends = since_start < reach, until_end < reach
            # The last segment turns fully to its end heading, any other halfway.
            fraction_at_end = np.where(segment < last, 0.5 * (1.0 - until_end / reach), 1.0 - until_end / reach)
            entered = before + 0.5 * (1.0 + since_start / reach) * (current - before)
            leaving = np.where(ends, current + fraction_at_end * (after - current), current)
            heading = np.where(begins, np.where(segment > 0, entered, current), leaving)
        return np.where(at_end, after, heading)


def _unwrap_shortest(heading: FloatArray, nudged: FloatArray) -> FloatArray:
    """Headings with full turns added, so that each change is the shorter one; the first stays.

    Half a turn goes in the direction of `nudged`.
    """
    turns = np.round((np.unwrap(np.mod(nudged, 2 * np.pi), axis=1) - heading) / (2 * np.pi))
    return np.asarray(heading + 2 * np.pi * (turns - turns[:, :1]))


def _segment_directions(x: FloatArray, y: FloatArray, segment_lengths: FloatArray) -> FloatArray:
    """Segment directions; without a length, that of the segment before it, or of the first with a length."""
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
    """Speeds at vertices, and accelerations of the segments that begin there, each (N, V)."""
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
        # There is more time than any speed needs: it stops at the next vertex before the time.
        stops = (speed < 0.0) != (speeds[-1] < 0.0)
        has_length = segment_lengths[:, k] > VERTEX_TOLERANCE
        braking = -(speeds[-1] ** 2) / (2.0 * np.where(has_length, segment_lengths[:, k], 1.0))
        rates.append(np.where(has_length & has_duration[:, k], np.where(stops, braking, rate), 0.0))
        speeds.append(np.where(has_length & ~stops, np.where(has_duration[:, k], speed, speeds[-1]), 0.0))
    return np.stack(speeds, axis=1), np.stack([*rates, np.zeros_like(start_speed)], axis=1)
