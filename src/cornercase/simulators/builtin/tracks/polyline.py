"""Trajectories through vertices."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.simulators.builtin.tracks.track import Trajectory

# Half of the stretch over which the heading turns at a corner of a polyline, in m; esmini's figure.
_CORNER: Final = 2.0


class Polyline(Trajectory):
    """A trajectory through vertices.

    Parameters
    ----------
    x, y : ndarray of float64, shape (N, V)
        Vertices in m.
    heading : ndarray of float64, shape (N, V)
        rad; NaN where the file gives none and the heading follows the line.
    time : ndarray of float64, shape (N, V), optional
        s, not decreasing.
    closed : bool
        Whether it goes on from its end to its start, for ever.
    smooth : bool
        Whether the heading turns over whole legs (following mode ``follow``) rather than near corners; and the speed
        at given times changes linearly rather than in steps.
    """

    _arrays = (
        "x", "y", "heading", "_time", "distance", "_length", "lengths", "_direction", "_facing", "_speeds",
    )  # fmt: skip

    def __init__(
        self,
        x: FloatArray,
        y: FloatArray,
        heading: FloatArray,
        time: FloatArray | None = None,
        closed: bool = False,
        smooth: bool = False,
    ) -> None:
        if closed:
            x, y, heading = (np.concatenate([a, a[:, :1]], axis=1) for a in (x, y, heading))
        self.x, self.y, self.heading, self._time = x, y, heading, time
        self.version = 0
        self._closed, self._smooth = closed, smooth
        legs = np.hypot(np.diff(x), np.diff(y))
        self.distance = np.concatenate([np.zeros((len(x), 1)), np.cumsum(legs, axis=1)], axis=1)
        self._length = self.distance[:, -1]
        self.lengths = np.full(len(x), np.inf) if closed else self._length
        direction = np.arctan2(np.diff(y), np.diff(x))
        # A leg of no length means waiting; it has the direction of the leg before.
        for k in range(direction.shape[1]):
            still = legs[:, k] < 1e-6
            direction[still, k] = direction[still, k - 1] if k else direction[still, min(1, direction.shape[1] - 1)]
        self._direction = np.unwrap(direction, axis=1)
        # A heading that is given only at the beginning of a leg holds for the whole leg.
        facing = np.where(~np.isnan(heading[:, :-1]) & np.isnan(heading[:, 1:]), heading[:, :-1], direction)
        self._facing = np.unwrap(facing, axis=1)
        self._speeds = None if time is None else self._speeds_at_vertices(legs, time)

    @property
    def time(self) -> FloatArray | None:
        return self._time

    def at(self, distance: FloatArray, offset: FloatArray, rows: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        distance = np.mod(distance, self._length[rows]) if self._closed else distance
        along, leg, part = self._leg(distance, rows)
        x0, y0 = self.x[rows, leg], self.y[rows, leg]
        x = x0 + part * (self.x[rows, leg + 1] - x0)
        y = y0 + part * (self.y[rows, leg + 1] - y0)
        beyond = distance - along
        if beyond.any() or offset.any():
            direction = self._direction[rows, leg]
            cos, sin = np.cos(direction), np.sin(direction)
            x, y = x + beyond * cos - offset * sin, y + beyond * sin + offset * cos
        return x, y, self._heading(along, leg, part, rows)

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
        _, leg, _ = self._leg(np.mod(distance, self._length[rows]) if self._closed else distance, rows)
        return np.asarray(~np.isnan(self.heading[rows, leg]))

    def direction(self, distance: FloatArray, rows: IntArray) -> FloatArray:
        return np.asarray(self._direction[rows, self._leg(distance, rows)[1]])

    def distance_at(self, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        assert self._time is not None
        assert self._speeds is not None
        rows = np.arange(len(time))
        last = self._time.shape[1] - 2
        leg = np.clip((self._time <= time[:, None]).sum(axis=1) - 1, 0, last)
        t0, t1 = self._time[rows, leg], self._time[rows, leg + 1]
        span = np.where(t1 > t0, t1 - t0, 1.0)
        part = np.clip((time - t0) / span, 0.0, 1.0)
        d0, d1 = self.distance[rows, leg], self.distance[rows, leg + 1]
        v0, v1 = self._speeds[rows, leg], self._speeds[rows, leg + 1]
        if not self._smooth:
            return np.asarray(d0 + part * (d1 - d0)), np.asarray((d1 - d0) / span)
        elapsed = part * span
        distance = d0 + v0 * elapsed + 0.5 * (v1 - v0) / span * elapsed**2
        return np.asarray(np.minimum(distance, np.maximum(d1, d0))), np.asarray(v0 + part * (v1 - v0))

    def _speeds_at_vertices(self, legs: FloatArray, time: FloatArray) -> FloatArray:
        """Speeds of constant acceleration on every leg: each follows from the one before and the leg's mean."""
        span = np.diff(time)
        mean = np.where(span > 0, legs / np.where(span > 0, span, 1.0), 0.0)
        speeds = np.empty_like(time)
        speeds[:, 0] = mean[:, 0]
        for k in range(mean.shape[1]):
            speeds[:, k + 1] = np.maximum(2.0 * mean[:, k] - speeds[:, k], 0.0)
        return speeds

    def _leg(self, distance: FloatArray, rows: IntArray) -> tuple[FloatArray, IntArray, FloatArray]:
        table = self.distance[rows]
        along = np.clip(distance, 0.0, table[:, -1])
        leg = np.clip((table <= along[:, None]).sum(axis=1) - 1, 0, table.shape[1] - 2)
        each = np.arange(len(rows))
        span = table[each, leg + 1] - table[each, leg]
        part = (along - table[each, leg]) / np.where(span > 0, span, 1.0)
        return along, leg, part

    def _heading(self, along: FloatArray, leg: IntArray, part: FloatArray, rows: IntArray) -> FloatArray:
        given0, given1 = self.heading[rows, leg], self.heading[rows, leg + 1]
        turn = (given1 - given0 + np.pi) % (2 * np.pi) - np.pi
        heading = self._facing[rows, leg]
        if self._smooth:
            ahead = self._facing[rows, np.minimum(leg + 1, self._facing.shape[1] - 1)]
            return np.where(np.isnan(given0 + given1), heading + part * (ahead - heading), given0 + part * turn)
        table = self.distance[rows]
        each = np.arange(len(rows))
        for side in (0, 1):
            corner = leg + side
            neighbour = np.clip(leg - 1 if side == 0 else leg + 1, 0, self._facing.shape[1] - 1)
            difference = self._facing[rows, neighbour] - self._facing[rows, leg]
            reach = np.minimum(_CORNER, 0.5 * (table[each, leg + 1] - table[each, leg]))
            away = np.abs(along - table[each, corner])
            close = (away < reach) & (neighbour != leg)
            share = 0.5 * (1.0 - away / np.where(reach > 0, reach, 1.0))
            heading = heading + np.where(close, share * difference, 0.0)
        return np.where(np.isnan(given0 + given1), heading, given0 + part * turn)
