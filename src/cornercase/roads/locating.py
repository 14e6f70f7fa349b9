"""Where points of the plane are on the roads."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from cornercase._common.compiling import kernel
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.roads.nearest import NearestPoints
from cornercase.roads.road import Road

# Lanes are sampled at this distance in m, or at a larger one where there would be more samples than this.
_SAMPLED: Final = 0.5
_MOST_SAMPLES: Final = 2_000_000
SLACK: Final = 2.0
"""So far beside it, in m, an entity still counts as on the road that it was on; esmini's figure."""
# So many samples that are near are compared.
_CANDIDATES: Final = 24
# So many places are remembered.
_MOST_LOCATED: Final = 4096
# Points lie no further out than this, in m.
_ANYWHERE: Final = 1e12


class Place(NamedTuple):
    """Where points are on the roads, each array of shape (N,).

    Attributes
    ----------
    road, lane : ndarray of int64
        Index of the road, and lane.
    s, offset : ndarray of float64
        Along the road, and to the left of the lane's centre as seen along the road, in m.
    """

    road: IntArray
    lane: IntArray
    s: FloatArray
    offset: FloatArray


class _Samples(NamedTuple):
    """Samples of the middle of all lanes, and how far apart they are at most, in m."""

    nearest: NearestPoints
    points: FloatArray
    heading: FloatArray
    road: IntArray
    lane: IntArray
    s: FloatArray
    half: FloatArray
    bad: BoolArray
    apart: float


class Locator:
    """Finds roads and lanes by place.

    Parameters
    ----------
    roads : sequence of Road
    """

    def __init__(self, roads: Sequence[Road]) -> None:
        self._roads = roads
        self._located: dict[bytes, Place] = {}
        self._references: dict[int, tuple[NearestPoints, FloatArray]] = {}
        self._overlapping = [i for i, road in enumerate(roads) if road.junction not in ("-1", "")]

    def locate(self, x: FloatArray, y: FloatArray) -> Place:
        """Find where points are on the roads.

        A lane that holds the point goes before a nearer one, and a driving lane before others.

        Parameters
        ----------
        x, y : ndarray of float64, shape (N,)
            m.

        Returns
        -------
        Place
        """
        if not (len(x) and (x == x[0]).all() and (y == y[0]).all()):
            return self._search(x, y)
        # As a rule a file puts all scenarios at the same place, and does so each time that it is run.
        point = x[:1].tobytes() + y[:1].tobytes()
        if point not in self._located:
            if len(self._located) >= _MOST_LOCATED:
                self._located = {}
            self._located[point] = self._search(x[:1], y[:1])
        road, lane, s, offset = self._located[point]
        return Place(road.repeat(len(x)), lane.repeat(len(x)), s.repeat(len(x)), offset.repeat(len(x)))

    def _search(self, x: FloatArray, y: FloatArray) -> Place:
        samples = self._samples
        # What is as far as that is found nowhere; NaN is not near either.
        known = (np.abs(x) < _ANYWHERE) & (np.abs(y) < _ANYWHERE)
        points = np.stack([np.where(known, x, 0.0), np.where(known, y, 0.0)], axis=1)
        near = samples.nearest.find(points, _CANDIDATES)
        wide = samples.apart > _SAMPLED
        gap = _to_line(points, samples, near) if wide else _to_samples(points, samples.points, near)
        best = near[np.arange(len(x)), _cheapest(gap, near, samples.half, samples.bad)]
        place = Place(samples.road[best], samples.lane[best], samples.s[best].copy(), np.zeros(len(x)))
        for r, ln in sorted({*zip(place.road.tolist(), place.lane.tolist(), strict=True)}):
            rows, one = (place.road == r) & (place.lane == ln), self._roads[r]
            for _ in range(2):
                cx, cy, heading = one.at_lane(ln, place.s[rows])
                dx, dy = points[rows, 0] - cx, points[rows, 1] - cy
                step = dx * np.cos(heading) + dy * np.sin(heading)
                place.s[rows] = np.clip(place.s[rows] + step, 0.0, one.length)
                place.offset[rows] = dy * np.cos(heading) - dx * np.sin(heading)
        return place

    def road_from(
        self, last: IntArray, last_s: FloatArray, x: FloatArray, y: FloatArray, heading: FloatArray
    ) -> tuple[IntArray, FloatArray]:
        """Find the road of points that move; as `RoadNetwork.road_from`."""
        road, s = last.copy(), last_s.copy()
        lost = ~self._holds(last, x, y, s, 1, SLACK)
        if lost.any():
            # Many scenarios are the same up to there; what lies together is found faster one after the other.
            order = np.flatnonzero(lost)[np.lexsort((heading[lost], y[lost], x[lost]))]
            places = np.stack([x[order], y[order], heading[order]], axis=1)
            new = np.append(True, (places[1:] != places[:-1]).any(axis=1))
            found, along = self._road_at(*places[new].T)
            which = np.cumsum(new) - 1
            road[order], s[order] = found[which], along[which]
        return road, s

    def _road_at(self, x: FloatArray, y: FloatArray, heading: FloatArray) -> tuple[IntArray, FloatArray]:
        """Find the road of points of which is not known where they were, and their s there."""
        place = self.locate(x, y)
        road, s = place.road, place.s
        apart = np.full(len(x), np.inf)
        inside = np.isin(road, self._overlapping)
        for r in self._overlapping if inside.any() else ():
            nearest, places = self._reference(r)
            along = places[nearest.find(np.stack([x, y], axis=1), 1)[:, 0]]
            found = self._holds(np.full(len(x), r), x, y, along, 2, 0.0) & inside
            turn = np.abs(np.sin(heading - self._roads[r].reference(along)[2]))
            better = found & (turn < apart)
            apart[better] = turn[better]
            road[better], s[better] = r, along[better]
        return road, s

    def _holds(
        self, road: IntArray, x: FloatArray, y: FloatArray, s: FloatArray, projections: int, slack: float
    ) -> BoolArray:
        """Whether points lie on given roads; `s`, a first guess, becomes their s where they do."""
        inside = np.zeros(len(x), dtype=np.bool_)
        for r in np.unique(road[(road >= 0) & np.isfinite(x)]):
            rows = np.flatnonzero((road == r) & np.isfinite(x))
            one, along = self._roads[r], s[rows]
            for _ in range(projections):
                px, py, heading = one.reference(np.clip(along, 0.0, one.length))
                dx, dy, cos, sin = x[rows] - px, y[rows] - py, np.cos(heading), np.sin(heading)
                along = np.clip(along, 0.0, one.length) + dx * cos + dy * sin
            t = dy * cos - dx * sin
            within = (along >= 0.0) & (along <= one.length)
            along = np.clip(along, 0.0, one.length)
            right, left = one.margins(along)
            good = within & (t >= right - slack) & (t <= left + slack)
            inside[rows] = good
            s[rows[good]] = along[good]
        return inside

    def _reference(self, road: int) -> tuple[NearestPoints, FloatArray]:
        if road not in self._references:
            length = self._roads[road].length
            s = np.linspace(0.0, length, max(2, int(length) + 1))
            x, y, _ = self._roads[road].reference(s)
            self._references[road] = NearestPoints(np.stack([x, y], axis=1)), s
        return self._references[road]

    @cached_property
    def _samples(self) -> _Samples:
        lanes = [
            (r, k, start, end, number)
            for r, one in enumerate(self._roads)
            for k, ((start, held), end) in enumerate(zip(one.sections, one.seams[1:].tolist(), strict=True))
            for number in held
        ]
        apart = max(_SAMPLED, sum(max(end - start, 0.0) for _, _, start, end, _ in lanes) / _MOST_SAMPLES)
        points, headings, road, lane, where, half, bad = [], [], [], [], [], [], []
        for r, k, start, end, number in lanes:
            one = self._roads[r]
            s = np.linspace(start, end, max(2, int(np.ceil((end - start) / apart)) + 1))
            x, y, heading = one.at(s, one.center(k, number, s))
            points.append(np.stack([x, y], axis=1))
            headings.append(heading)
            road.append(np.full(len(s), r))
            lane.append(np.full(len(s), number))
            where.append(s)
            half.append(0.5 * one.width(k, number, s))
            bad.append(np.full(len(s), not one.sections[k][1][number].drivable))
        together = np.concatenate(points)
        return _Samples(
            NearestPoints(together), together, np.concatenate(headings), np.concatenate(road), np.concatenate(lane),
            np.concatenate(where), np.concatenate(half), np.concatenate(bad), apart,
        )  # fmt: skip


