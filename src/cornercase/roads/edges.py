"""Compiled lateral extent of roads, for one point at a time."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from cornercase._common.compiling import kernel
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.roads.lane import Polynomial
from cornercase.roads.road import Road

_RIGHT, _LEFT = 0, 1
# Tolerance in m for rounded edges.
_ROUNDING: Final = 1e-9


class RoadEdges(NamedTuple):
    """Widths of R roads with S lane sections, L lanes and Q cubics in all, as arrays for kernels.

    `sections`, shape (R + 1,), has the first section of each road; `lanes`, (2 S + 1,), the first lane right and left
    of each section, from the center outwards; `cubics`, (R + L + 1,), the first cubic of each road's lane offset and
    of each lane's width or border (`is_border`). `coefficients`, (Q, 5), are the start in m and the coefficients,
    lowest first. Between both values of `always_inside`, (R, 2), a lateral coordinate in m is on the road everywhere
    along it.
    """

    sections: IntArray
    start: FloatArray
    lanes: IntArray
    cubics: IntArray
    bordered: BoolArray
    coefficients: FloatArray
    inner: FloatArray


def road_edges(roads: Sequence[Road]) -> RoadEdges:
    """Tabulate the widths of roads for kernels."""
    lines: list[tuple[Polynomial, ...]] = [road.offsets for road in roads]
    starts, counts, bordered = [], [], []
    for road in roads:
        for start, lanes in road.sections:
            starts.append(start)
            for sign in (-1, 1):
                side = [lanes[number] for number in sorted((k for k in lanes if k * sign > 0), key=abs)]
                counts.append(len(side))
                bordered += [bool(lane.borders) for lane in side]
                lines += [lane.borders or lane.widths for lane in side]
    return RoadEdges(
        np.cumsum([0, *(len(road.sections) for road in roads)], dtype=np.int64),
        np.array(starts, dtype=np.float64),
        np.cumsum([0, *counts], dtype=np.int64),
        np.cumsum([0, *map(len, lines)], dtype=np.int64),
        np.array(bordered, dtype=np.bool_),
        np.array([cubic for line in lines for cubic in line], dtype=np.float64).reshape(-1, 5),
        np.array([_inner(road) for road in roads]).reshape(-1, 2),
    )


def _inner(road: Road) -> tuple[float, float]:
    knots = [*road.seams[:-1].tolist(), *(offset for offset, *_ in road.offsets)]
    lines = [road.offsets]
    for start, lanes in road.sections:
        for lane in lanes.values():
            lines.append(lane.borders or lane.widths)
            knots += [start + offset for offset, *_ in lines[-1]]
    if any(change != 0.0 for line in lines for cubic in line for change in cubic[2:]):
        return np.inf, -np.inf
    # The edges are constant between knots.
    right, left = road.margins(np.clip(knots, 0.0, road.length))
    return float(right.max()) + _ROUNDING, float(left.min()) - _ROUNDING


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def road_margins(edges, road, s):
    """Return the lateral coordinates of a road's right and left edge at `s`, in m."""
    section = edges.sections[road]
    while section + 1 < edges.sections[road + 1] and edges.start[section + 1] <= s:
        section += 1
    middle = _value(edges, road, s)
    return _edge(edges, section, _RIGHT, middle, s), _edge(edges, section, _LEFT, middle, s)


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _edge(edges, section, side, middle, s):
    first, last = edges.lanes[2 * section + side], edges.lanes[2 * section + side + 1]
    roads, edge, sign = edges.sections.size - 1, middle, 1.0 if side == _LEFT else -1.0
    for lane in range(first, last):
        value = _value(edges, roads + lane, s - edges.start[section])
        if edges.bordered[lane]:
            edge = middle + value
        elif value > 0.0:
            edge = edge + sign * value
    return edge


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _value(edges, line, s):
    """Evaluate piecewise cubics; 0 if there are none."""
    k, last, table = edges.cubics[line], edges.cubics[line + 1], edges.coefficients
    if k == last:
        return 0.0
    while k + 1 < last and table[k + 1, 0] <= s:
        k += 1
    d = s - table[k, 0]
    return table[k, 1] + d * (table[k, 2] + d * (table[k, 3] + d * table[k, 4]))
