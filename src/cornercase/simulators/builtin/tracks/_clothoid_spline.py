"""Trajectories made of clothoids, whose curvature changes linearly."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import chain
from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.simulators.builtin.track_kernels._track_layout import CLOTHOID_TRACK, TrackTable, make_trajectory_table
from cornercase.simulators.builtin.tracks._track import Pose, Trajectory, is_uniform

# Length of the chords of a spline in m, and largest number of chords; very long splines get longer chords instead.
_CHORD_LENGTH: Final = 1.0
_MAX_CHORDS: Final = 2000

# rad; a clothoid that bends less is treated as an arc, since Fresnel integrals lose digits there.
_MIN_BEND: Final = 1e-7


class ClothoidSpline(Trajectory):
    """A trajectory of K segments with linearly changing curvature, in N scenarios.

    As in esmini, the entity moves along chords of 1 m, or longer ones if the spline is longer than 2 km. Chords are
    within millimetres of the curve, and much faster to compute.

    Arguments: `x`, `y`, `heading` (N,) are the start pose. `start` and `end` (N, K) are the curvatures in 1/m at the
    start and end of each segment, `length` (N, K) is its length in m. `times` (N, K + 1) are the times in s at which
    segments begin, and the end of the last; the speed on a segment is constant. `segment_starts` maps the index of each
    segment that does not continue the previous segment to its start pose. `heading_offsets` (N, K) are angles in rad by
    which the heading jumps at the start of segments.

    Attributes: `segment_distances` (N, K + 1) are the distances in m at which segments begin, and the end of the last.
    `x`, `y`, `heading` are here the ends of the chords, shape (N, C), or (1, C) if `is_uniform` (the same in all
    scenarios). `chord_length` (N,) is the length in m of all chords but the last. `last_chord` (N,) is the index of the
    last chord.
    """

    _scenario_arrays = ("_start", "_rate", "segment_distances", "lengths", "_x", "_y", "_node_headings", "_times")

    def __init__(
        self,
        x: FloatArray,
        y: FloatArray,
        heading: FloatArray,
        start: FloatArray,
        end: FloatArray,
        length: FloatArray,
        times: FloatArray | None = None,
        segment_starts: Mapping[int, Pose] | None = None,
        heading_offsets: FloatArray | None = None,
    ) -> None:
        self._start, self._rate, self._times = start, (end - start) / length, None
        if times is not None:
            self._times = np.ascontiguousarray(times)
        self.version = 0
        ends = np.cumsum(length, axis=1)
        self.segment_distances = np.concatenate([np.zeros((len(x), 1)), ends], axis=1)
        self.lengths = ends[:, -1].copy()
        poses = {k: (pose.x, pose.y, pose.heading) for k, pose in (segment_starts or {}).items()}
        angles = np.zeros_like(length) if heading_offsets is None else heading_offsets
        inputs = (x, y, heading, start, end, length, angles, *chain.from_iterable(poses.values()))
        # A curve that is the same in all scenarios is computed once.
        rows = slice(1) if is_uniform(*inputs) else slice(None)
        nodes = [(x[rows], y[rows], heading[rows])]
        for k in range(length.shape[1]):
            u, v, turn = evaluate_clothoid(length[rows, k], start[rows, k], self._rate[rows, k])
            if k in poses:
                x, y, heading = (part[rows] for part in poses[k])
            else:
                x, y, heading = nodes[-1]
            heading = heading if heading_offsets is None else heading + heading_offsets[rows, k]
            nodes[-1] = x, y, heading
            cos, sin = np.cos(heading), np.sin(heading)
            nodes.append((x + cos * u - sin * v, y + sin * u + cos * v, heading + turn))
        stacked = (np.stack(parts, axis=1) for parts in zip(*nodes, strict=True))
        self._x, self._y, self._node_headings = (
            np.broadcast_to(pose, self.segment_distances.shape).copy() for pose in stacked
        )
        self._sample_chords()

    def _sample_chords(self) -> None:
        lengths = np.nan_to_num(self.lengths, posinf=0.0)
        self.chord_length = np.maximum(_CHORD_LENGTH, lengths / _MAX_CHORDS)
        chords = np.ceil(lengths / self.chord_length)
        self.last_chord = np.maximum(chords.astype(np.int64) - 1, 0)
        # Usually the curve is the same in all scenarios.
        self.is_uniform = len(lengths) > 0 and is_uniform(
            self._x, self._y, self._node_headings, self._start, self._rate, self.segment_distances
        )
        indices = np.arange(int(chords.max(initial=0.0)) + 1)
        if self.is_uniform:
            clipped = np.minimum(indices * self.chord_length[0], lengths[0])
            points = self._pose_on_curve(clipped, np.zeros(len(indices), dtype=np.int64))
            self.x, self.y, self.heading = (part[None] for part in points)
            return
        rows = np.arange(len(lengths))
        poses = [self._pose_on_curve(np.minimum(k * self.chord_length, lengths), rows) for k in indices]
        self.x, self.y, self.heading = (np.stack(parts, axis=1) for parts in zip(*poses, strict=True))

    def _make_table(self) -> TrackTable:
        ends, poses = self.segment_distances, (self.x, self.y, self.heading)
        arrays = (ends, *poses, self.lengths, self.chord_length, self._times, self.last_chord)
        table = make_trajectory_table(CLOTHOID_TRACK, self.is_uniform, arrays)
        return table._replace(n_curvatures=np.array([ends.shape[1]]))

    def _pose_on_curve(self, distance: FloatArray, rows: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        segment, node = self._segment_and_node(distance, rows)
        u, v, turn = evaluate_clothoid(
            distance - self.segment_distances.take(node), self._start.take(segment), self._rate.take(segment)
        )
        h0 = self._node_headings.take(node)
        cos, sin = np.cos(h0), np.sin(h0)
        return self._x.take(node) + cos * u - sin * v, self._y.take(node) + sin * u + cos * v, h0 + turn

    def curvature_at(self, distance: FloatArray, rows: IntArray) -> FloatArray:
        clipped = np.clip(distance, 0.0, self.lengths.take(rows))
        segment, node = self._segment_and_node(clipped, rows)
        return np.asarray(
            self._start.take(segment) + self._rate.take(segment) * (clipped - self.segment_distances.take(node))
        )

    def _segment_and_node(self, distance: FloatArray, rows: IntArray) -> tuple[IntArray, IntArray]:
        """Return two flat indices for each distance in the scenarios `rows`.

        The first finds the segment at the distance in an array (N, K), the second its start in an array (N, K + 1).
        """
        count = self._start.shape[1]
        k = np.zeros(len(rows), dtype=np.int64)
        first = rows * (count + 1)
        for later in range(1, count):
            k += self.segment_distances.take(first + later) <= distance
        return rows * count + k, first + k

    def nearest_distance(
        self, x: FloatArray, y: FloatArray, rows: IntArray, after: FloatArray | None = None
    ) -> FloatArray:
        if self.is_uniform and len(x) > 1 and (x == x[0]).all() and (y == y[0]).all():
            return np.repeat(self.nearest_distance(x[:1], y[:1], rows[:1]), len(x))
        lengths, best, gap = self.lengths[rows], np.zeros(len(x)), np.full(len(x), np.inf)
        # For few scenarios, few chunks of points, to save NumPy calls.
        for fractions in np.array_split(np.linspace(0.0, 1.0, 201), min(max(len(x), 1), 201)):
            along, count = np.outer(fractions, lengths), len(fractions)
            at_x, at_y, _ = self.pose_at(along.ravel(), np.zeros(along.size), np.tile(rows, count))
            gaps = np.hypot(at_x - np.tile(x, count), at_y - np.tile(y, count)).reshape(along.shape)
            least = np.nan_to_num(gaps, nan=np.inf).argmin(axis=0)[None]
            smallest = np.take_along_axis(gaps, least, axis=0)[0]
            is_nearer = smallest < gap
            best = np.where(is_nearer, np.take_along_axis(along, least, axis=0)[0], best)
            gap = np.where(is_nearer, smallest, gap)
        for _ in range(8):
            at_x, at_y, heading = self.pose_at(best, np.zeros(len(x)), rows)
            best = np.clip(best + (x - at_x) * np.cos(heading) + (y - at_y) * np.sin(heading), 0.0, self.lengths[rows])
        return best

    def copy_scenarios_from(self, other: Trajectory, rows: BoolArray) -> None:
        super().copy_scenarios_from(other, rows)
        self._sample_chords()

    @property
    def times(self) -> FloatArray | None:
        return self._times


def evaluate_clothoid(
    distance: FloatArray, start: FloatArray, rate: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return x, y (m) and change of heading (rad) at distances along clothoids that start at 0 along the x axis.

    All arrays have shape (N,). `start` is the curvature at the start in 1/m, `rate` the change of curvature in 1/m².
    """
    turn = start * distance + 0.5 * rate * distance**2
    is_curved = np.abs(rate) * distance**2 >= _MIN_BEND
    # sinc is accurate for small curvature.
    mean = (start + 0.5 * rate * distance) * distance
    chord = distance * np.sinc(0.5 * mean / np.pi)
    u, v = chord * np.cos(0.5 * mean), chord * np.sin(0.5 * mean)
    if is_curved.any():
        # Imported late: slow to import, and rarely needed.
        from scipy.special import fresnel

        d, k, r = distance[is_curved], start[is_curved], rate[is_curved]
        scale = np.sqrt(np.pi / np.abs(r))
        before = k / r
        phase = -0.5 * k * before
        s0, c0 = fresnel(before / scale)
        s1, c1 = fresnel((before + d) / scale)
        c, s = scale * (c1 - c0), scale * np.sign(r) * (s1 - s0)
        u[is_curved], v[is_curved] = np.cos(phase) * c - np.sin(phase) * s, np.sin(phase) * c + np.cos(phase) * s
    return u, v, turn
