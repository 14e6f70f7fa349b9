"""Distances that are computed on demand from a low-dimensional embedding."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import eigh

from cornercase._common.threads import one_thread
from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering.place_kernels import nearest_chosen

DIMENSIONS: Final = 48
"""Largest number of coordinates."""

# Axes with a variance below this share of the largest one are rounding errors.
_FLAT: Final = 1e-9
# Distances per block: 64 MB.
_AT_ONCE: Final = 2**23
# One of the 64 nearest scenarios is nearly always in a random choice, unless that has fewer than one in twenty.
_NEAR: Final = 64
_RARE: Final = 0.05
_WALKS: Final = 8
_ROUNDS: Final = 30


class PlacedDistances:
    """Squared Euclidean distances of embedded scenarios, computed on demand; behaves like a matrix of shape (n, m).

    `rows`, shape (n, p), and `columns`, shape (m, p), are coordinates; by default both are the same scenarios. Supports
    indexing by rows and by ``numpy.ix_``.
    """

    def __init__(self, rows: FloatArray, columns: FloatArray | None = None) -> None:
        self._rows = rows
        self._columns = rows if columns is None else columns
        self._row_norms = np.einsum("ij,ij->i", self._rows, self._rows)
        self._column_norms = np.einsum("ij,ij->i", self._columns, self._columns)

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of rows and of columns."""
        return len(self._rows), len(self._columns)

    @property
    def places(self) -> FloatArray:
        """Coordinates of the scenarios of the rows, shape (n, p)."""
        return self._rows

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, which: Any) -> FloatArray:
        if isinstance(which, tuple):
            rows, columns = (index.ravel() if isinstance(index, np.ndarray) else index for index in which)
        else:
            rows, columns = which, slice(None)
        if isinstance(rows, (int, np.integer)):
            row: FloatArray = self[[int(rows)]][0]
            return row
        distances = self._products(rows, columns)
        distances *= -2.0
        distances += self._row_norms[rows][:, None]
        distances += self._column_norms[columns]
        np.maximum(distances, 0.0, out=distances)
        return distances

    def _products(self, rows: Any, columns: Any) -> FloatArray:
        with one_thread():
            products: FloatArray = self._rows[rows] @ self._columns[columns].T
        return products

    def __array__(self, dtype: npt.DTypeLike = None, copy: bool | None = None) -> FloatArray:
        return self[:] if dtype is None else self[:].astype(dtype)

    def part(self, rows: IntArray, columns: IntArray) -> PlacedDistances:
        """Return the distances of some of the rows and columns."""
        return PlacedDistances(self._rows[rows], self._columns[columns])

    def blocks(self) -> Iterator[slice]:
        """Yield slices of the rows such that the distances of each take at most 64 MB."""
        step = max(1, _AT_ONCE // max(1, len(self._columns)))
        for first in range(0, len(self), step):
            yield slice(first, min(first + step, len(self)))

    def max(self) -> float:
        """Return the largest distance, nearly.

        Walks from eight scenarios to the farthest one until that leads no farther; all pairs would take n² time.
        """
        largest = 0.0
        for start in np.linspace(0, len(self) - 1, _WALKS).astype(np.int64).tolist():
            current, longest = start, -1.0
            while (row := self[current]).max(initial=0.0) > longest:
                current, longest = int(row.argmax()), float(row.max(initial=0.0))
            largest = max(largest, longest)
        return largest

    def middle(self, members: IntArray) -> int:
        """Return the medoid of some scenarios: the member nearest to their mean, since the distances are squares."""
        points = self._rows[members]
        return int(members[((points - points.mean(axis=0)) ** 2).sum(axis=1).argmin()])

    def nearest(self, choice: IntArray) -> FloatArray:
        """Return the distance of every column to the nearest of some rows, shape (m,)."""
        transposed = PlacedDistances(self._columns, self._rows[choice])
        return np.concatenate([transposed[block].min(axis=1) for block in transposed.blocks()])

    def nearest_of(self, choices: IntArray) -> FloatArray:
        """Return the distance of every column to the nearest row of each choice, shape (draws, m)."""
        n = len(self)
        if choices.shape[1] < _RARE * n or n <= 2 * _NEAR:
            return np.array([self.nearest(choice) for choice in choices])
        is_chosen = np.zeros((len(choices), n), dtype=np.bool_)
        np.put_along_axis(is_chosen, choices, True, axis=1)
        distances = np.empty((len(choices), len(self._columns)))
        transposed = PlacedDistances(self._columns, self._rows)
        for block in transposed.blocks():
            rows, columns = transposed._row_norms[block], transposed._column_norms
            nearest_chosen(
                transposed._products(block, slice(None)), rows, columns, is_chosen, _NEAR, distances[:, block]
            )
        return distances

    def medoids(self, count: int) -> IntArray:
        """Choose `count` scenarios with a small mean distance from all to the nearest one, in rising order.

        The distances are squares, so k-means minimises their sum; the scenario nearest to each mean is taken. D.
        Arthur, S. Vassilvitskii, "k-means++: The advantages of careful seeding", 2007.
        """
        n = len(self)
        if count >= n:
            return np.arange(n)
        from sklearn.cluster import KMeans
        from sklearn.exceptions import ConvergenceWarning

        # k-means warns if identical scenarios leave fewer groups than asked for.
        with one_thread(), warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)
            model = KMeans(count, n_init=1, max_iter=_ROUNDS, random_state=0).fit(self._rows)
        groups = model.labels_
        squares = ((self._rows - model.cluster_centers_[groups]) ** 2).sum(axis=1)
        order = np.lexsort((squares, groups))
        selected = order[np.unique(groups[order], return_index=True)[1]]
        remaining = np.setdiff1d(np.arange(n), selected)[: count - len(selected)]
        return np.sort(np.concatenate((selected, remaining))).astype(np.int64)


