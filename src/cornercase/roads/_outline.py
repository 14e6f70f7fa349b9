"""Outlines of roads for drawings: lane areas, and the lines between lanes."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby, pairwise
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.roads._road import Road

if TYPE_CHECKING:
    from cornercase.roads._network import RoadNetwork

# Tolerance in m, once for sampling and once for simplification.
_MAX_DEVIATION: Final = 0.02
# Limits of the step along a road in m; the upper one keeps the shape of lanes that widen.
_STEP_LIMITS: Final = (0.05, 1.0)
# Largest distance of a lane from its reference line, in m.
_MAX_LANE_DISTANCE: Final = 100.0
# Step in m to find parts of roads in the region.
_COARSE_STEP: Final = 5.0
# Smallest width of a lane in m.
_MIN_LANE_WIDTH: Final = 0.01
_PEDESTRIAN_LANE_TYPES: Final = ("sidewalk", "walking")

Region = tuple[float, float, float, float]
"""Smallest x and y, and largest x and y, in m."""


class RoadOutline(NamedTuple):
    """Areas and lines to draw: pairs of a kind and an array of points in m, shape (P, 2).

    An area is the polygon of neighboring lanes of a kind: ``"road"`` for vehicles, ``"walk"`` for pedestrians, or
    ``"verge"`` for other lanes; lanes of the type ``none`` have no area. Areas may overlap, for example in junctions. A
    line separates two lanes for vehicles. Its kind is ``"lane"`` if both lanes have the same direction, else
    ``"centre"``. Junctions have no lines.
    """

    areas: list[tuple[str, FloatArray]]
    lines: list[tuple[str, FloatArray]]


def outline_roads(network: RoadNetwork, region: Region) -> RoadOutline:
    """Return areas and lines of the roads in a region.

    They follow the lane borders to within 5 cm. They may be farther away where the width of a lane changes quickly, as
    the borders are sampled at steps of up to 1 m.
    """
    outline = RoadOutline([], [])
    for road in _roads_near(network, region):
        for section in range(len(road.sections)):
            for s in _sample_section_in_region(road, section, region):
                _add_section_outline(outline, road, section, s)
    return outline


def _roads_near(network: RoadNetwork, region: Region) -> Iterator[Road]:
    """Yield the roads that may reach into the region.

    The test is coarse: it takes each geometry of a road as a disc that surely contains the geometry and its lanes.
    """
    pieces = [
        (k, geometry.x, geometry.y, geometry.length)
        for k, road in enumerate(network.roads)
        for geometry in road.geometries
    ]
    table = np.array(pieces)
    distances = _distance_from_region(table[:, 1], table[:, 2], region)
    for k in np.unique(table[distances <= table[:, 3] + _MAX_LANE_DISTANCE, 0]).astype(int):
        yield network.roads[int(k)]


def _distance_from_region(x: FloatArray, y: FloatArray, region: Region) -> FloatArray:
    """Return the distance of points from a region in m; 0 inside."""
    left, bottom, right, top = region
    across = np.maximum(np.maximum(left - x, x - right), 0.0)
    return np.asarray(np.hypot(across, np.maximum(np.maximum(bottom - y, y - top), 0.0)))


def _sample_section_in_region(road: Road, section: int, region: Region) -> Iterator[FloatArray]:
    """Yield an array of s coordinates for each part of a lane section that lies in the region.

    The coordinates are closer together in bends.
    """
    start, end = road.section_interval(section)
    if end <= start:
        return
    coarse = np.linspace(start, end, int(np.ceil((end - start) / _COARSE_STEP)) + 1)
    near = np.zeros(len(coarse), dtype=np.bool_)
    right, left = road.road_edge_offsets(coarse)
    for t in (right, np.zeros(len(coarse)), left):
        near |= _distance_from_region(*road.pose_at(coarse, t)[:2], region) <= _COARSE_STEP
    for start_row, end_row in _true_runs(near):
        yield _sample_by_curvature(
            road, float(coarse[max(start_row - 1, 0)]), float(coarse[min(end_row, len(coarse) - 1)])
        )


def _true_runs(mask: BoolArray) -> Iterator[tuple[int, int]]:
    """Yield the first index of each unbroken series of True in a mask, and the index after its last."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def _sample_by_curvature(road: Road, start: float, end: float) -> FloatArray:
    seams = [geometry.s for geometry in road.geometries] + [offset[0] for offset in road.lane_offsets]
    breaks = sorted({start, end, *(s for s in seams if start < s < end)})
    samples = []
    for begin, end_ in pairwise(breaks):
        coarse = np.linspace(begin, end_, 2 + int((end_ - begin) / _COARSE_STEP))
        bend = float(np.abs(road.reference_curvature(coarse)).max())
        reach = float(np.abs(np.concatenate(road.road_edge_offsets(coarse))).max())
        # The sagitta of the outer edge is an eighth of its radius times the squared angle.
        step = np.sqrt(8.0 * _MAX_DEVIATION / (bend * (1.0 + reach * bend))) if bend > 0.0 else _STEP_LIMITS[1]
        samples.append(np.linspace(begin, end_, 1 + int(np.ceil((end_ - begin) / np.clip(step, *_STEP_LIMITS)))))
    return np.asarray(np.unique(np.concatenate(samples)))