@kernel(error_model="numpy")
def _to_samples(points, samples, near):
    """Distance in m of points from the samples that are near."""
    gap = np.empty(near.shape)
    for i in range(near.shape[0]):
        for k in range(near.shape[1]):
            dx, dy = points[i, 0] - samples[near[i, k], 0], points[i, 1] - samples[near[i, k], 1]
            gap[i, k] = math.sqrt(dx * dx + dy * dy)
    return gap


@kernel(error_model="numpy")
def _cheapest(gap, near, half, bad):
    """Which of the samples near each point is on the lane that it counts as on; the first of several."""
    best = np.zeros(near.shape[0], dtype=np.int64)
    for i in range(near.shape[0]):
        least = math.inf
        for k in range(near.shape[1]):
            to, wide = gap[i, k], half[near[i, k]]
            cost = max(to - wide, 0.0) + 1e-3 * to
            if to <= wide and bad[near[i, k]]:
                cost += 0.01
            if cost < least:
                best[i], least = k, cost
    return best


def _to_line(points: FloatArray, samples: _Samples, near: IntArray) -> FloatArray:
    """Distance in m of points from the lanes whose samples are near, which lie too far apart to stand for them."""
    dx, dy = (points[:, None, axis] - samples.points[near, axis] for axis in (0, 1))
    cos, sin = np.cos(samples.heading[near]), np.sin(samples.heading[near])
    beyond = np.maximum(np.abs(dx * cos + dy * sin) - samples.apart, 0.0)
    return np.asarray(np.hypot(beyond, dy * cos - dx * sin))
