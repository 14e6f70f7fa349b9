"""Nearest neighbours among fixed points."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from cornercase._common.typing import FloatArray, IntArray

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

# Up to this number of pairs, in one query or in all so far, brute force is faster than building a tree, for which SciPy
# is imported.
_MAX_BRUTE_FORCE_PAIRS: Final = 200_000
_MAX_PAIRS_SO_FAR: Final = 10 * _MAX_BRUTE_FORCE_PAIRS


class NearestPointIndex:
    """Search index for the nearest neighbours of query points among M fixed points, shape (M, 2)."""

    def __init__(self, points: FloatArray) -> None:
        self._points, self._n_pairs = points, 0

    def find_nearest(self, queries: FloatArray, count: int) -> IntArray:
        """Return the indices of the `count` points nearest to each query, shape (N, min(count, M)).

        The indices of each query are in ascending order, not in the order of distance.
        """
        count = min(count, len(self._points))
        n_pairs = len(queries) * len(self._points)
        self._n_pairs += n_pairs
        if n_pairs > _MAX_BRUTE_FORCE_PAIRS or self._n_pairs > _MAX_PAIRS_SO_FAR:
            rows = np.reshape(self._tree.query(queries, k=count)[1], (len(queries), count))
        else:
            points = self._points
            # One expression, so that NumPy reuses memory.
            squared = (queries[:, None, 0] - points[:, 0]) ** 2 + (queries[:, None, 1] - points[:, 1]) ** 2
            rows = (
                np.argpartition(squared, count - 1, axis=1)[:, :count] if count > 1 else squared.argmin(axis=1)[:, None]
            )
        return np.sort(rows, axis=1).astype(np.int64)

    @cached_property
    def _tree(self) -> cKDTree:
        # Imported here: it takes a quarter of a second.
        from scipy.spatial import cKDTree

        return cKDTree(self._points)