def _add_section_outline(outline: RoadOutline, road: Road, section: int, s: FloatArray) -> None:
    lanes = road.sections[section][1]
    # From left to right, as the edges of each lane.
    order = sorted(lanes, reverse=True)
    sides = {}
    for number in order:
        inner, outer = road.lane_edge_offsets(section, number, s)
        sides[number] = (outer, inner) if number > 0 else (inner, outer)

    def to_polyline(t: FloatArray) -> FloatArray:
        return _simplify_line(np.stack(road.pose_at(s, t)[:2], axis=-1))

    classes = {number: _area_kind(lanes[number].lane_type, lanes[number].is_drivable) for number in order}
    for kind, group in groupby(order, key=lambda number: classes[number]):
        numbers = [number for number in group if number != 0]
        if kind and numbers:
            left, right = sides[numbers[0]][0], sides[numbers[-1]][1]
            if (np.abs(left - right) > _MIN_LANE_WIDTH).any():
                outline.areas.append((kind, np.concatenate([to_polyline(left), to_polyline(right)[::-1]])))
    if road.junction not in ("-1", ""):
        return
    driven = [number for number in order if classes[number] == "road"]
    for left_lane, right_lane in pairwise(driven):
        if order.index(right_lane) != order.index(left_lane) + 1:
            continue
        widths = [np.abs(np.subtract(*sides[number])) for number in (left_lane, right_lane)]
        along = [bool(road.is_traffic_forward(number, s[:1])[0]) for number in (left_lane, right_lane)]
        kind = "lane" if along[0] == along[1] else "centre"
        line = np.stack(road.pose_at(s, sides[right_lane][0])[:2], axis=-1)
        for start, until in _true_runs((widths[0] > _MIN_LANE_WIDTH) & (widths[1] > _MIN_LANE_WIDTH)):
            if until - start > 1:
                outline.lines.append((kind, _simplify_line(line[start:until])))


def _area_kind(kind: str, drivable: bool) -> str:
    if drivable:
        return "road"
    return "" if kind == "none" else "walk" if kind in _PEDESTRIAN_LANE_TYPES else "verge"


def _simplify_line(points: FloatArray) -> FloatArray:
    """Simplify a line (Douglas-Peucker): removed points are at most `_MAX_DEVIATION` away from the simplified line."""
    keep = np.zeros(len(points), dtype=np.bool_)
    keep[[0, -1]] = True
    pending = [(0, len(points) - 1)]
    while pending:
        first, last = pending.pop()
        if last - first < 2:
            continue
        offsets, chord = points[first + 1 : last] - points[first], points[last] - points[first]
        part = np.clip(offsets @ chord / max(float(chord @ chord), 1e-12), 0.0, 1.0)
        away = np.hypot(*(offsets - part[:, None] * chord).T)
        furthest = int(away.argmax())
        if away[furthest] > _MAX_DEVIATION:
            middle = first + 1 + furthest
            keep[middle] = True
            pending += [(first, middle), (middle, last)]
    return points[keep]
