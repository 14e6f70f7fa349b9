"""Trajectories through vertices."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.simulators.builtin.tracks.track import ALONG_LEGS, AT_CORNERS, Trajectory, same_in_all

CORNER: Final = 2.0
"""m; half the length over which the heading turns at a corner of a polyline (esmini's value)."""

TINY: Final = 1e-6
"""m or s; closer vertices coincide."""


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

    _arrays = (
        "x", "y", "heading", "_time", "distance", "_length", "lengths", "directions", "facing", "speeds", "rates",
    )  # fmt: skip

    def __init__(
        self,
        x: FloatArray,
        y: FloatArray,
        heading: FloatArray,
        time: FloatArray | None = None,
        closed: bool = False,
        turning: str = AT_CORNERS,
        begin_speed: FloatArray | None = None,
    ) -> None:
        if closed:
            x, y, heading = (np.concatenate([a, a[:, :1]], axis=1) for a in (x, y, heading))
        # Kernels read rows of these arrays in place.
        x, y, heading = (np.ascontiguousarray(a) for a in (x, y, heading))
        self.x, self.y, self.heading = x, y, heading
        self._time = None if time is None else np.ascontiguousarray(time)
        self.version = 0
        self.closed, self.turning = closed, turning
        legs = np.hypot(np.diff(x), np.diff(y))
        self.distance = np.concatenate([np.zeros((len(x), 1)), np.cumsum(legs, axis=1)], axis=1)
        self._length = self.distance[:, -1]
        self.lengths = np.full(len(x), np.inf) if closed else self._length
        self.directions = _directions(x, y, legs)
        # At the last vertex, a line without headings keeps its direction.
        ends = np.concatenate([self.directions, self.directions[:, -1:]], axis=1)
        facing = np.where(np.isnan(heading), ends, heading)
        # The direction of half a turn would depend on rounding: as in esmini, straight up or down counts as slightly
        # right.
        nudged = np.where(np.isnan(heading) & (np.abs(np.cos(ends)) < TINY), ends - TINY * np.sin(ends), facing)
        self.facing = _unwound(facing, nudged)
        self.speeds, self.rates = None, None
        if time is not None:
            self.speeds, self.rates = _motion(legs, np.diff(time), begin_speed)
        self._compare()

    def _compare(self) -> None:
        self.alike = same_in_all(self.x, self.y, self.heading, self._time, self.facing, self.speeds, self.rates)

    def adopt(self, other: Trajectory, rows: BoolArray) -> None:
        super().adopt(other, rows)
        self._compare()

    @property
    def time(self) -> FloatArray | None:
        return self._time

    def at(self, distance: FloatArray, offset: FloatArray, rows: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        distance = self._round(distance, rows)
        clipped, segment, fraction = self._leg(distance, rows, 0.0)
        x0, y0 = self.x[rows, segment], self.y[rows, segment]
        x = x0 + fraction * (self.x[rows, segment + 1] - x0)
        y = y0 + fraction * (self.y[rows, segment + 1] - y0)
        beyond = distance - clipped
        if beyond.any() or offset.any():
            direction = self.directions[rows, segment]
            cos, sin = np.cos(direction), np.sin(direction)
            x, y = x + beyond * cos - offset * sin, y + beyond * sin + offset * cos
        return x, y, self._heading(distance, rows)

    def curvature(self, distance: FloatArray, rows: IntArray) -> FloatArray:
        return np.zeros_like(distance)

    def nearest(self, x: FloatArray, y: FloatArray, rows: IntArray, after: FloatArray | None = None) -> FloatArray:
        px, py, distance = self.x[rows], self.y[rows], self.distance[rows]
        dx, dy = np.diff(px), np.diff(py)
        squared = np.maximum(dx * dx + dy * dy, 1e-30)
        fraction = np.clip(((x[:, None] - px[:, :-1]) * dx + (y[:, None] - py[:, :-1]) * dy) / squared, 0.0, 1.0)
        gap = np.hypot(px[:, :-1] + fraction * dx - x[:, None], py[:, :-1] + fraction * dy - y[:, None])
        best = gap.argmin(axis=1)
        rows_of_x = np.arange(len(x))
        return np.asarray(distance[rows_of_x, best] + fraction[rows_of_x, best] * np.diff(distance)[rows_of_x, best])

    def oriented(self, distance: FloatArray, rows: IntArray) -> BoolArray:
        distance = self._round(distance, rows)
        _, segment, _ = self._leg(distance, rows)
        # On a segment, the vertex at its beginning counts.
        vertex = np.where(distance > self._length[rows] - TINY, self.heading.shape[1] - 1, segment)
        return np.asarray(~np.isnan(self.heading[rows, vertex]))

    def direction(self, distance: FloatArray, rows: IntArray) -> FloatArray:
        distance = self._round(distance, rows)
        return np.asarray(self.directions[rows, self._leg(distance, rows)[1]])

    def _round(self, distance: FloatArray, rows: IntArray) -> FloatArray:
        return np.mod(distance, self._length[rows]) if self.closed else distance

    def distance_at(self, time: FloatArray) -> FloatArray:
        assert self._time is not None
        assert self.speeds is not None
        assert self.rates is not None
        rows = np.arange(len(time))
        segment = (self._time[:, 1:-1] <= time[:, None]).sum(axis=1)
        elapsed = np.maximum(time - self._time[rows, segment], 0.0)
        speed, rate = self.speeds[rows, segment], self.rates[rows, segment]
        begin, length = self.distance[rows, segment], self.distance[rows, segment + 1] - self.distance[rows, segment]
        span = self._time[rows, segment + 1] - self._time[rows, segment]
        at_constant_speed = begin + np.clip(elapsed / np.where(span > 0.0, span, np.inf), 0.0, 1.0) * length
        # An entity that brakes to a stop waits there for the rest of the segment's time.
        stops = rate < 0.0
        elapsed = np.where(stops, np.minimum(elapsed, -speed / np.where(stops, rate, 1.0)), elapsed)
        accelerated = begin + speed * elapsed + 0.5 * rate * elapsed**2
        distance = np.where(rate == 0.0, at_constant_speed, accelerated)
        return np.asarray(np.where(time > self._time[:, -1], self._length, distance))

    def clock_at(self, distance: FloatArray) -> tuple[FloatArray, FloatArray]:
        assert self._time is not None
        assert self.speeds is not None
        rows = np.arange(len(distance))
        _, segment, fraction = self._leg(distance, rows)
        t0, t1 = self._time[rows, segment], self._time[rows, segment + 1]
        v0, v1 = self.speeds[rows, segment], self.speeds[rows, segment + 1]
        return t0 + fraction * (t1 - t0), v0 + fraction * (v1 - v0)

    def _leg(
        self, distance: FloatArray, rows: IntArray, beyond: float = TINY
    ) -> tuple[FloatArray, IntArray, FloatArray]:
        """Distance clipped to the line, its segment, and the fraction of the segment.

        A segment begins `tolerance` after its vertex.
        """
        table = self.distance[rows]
        clipped = np.clip(distance, 0.0, table[:, -1])
        segment = (table[:, 1:-1] + beyond <= clipped[:, None]).sum(axis=1)
        indices = np.arange(len(rows))
        span = table[indices, segment + 1] - table[indices, segment]
        fraction = (clipped - table[indices, segment]) / np.where(span > 0, span, 1.0)
        return clipped, segment, np.where(span > 0, fraction, 0.0)

    def _heading(self, distance: FloatArray, rows: IntArray) -> FloatArray:
        clipped, segment, fraction = self._leg(distance, rows)
        current, after = self.facing[rows, segment], self.facing[rows, segment + 1]
        table, indices, last = self.distance[rows], np.arange(len(rows)), self.distance.shape[1] - 2
        at_end = clipped > table[:, -1] - TINY
        if self.turning == ALONG_LEGS:
            return np.asarray(current + np.where(at_end, 1.0, fraction) * (after - current))
        heading = current
        if self.turning == AT_CORNERS:
            before = self.facing[rows, np.maximum(segment - 1, 0)]
            span = table[indices, segment + 1] - table[indices, segment]
            reach = np.maximum(np.minimum(CORNER, 0.5 * span), TINY)
            since_start = clipped - table[indices, segment]
            until_end = span - since_start
            begins, ends = since_start < reach, until_end < reach
            # The last segment turns fully to its end heading, any other halfway.
            fraction_at_end = np.where(segment < last, 0.5 * (1.0 - until_end / reach), 1.0 - until_end / reach)
            entered = before + 0.5 * (1.0 + since_start / reach) * (current - before)
            leaving = np.where(ends, current + fraction_at_end * (after - current), current)
            heading = np.where(begins, np.where(segment > 0, entered, current), leaving)
        return np.where(at_end, after, heading)


def _unwound(heading: FloatArray, nudged: FloatArray) -> FloatArray:
    """Headings with full turns added, so that each change is the shorter one; the first stays.

    Half a turn goes in the direction of `nudged`.
    """
    turns = np.round((np.unwrap(np.mod(nudged, 2 * np.pi), axis=1) - heading) / (2 * np.pi))
    return np.asarray(heading + 2 * np.pi * (turns - turns[:, :1]))


def _directions(x: FloatArray, y: FloatArray, legs: FloatArray) -> FloatArray:
    """Segment directions; without a length, that of the segment before it, or of the first with a length."""
    dx, dy = np.diff(x), np.diff(y)
    direction = np.arctan2(dy, dx)
    rows, first = np.arange(len(x)), (legs > TINY).argmax(axis=1)
    current = direction[rows, first]
    for k in range(direction.shape[1]):
        current = np.where(legs[:, k] > TINY, direction[:, k], current)
        direction[:, k] = current
    return np.asarray(np.unwrap(direction, axis=1))


def _motion(legs: FloatArray, spans: FloatArray, begin: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Speeds at vertices, and accelerations of the segments that begin there, each (N, V)."""
    has_duration = spans > TINY
    mean = np.where(has_duration, legs / np.where(has_duration, spans, 1.0), 0.0)
    if begin is None:
        # As in esmini, an entity that starts on the last segment has a speed that falls to 0 until the first step.
        return np.concatenate([mean, np.zeros_like(mean[:, -1:])], axis=1), np.zeros((len(legs), legs.shape[1] + 1))
    speeds, rates = [begin], []
    for k in range(legs.shape[1]):
        span = np.where(has_duration[:, k], spans[:, k], 1.0)
        rate = 2.0 * (mean[:, k] - speeds[-1]) / span
        speed = speeds[-1] + rate * span
        # There is more time than any speed needs: it stops at the next vertex before the time.
        stops = (speed < 0.0) != (speeds[-1] < 0.0)
        has_length = legs[:, k] > TINY
        braking = -(speeds[-1] ** 2) / (2.0 * np.where(has_length, legs[:, k], 1.0))
        rates.append(np.where(has_length & has_duration[:, k], np.where(stops, braking, rate), 0.0))
        speeds.append(np.where(has_length & ~stops, np.where(has_duration[:, k], speed, speeds[-1]), 0.0))
    return np.stack(speeds, axis=1), np.stack([*rates, np.zeros_like(begin)], axis=1)
