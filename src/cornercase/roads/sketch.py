"""What is drawn of roads: areas of lanes, and the lines between them."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby, pairwise
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.roads.road import Road

if TYPE_CHECKING:
    from cornercase.roads.opendrive import RoadNetwork

# What a chord may leave of a curve, in m: one half by the sampling, one half by leaving out points.
_CHORD: Final = 0.02
# The step along a road is no longer, so that lanes that widen keep their shape, and no shorter, in m.
_STEPS: Final = (0.05, 1.0)
# No lane lies further from its road's reference line, in m.
_WIDEST: Final = 100.0
# m; where a road is looked for in the region.
_COARSE: Final = 5.0
# m; less is no lane.
_NARROW: Final = 0.01
_WALKED: Final = ("sidewalk", "walking")

Region = tuple[float, float, float, float]
"""Least x and y, and greatest x and y, in m."""


class RoadSketch(NamedTuple):
    """What is drawn of roads.

    Attributes
    ----------
    areas : list of (str, ndarray of float64, shape (P, 2))
        Polygons of lanes that lie beside each other, in m: ``"road"`` for vehicles, ``"walk"`` for pedestrians and
        ``"verge"``, whatever else lies beside. Where they overlap, as in junctions, their union is meant; its outline
        is the edge of the road.
    lines : list of (str, ndarray of float64, shape (P, 2))
        Borders between lanes for vehicles, in m: ``"lane"`` where traffic runs the same way on both sides,
        ``"centre"`` where it does not. There are none within junctions, where lanes cross.
    """

    areas: list[tuple[str, FloatArray]]
    lines: list[tuple[str, FloatArray]]


def lane_borders(network: RoadNetwork, region: Region) -> RoadSketch:
    """Find what is drawn of a road network in a region.

    Parameters
    ----------
    network : RoadNetwork
    region : tuple of float
        Least x and y, and greatest x and y, in m.

    Returns
    -------
    RoadSketch
        No chord leaves a lane's border by more than 5 cm.
    """
    found = RoadSketch([], [])
    for road in _roads_near(network, region):
        for section in range(len(road.sections)):
            for s in _stretches(road, section, region):
                _add_section(found, road, section, s)
    return found


def _roads_near(network: RoadNetwork, region: Region) -> Iterator[Road]:
    """Roads of which a piece can be near: it lies in a disc around its begin with its length as radius."""
    pieces = [(k, one.x, one.y, one.length) for k, road in enumerate(network.roads) for one in road.geometries]
    table = np.array(pieces)
    away = _apart(table[:, 1], table[:, 2], region)
    for k in np.unique(table[away <= table[:, 3] + _WIDEST, 0]).astype(int):
        yield network.roads[int(k)]


def _apart(x: FloatArray, y: FloatArray, region: Region) -> FloatArray:
    """Distance of points from a region in m, 0 inside."""
    left, bottom, right, top = region
    across = np.maximum(np.maximum(left - x, x - right), 0.0)
    return np.asarray(np.hypot(across, np.maximum(np.maximum(bottom - y, y - top), 0.0)))


def _stretches(road: Road, section: int, region: Region) -> Iterator[FloatArray]:
    """Coordinates s of each stretch of a section that lies in the region, as dense as its bends ask for."""
    start, end = road.section_span(section)
    if end <= start:
        return
    coarse = np.linspace(start, end, int(np.ceil((end - start) / _COARSE)) + 1)
    near = np.zeros(len(coarse), dtype=np.bool_)
    right, left = road.margins(coarse)
    for t in (right, np.zeros(len(coarse)), left):
        near |= _apart(*road.at(coarse, t)[:2], region) <= _COARSE
    for begin, until in _runs(near):
        yield _fine(road, float(coarse[max(begin - 1, 0)]), float(coarse[min(until, len(coarse) - 1)]))


def _runs(mask: BoolArray) -> Iterator[tuple[int, int]]:
    """First row, and row after the last one, of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def _fine(road: Road, start: float, end: float) -> FloatArray:
    seams = [one.s for one in road.geometries] + [one[0] for one in road.offsets]
    breaks = sorted({start, end, *(s for s in seams if start < s < end)})
    found = []
    for one, other in pairwise(breaks):
        some = np.linspace(one, other, 2 + int((other - one) / _COARSE))
        bend = float(np.abs(road.bend(some)).max())
        reach = float(np.abs(np.concatenate(road.margins(some))).max())
        # The chord of the outer edge leaves it by an eighth of its radius times the square of the angle.
        step = np.sqrt(8.0 * _CHORD / (bend * (1.0 + reach * bend))) if bend > 0.0 else _STEPS[1]
        found.append(np.linspace(one, other, 1 + int(np.ceil((other - one) / np.clip(step, *_STEPS)))))
    return np.asarray(np.unique(np.concatenate(found)))


def _add_section(found: RoadSketch, road: Road, section: int, s: FloatArray) -> None:
    lanes = road.sections[section][1]
    # From the left to the right, with the edges of each lane in this order.
    order = sorted(lanes, reverse=True)
    sides = {}
    for number in order:
        inner, outer = road.edges(section, number, s)
        sides[number] = (outer, inner) if number > 0 else (inner, outer)

    def drawn(t: FloatArray) -> FloatArray:
        return _simplified(np.stack(road.at(s, t)[:2], axis=-1))

    classes = {number: _class_of(lanes[number].kind, lanes[number].drivable) for number in order}
    for kind, beside in groupby(order, key=lambda number: classes[number]):
        some = [number for number in beside if number != 0]
        if kind and some:
            left, right = sides[some[0]][0], sides[some[-1]][1]
            if (np.abs(left - right) > _NARROW).any():
                found.areas.append((kind, np.concatenate([drawn(left), drawn(right)[::-1]])))
    if road.junction not in ("-1", ""):
        return
    driven = [number for number in order if classes[number] == "road"]
    for left_lane, right_lane in pairwise(driven):
        if order.index(right_lane) != order.index(left_lane) + 1:
            continue
        widths = [np.abs(np.subtract(*sides[number])) for number in (left_lane, right_lane)]
        along = [bool(road.along(number, s[:1])[0]) for number in (left_lane, right_lane)]
        kind = "lane" if along[0] == along[1] else "centre"
        line = np.stack(road.at(s, sides[right_lane][0])[:2], axis=-1)
        for begin, until in _runs((widths[0] > _NARROW) & (widths[1] > _NARROW)):
            if until - begin > 1:
                found.lines.append((kind, _simplified(line[begin:until])))


def _class_of(kind: str, drivable: bool) -> str:
    if drivable:
        return "road"
    return "" if kind == "none" else "walk" if kind in _WALKED else "verge"


def _simplified(points: FloatArray) -> FloatArray:
    """Points of a line without those that lie within `_CHORD` of the line without them (Douglas and Peucker)."""
    kept = np.zeros(len(points), dtype=np.bool_)
    kept[[0, -1]] = True
    waiting = [(0, len(points) - 1)]
    while waiting:
        first, last = waiting.pop()
        if last - first < 2:
            continue
        way, chord = points[first + 1 : last] - points[first], points[last] - points[first]
        part = np.clip(way @ chord / max(float(chord @ chord), 1e-12), 0.0, 1.0)
        away = np.hypot(*(way - part[:, None] * chord).T)
        furthest = int(away.argmax())
        if away[furthest] > _CHORD:
            middle = first + 1 + furthest
            kept[middle] = True
            waiting += [(first, middle), (middle, last)]
    return points[kept]
