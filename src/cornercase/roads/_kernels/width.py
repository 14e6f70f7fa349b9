"""Compiled lateral extent of roads, for one point at a time."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from cornercase._common.numba.kernel import kernel
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.roads._lane import CubicPolynomial
from cornercase.roads._road import Road

_RIGHT, _LEFT = 0, 1
# Tolerance in m for rounded edges.
_EDGE_TOLERANCE: Final = 1e-9


class RoadEdgeTables(NamedTuple):
    """Edges of R roads with S lane sections, L lanes and Q cubics in all, as arrays for compiled functions.

    `sections`, shape (R + 1,), has the index of each road's first section. `start` has the start of each section in m.
    `lanes`, shape (2 S + 1,), has for each section the index of the first lane on its right side and on its left side;
    lanes are counted from the center outwards. Cubics describe the lane offset of each road, and then the width of each
    lane, or its border if `is_border` is True. `cubics`, shape (R + L + 1,), has the index of the first cubic of each
    of these curves. `coefficients`, shape (Q, 5), has the start of each cubic in m and its coefficients, lowest first.
    `always_inside`, shape (R, 2), has two lateral coordinates in m: a point between them is on the road at every s.
    """

    sections: IntArray
    start: FloatArray
    lanes: IntArray
    cubics: IntArray
    is_border: BoolArray
    coefficients: FloatArray
    always_inside: FloatArray


def build_edge_tables(roads: Sequence[Road]) -> RoadEdgeTables:
    """Create the arrays of road edges for compiled functions."""
    lines: list[tuple[CubicPolynomial, ...]] = [road.lane_offsets for road in roads]
    starts, counts, bordered = [], [], []
    for road in roads:
        for start, lanes in road.sections:
            starts.append(start)
            for sign in (-1, 1):
                side = [lanes[number] for number in sorted((k for k in lanes if k * sign > 0), key=abs)]
                counts.append(len(side))
                bordered += [bool(lane.borders) for lane in side]
                lines += [lane.borders or lane.widths for lane in side]
    return RoadEdgeTables(
        np.cumsum([0, *(len(road.sections) for road in roads)], dtype=np.int64),
        np.array(starts, dtype=np.float64),
        np.cumsum([0, *counts], dtype=np.int64),
        np.cumsum([0, *map(len, lines)], dtype=np.int64),
        np.array(bordered, dtype=np.bool_),
        np.array([cubic for line in lines for cubic in line], dtype=np.float64).reshape(-1, 5),
        np.array([_interval_always_inside(road) for road in roads]).reshape(-1, 2),
    )


def _interval_always_inside(road: Road) -> tuple[float, float]:
    knots = [*road.section_bounds[:-1].tolist(), *(offset for offset, *_ in road.lane_offsets)]
    lines = [road.lane_offsets]
    for start, lanes in road.sections:
        for lane in lanes.values():
            lines.append(lane.borders or lane.widths)
            knots += [start + offset for offset, *_ in lines[-1]]
    if any(change != 0.0 for line in lines for cubic in line for change in cubic[2:]):
        return np.inf, -np.inf
    # The edges are constant between knots.
    right, left = road.road_edge_offsets(np.clip(knots, 0.0, road.length))
    return float(right.max()) + _EDGE_TOLERANCE, float(left.min()) - _EDGE_TOLERANCE


@kernel(error_model="numpy", _nrt=False)
def road_edge_offsets(tables, road, s):
    """Return the lateral coordinates of a road's right and left edge at `s`, in m."""
    section = tables.sections[road]
    while section + 1 < tables.sections[road + 1] and tables.start[section + 1] <= s:
        section += 1
    middle = _evaluate_cubics(tables, road, s)
    return _edge_offset(tables, section, _RIGHT, middle, s), _edge_offset(tables, section, _LEFT, middle, s)


@kernel(error_model="numpy", _nrt=False)
def _edge_offset(tables, section, side, lane_offset, s):
    first, last = tables.lanes[2 * section + side], tables.lanes[2 * section + side + 1]
    roads, edge, sign = tables.sections.size - 1, lane_offset, 1.0 if side == _LEFT else -1.0
    for lane in range(first, last):
        value = _evaluate_cubics(tables, roads + lane, s - tables.start[section])
        if tables.is_border[lane]:
            edge = lane_offset + value
        elif value > 0.0:
            edge = edge + sign * value
    return edge


@kernel(error_model="numpy", _nrt=False)
def _evaluate_cubics(tables, curve, s):
    """Evaluate piecewise cubics; 0 if there are none."""
    k, last, table = tables.cubics[curve], tables.cubics[curve + 1], tables.coefficients
    if k == last:
        return 0.0
    while k + 1 < last and table[k + 1, 0] <= s:
        k += 1
    d = s - table[k, 0]
    return table[k, 1] + d * (table[k, 2] + d * (table[k, 3] + d * table[k, 4]))
