"""Which of many fixed points are the nearest to a point."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from cornercase._common.typing import FloatArray, IntArray

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

# Up to so many pairs of points, all distances are computed; that takes less time than to load and to plant a tree.
_FEW: Final = 200_000


class NearestPoints:
    """Find the nearest of fixed points.

    Parameters
    ----------
    points : ndarray of float64, shape (M, 2)
    """

    def __init__(self, points: FloatArray) -> None:
        self._points = points

    def find(self, asked: FloatArray, count: int) -> IntArray:
        """Find the nearest points.

        Parameters
        ----------
        asked : ndarray of float64, shape (N, 2)
        count : int
            How many.

        Returns
        -------
        ndarray of int64, shape (N, min(count, M))
            Their rows, ascending.
        """
        count = min(count, len(self._points))
        if len(asked) * len(self._points) > _FEW:
            near = np.reshape(self._tree.query(asked, k=count)[1], (len(asked), count))
        else:
            points = self._points
            # In one expression, as NumPy takes its memory again then.
            apart = (asked[:, None, 0] - points[:, 0]) ** 2 + (asked[:, None, 1] - points[:, 1]) ** 2
            near = np.argpartition(apart, count - 1, axis=1)[:, :count] if count > 1 else apart.argmin(axis=1)[:, None]
        return np.sort(near, axis=1).astype(np.int64)

    @cached_property
    def _tree(self) -> cKDTree:
        # The package takes a quarter of a second to load.
        from scipy.spatial import cKDTree

        return cKDTree(self._points)
