"""Trajectories that entities follow; their shape may differ between the scenarios of a batch."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.special import fresnel

from cornercase._common.typing import BoolArray, FloatArray, IntArray

# Half of the stretch over which the heading turns at a corner of a polyline, in m; esmini's figure.
_CORNER: Final = 2.0

# Chords of a clothoid spline in m, and how many there are at most; longer splines get longer chords.
_CHORD: Final = 1.0
_MOST_CHORDS: Final = 2000

# Below this bend, in rad, a clothoid is not told from an arc; Fresnel's integrals lose digits there.
_STRAIGHT: Final = 1e-7


class Polyline:
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

    ends = False
    version = 0
    """How often it was changed by `adopt`."""

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
        self.x, self.y, self.heading, self.time = x, y, heading, time
        self._closed, self._smooth = closed, smooth
        legs = np.hypot(np.diff(x), np.diff(y))
        self.distance = np.concatenate([np.zeros((len(x), 1)), np.cumsum(legs, axis=1)], axis=1)
        self._length = self.distance[:, -1]
        self.lengths = np.full(len(x), np.inf) if closed else self._length
        direction = np.arctan2(np.diff(y), np.diff(x))
        # A leg without length, as it stands for waiting, has the direction of the leg before it.
        for k in range(direction.shape[1]):
            still = legs[:, k] < 1e-6
            direction[still, k] = direction[still, k - 1] if k else direction[still, min(1, direction.shape[1] - 1)]
        self._direction = np.unwrap(direction, axis=1)
        # A heading that is given at the beginning of a leg only holds for all of it.
        facing = np.where(~np.isnan(heading[:, :-1]) & np.isnan(heading[:, 1:]), heading[:, :-1], direction)
        self._facing = np.unwrap(facing, axis=1)
        self._speeds = None if time is None else self._speeds_at_vertices(legs, time)

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

    def adopt(self, other: Polyline, rows: BoolArray) -> None:
        """Take over how `other` runs in the scenarios of a mask."""
        for name in ("x", "y", "heading", "time", "distance", "_length", "lengths", "_direction", "_facing", "_speeds"):
            if getattr(self, name) is not None:
                getattr(self, name)[rows] = getattr(other, name)[rows]
        self.version += 1

    def oriented(self, distance: FloatArray, rows: IntArray) -> BoolArray:
        """Whether the file says the heading there, shape (R,)."""
        _, leg, _ = self._leg(np.mod(distance, self._length[rows]) if self._closed else distance, rows)
        return np.asarray(~np.isnan(self.heading[rows, leg]))

    def direction(self, distance: FloatArray, rows: IntArray) -> FloatArray:
        """Direction of the line itself, shape (R,)."""
        return np.asarray(self._direction[rows, self._leg(distance, rows)[1]])

    def distance_at(self, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance along the trajectory, and speed, at times of its own clock, each (N,)."""
        assert self.time is not None
        assert self._speeds is not None
        rows = np.arange(len(time))
        last = self.time.shape[1] - 2
        leg = np.clip((self.time <= time[:, None]).sum(axis=1) - 1, 0, last)
        t0, t1 = self.time[rows, leg], self.time[rows, leg + 1]
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


