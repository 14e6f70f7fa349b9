"""Compiled position and heading of the reference lines of roads, for one point at a time."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from cornercase._common.numba.kernel import kernel
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.roads._kernels.width import RoadEdgeTables, build_edge_tables, road_edge_offsets
from cornercase.roads._locator import OFF_ROAD_TOLERANCE
from cornercase.roads._reference_line import ReferenceGeometry, is_nearly_arc
from cornercase.roads._road import Road

# Line, arc or spiral; parametric curve.
_LINE_ARC_OR_SPIRAL, _PARAMETRIC_CURVE = 0, 1
_N_COEFFICIENTS: Final = 8


class RoadTables(NamedTuple):
    """Reference lines of R roads with P geometries in all, as arrays for compiled functions.

    Arrays with one value for each road: `heading_known` and `position_known` say whether compiled functions can compute
    headings and positions on the road, and `length` is in m. The geometries of road k have the
    indices from ``first_geometry[k]`` to ``first_geometry[k + 1] - 1``.

    Arrays with one value for each geometry: its start (`s`, `x` and `y` in m, `heading` in rad, `cos` and `sin` of the
    heading), `geometry_type` and `coefficients`. A line, arc or spiral has two coefficients: the curvature at its start
    in 1/m, and the change of curvature per distance in 1/m². A parametric curve has its length in m, the number of
    steps in its table, and the coefficients of the derivatives of its two polynomials, highest first.

    The table of a parametric curve begins at the index `table_start` of two arrays: `parameter` has the curve parameter
    at equal distances, and `parameter_rate` its derivative by distance in 1/m. `edges` are the edges of the roads.
    """

    heading_known: BoolArray
    position_known: BoolArray
    length: FloatArray
    first_geometry: IntArray
    s: FloatArray
    x: FloatArray
    y: FloatArray
    heading: FloatArray
    cos: FloatArray
    sin: FloatArray
    geometry_type: IntArray
    coefficients: FloatArray
    table_start: IntArray
    parameter: FloatArray
    parameter_rate: FloatArray
    edges: RoadEdgeTables


def build_road_tables(roads: Sequence[Road]) -> RoadTables:
    """Create the arrays of the reference lines for compiled functions."""
    pieces = [piece for road in roads for piece in road.geometries]
    numbers = np.zeros((len(pieces), _N_COEFFICIENTS))
    for k, piece in enumerate(pieces):
        values = _geometry_coefficients(piece)
        numbers[k, : len(values)] = values
    curves = [piece.parameter_table if piece.kind == "paramPoly3" else (np.zeros(0), np.zeros(0)) for piece in pieces]
    parameter, rate = (np.concatenate([np.zeros(0), *(curve[k] for curve in curves)]) for k in range(2))
    cos, sin = _cos_and_sin(np.array([piece_.heading for piece_ in pieces]))
    s, x, y, heading = (
        np.array([(piece_.s, piece_.x, piece_.y, piece_.heading) for piece_ in pieces]).reshape(-1, 4).T.copy()
    )
    return RoadTables(
        np.array([all(piece.kind != "poly3" for piece in road.geometries) for road in roads], dtype=np.bool_),
        np.array([all(map(_is_line_or_arc, road.geometries)) for road in roads], dtype=np.bool_),
        np.array([road.length for road in roads], dtype=np.float64),
        np.cumsum([0, *(len(road.geometries) for road in roads)], dtype=np.int64),
        s,
        x,
        y,
        heading,
        cos,
        sin,
        np.array(
            [_PARAMETRIC_CURVE if piece.kind == "paramPoly3" else _LINE_ARC_OR_SPIRAL for piece in pieces],
            dtype=np.int64,
        ),
        numbers,
        np.cumsum([0, *(len(value) for value, _ in curves)], dtype=np.int64)[:-1],
        parameter,
        rate,
        build_edge_tables(roads),
    )


def _is_line_or_arc(geometry: ReferenceGeometry) -> bool:
    if geometry.kind != "spiral":
        return geometry.kind in ("line", "arc")
    start, end = geometry.shape_parameters
    return bool(is_nearly_arc(start, end, geometry.length))


def _geometry_coefficients(geometry: ReferenceGeometry) -> tuple[float, ...]:
    if geometry.kind == "arc":
        return geometry.shape_parameters[0], 0.0
    if geometry.kind == "spiral":
        start, end = geometry.shape_parameters
        bent = is_nearly_arc(start, end, geometry.length)
        return (0.5 * (start + end), 0.0) if bent else (start, (end - start) / geometry.length)
    if geometry.kind == "paramPoly3":
        _, _, u1, u2, u3, _, v1, v2, v3 = geometry.shape_parameters
        return geometry.length, len(geometry.parameter_table[0]) - 1, 3 * u3, 2 * u2, u1, 3 * v3, 2 * v2, v1
    return ()


@kernel(interpreted_seconds=lambda heading: 1e-6 * heading.size, error_model="numpy")
def _cos_and_sin(heading):
    """Return cosines and sines as compiled functions compute them; those of NumPy may differ in the last digits."""
    cos, sin = np.empty(heading.size), np.empty(heading.size)
    for k in range(heading.size):
        cos[k], sin[k] = math.cos(heading[k]), math.sin(heading[k])
    return cos, sin


@kernel(error_model="numpy", _nrt=False)
def reference_heading(tables, road, s):
    """Return the heading of a road's reference line at `s`, in rad; only for roads with `heading_known`."""
    piece = _geometry_index(tables, road, s)
    along, numbers = s - tables.s[piece], tables.coefficients[piece]
    if tables.geometry_type[piece] == _LINE_ARC_OR_SPIRAL:
        return tables.heading[piece] + (numbers[0] * along + 0.5 * numbers[1] * (along * along))
    p = _curve_parameter(tables, piece, along)
    du, dv = (numbers[2] * p + numbers[3]) * p + numbers[4], (numbers[5] * p + numbers[6]) * p + numbers[7]
    return tables.heading[piece] + math.atan2(dv, du)


