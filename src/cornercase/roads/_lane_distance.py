"""Distance of points from the nearest lane."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.roads._nearest import NearestPointIndex
from cornercase.roads._road import Road

NEAR_DISTANCE: Final = 10.0
"""Distance from a lane in m up to which a point counts as near."""

# Cell size in m: points in a cell with a sample, or in a neighbouring one, are at most 9.9 m away.
_CELL_SIZE: Final = 3.5
# Sample spacing in m, along and across a road.
_STEP_ALONG: Final = 2.0
_STEP_ACROSS: Final = 5.0
# Factor to number cells; larger than any cell index.
_CELLS_PER_ROW: Final = 1 << 31


class LaneDistanceIndex:
    """Search index for the distances of points from the nearest lane."""

    def __init__(self, roads: Sequence[Road]) -> None:
        samples = np.concatenate([_sample_lanes(road) for road in roads])
        self._nearest, self._samples = NearestPointIndex(samples), samples
        cells = np.floor(samples / _CELL_SIZE).astype(np.int64)
        around = [(cells[:, 0] + i) * _CELLS_PER_ROW + cells[:, 1] + j for i in (-1, 0, 1) for j in (-1, 0, 1)]
        self._cells = np.unique(np.concatenate(around))

    def distances(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return the distance of each point from the nearest lane in m, shape (N,).

        Distances up to `NEAR_DISTANCE` are returned as 0. Points with a coordinate that is not finite have the
        distance 0, too.
        """
        result = np.zeros(len(x))
        finite = np.flatnonzero(np.isfinite(x + y))
        points = np.stack([x[finite], y[finite]], axis=1)
        far = ~self._is_cell_near_lane(np.floor(points / _CELL_SIZE).astype(np.int64))
        nearest = self._samples[self._nearest.find_nearest(points[far], 1)[:, 0]] if far.any() else points[:0]
        distance = np.hypot(*(points[far] - nearest).T)
        result[finite[far]] = np.where(distance > NEAR_DISTANCE, distance, 0.0)
        return result

    def _is_cell_near_lane(self, cells: IntArray) -> BoolArray:
        keys = cells[:, 0] * _CELLS_PER_ROW + cells[:, 1]
        at = np.minimum(np.searchsorted(self._cells, keys), len(self._cells) - 1)
        return np.asarray(self._cells[at] == keys)


def _sample_lanes(road: Road) -> FloatArray:
    """Return points that cover all lanes of a road, shape (M, 2)."""
    s = np.linspace(0.0, road.length, max(2, int(np.ceil(road.length / _STEP_ALONG)) + 1))
    right, left = road.road_edge_offsets(s)
    share = np.linspace(0.0, 1.0, max(2, int(np.ceil(float((left - right).max()) / _STEP_ACROSS)) + 1))
    t = right + share[:, None] * (left - right)
    x, y, heading = road.reference_pose(s)
    return np.stack([(x - t * np.sin(heading)).ravel(), (y + t * np.cos(heading)).ravel()], axis=1)
