"""Compiled position and heading of roads' reference lines, for one point at a time."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from cornercase._common.compiling import kernel
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.roads.edges import RoadEdges, road_edges, road_margins
from cornercase.roads.locating import SLACK
from cornercase.roads.reference_line import Geometry, turns_evenly
from cornercase.roads.road import Road

# Line, arc or spiral; parametric curve.
_TURNS, _CURVE = 0, 1
_NUMBERS: Final = 8


class RoadTables(NamedTuple):
    """Reference lines of R roads with P geometries in all, as arrays for kernels.

    By road: whether kernels can compute headings (`heading_known`) and positions (`position_known`), `length` in m, and
    the `first_geometry`. By geometry: its start in m and rad, its type, and `coefficients`: curvature at the start in
    1/m and its rate in 1/m²; or length in m, number of tabulated steps, and coefficients of the derivatives of both
    polynomials, highest first. `table_start` points to the table of the curve `parameter` at equal distances and of its
    derivative, the `parameter_rate` in 1/m.
    """

    known: BoolArray
    plain: BoolArray
    length: FloatArray
    first: IntArray
    s: FloatArray
    x: FloatArray
    y: FloatArray
    heading: FloatArray
    cos: FloatArray
    sin: FloatArray
    shape: IntArray
    numbers: FloatArray
    parameters: IntArray
    parameter: FloatArray
    rate: FloatArray
    edges: RoadEdges


def road_tables(roads: Sequence[Road]) -> RoadTables:
    """Tabulate reference lines for kernels."""
    pieces = [piece for road in roads for piece in road.geometries]
    numbers = np.zeros((len(pieces), _NUMBERS))
    for k, piece in enumerate(pieces):
        values = _numbers(piece)
        numbers[k, : len(values)] = values
    curves = [piece.table if piece.kind == "paramPoly3" else (np.zeros(0), np.zeros(0)) for piece in pieces]
    parameter, rate = (np.concatenate([np.zeros(0), *(curve[k] for curve in curves)]) for k in range(2))
    cos, sin = _components(np.array([piece_.heading for piece_ in pieces]))
    s, x, y, heading = (
        np.array([(piece_.s, piece_.x, piece_.y, piece_.heading) for piece_ in pieces]).reshape(-1, 4).T.copy()
    )
    return RoadTables(
        np.array([all(piece.kind != "poly3" for piece in road.geometries) for road in roads], dtype=np.bool_),
        np.array([all(map(_plain, road.geometries)) for road in roads], dtype=np.bool_),
        np.array([road.length for road in roads], dtype=np.float64),
        np.cumsum([0, *(len(road.geometries) for road in roads)], dtype=np.int64),
        s,
        x,
        y,
        heading,
        cos,
        sin,
        np.array([_CURVE if piece.kind == "paramPoly3" else _TURNS for piece in pieces], dtype=np.int64),
        numbers,
        np.cumsum([0, *(len(value) for value, _ in curves)], dtype=np.int64)[:-1],
        parameter,
        rate,
        road_edges(roads),
    )


def _plain(piece: Geometry) -> bool:
    if piece.kind != "spiral":
        return piece.kind in ("line", "arc")
    start, end = piece.numbers
    return bool(turns_evenly(start, end, piece.length))


def _numbers(piece: Geometry) -> tuple[float, ...]:
    if piece.kind == "arc":
        return piece.numbers[0], 0.0
    if piece.kind == "spiral":
        start, end = piece.numbers
        bent = turns_evenly(start, end, piece.length)
        return (0.5 * (start + end), 0.0) if bent else (start, (end - start) / piece.length)
    if piece.kind == "paramPoly3":
        _, _, u1, u2, u3, _, v1, v2, v3 = piece.numbers
        return piece.length, len(piece.table[0]) - 1, 3 * u3, 2 * u2, u1, 3 * v3, 2 * v2, v1
    return ()


@kernel(error_model="numpy")
def _components(heading):
    """Return cosines and sines with the last digits that kernels compute, which NumPy's may not have."""
    cos, sin = np.empty(heading.size), np.empty(heading.size)
    for k in range(heading.size):
        cos[k], sin[k] = math.cos(heading[k]), math.sin(heading[k])
    return cos, sin


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def road_heading(roads, road, s):
    """Return the heading of a road's reference line at `s`, in rad; only for roads that are `known`."""
    piece = _piece(roads, road, s)
    along, numbers = s - roads.s[piece], roads.numbers[piece]
    if roads.shape[piece] == _TURNS:
        return roads.heading[piece] + (numbers[0] * along + 0.5 * numbers[1] * (along * along))
    p = _parameter(roads, piece, along)
    du, dv = (numbers[2] * p + numbers[3]) * p + numbers[4], (numbers[5] * p + numbers[6]) * p + numbers[7]
    return roads.heading[piece] + math.atan2(dv, du)


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def road_direction(roads, road, s):
    """Return cosine and sine of `reference_heading`."""
    piece = _piece(roads, road, s)
    if roads.shape[piece] == _TURNS and roads.numbers[piece, 0] == 0.0 and roads.numbers[piece, 1] == 0.0:
        return roads.cos[piece], roads.sin[piece]
    heading = road_heading(roads, road, s)
    return math.cos(heading), math.sin(heading)


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def stays_on_road(roads, road, s, x, y):
    """Return whether a moved point is still on its `plain` road, or at most `SLACK` beside it, and its new `s`.

    `s` is its last coordinate on the road; x and y are its position, all in m.
    """
    length = roads.length[road]
    s = min(max(s, 0.0), length)
    at_x, at_y, cos, sin = _plain_place(roads, _piece(roads, road, s), s)
    dx, dy = x - at_x, y - at_y
    along, t = s + dx * cos + dy * sin, dy * cos - dx * sin
    if not (along >= 0.0 and along <= length):
        return False, s
    if t >= roads.edges.inner[road, 0] - SLACK and t <= roads.edges.inner[road, 1] + SLACK:
        return True, along
    right, left = road_margins(roads.edges, road, along)
    return t >= right - SLACK and t <= left + SLACK, along


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _plain_place(roads, piece, s):
    """Return x, y, cosine and sine of the heading on a line or arc."""
    along, curvature = s - roads.s[piece], roads.numbers[piece, 0]
    turn, cos, sin = curvature * along, roads.cos[piece], roads.sin[piece]
    if turn == 0.0:
        return roads.x[piece] + cos * along, roads.y[piece] + sin * along, cos, sin
    half = 0.5 * turn / math.pi
    chord = along * (math.sin(math.pi * half) / (math.pi * half))
    u, v = chord * math.cos(0.5 * turn), chord * math.sin(0.5 * turn)
    heading = roads.heading[piece] + turn
    x, y = roads.x[piece] + cos * u - sin * v, roads.y[piece] + sin * u + cos * v
    return x, y, math.cos(heading), math.sin(heading)


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _parameter(roads, piece, along):
    """Return the curve parameter at a distance, as `ReferenceGeometry.curve_parameter`."""
    length, steps, first = roads.numbers[piece, 0], roads.numbers[piece, 1], roads.parameters[piece]
    position = min(max(along, 0.0), length) / (length / steps)
    k = min(int(position), int(steps) - 1)
    low, high = roads.parameter[first + k], roads.parameter[first + k + 1]
    rate_low, rate_high = roads.rate[first + k], roads.rate[first + k + 1]
    x, rise = position - k, high - low
    bend_low, bend_high = length / steps * rate_low - rise, rise - length / steps * rate_high
    return (1.0 - x) * low + x * high + x * (1.0 - x) * ((1.0 - x) * bend_low + x * bend_high)


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _piece(roads, road, s):
    low, high = roads.first[road], roads.first[road + 1]
    # The first geometry also covers s below its start.
    while high - low > 1:
        middle = (low + high) // 2
        if roads.s[middle] <= s:
            low = middle
        else:
            high = middle
    return low