class Placing:
    """Landmark multidimensional scaling: coordinates of scenarios from their distances to some landmarks.

    `landmark_distances`, shape (m, m), are the distances of the landmarks. Uses the roots of the distances: DTW sums
    along a path and is no metric, but its root is nearly Euclidean. Only the 48 largest axes are kept, so distances
    between very similar scenarios come out too small. V. de Silva, J. Tenenbaum, "Sparse multidimensional scaling using
    landmark points", 2004.
    """

    def __init__(self, between: FloatArray) -> None:
        self._means = between.mean(axis=0)
        centred = -0.5 * (between - self._means - self._means[:, None] + self._means.mean())
        m = len(between)
        with one_thread():
            values, vectors = eigh(centred, subset_by_index=[max(0, m - DIMENSIONS), m - 1])
        values, vectors = values[::-1], vectors[:, ::-1]
        is_used = values > max(_FLAT * float(values[0]), 1e-300)
        # Each axis is signed so that its largest entry is positive, as in kernel space.
        signs = np.sign(vectors[np.abs(vectors).argmax(axis=0), np.arange(vectors.shape[1])])
        # If all landmarks are identical, all scenarios get the same coordinates.
        self._axes = (vectors * signs)[:, is_used] / np.sqrt(values[is_used]) if is_used.any() else np.zeros((m, 1))
        embedded = PlacedDistances(self._placed(between))
        (rows, columns) = np.triu_indices(m, 1)
        estimated, true = embedded[:][rows, columns], between[rows, columns]
        squares = float((estimated * estimated).sum())
        self._scale = np.sqrt((estimated * true).sum() / squares) if squares else 1.0

    def _placed(self, to_landmarks: FloatArray) -> FloatArray:
        with one_thread():
            return np.asarray(-0.5 * (to_landmarks - self._means) @ self._axes)

    def place(self, to_landmarks: FloatArray) -> FloatArray:
        """Embed scenarios by their distances to the landmarks, shape (n, m)."""
        return self._placed(to_landmarks) * self._scale


Distances = npt.NDArray[np.float64] | PlacedDistances
"""Distances between scenarios: a full matrix, or computed from an embedding."""