class ClothoidSpline:
    """A trajectory whose curvature changes linearly over each of its segments.

    It is travelled on chords of 1 m, as esmini does: within millimetres of the curve, and much faster to find.

    Parameters
    ----------
    x, y, heading : ndarray of float64, shape (N,)
        Where it starts.
    start, end, length : ndarray of float64, shape (N, K)
        Curvature at both ends of the segments, in 1/m, and their lengths in m.
    clock : ndarray of float64, shape (N, 2), optional
        Times in s of its start and its end, between which it is travelled at constant speed.
    """

    ends = False
    version = 0
    """How often it was changed by `adopt`."""

    def __init__(
        self,
        x: FloatArray,
        y: FloatArray,
        heading: FloatArray,
        start: FloatArray,
        end: FloatArray,
        length: FloatArray,
        clock: FloatArray | None = None,
    ) -> None:
        self._start, self._rate, self._clock = start, (end - start) / length, clock
        ends = np.cumsum(length, axis=1)
        self._begin = np.concatenate([np.zeros((len(x), 1)), ends], axis=1)
        self.lengths = ends[:, -1]
        nodes = [(x, y, heading)]
        for k in range(length.shape[1]):
            u, v, turn = clothoid(length[:, k], start[:, k], self._rate[:, k])
            x, y, heading = nodes[-1]
            cos, sin = np.cos(heading), np.sin(heading)
            nodes.append((x + cos * u - sin * v, y + sin * u + cos * v, heading + turn))
        self._x, self._y, self._turn = (np.stack(parts, axis=1) for parts in zip(*nodes, strict=True))
        self._sample()

    def _sample(self) -> None:
        longest = float(self.lengths.max(initial=0.0))
        self._chord = max(_CHORD, longest / _MOST_CHORDS)
        every = np.arange(len(self.lengths))
        places = self._chord * np.arange(int(np.ceil(longest / self._chord)) + 1)
        points = [self._on_curve(np.minimum(place, self.lengths), every) for place in places]
        self.x, self.y, self.heading = (np.stack(parts, axis=1) for parts in zip(*points, strict=True))

    def at(self, distance: FloatArray, offset: FloatArray, rows: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        length = self.lengths.take(rows)
        along = np.clip(distance, 0.0, length)
        k = np.minimum((along / self._chord).astype(np.int64), max(self.x.shape[1] - 2, 0))
        before = self._chord * k
        span = np.minimum(before + self._chord, length) - before
        part = (along - before) / np.where(span > 0.0, span, 1.0)
        node = rows * self.x.shape[1] + k
        after = node + min(1, self.x.shape[1] - 1)
        x, y, heading = (
            table.take(node) + part * (table.take(after) - table.take(node)) for table in (self.x, self.y, self.heading)
        )
        beyond = distance - along
        if beyond.any() or offset.any():
            cos, sin = np.cos(heading), np.sin(heading)
            x, y = x + beyond * cos - offset * sin, y + beyond * sin + offset * cos
        return x, y, heading

    def _on_curve(self, along: FloatArray, rows: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        piece, node = self._piece(along, rows)
        u, v, turn = clothoid(along - self._begin.take(node), self._start.take(piece), self._rate.take(piece))
        h0 = self._turn.take(node)
        cos, sin = np.cos(h0), np.sin(h0)
        return self._x.take(node) + cos * u - sin * v, self._y.take(node) + sin * u + cos * v, h0 + turn

    def curvature(self, distance: FloatArray, rows: IntArray) -> FloatArray:
        along = np.clip(distance, 0.0, self.lengths.take(rows))
        piece, node = self._piece(along, rows)
        return np.asarray(self._start.take(piece) + self._rate.take(piece) * (along - self._begin.take(node)))

    def _piece(self, along: FloatArray, rows: IntArray) -> tuple[IntArray, IntArray]:
        """Flat places of the clothoid that each scenario is on, and of the node before it."""
        count = self._start.shape[1]
        k = np.zeros(len(rows), dtype=np.int64)
        first = rows * (count + 1)
        for later in range(1, count):
            k += self._begin.take(first + later) <= along
        return rows * count + k, first + k

    def nearest(self, x: FloatArray, y: FloatArray, rows: IntArray, after: FloatArray | None = None) -> FloatArray:
        places = np.linspace(0.0, 1.0, 201)
        best, gap = np.zeros(len(x)), np.full(len(x), np.inf)
        for place in places:
            at_x, at_y, _ = self.at(place * self.lengths[rows], np.zeros(len(x)), rows)
            here = np.hypot(at_x - x, at_y - y)
            best, gap = np.where(here < gap, place * self.lengths[rows], best), np.minimum(here, gap)
        for _ in range(8):
            at_x, at_y, heading = self.at(best, np.zeros(len(x)), rows)
            best = np.clip(best + (x - at_x) * np.cos(heading) + (y - at_y) * np.sin(heading), 0.0, self.lengths[rows])
        return best

    def adopt(self, other: ClothoidSpline, rows: BoolArray) -> None:
        """Take over how `other` runs in the scenarios of a mask."""
        for name in ("_start", "_rate", "_begin", "lengths", "_x", "_y", "_turn", "_clock"):
            if getattr(self, name) is not None:
                getattr(self, name)[rows] = getattr(other, name)[rows]
        self._sample()
        self.version += 1

    def oriented(self, distance: FloatArray, rows: IntArray) -> BoolArray:
        return np.zeros(len(rows), dtype=np.bool_)

    def direction(self, distance: FloatArray, rows: IntArray) -> FloatArray:
        return self.at(distance, np.zeros_like(distance), rows)[2]

    @property
    def time(self) -> FloatArray | None:
        """Times in s of its start and its end, shape (N, 2)."""
        return self._clock

    def distance_at(self, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        assert self._clock is not None
        begin, end = self._clock.T
        speed = self.lengths / np.where(end > begin, end - begin, 1.0)
        return np.clip(time - begin, 0.0, end - begin) * speed, speed


Trajectory = Polyline | ClothoidSpline


def clothoid(along: FloatArray, start: FloatArray, rate: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Local coordinates and turn of clothoids after a distance.

    Parameters
    ----------
    along, start, rate : ndarray of float64, shape (N,)
        Distance in m, curvature at the beginning in 1/m, its change in 1/m².

    Returns
    -------
    tuple of ndarray of float64, each (N,)
        m, m, rad.
    """
    turn = start * along + 0.5 * rate * along**2
    bends = np.abs(rate) * along**2 >= _STRAIGHT
    # sinc keeps the digits where the curvature is small.
    mean = (start + 0.5 * rate * along) * along
    chord = along * np.sinc(0.5 * mean / np.pi)
    u, v = chord * np.cos(0.5 * mean), chord * np.sin(0.5 * mean)
    if bends.any():
        d, k, r = along[bends], start[bends], rate[bends]
        scale = np.sqrt(np.pi / np.abs(r))
        before = k / r
        phase = -0.5 * k * before
        s0, c0 = fresnel(before / scale)
        s1, c1 = fresnel((before + d) / scale)
        c, s = scale * (c1 - c0), scale * np.sign(r) * (s1 - s0)
        u[bends], v[bends] = np.cos(phase) * c - np.sin(phase) * s, np.sin(phase) * c + np.cos(phase) * s
    return u, v, turn


def nurbs_points(
    x: FloatArray,
    y: FloatArray,
    time: FloatArray,
    weights: FloatArray,
    knots: FloatArray,
    order: int,
    samples: int = 1000,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Points of a rational B-spline curve, the direction of its tangent there, and when they are reached.

    The time of a control point is reached where its influence is largest; between these places it grows evenly.

    Parameters
    ----------
    x, y : ndarray of float64, shape (N, C)
        Control points in m.
    time : ndarray of float64, shape (N, C)
        s.
    weights : ndarray of float64, shape (C,)
    knots : ndarray of float64, shape (C + order,)
    order : int
        Degree plus one.

    Returns
    -------
    tuple of ndarray of float64, each (N, samples)
    """
    # Loaded here, as it takes a while and few files have such curves.
    from scipy.interpolate import BSpline

    basis = BSpline(knots, np.eye(len(weights)), order - 1)
    u = np.linspace(knots[order - 1], knots[len(weights)], samples)
    value, slope = basis(u) * weights, basis(u, 1) * weights
    total, change = value.sum(axis=1), slope.sum(axis=1)
    px, py = x @ value.T / total, y @ value.T / total
    dx, dy = (x @ slope.T - px * change) / total, (y @ slope.T - py * change) / total
    # Found on points about 1 m apart, as in esmini, whose times follow from it.
    coarse = np.linspace(u[0], u[-1], 2 + int(np.hypot(np.diff(x), np.diff(y)).sum(axis=1).mean()))
    peaks = coarse[(basis(coarse) * weights).argmax(axis=0)]
    # A hat function for each control point.
    hats = np.stack([np.interp(u, peaks, row) for row in np.eye(len(weights))])
    return px, py, np.unwrap(np.arctan2(dy, dx), axis=1), time @ hats
