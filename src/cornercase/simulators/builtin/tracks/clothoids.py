"""Trajectories made of clothoids, whose curvature changes linearly along them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.simulators.builtin.tracks.track import Pose, Trajectory, same_in_all

# Chords of a clothoid spline in m, and how many there are at most; longer splines get longer chords.
_CHORD: Final = 1.0
_MOST_CHORDS: Final = 2000

# A clothoid that bends by less, in rad, is treated as an arc, since Fresnel's integrals lose digits there.
_STRAIGHT: Final = 1e-7


class ClothoidSpline(Trajectory):
    """A trajectory whose curvature changes linearly over each of its segments.

    It is travelled on chords of 1 m, as esmini does: within millimetres of the curve, and much faster to find.

    Parameters
    ----------
    x, y, heading : ndarray of float64, shape (N,)
        Where it starts.
    start, end, length : ndarray of float64, shape (N, K)
        Curvature at both ends of the segments, in 1/m, and their lengths in m.
    clock : ndarray of float64, shape (N, K + 1), optional
        Times in s at which the segments begin, and the last one ends; each is travelled at constant speed.
    begins : mapping of int to Pose, optional
        Where segments begin, by their number, that do not begin where the one before ends.
    turns : ndarray of float64, shape (N, K), optional
        By how much in rad the heading of each segment differs at its beginning from that of the place.

    Attributes
    ----------
    begin : ndarray of float64, shape (N, K + 1)
        Distance in m at which the segments begin, and the last one ends.
    x, y, heading : ndarray of float64, shape (N, C), or (1, C) where `alike`
        Where the chords begin, and the last one ends, in m and rad.
    chord : ndarray of float64, shape (N,)
        How long all chords but the last one are, in m.
    last : ndarray of int64, shape (N,)
        The last chord.
    alike : bool
        Whether the curve is the same in all scenarios.
    """

    _arrays = ("_start", "_rate", "begin", "lengths", "_x", "_y", "_turn", "_clock")

    def __init__(
        self,
        x: FloatArray,
        y: FloatArray,
        heading: FloatArray,
        start: FloatArray,
        end: FloatArray,
        length: FloatArray,
        clock: FloatArray | None = None,
        begins: Mapping[int, Pose] | None = None,
        turns: FloatArray | None = None,
    ) -> None:
        self._start, self._rate, self._clock = start, (end - start) / length, None
        if clock is not None:
            self._clock = np.ascontiguousarray(clock)
        self.version = 0
        ends = np.cumsum(length, axis=1)
        self.begin = np.concatenate([np.zeros((len(x), 1)), ends], axis=1)
        self.lengths = ends[:, -1].copy()
        places = {} if begins is None else {k: (one.x, one.y, one.heading) for k, one in begins.items()}
        angles = np.zeros_like(length) if turns is None else turns
        given = (x, y, heading, start, end, length, angles, *(part for place in places.values() for part in place))
        # Curves that are the same in all scenarios are laid out once.
        rows = slice(1) if same_in_all(*given) else slice(None)
        nodes = [(x[rows], y[rows], heading[rows])]
        for k in range(length.shape[1]):
            u, v, turn = clothoid(length[rows, k], start[rows, k], self._rate[rows, k])
            if k in places:
                x, y, heading = (part[rows] for part in places[k])
            else:
                x, y, heading = nodes[-1]
            heading = heading if turns is None else heading + turns[rows, k]
            nodes[-1] = x, y, heading
            cos, sin = np.cos(heading), np.sin(heading)
            nodes.append((x + cos * u - sin * v, y + sin * u + cos * v, heading + turn))
        stacked = (np.stack(parts, axis=1) for parts in zip(*nodes, strict=True))
        self._x, self._y, self._turn = (np.broadcast_to(one, self.begin.shape).copy() for one in stacked)
        self._sample()

    def _sample(self) -> None:
        lengths = np.nan_to_num(self.lengths, posinf=0.0)
        self.chord = np.maximum(_CHORD, lengths / _MOST_CHORDS)
        chords = np.ceil(lengths / self.chord)
        self.last = np.maximum(chords.astype(np.int64) - 1, 0)
        # As a rule the curve is the same in all scenarios.
        self.alike = len(lengths) > 0 and same_in_all(self._x, self._y, self._turn, self._start, self._rate, self.begin)
        places = np.arange(int(chords.max(initial=0.0)) + 1)
        if self.alike:
            along = np.minimum(places * self.chord[0], lengths[0])
            points = self._on_curve(along, np.zeros(len(places), dtype=np.int64))
            self.x, self.y, self.heading = (part[None] for part in points)
            return
        every = np.arange(len(lengths))
        found = [self._on_curve(np.minimum(k * self.chord, lengths), every) for k in places]
        self.x, self.y, self.heading = (np.stack(parts, axis=1) for parts in zip(*found, strict=True))

    def at(self, distance: FloatArray, offset: FloatArray, rows: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        length = self.lengths.take(rows)
        along = np.clip(distance, 0.0, length)
        chord = self.chord.take(rows)
        k = np.minimum(np.nan_to_num(along / chord).astype(np.int64), self.last.take(rows))
        before = chord * k
        span = np.minimum(before + chord, length) - before
        part = (along - before) / np.where(span > 0.0, span, 1.0)
        node = k if self.alike else rows * self.x.shape[1] + k
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
        u, v, turn = clothoid(along - self.begin.take(node), self._start.take(piece), self._rate.take(piece))
        h0 = self._turn.take(node)
        cos, sin = np.cos(h0), np.sin(h0)
        return self._x.take(node) + cos * u - sin * v, self._y.take(node) + sin * u + cos * v, h0 + turn

    def curvature(self, distance: FloatArray, rows: IntArray) -> FloatArray:
        along = np.clip(distance, 0.0, self.lengths.take(rows))
        piece, node = self._piece(along, rows)
        return np.asarray(self._start.take(piece) + self._rate.take(piece) * (along - self.begin.take(node)))

    def _piece(self, along: FloatArray, rows: IntArray) -> tuple[IntArray, IntArray]:
        """Flat places of the clothoid that each scenario is on, and of the node before it."""
        count = self._start.shape[1]
        k = np.zeros(len(rows), dtype=np.int64)
        first = rows * (count + 1)
        for later in range(1, count):
            k += self.begin.take(first + later) <= along
        return rows * count + k, first + k

    def nearest(self, x: FloatArray, y: FloatArray, rows: IntArray, after: FloatArray | None = None) -> FloatArray:
        if self.alike and len(x) > 1 and (x == x[0]).all() and (y == y[0]).all():
            return np.repeat(self.nearest(x[:1], y[:1], rows[:1]), len(x))
        lengths, best, gap = self.lengths[rows], np.zeros(len(x)), np.full(len(x), np.inf)
        # As many places at once as calls of NumPy are worth.
        for places in np.array_split(np.linspace(0.0, 1.0, 201), min(max(len(x), 1), 201)):
            along, count = np.outer(places, lengths), len(places)
            at_x, at_y, _ = self.at(along.ravel(), np.zeros(along.size), np.tile(rows, count))
            here = np.hypot(at_x - np.tile(x, count), at_y - np.tile(y, count)).reshape(along.shape)
            least = np.nan_to_num(here, nan=np.inf).argmin(axis=0)[None]
            apart = np.take_along_axis(here, least, axis=0)[0]
            nearer = apart < gap
            best = np.where(nearer, np.take_along_axis(along, least, axis=0)[0], best)
            gap = np.where(nearer, apart, gap)
        for _ in range(8):
            at_x, at_y, heading = self.at(best, np.zeros(len(x)), rows)
            best = np.clip(best + (x - at_x) * np.cos(heading) + (y - at_y) * np.sin(heading), 0.0, self.lengths[rows])
        return best

    def adopt(self, other: Trajectory, rows: BoolArray) -> None:
        super().adopt(other, rows)
        self._sample()

    def oriented(self, distance: FloatArray, rows: IntArray) -> BoolArray:
        return np.zeros(len(rows), dtype=np.bool_)

    def direction(self, distance: FloatArray, rows: IntArray) -> FloatArray:
        return self.at(distance, np.zeros_like(distance), rows)[2]

    @property
    def time(self) -> FloatArray | None:
        return self._clock

    def distance_at(self, time: FloatArray) -> FloatArray:
        assert self._clock is not None
        rows = np.arange(len(time))
        k = np.clip((self._clock <= time[:, None]).sum(axis=1) - 1, 0, self._clock.shape[1] - 2)
        begin, end = self._clock[rows, k], self._clock[rows, k + 1]
        way = self.begin[rows, k + 1] - self.begin[rows, k]
        speed = way / np.where(end > begin, end - begin, 1.0)
        return np.asarray(self.begin[rows, k] + np.clip(time - begin, 0.0, end - begin) * speed)

    def clock_at(self, distance: FloatArray) -> tuple[FloatArray, FloatArray]:
        assert self._clock is not None
        rows = np.arange(len(distance))
        k = np.clip((self.begin <= distance[:, None]).sum(axis=1) - 1, 0, self._clock.shape[1] - 2)
        begin, end = self._clock[rows, k], self._clock[rows, k + 1]
        way = self.begin[rows, k + 1] - self.begin[rows, k]
        part = (distance - self.begin[rows, k]) / np.where(way > 0.0, way, 1.0)
        return begin + part * (end - begin), way / np.where(end > begin, end - begin, np.inf)


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
        # Imported here, since it takes time and few files have such curves.
        from scipy.special import fresnel

        d, k, r = along[bends], start[bends], rate[bends]
        scale = np.sqrt(np.pi / np.abs(r))
        before = k / r
        phase = -0.5 * k * before
        s0, c0 = fresnel(before / scale)
        s1, c1 = fresnel((before + d) / scale)
        c, s = scale * (c1 - c0), scale * np.sign(r) * (s1 - s0)
        u[bends], v[bends] = np.cos(phase) * c - np.sin(phase) * s, np.sin(phase) * c + np.cos(phase) * s
    return u, v, turn
