"""Where roads' reference lines run and which way, compiled, for one place at a time."""

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

# A piece that turns as a spiral does, and one that is a curve of its parameter.
_TURNS, _CURVE = 0, 1
_NUMBERS: Final = 8


class RoadTables(NamedTuple):
    """Tables of the reference lines of R roads, of P pieces in all.

    Attributes
    ----------
    known : ndarray of bool, shape (R,)
        Whether kernels know the direction of all pieces of a road.
    plain : ndarray of bool, shape (R,)
        Whether all its pieces are straight or arcs, of which kernels know the places, too.
    length : ndarray of float64, shape (R,)
        m.
    first : ndarray of int64, shape (R + 1,)
        First piece of each road, and the number of pieces.
    s, x, y, heading : ndarray of float64, shape (P,)
        Where pieces begin, in m and rad.
    cos, sin : ndarray of float64, shape (P,)
        Of that heading.
    shape : ndarray of int64, shape (P,)
        What kind of piece it is.
    numbers : ndarray of float64, shape (P, 8)
        Its curvature at the begin in 1/m and the change of it in 1/m²; or its length in m, how many steps of its
        parameter are tabulated, and the coefficients of the derivatives of two polynomials, the highest first.
    parameters : ndarray of int64, shape (P,)
        Where the parameter of each piece begins in the next two, of length Q.
    parameter, rate : ndarray of float64, shape (Q,)
        Parameter at equal distances from the begin of a piece to its end, and its change by m.
    edges : RoadEdges
        How far they reach to both sides.
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
    """Tables of the reference lines of roads.

    Parameters
    ----------
    roads : sequence of Road

    Returns
    -------
    RoadTables
    """
    pieces = [piece for road in roads for piece in road.geometries]
    numbers = np.zeros((len(pieces), _NUMBERS))
    for k, piece in enumerate(pieces):
        found = _numbers(piece)
        numbers[k, : len(found)] = found
    curves = [piece.table if piece.kind == "paramPoly3" else (np.zeros(0), np.zeros(0)) for piece in pieces]
    parameter, rate = (np.concatenate([np.zeros(0), *(curve[k] for curve in curves)]) for k in range(2))
    cos, sin = _components(np.array([one.heading for one in pieces]))
    s, x, y, heading = np.array([(one.s, one.x, one.y, one.heading) for one in pieces]).reshape(-1, 4).T.copy()
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
    begin, end = piece.numbers
    return bool(turns_evenly(begin, end, piece.length))


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
    """Cosines and sines, to the last digit as kernels compute them, which NumPy's are not."""
    cos, sin = np.empty(heading.size), np.empty(heading.size)
    for k in range(heading.size):
        cos[k], sin[k] = math.cos(heading[k]), math.sin(heading[k])
    return cos, sin


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def road_heading(roads, road, s):
    """Direction of a road's s, of a road that is known.

    Parameters
    ----------
    roads : RoadTables
    road : int
        Index of the road.
    s : float
        m.

    Returns
    -------
    float
        rad.
    """
    piece = _piece(roads, road, s)
    along, numbers = s - roads.s[piece], roads.numbers[piece]
    if roads.shape[piece] == _TURNS:
        return roads.heading[piece] + (numbers[0] * along + 0.5 * numbers[1] * (along * along))
    p = _parameter(roads, piece, along)
    du, dv = (numbers[2] * p + numbers[3]) * p + numbers[4], (numbers[5] * p + numbers[6]) * p + numbers[7]
    return roads.heading[piece] + math.atan2(dv, du)


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def road_direction(roads, road, s):
    """Cosine and sine of `road_heading`.

    Parameters
    ----------
    roads : RoadTables
    road : int
        Index of the road.
    s : float
        m.

    Returns
    -------
    cos, sin : float
    """
    piece = _piece(roads, road, s)
    if roads.shape[piece] == _TURNS and roads.numbers[piece, 0] == 0.0 and roads.numbers[piece, 1] == 0.0:
        return roads.cos[piece], roads.sin[piece]
    heading = road_heading(roads, road, s)
    return math.cos(heading), math.sin(heading)


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def stays_on_road(roads, road, s, x, y):
    """Whether a point that moves is still on the plain road that it was on, or not far beside it.

    Parameters
    ----------
    roads : RoadTables
    road : int
        Index of the road.
    s : float
        Where on the road it was a moment ago, in m.
    x, y : float
        Where it is, in m.

    Returns
    -------
    stays : bool
    s : float
        Where on the road it is, in m.
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
    """Place on a straight piece or an arc, and cosine and sine of its direction there."""
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
    """`Geometry.parameter` of a piece that is a curve of its parameter."""
    length, steps, first = roads.numbers[piece, 0], roads.numbers[piece, 1], roads.parameters[piece]
    place = min(max(along, 0.0), length) / (length / steps)
    k = min(int(place), int(steps) - 1)
    low, high = roads.parameter[first + k], roads.parameter[first + k + 1]
    before, after = roads.rate[first + k], roads.rate[first + k + 1]
    x, rise = place - k, high - low
    begin, end = length / steps * before - rise, rise - length / steps * after
    return (1.0 - x) * low + x * high + x * (1.0 - x) * ((1.0 - x) * begin + x * end)


@kernel(error_model="numpy", forceinline=True, _nrt=False)
def _piece(roads, road, s):
    low, high = roads.first[road], roads.first[road + 1]
    # The first piece begins everywhere.
    while high - low > 1:
        middle = (low + high) // 2
        if roads.s[middle] <= s:
            low = middle
        else:
            high = middle
    return low
