"""Distances of boxes (outlines of entities) from the edges of their lanes, or of the road."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.roads._nearest import NearestPointIndex
from cornercase.roads._network import RoadNetwork
from cornercase.roads._road import Road

# Spacing in m of points on a reference line, among which the nearest is searched, and number of refinement steps.
_SAMPLE_DISTANCE: Final = 1.0
_N_REFINEMENTS: Final = 4
# Smallest cosine of the angle between a box and the traffic of a lane for the lane to be the box's own.
_SAME_DIRECTION: Final = 0.5
# Length in m by which a road may end before the centre of a box on it.
_END_TOLERANCE: Final = 0.01


def lane_margins(
    network: RoadNetwork, x: FloatArray, y: FloatArray, heading: FloatArray, corners: FloatArray
) -> FloatArray:
    """Return how far boxes (outlines of entities) are inside of their lane, in m, shape (T,); negative outside.

    The distance is measured from the outermost corner to the edge of the lane. `x`, `y` and `heading`, shape (T,), are
    the poses of the centres, and `corners` has shape (T, 4, 2). The lane of a box is the drivable lane that contains
    its centre, preferably with traffic in the direction of the box. If several lanes qualify, as in junctions, the
    largest distance counts. If no lane contains the centre, the nearest lane counts. NaN if there is no lane.
    """
    # One row per order of preference.
    best = np.full((3, len(x)), -np.inf)
    for road, rows in _iter_roads_near(network, x, y):
        s, t = _road_coordinates(road, x[rows], y[rows])
        section = road.section_at(s)
        is_along = _is_along(road, s, x[rows], y[rows])
        for strip, at in _iter_strips(road, section, merge=False):
            (lane,) = strip
            low, high = _strip_edges(road, int(section[at[0]]), strip, s[at])
            contains = is_along[at] & (low <= t[at]) & (t[at] <= high)
            direction = road.reference_pose(s[at])[2] + np.where(road.is_traffic_forward(lane, s[at]), 0.0, np.pi)
            is_own = contains & (np.cos(heading[rows[at]] - direction) > _SAME_DIRECTION)
            margin = _corner_margins(road, int(section[at[0]]), strip, corners[rows[at]]).min(axis=1)
            for rank, counts in enumerate((is_own, contains, np.ones_like(contains))):
                best[rank, rows[at[counts]]] = np.maximum(best[rank, rows[at[counts]]], margin[counts])
    rank = np.isfinite(best).argmax(axis=0)
    return np.where(np.isfinite(best).any(axis=0), best[rank, np.arange(len(x))], np.nan)


def road_margins(network: RoadNetwork, x: FloatArray, y: FloatArray, corners: FloatArray) -> FloatArray:
    """Return how far boxes (outlines of entities) are inside of the drivable lanes, in m, shape (T,); negative outside.

    The distance is measured from the outermost corner to the edge of all drivable lanes together. Arguments are as in
    `lane_margins`.
    """
    best = np.full((len(x), 4), -np.inf)
    for road, rows in _iter_roads_near(network, x, y):
        section = road.section_at(_road_coordinates(road, x[rows], y[rows])[0])
        for strip, at in _iter_strips(road, section, merge=True):
            margin = _corner_margins(road, int(section[at[0]]), strip, corners[rows[at]])
            best[rows[at]] = np.maximum(best[rows[at]], margin)
    margin = best.min(axis=1)
    return np.where(np.isfinite(margin), margin, np.nan)


def _iter_roads_near(network: RoadNetwork, x: FloatArray, y: FloatArray) -> Iterator[tuple[Road, IntArray]]:
    """Yield each road near some points, with the indices of these points.

    A road is near a point if it is the nearest road, or belongs to the same junction as the nearest road.
    """
    present = np.flatnonzero(np.isfinite(x + y))
    if not present.size:
        return
    nearest = network.locate(x[present], y[present]).road
    reached: dict[int, list[int]] = {}
    for number in sorted(set(nearest.tolist())):
        junction = network.roads[number].junction
        is_alone = junction in ("", "-1")
        for k, road in enumerate(network.roads):
            if k == number or (not is_alone and road.junction == junction):
                reached.setdefault(k, []).append(number)
    for k in sorted(reached):
        yield network.roads[k], present[np.isin(nearest, reached[k])]


def _iter_strips(road: Road, section: IntArray, merge: bool) -> Iterator[tuple[tuple[int, ...], IntArray]]:
    """Yield each strip of drivable lanes, as lane numbers, with the indices of the points in the same lane section.

    `section` is the lane section of each point. A strip is a single lane or, with `merge`, a group of adjacent drivable
    lanes.
    """
    for k in sorted(set(section.tolist())):
        lanes = road.sections[k][1]
        strips: list[tuple[int, ...]] = []
        previous: int | None = None
        for number in sorted(n for n in lanes if n != 0):
            if not lanes[number].is_drivable:
                previous = None
                continue
            if merge and previous is not None:
                strips[-1] += (number,)
            else:
                strips.append((number,))
            previous = number
        for strip in strips:
            yield strip, np.flatnonzero(section == k)


def _strip_edges(road: Road, section: int, strip: tuple[int, ...], s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the lateral coordinates t of the right and left edge of a strip, (N,) each."""
    edges = np.stack([edge for lane in (strip[0], strip[-1]) for edge in road.lane_edge_offsets(section, lane, s)])
    return edges.min(axis=0), edges.max(axis=0)


def _corner_margins(road: Road, section: int, strip: tuple[int, ...], corners: FloatArray) -> FloatArray:
    """Return how far corners (N, 4, 2) are inside of a strip, in m, (N, 4); negative outside."""
    s, t = _road_coordinates(road, corners[..., 0].ravel(), corners[..., 1].ravel())
    low, high = _strip_edges(road, section, strip, s)
    return np.minimum(t - low, high - t).reshape(corners.shape[:2])


def _is_along(road: Road, s: FloatArray, x: FloatArray, y: FloatArray) -> BoolArray:
    """Return whether points, whose s was found by `_road_coordinates`, are not beyond the ends of the road, (N,)."""
    is_along = (s > 0.0) & (s < road.length)
    at_end = np.flatnonzero(~is_along)
    on_x, on_y, heading = road.reference_pose(s[at_end])
    ahead = (x[at_end] - on_x) * np.cos(heading) + (y[at_end] - on_y) * np.sin(heading)
    is_along[at_end] = np.where(s[at_end] > 0.0, ahead < _END_TOLERANCE, ahead > -_END_TOLERANCE)
    return np.asarray(is_along)


def _road_coordinates(road: Road, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return s and t of points in m, (N,) each; beyond an end of the road, s is that end."""
    stations = np.linspace(0.0, road.length, max(2, int(np.ceil(road.length / _SAMPLE_DISTANCE)) + 1))
    line_x, line_y, _ = road.reference_pose(stations)
    index = NearestPointIndex(np.stack((line_x, line_y), axis=1))
    s = stations[index.find_nearest(np.stack((x, y), axis=1), 1)[:, 0]]
    for _ in range(_N_REFINEMENTS):
        on_x, on_y, heading = road.reference_pose(s)
        s = np.clip(s + (x - on_x) * np.cos(heading) + (y - on_y) * np.sin(heading), 0.0, road.length)
    on_x, on_y, heading = road.reference_pose(s)
    return s, (y - on_y) * np.cos(heading) - (x - on_x) * np.sin(heading)
