"""Map positions in the plane to roads and lanes."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from cornercase._common.numba.kernel import kernel
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.roads._nearest import NearestPointIndex
from cornercase.roads._road import Road

# Sample distance in m, and largest number of samples; if that is exceeded, the distance is increased.
_SAMPLE_DISTANCE: Final = 0.5
_MAX_SAMPLES: Final = 2_000_000
OFF_ROAD_TOLERANCE: Final = 2.0
"""Largest distance in m from the edge of a road at which an entity still stays on this road, as in esmini."""
# Number of nearest samples to compare.
_N_CANDIDATES: Final = 24
# Size of the cache.
_CACHE_SIZE: Final = 4096
# Largest valid coordinate in m.
_MAX_COORDINATE: Final = 1e12


class LaneCoordinates(NamedTuple):
    """Positions of N points on roads: road index, lane number, s, and offset from the lane's center.

    s and offset are in m. The offset is positive to the left, seen along s.
    """

    road: IntArray
    lane: IntArray
    s: FloatArray
    offset: FloatArray


class _LaneSamples(NamedTuple):
    """Samples of the center lines of all lanes; `spacing` is the largest distance in m between consecutive samples."""

    point_index: NearestPointIndex
    points: FloatArray
    heading: FloatArray
    road: IntArray
    lane: IntArray
    s: FloatArray
    half_width: FloatArray
    is_undrivable: BoolArray
    spacing: float


class RoadLocator:
    """Search index for the road and lane at a position."""

    def __init__(self, roads: Sequence[Road], max_samples: int = _MAX_SAMPLES) -> None:
        self._roads, self._max_samples = roads, max_samples
        self._cache: dict[bytes, LaneCoordinates] = {}
        self._reference_samples: dict[int, tuple[NearestPointIndex, FloatArray]] = {}
        self._junction_roads = [i for i, road in enumerate(roads) if road.junction not in ("-1", "")]

    def locate(self, x: FloatArray, y: FloatArray) -> LaneCoordinates:
        """Return the positions of points on the roads; x and y in m, shape (N,).

        A lane that contains the point is preferred to other lanes nearby. If several lanes contain the point, drivable
        lanes are preferred.
        """
        if not (len(x) and (x == x[0]).all() and (y == y[0]).all()):
            return self._locate_uncached(x, y)
        # Usually all scenarios of a file start at the same position, in each run: cache it.
        point = x[:1].tobytes() + y[:1].tobytes()
        if point not in self._cache:
            if len(self._cache) >= _CACHE_SIZE:
                self._cache = {}
            self._cache[point] = self._locate_uncached(x[:1], y[:1])
        road, lane, s, offset = self._cache[point]
        return LaneCoordinates(road.repeat(len(x)), lane.repeat(len(x)), s.repeat(len(x)), offset.repeat(len(x)))

    def _locate_uncached(self, x: FloatArray, y: FloatArray) -> LaneCoordinates:
        samples = self._samples
        # NaN is not valid either.
        valid = (np.abs(x) < _MAX_COORDINATE) & (np.abs(y) < _MAX_COORDINATE)
        points = np.stack([np.where(valid, x, 0.0), np.where(valid, y, 0.0)], axis=1)
        near = samples.point_index.find_nearest(points, _N_CANDIDATES)
        wide = samples.spacing > _SAMPLE_DISTANCE
        gap = (
            _distances_to_lanes(points, samples, near) if wide else _distances_to_samples(points, samples.points, near)
        )
        best = near[np.arange(len(x)), _choose_candidate(gap, near, samples.half_width, samples.is_undrivable)]
        located = LaneCoordinates(samples.road[best], samples.lane[best], samples.s[best].copy(), np.zeros(len(x)))
        for r, ln in sorted({*zip(located.road.tolist(), located.lane.tolist(), strict=True)}):
            rows, road = (located.road == r) & (located.lane == ln), self._roads[r]
            for _ in range(2):
                cx, cy, heading = road.lane_pose_at(ln, located.s[rows])
                dx, dy = points[rows, 0] - cx, points[rows, 1] - cy
                step = dx * np.cos(heading) + dy * np.sin(heading)
                located.s[rows] = np.clip(located.s[rows] + step, 0.0, road.length)
                located.offset[rows] = dy * np.cos(heading) - dx * np.sin(heading)
        return located

    def track_road(
        self, last_road: IntArray, last_s: FloatArray, x: FloatArray, y: FloatArray, heading: FloatArray
    ) -> tuple[IntArray, FloatArray]:
        """Return road and s of moving points, given their previous road and s; see `RoadNetwork.track_road`."""
        road, s = last_road.copy(), last_s.copy()
        lost = ~self._is_on_road(last_road, x, y, s, 1, OFF_ROAD_TOLERANCE)
        if lost.any():
            # Locate equal points once, and in spatial order for speed.
            order = np.flatnonzero(lost)[np.lexsort((heading[lost], y[lost], x[lost]))]
            poses = np.stack([x[order], y[order], heading[order]], axis=1)
            is_new = np.append(True, (poses[1:] != poses[:-1]).any(axis=1))
            found_road, found_s = self._find_road(*poses[is_new].T)
            which = np.cumsum(is_new) - 1
            road[order], s[order] = found_road[which], found_s[which]
        return road, s

    def _find_road(self, x: FloatArray, y: FloatArray, heading: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return road and s of points whose previous road is unknown; in junctions, the heading decides."""
        located = self.locate(x, y)
        road, s = located.road, located.s
        best_turn = np.full(len(x), np.inf)
        inside = np.isin(road, self._junction_roads)
        for r in self._junction_roads if inside.any() else ():
            nearest, samples = self._sample_reference_line(r)
            along = samples[nearest.find_nearest(np.stack([x, y], axis=1), 1)[:, 0]]
            held = self._is_on_road(np.full(len(x), r), x, y, along, 2, 0.0) & inside
            turn = np.abs(np.sin(heading - self._roads[r].reference_pose(along)[2]))
            better = held & (turn < best_turn)
            best_turn[better] = turn[better]
            road[better], s[better] = r, along[better]
        return road, s

    def _is_on_road(
        self, road: IntArray, x: FloatArray, y: FloatArray, s: FloatArray, n_projections: int, tolerance: float
    ) -> BoolArray:
        """Return whether each point is on its `road`, or at most `tolerance` in m beside the road.

        `s` has estimates of the s coordinates, which are improved in place for points on the road.
        """
        inside = np.zeros(len(x), dtype=np.bool_)
        for r in np.unique(road[(road >= 0) & np.isfinite(x)]):
            rows = np.flatnonzero((road == r) & np.isfinite(x))
            candidate, along = self._roads[r], s[rows]
            for _ in range(n_projections):
                px, py, heading = candidate.reference_pose(np.clip(along, 0.0, candidate.length))
                dx, dy, cos, sin = x[rows] - px, y[rows] - py, np.cos(heading), np.sin(heading)
                along = np.clip(along, 0.0, candidate.length) + dx * cos + dy * sin
            t = dy * cos - dx * sin
            within = (along >= 0.0) & (along <= candidate.length)
            along = np.clip(along, 0.0, candidate.length)
            right, left = candidate.road_edge_offsets(along)
            good = within & (t >= right - tolerance) & (t <= left + tolerance)
            inside[rows] = good
            s[rows[good]] = along[good]
        return inside

    def _sample_reference_line(self, road: int) -> tuple[NearestPointIndex, FloatArray]:
        if road not in self._reference_samples:
            length = self._roads[road].length
            s = np.linspace(0.0, length, max(2, int(length) + 1))
            x, y, _ = self._roads[road].reference_pose(s)
            self._reference_samples[road] = NearestPointIndex(np.stack([x, y], axis=1)), s
        return self._reference_samples[road]

    @cached_property
    def _samples(self) -> _LaneSamples:
        lanes = [
            (r, k, start, end, number)
            for r, current in enumerate(self._roads)
            for k, ((start, lanes_held), end) in enumerate(
                zip(current.sections, current.section_bounds[1:].tolist(), strict=True)
            )
            for number in lanes_held
        ]
        spacing = max(_SAMPLE_DISTANCE, sum(max(end - start, 0.0) for _, _, start, end, _ in lanes) / self._max_samples)
        points, headings, road, lane, positions, half, bad = [], [], [], [], [], [], []
        for r, k, start, end, number in lanes:
            current = self._roads[r]
            s = np.linspace(start, end, max(2, int(np.ceil((end - start) / spacing)) + 1))
            x, y, heading = current.pose_at(s, current.lane_center(k, number, s))
            points.append(np.stack([x, y], axis=1))
            headings.append(heading)
            road.append(np.full(len(s), r))
            lane.append(np.full(len(s), number))
            positions.append(s)
            half.append(0.5 * current.lane_width(k, number, s))
            bad.append(np.full(len(s), not current.sections[k][1][number].is_drivable))
        all_points = np.concatenate(points)
        return _LaneSamples(
            NearestPointIndex(all_points),
            all_points,
            np.concatenate(headings),
            np.concatenate(road),
            np.concatenate(lane),
            np.concatenate(positions),
            np.concatenate(half),
            np.concatenate(bad),
            spacing,
        )


