"""Distances that are computed on demand from a low-dimensional embedding."""

from __future__ import annotations

from functools import cached_property
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import eigh
from scipy.spatial import cKDTree

from cornercase._common.numba.blas import single_threaded_blas
from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering._cells import AXES_PER_STAGE, make_cells, pad_axes
from cornercase.clustering._k_means import find_k_means
from cornercase.clustering._kernels.nearest_rows import fill_nearest_rows
from cornercase.clustering._kernels.nearest_selected import fill_nearest_distances

MAX_DIMENSIONS: Final = 48
"""Largest number of coordinates."""

# Axes with a variance below this share of the largest one are rounding errors.
_AXIS_TOLERANCE: Final = 1e-9
# A random tenth of the scenarios lacks all of the 64 nearest scenarios in 0.1 % of cases, a random twentieth in 4 %.
_N_NEAREST: Final = 64
_SPARSE_SHARE: Final = 0.05
_N_WALKS: Final = 8


class EmbeddedDistances:
    """Squared Euclidean distances of embedded scenarios, computed on demand; behaves like a matrix of shape (n, m).

    `rows`, shape (n, p), and `columns`, shape (m, p), are coordinates of scenarios; by default the columns are the same
    scenarios as the rows. The matrix can be indexed by rows, by rows and columns (at most one of the two as a list),
    and by ``numpy.ix_``.
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
    def coordinates(self) -> FloatArray:
        """Coordinates of the scenarios in the rows, shape (n, p)."""
        return self._rows

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, which: Any) -> FloatArray:
        rows, columns = which if isinstance(which, tuple) else (which, slice(None))
        is_mesh = np.shape(rows)[1:] == (1,) and np.shape(columns)[:-1] == (1,)
        if not is_mesh and np.ndim(rows) + np.ndim(columns) > 1:
            raise IndexError(
                "EmbeddedDistances cannot be indexed by pairs of scenarios or by a matrix; give numpy.ix_(rows,"
                " columns)."
            )
        is_single = [isinstance(index, (int, np.integer)) for index in (rows, columns)]
        rows, columns = (
            np.ravel(index) if is_mesh or single else index
            for index, single in zip((rows, columns), is_single, strict=True)
        )
        distances = self._inner_products(rows, columns)
        distances *= -2.0
        distances += self._row_norms[rows][:, None]
        distances += self._column_norms[columns]
        np.maximum(distances, 0.0, out=distances)
        selected: FloatArray = distances[tuple(0 if single else slice(None) for single in is_single)]
        return selected

    def _inner_products(self, rows: Any, columns: Any) -> FloatArray:
        with single_threaded_blas():
            products: FloatArray = self._rows[rows] @ self._columns[columns].T
        return products

    def __array__(self, dtype: npt.DTypeLike = None, copy: bool | None = None) -> FloatArray:
        return self[:] if dtype is None else self[:].astype(dtype)

    def subset(self, rows: IntArray, columns: IntArray) -> EmbeddedDistances:
        """Return the distances between some of the rows and some of the columns."""
        return EmbeddedDistances(self._rows[rows], self._columns[columns])

    def max(self) -> float:
        """Return approximately the largest distance.

        The search starts at each of eight scenarios, and moves to the farthest scenario until the distance no longer
        grows. Comparing all pairs would take n² time.
        """
        largest = 0.0
        for start in np.linspace(0, len(self) - 1, _N_WALKS).astype(np.int64).tolist():
            current, longest = start, -1.0
            while (row := self[current]).max(initial=0.0) > longest:
                current, longest = int(row.argmax()), float(row.max(initial=0.0))
            largest = max(largest, longest)
        return largest

    def medoid(self, members: IntArray) -> int:
        """Return the index of the medoid of some scenarios.

        Distances are squared, so the medoid is the member nearest to the mean of all members.
        """
        points = self._rows[members]
        return int(members[((points - points.mean(axis=0)) ** 2).sum(axis=1).argmin()])

    def distances_to_nth_neighbour(self, rows: IntArray, number: int) -> FloatArray:
        """Return the distance from each of the given rows to its `number`-th nearest neighbour among all rows.

        If `number` is 1, this is the nearest neighbour; if 0, the row itself.
        """
        roots, _ = self._tree.query(self._rows[rows], k=[number + 1])
        return np.asarray(roots, dtype=np.float64)[:, 0] ** 2

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self._rows)

    def distances_to_nearest(self, rows: IntArray) -> FloatArray:
        """Return the distance from each column to the nearest of the given rows, shape (m,)."""
        return self._squares_to_nearest(rows, np.arange(len(self._columns)))

    def _squares_to_nearest(self, rows: IntArray, columns: IntArray) -> FloatArray:
        nearest = rows[cKDTree(self._rows[rows]).query(self._columns[columns])[1]]
        squares: FloatArray = ((self._rows[nearest] - self._columns[columns]) ** 2).sum(axis=1)
        return squares

    def distances_to_nearest_per_choice(self, row_choices: IntArray, columns: IntArray | None = None) -> FloatArray:
        """Return the distance from each column to the nearest chosen row, for several alternative choices of rows.

        `row_choices`, shape (choices, rows), has the indices of the rows in each choice. `columns` are indices of
        columns, by default all. The result has the shape (choices, columns).
        """
        n = len(self)
        columns = np.arange(len(self._columns)) if columns is None else columns
        if row_choices.shape[1] < _SPARSE_SHARE * n or n <= 2 * _N_NEAREST:
            return np.array([self._squares_to_nearest(choice, columns) for choice in row_choices])
        distances = np.empty((len(row_choices), len(columns)))
        fill_nearest_distances(self._rows, self._columns[columns], self._nearest_rows[columns], row_choices, distances)
        return distances

    @cached_property
    def _nearest_rows(self) -> IntArray:
        """Indices of the 64 scenarios in the rows nearest to the scenario in each column, nearest first, (m, 64)."""
        columns, nearest = pad_axes(self._columns), np.empty((len(self._columns), _N_NEAREST), dtype=np.int64)
        fill_nearest_rows(columns.reshape(len(columns), -1, AXES_PER_STAGE), make_cells(pad_axes(self._rows)), nearest)
        return nearest

    def medoids(self, count: int) -> IntArray:
        """Choose `count` scenarios so that each scenario is near to a chosen scenario; return rising indices.

        k-means divides the scenarios into groups, and of each group the scenario nearest to the mean is chosen. k-means
        fits here, since it minimises the sum of squared distances, and the distances of this class are squared.
        """
        n = len(self)
        if count >= n:
            return np.arange(n)
        groups, centers = find_k_means(self._rows, count)
        squares = ((self._rows - centers[groups]) ** 2).sum(axis=1)
        order = np.lexsort((squares, groups))
        selected = order[np.unique(groups[order], return_index=True)[1]]
        remaining = np.setdiff1d(np.arange(n), selected)[: count - len(selected)]
        return np.sort(np.concatenate((selected, remaining))).astype(np.int64)


class LandmarkMDS:
    """Landmark multidimensional scaling: coordinates of scenarios from their distances to some landmarks.

    `landmark_distances`, shape (m, m), are the distances between the landmarks. The coordinates represent the square
    roots of the distances, since the root of a DTW distance is nearly Euclidean. Only the 48 largest axes are used, so
    distances between very similar scenarios come out too small. V. de Silva, J. Tenenbaum, "Sparse multidimensional
    scaling using landmark points", 2004.
    """

    def __init__(self, landmark_distances: FloatArray) -> None:
        self._means = landmark_distances.mean(axis=0)
        centred = -0.5 * (landmark_distances - self._means - self._means[:, None] + self._means.mean())
        m = len(landmark_distances)
        with single_threaded_blas():
            values, vectors = eigh(centred, subset_by_index=[max(0, m - MAX_DIMENSIONS), m - 1])
        values, vectors = values[::-1], vectors[:, ::-1]
        is_used = values > max(_AXIS_TOLERANCE * float(values[0]), 1e-300)
        # Each axis is signed so that its largest entry is positive, as in kernel space.
        signs = np.sign(vectors[np.abs(vectors).argmax(axis=0), np.arange(vectors.shape[1])])
        # If all landmarks are identical, all scenarios get the same coordinates.
        self._axes = (vectors * signs)[:, is_used] / np.sqrt(values[is_used]) if is_used.any() else np.zeros((m, 1))
        embedded = EmbeddedDistances(self._project(landmark_distances))
        (rows, columns) = np.triu_indices(m, 1)
        estimated, true = embedded[:][rows, columns], landmark_distances[rows, columns]
        squares = float((estimated * estimated).sum())
        self._scale = np.sqrt((estimated * true).sum() / squares) if squares else 1.0

    def _project(self, to_landmarks: FloatArray) -> FloatArray:
        with single_threaded_blas():
            return np.asarray(-0.5 * (to_landmarks - self._means) @ self._axes)

    def embed(self, to_landmarks: FloatArray) -> FloatArray:
        """Return coordinates of scenarios from their distances to the landmarks, shape (n, m)."""
        return self._project(to_landmarks) * self._scale


Distances = npt.NDArray[np.float64] | EmbeddedDistances
"""Distances between scenarios: a full matrix, or computed from an embedding."""
