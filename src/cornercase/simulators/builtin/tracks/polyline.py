"""Trajectories through vertices."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.simulators.builtin.tracks.track import ALONG_LEGS, AT_CORNERS, Trajectory, same_in_all

CORNER: Final = 2.0
"""Half of the stretch over which the heading turns at a corner of a polyline, in m; esmini's figure."""

TINY: Final = 1e-6
"""Vertices that are closer, in m or s, are at one place or instant."""


class Polyline(Trajectory):
    """A trajectory through vertices.

    Parameters
    ----------
    x, y : ndarray of float64, shape (N, V)
        Vertices in m.
    heading : ndarray of float64, shape (N, V)
        rad; NaN where the file gives none and the heading is that of the leg that begins there.
    time : ndarray of float64, shape (N, V), optional
        s, not decreasing.
    closed : bool
        Whether it goes on from its end to its start, for ever.
    turning : {"legs", "corners", "vertices"}, default "corners"
        Where the heading turns from that of one vertex to that of the next: over whole legs, near corners, or at once.
    begin_speed : ndarray of float64, shape (N,), optional
        Speed at the first vertex in m/s: with it, the acceleration is constant on each leg, so that the next vertex is
        reached in time; without it, the speed is.

    Attributes
    ----------
    distance, facing : ndarray of float64, shape (N, V)
        Distance along the line in m, and heading in rad with full turns added, at its vertices.
    directions : ndarray of float64, shape (N, V - 1)
        Directions of its legs in rad.
    speeds, rates : ndarray of float64, shape (N, V), optional
        Speeds at its vertices in m/s, and accelerations in m/s² on the legs that begin there, by its clock.
    alike : bool
        Whether all of that is the same in all scenarios.
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
        # Rows of these and of what is made of them are read where they lie.
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
        # At the last vertex, a line without headings goes on as it came.
        ends = np.concatenate([self.directions, self.directions[:, -1:]], axis=1)
        facing = np.where(np.isnan(heading), ends, heading)
        # Which way half a turn goes depends on the last digit: straight up or down is a little to the right, as in
        # esmini.
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
        along, leg, part = self._leg(distance, rows, 0.0)
        x0, y0 = self.x[rows, leg], self.y[rows, leg]
        x = x0 + part * (self.x[rows, leg + 1] - x0)
        y = y0 + part * (self.y[rows, leg + 1] - y0)
        beyond = distance - along
        if beyond.any() or offset.any():
            direction = self.directions[rows, leg]
            cos, sin = np.cos(direction), np.sin(direction)
            x, y = x + beyond * cos - offset * sin, y + beyond * sin + offset * cos
        return x, y, self._heading(distance, rows)

    def curvature(self, distance: FloatArray, rows: IntArray) -> FloatArray:
        return np.zeros_like(distance)

    def nearest(self, x: FloatArray, y: FloatArray, rows: IntArray, after: FloatArray | None = None) -> FloatArray:
        px, py, distance = self.x[rows], self.y[rows], self.distance[rows]
        dx, dy = np.diff(px), np.diff(py)
        squared = np.maximum(dx * dx + dy * dy, 1e-30)
        part = np.clip(((x[:, None] - px[:, :-1]) * dx + (y[:, None] - py[:, :-1]) * dy) / squared, 0.0, 1.0)
        gap = np.hypot(px[:, :-1] + part * dx - x[:, None], py[:, :-1] + part * dy - y[:, None])
        best = gap.argmin(axis=1)
        each = np.arange(len(x))
        return np.asarray(distance[each, best] + part[each, best] * np.diff(distance)[each, best])

    def oriented(self, distance: FloatArray, rows: IntArray) -> BoolArray:
        distance = self._round(distance, rows)
        _, leg, _ = self._leg(distance, rows)
        # On a leg the vertex at its beginning counts.
        vertex = np.where(distance > self._length[rows] - TINY, self.heading.shape[1] - 1, leg)
        return np.asarray(~np.isnan(self.heading[rows, vertex]))

    def direction(self, distance: FloatArray, rows: IntArray) -> FloatArray:
        distance = self._round(distance, rows)
        return np.asarray(self.directions[rows, self._leg(distance, rows)[1]])

    def _round(self, distance: FloatArray, rows: IntArray) -> FloatArray:
        """Distances within one round of a closed line."""
        return np.mod(distance, self._length[rows]) if self.closed else distance

    def distance_at(self, time: FloatArray) -> FloatArray:
        assert self._time is not None
        assert self.speeds is not None
        assert self.rates is not None
        every = np.arange(len(time))
        leg = (self._time[:, 1:-1] <= time[:, None]).sum(axis=1)
        elapsed = np.maximum(time - self._time[every, leg], 0.0)
        speed, rate = self.speeds[every, leg], self.rates[every, leg]
        begin, way = self.distance[every, leg], self.distance[every, leg + 1] - self.distance[every, leg]
        span = self._time[every, leg + 1] - self._time[every, leg]
        even = begin + np.clip(elapsed / np.where(span > 0.0, span, np.inf), 0.0, 1.0) * way
        # Who brakes to a stop waits there for the rest of the leg's time.
        stops = rate < 0.0
        elapsed = np.where(stops, np.minimum(elapsed, -speed / np.where(stops, rate, 1.0)), elapsed)
        bent = begin + speed * elapsed + 0.5 * rate * elapsed**2
        distance = np.where(rate == 0.0, even, bent)
        return np.asarray(np.where(time > self._time[:, -1], self._length, distance))

    def clock_at(self, distance: FloatArray) -> tuple[FloatArray, FloatArray]:
        assert self._time is not None
        assert self.speeds is not None
        every = np.arange(len(distance))
        _, leg, part = self._leg(distance, every)
        t0, t1 = self._time[every, leg], self._time[every, leg + 1]
        v0, v1 = self.speeds[every, leg], self.speeds[every, leg + 1]
        return t0 + part * (t1 - t0), v0 + part * (v1 - v0)

    def _leg(
        self, distance: FloatArray, rows: IntArray, beyond: float = TINY
    ) -> tuple[FloatArray, IntArray, FloatArray]:
        """Distance within the line, the leg there, and how much of it is gone; one begins `beyond` its vertex."""
        table = self.distance[rows]
        along = np.clip(distance, 0.0, table[:, -1])
        leg = (table[:, 1:-1] + beyond <= along[:, None]).sum(axis=1)
        each = np.arange(len(rows))
        span = table[each, leg + 1] - table[each, leg]
        part = (along - table[each, leg]) / np.where(span > 0, span, 1.0)
        return along, leg, np.where(span > 0, part, 0.0)

    def _heading(self, distance: FloatArray, rows: IntArray) -> FloatArray:
        along, leg, part = self._leg(distance, rows)
        now, after = self.facing[rows, leg], self.facing[rows, leg + 1]
        table, each, last = self.distance[rows], np.arange(len(rows)), self.distance.shape[1] - 2
        at_end = along > table[:, -1] - TINY
        if self.turning == ALONG_LEGS:
            return np.asarray(now + np.where(at_end, 1.0, part) * (after - now))
        heading = now
        if self.turning == AT_CORNERS:
            before = self.facing[rows, np.maximum(leg - 1, 0)]
            span = table[each, leg + 1] - table[each, leg]
            reach = np.maximum(np.minimum(CORNER, 0.5 * span), TINY)
            gone = along - table[each, leg]
            left = span - gone
            begins, ends = gone < reach, left < reach
            # The last leg turns wholly to the heading of its end, any other halfway.
            share = np.where(leg < last, 0.5 * (1.0 - left / reach), 1.0 - left / reach)
            entered = before + 0.5 * (1.0 + gone / reach) * (now - before)
            leaving = np.where(ends, now + share * (after - now), now)
            heading = np.where(begins, np.where(leg > 0, entered, now), leaving)
        return np.where(at_end, after, heading)


def _unwound(heading: FloatArray, nudged: FloatArray) -> FloatArray:
    """Headings with full turns added, so that from each to the next it is the shorter way; the first stays as it is.

    Where both ways are as short, `nudged` tells which it is.
    """
    turns = np.round((np.unwrap(np.mod(nudged, 2 * np.pi), axis=1) - heading) / (2 * np.pi))
    return np.asarray(heading + 2 * np.pi * (turns - turns[:, :1]))


def _directions(x: FloatArray, y: FloatArray, legs: FloatArray) -> FloatArray:
    """Directions of legs; one without length has that of the leg before it, or of the first that has one."""
    dx, dy = np.diff(x), np.diff(y)
    direction = np.arctan2(dy, dx)
    every, first = np.arange(len(x)), (legs > TINY).argmax(axis=1)
    known = direction[every, first]
    for k in range(direction.shape[1]):
        known = np.where(legs[:, k] > TINY, direction[:, k], known)
        direction[:, k] = known
    return np.asarray(np.unwrap(direction, axis=1))


def _motion(legs: FloatArray, spans: FloatArray, begin: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Speeds at vertices, and accelerations of the legs that begin there, each (N, V)."""
    lasts = spans > TINY
    mean = np.where(lasts, legs / np.where(lasts, spans, 1.0), 0.0)
    if begin is None:
        # As in esmini, who begins on the last leg has a speed that falls towards its end, until the first step.
        return np.concatenate([mean, np.zeros_like(mean[:, -1:])], axis=1), np.zeros((len(legs), legs.shape[1] + 1))
    speeds, rates = [begin], []
    for k in range(legs.shape[1]):
        span = np.where(lasts[:, k], spans[:, k], 1.0)
        rate = 2.0 * (mean[:, k] - speeds[-1]) / span
        speed = speeds[-1] + rate * span
        # Too much time to go on with any speed: it stops at the next vertex, before the time.
        turns = (speed < 0.0) != (speeds[-1] < 0.0)
        moves = legs[:, k] > TINY
        braking = -(speeds[-1] ** 2) / (2.0 * np.where(moves, legs[:, k], 1.0))
        rates.append(np.where(moves & lasts[:, k], np.where(turns, braking, rate), 0.0))
        speeds.append(np.where(moves & ~turns, np.where(lasts[:, k], speed, speeds[-1]), 0.0))
    return np.stack(speeds, axis=1), np.stack([*rates, np.zeros_like(begin)], axis=1)
