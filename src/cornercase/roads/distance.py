"""How far points of the plane are from every road."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.roads.nearest import NearestPoints
from cornercase.roads.road import Road

NEAR: Final = 10.0
"""Up to so far from a lane, in m, a point is near a road."""

# m; what lies in a cell that holds a sample, or beside such a cell, is near: two cells are 9.9 m across.
_CELL: Final = 3.5
# m between samples along a road, and at most across its lanes.
_ALONG: Final = 2.0
_ACROSS: Final = 5.0
# Cells have numbers; no road lies so many cells from the origin.
_ROW: Final = 1 << 31


class LaneDistance:
    """Distances from the nearest of all lanes.

    Parameters
    ----------
    roads : sequence of Road
    """

    def __init__(self, roads: Sequence[Road]) -> None:
        samples = np.concatenate([_samples(road) for road in roads])
        self._nearest, self._samples = NearestPoints(samples), samples
        cells = np.floor(samples / _CELL).astype(np.int64)
        around = [(cells[:, 0] + i) * _ROW + cells[:, 1] + j for i in (-1, 0, 1) for j in (-1, 0, 1)]
        self._cells = np.unique(np.concatenate(around))

    def of(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Distance in m of points, shape (N,), 0 for those that are near or nowhere."""
        result = np.zeros(len(x))
        there = np.flatnonzero(np.isfinite(x + y))
        points = np.stack([x[there], y[there]], axis=1)
        away = ~self._is_in_cell(np.floor(points / _CELL).astype(np.int64))
        nearest = self._samples[self._nearest.find(points[away], 1)[:, 0]] if away.any() else points[:0]
        distance = np.hypot(*(points[away] - nearest).T)
        result[there[away]] = np.where(distance > NEAR, distance, 0.0)
        return result

    def _is_in_cell(self, cells: IntArray) -> BoolArray:
        keys = cells[:, 0] * _ROW + cells[:, 1]
        at = np.minimum(np.searchsorted(self._cells, keys), len(self._cells) - 1)
        return np.asarray(self._cells[at] == keys)


def _samples(road: Road) -> FloatArray:
    """Points of the strip that the lanes of a road cover, shape (M, 2)."""
    s = np.linspace(0.0, road.length, max(2, int(np.ceil(road.length / _ALONG)) + 1))
    right, left = road.margins(s)
    share = np.linspace(0.0, 1.0, max(2, int(np.ceil(float((left - right).max()) / _ACROSS)) + 1))
    t = right + share[:, None] * (left - right)
    x, y, heading = road.reference(s)
    return np.stack([(x - t * np.sin(heading)).ravel(), (y + t * np.cos(heading)).ravel()], axis=1)