@kernel(interpreted_seconds=lambda points, samples, candidates: 3e-6 * candidates.size, error_model="numpy")
def _distances_to_samples(points, samples, candidates):
    """Return the distances in m from each point to its candidates (the samples of lanes nearest to the point)."""
    gap = np.empty(candidates.shape)
    for i in range(candidates.shape[0]):
        for k in range(candidates.shape[1]):
            dx, dy = points[i, 0] - samples[candidates[i, k], 0], points[i, 1] - samples[candidates[i, k], 1]
            gap[i, k] = math.sqrt(dx * dx + dy * dy)
    return gap


@kernel(interpreted_seconds=lambda distances, *_: 2e-6 * distances.size, error_model="numpy")
def _choose_candidate(distances, candidates, half_width, is_undrivable):
    """Return, for each point, which of its candidate samples lies on the lane that the point belongs to.

    If several candidates are equally good, the first one is returned.
    """
    best = np.zeros(candidates.shape[0], dtype=np.int64)
    for i in range(candidates.shape[0]):
        lowest = math.inf
        for k in range(candidates.shape[1]):
            distance, half = distances[i, k], half_width[candidates[i, k]]
            cost = max(distance - half, 0.0) + 1e-3 * distance
            if distance <= half and is_undrivable[candidates[i, k]]:
                cost += 0.01
            if cost < lowest:
                best[i], lowest = k, cost
    return best


def _distances_to_lanes(points: FloatArray, samples: _LaneSamples, candidates: IntArray) -> FloatArray:
    """Return the distances in m from points to the lanes of their candidate samples; for widely spaced samples."""
    dx, dy = (points[:, None, axis] - samples.points[candidates, axis] for axis in (0, 1))
    cos, sin = np.cos(samples.heading[candidates]), np.sin(samples.heading[candidates])
    beyond = np.maximum(np.abs(dx * cos + dy * sin) - samples.spacing, 0.0)
    return np.asarray(np.hypot(beyond, dy * cos - dx * sin))