@kernel(error_model="numpy", _nrt=False)
def reference_cos_and_sin(tables, road, s):
    """Return cosine and sine of `reference_heading`."""
    piece = _geometry_index(tables, road, s)
    if (
        tables.geometry_type[piece] == _LINE_ARC_OR_SPIRAL
        and tables.coefficients[piece, 0] == 0.0
        and tables.coefficients[piece, 1] == 0.0
    ):
        return tables.cos[piece], tables.sin[piece]
    heading = reference_heading(tables, road, s)
    return math.cos(heading), math.sin(heading)


@kernel(error_model="numpy", _nrt=False)
def stays_on_road(tables, road, s, x, y):
    """Return whether a moved point is still on its road, and the s coordinate of its new position.

    Points at most `OFF_ROAD_TOLERANCE` from the edge of the road count as on the road. The argument `s` is the
    coordinate of the point before it moved; `x` and `y` are its new position, all in m. Only for roads with
    `position_known`. The returned s is valid only if the point is still on the road.
    """
    length = tables.length[road]
    s = min(max(s, 0.0), length)
    at_x, at_y, cos, sin = _line_or_arc_pose(tables, _geometry_index(tables, road, s), s)
    dx, dy = x - at_x, y - at_y
    along, t = s + dx * cos + dy * sin, dy * cos - dx * sin
    if not (along >= 0.0 and along <= length):
        return False, s
    if (
        t >= tables.edges.always_inside[road, 0] - OFF_ROAD_TOLERANCE
        and t <= tables.edges.always_inside[road, 1] + OFF_ROAD_TOLERANCE
    ):
        return True, along
    right, left = road_edge_offsets(tables.edges, road, along)
    return t >= right - OFF_ROAD_TOLERANCE and t <= left + OFF_ROAD_TOLERANCE, along


@kernel(error_model="numpy", _nrt=False)
def _line_or_arc_pose(tables, geometry, s):
    """Return x, y, cosine and sine of the heading on a line or arc."""
    along, curvature = s - tables.s[geometry], tables.coefficients[geometry, 0]
    turn, cos, sin = curvature * along, tables.cos[geometry], tables.sin[geometry]
    if turn == 0.0:
        return tables.x[geometry] + cos * along, tables.y[geometry] + sin * along, cos, sin
    half = 0.5 * turn / math.pi
    chord = along * (math.sin(math.pi * half) / (math.pi * half))
    u, v = chord * math.cos(0.5 * turn), chord * math.sin(0.5 * turn)
    heading = tables.heading[geometry] + turn
    x, y = tables.x[geometry] + cos * u - sin * v, tables.y[geometry] + sin * u + cos * v
    return x, y, math.cos(heading), math.sin(heading)


@kernel(error_model="numpy", _nrt=False)
def _curve_parameter(tables, geometry, distance):
    """Return the parameter of a parametric curve at a distance in m from the start of the curve."""
    length, steps, first = (
        tables.coefficients[geometry, 0],
        tables.coefficients[geometry, 1],
        tables.table_start[geometry],
    )
    position = min(max(distance, 0.0), length) / (length / steps)
    k = min(int(position), int(steps) - 1)
    low, high = tables.parameter[first + k], tables.parameter[first + k + 1]
    rate_low, rate_high = tables.parameter_rate[first + k], tables.parameter_rate[first + k + 1]
    x, rise = position - k, high - low
    bend_low, bend_high = length / steps * rate_low - rise, rise - length / steps * rate_high
    return (1.0 - x) * low + x * high + x * (1.0 - x) * ((1.0 - x) * bend_low + x * bend_high)


@kernel(error_model="numpy", _nrt=False)
def _geometry_index(tables, road, s):
    low, high = tables.first_geometry[road], tables.first_geometry[road + 1]
    # The first geometry also covers s below its start.
    while high - low > 1:
        middle = (low + high) // 2
        if tables.s[middle] <= s:
            low = middle
        else:
            high = middle
    return low
