"""The direction of roads' reference lines, compiled, for one place at a time."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from cornercase._common.compiling import kernel
from cornercase._common.typing import BoolArray, FloatArray, IntArray
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
        Whether kernels know all pieces of a road.
    first : ndarray of int64, shape (R + 1,)
        First piece of each road, and the number of pieces.
    s, heading : ndarray of float64, shape (P,)
        Where pieces begin, in m and rad.
    shape : ndarray of int64, shape (P,)
        What kind of piece it is.
    numbers : ndarray of float64, shape (P, 8)
        Its curvature at the begin in 1/m and the change of it in 1/m²; or its length in m, the largest value of its
        parameter, and the coefficients of the derivatives of two polynomials, the highest first.
    """

    known: BoolArray
    first: IntArray
    s: FloatArray
    heading: FloatArray
    shape: IntArray
    numbers: FloatArray


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
    return RoadTables(
        np.array([all(piece.kind != "poly3" for piece in road.geometries) for road in roads], dtype=np.bool_),
        np.cumsum([0, *(len(road.geometries) for road in roads)], dtype=np.int64),
        np.array([piece.s for piece in pieces], dtype=np.float64),
        np.array([piece.heading for piece in pieces], dtype=np.float64),
        np.array([_CURVE if piece.kind == "paramPoly3" else _TURNS for piece in pieces], dtype=np.int64),
        numbers,
    )


def _numbers(piece: Geometry) -> tuple[float, ...]:
    if piece.kind == "arc":
        return piece.numbers[0], 0.0
    if piece.kind == "spiral":
        start, end = piece.numbers
        bent = turns_evenly(start, end, piece.length)
        return (0.5 * (start + end), 0.0) if bent else (start, (end - start) / piece.length)
    if piece.kind == "paramPoly3":
        top, _, u1, u2, u3, _, v1, v2, v3 = piece.numbers
        return piece.length, top, 3 * u3, 2 * u2, u1, 3 * v3, 2 * v2, v1
    return ()


@kernel(error_model="numpy")
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
    low, high = roads.first[road], roads.first[road + 1]
    # The first piece begins everywhere.
    while high - low > 1:
        middle = (low + high) // 2
        if roads.s[middle] <= s:
            low = middle
        else:
            high = middle
    along, numbers = s - roads.s[low], roads.numbers[low]
    if roads.shape[low] == _TURNS:
        return roads.heading[low] + (numbers[0] * along + 0.5 * numbers[1] * (along * along))
    p = along / numbers[0] * numbers[1]
    du, dv = (numbers[2] * p + numbers[3]) * p + numbers[4], (numbers[5] * p + numbers[6]) * p + numbers[7]
    return roads.heading[low] + math.atan2(dv, du)
