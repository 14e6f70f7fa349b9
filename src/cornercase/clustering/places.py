"""Distances between many scenarios that are nowhere stored: each scenario has a place, and they follow from these."""

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
"""Most coordinates of a place."""

# Axes along which the landmarks differ by less than this share of what they do along the longest are rounding.
_FLAT: Final = 1e-9
# Numbers of a block of distances: 64 MB.
_AT_ONCE: Final = 2**23
# Of so many nearest scenarios one is nearly always in a random choice, unless it holds fewer than one in twenty.
_NEAR: Final = 64
_RARE: Final = 0.05
_WALKS: Final = 8
_ROUNDS: Final = 30


class PlacedDistances:
    """Distances from some scenarios to others, made of their places when they are asked for.

    The distance of two scenarios is the squared Euclidean distance of their places. What is asked of a matrix of
    distances can be asked of it too: rows, blocks (``numpy.ix_``), its shape.

    Parameters
    ----------
    rows : ndarray of float64, shape (n, p)
        Places of scenarios.
    columns : ndarray of float64, shape (m, p), optional
        Places of the others; by default the same scenarios.
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
        """Places of the scenarios of the rows, shape (n, p)."""
        return self._rows

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, which: Any) -> FloatArray:
        if isinstance(which, tuple):
            rows, columns = (one.ravel() if isinstance(one, np.ndarray) else one for one in which)
        else:
            rows, columns = which, slice(None)
        if isinstance(rows, (int, np.integer)):
            row: FloatArray = self[[int(rows)]][0]
            return row
        found = self._products(rows, columns)
        found *= -2.0
        found += self._row_norms[rows][:, None]
        found += self._column_norms[columns]
        np.maximum(found, 0.0, out=found)
        return found

    def _products(self, rows: Any, columns: Any) -> FloatArray:
        with one_thread():
            found: FloatArray = self._rows[rows] @ self._columns[columns].T
        return found

    def __array__(self, dtype: npt.DTypeLike = None, copy: bool | None = None) -> FloatArray:
        return self[:] if dtype is None else self[:].astype(dtype)

    def part(self, rows: IntArray, columns: IntArray) -> PlacedDistances:
        """Take some of the rows and columns.

        Parameters
        ----------
        rows, columns : ndarray of int64, each of shape (m,)
            Indices.

        Returns
        -------
        PlacedDistances
        """
        return PlacedDistances(self._rows[rows], self._columns[columns])

    def blocks(self) -> Iterator[slice]:
        """Split the rows so that the distances of each block take little memory.

        Yields
        ------
        slice
            Of the rows.
        """
        step = max(1, _AT_ONCE // max(1, len(self._columns)))
        for first in range(0, len(self), step):
            yield slice(first, min(first + step, len(self)))

    def max(self) -> float:
        """Find a distance that is the largest, or nearly.

        From each of eight scenarios it goes to the one farthest from it, as long as that leads farther; all pairs
        would take the square of the time.

        Returns
        -------
        float
        """
        largest = 0.0
        for start in np.linspace(0, len(self) - 1, _WALKS).astype(np.int64).tolist():
            at, longest = start, -1.0
            while (row := self[at]).max(initial=0.0) > longest:
                at, longest = int(row.argmax()), float(row.max(initial=0.0))
            largest = max(largest, longest)
        return largest

    def middle(self, members: IntArray) -> int:
        """Find the medoid of some scenarios.

        Parameters
        ----------
        members : ndarray of int64, shape (m,)
            Indices, at least one.

        Returns
        -------
        int
            The member with the smallest sum of distances to the others, which are squares: the one nearest to the mean.
        """
        places = self._rows[members]
        return int(members[((places - places.mean(axis=0)) ** 2).sum(axis=1).argmin()])

    def nearest(self, choice: IntArray) -> FloatArray:
        """Measure how far every column is from the nearest of some rows.

        Parameters
        ----------
        choice : ndarray of int64, shape (k,)
            Indices of the rows, at least one.

        Returns
        -------
        ndarray of float64, shape (m,)
        """
        turned = PlacedDistances(self._columns, self._rows[choice])
        return np.concatenate([turned[block].min(axis=1) for block in turned.blocks()])

    def nearest_of(self, choices: IntArray) -> FloatArray:
        """Measure how far every column is from the nearest row of each choice.

        Parameters
        ----------
        choices : ndarray of int64, shape (draws, k)
            Indices of the rows of each choice.

        Returns
        -------
        ndarray of float64, shape (draws, m)
        """
        n = len(self)
        if choices.shape[1] < _RARE * n or n <= 2 * _NEAR:
            return np.array([self.nearest(one) for one in choices])
        chosen = np.zeros((len(choices), n), dtype=np.bool_)
        np.put_along_axis(chosen, choices, True, axis=1)
        found = np.empty((len(choices), len(self._columns)))
        turned = PlacedDistances(self._columns, self._rows)
        for block in turned.blocks():
            rows, columns = turned._row_norms[block], turned._column_norms
            nearest_chosen(turned._products(block, slice(None)), rows, columns, chosen, _NEAR, found[:, block])
        return found

    def medoids(self, count: int) -> IntArray:
        """Choose scenarios with a small mean distance from all to the nearest one.

        The distances are squares, so what k-means makes small is their sum; the scenario nearest to each mean is taken
        [1]_.

        Parameters
        ----------
        count : int
            How many.

        Returns
        -------
        ndarray of int64, shape (count,)
            Indices, rising.

        References
        ----------
        .. [1] D. Arthur, S. Vassilvitskii, "k-means++: The advantages of careful seeding", 2007.
        """
        n = len(self)
        if count >= n:
            return np.arange(n)
        from sklearn.cluster import KMeans
        from sklearn.exceptions import ConvergenceWarning

        # Of scenarios that are the same there are fewer groups, which is no news here.
        with one_thread(), warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)
            model = KMeans(count, n_init=1, max_iter=_ROUNDS, random_state=0).fit(self._rows)
        groups = model.labels_
        away = ((self._rows - model.cluster_centers_[groups]) ** 2).sum(axis=1)
        order = np.lexsort((away, groups))
        taken = order[np.unique(groups[order], return_index=True)[1]]
        rest = np.setdiff1d(np.arange(n), taken)[: count - len(taken)]
        return np.sort(np.concatenate((taken, rest))).astype(np.int64)


class Placing:
    """Places by the distances to some landmarks.

    Parameters
    ----------
    between : ndarray of float64, shape (m, m)
        Distances between the landmarks.

    Notes
    -----
    Landmark multidimensional scaling [1]_ of the roots of the distances: Dynamic Time Warping sums along a path and is
    no metric, but its root is nearly Euclidean. Coordinates beyond the 48 most important ones are left out, so a
    distance between scenarios that are much alike is rather too small.

    References
    ----------
    .. [1] V. de Silva, J. Tenenbaum, "Sparse multidimensional scaling using landmark points", 2004.
    """

    def __init__(self, between: FloatArray) -> None:
        self._means = between.mean(axis=0)
        centred = -0.5 * (between - self._means - self._means[:, None] + self._means.mean())
        m = len(between)
        with one_thread():
            values, vectors = eigh(centred, subset_by_index=[max(0, m - DIMENSIONS), m - 1])
        values, vectors = values[::-1], vectors[:, ::-1]
        used = values > max(_FLAT * float(values[0]), 1e-300)
        # The sign of an axis is that of its largest entry, as in kernel space.
        signs = np.sign(vectors[np.abs(vectors).argmax(axis=0), np.arange(vectors.shape[1])])
        # Where all are the same, all are at one place.
        self._axes = (vectors * signs)[:, used] / np.sqrt(values[used]) if used.any() else np.zeros((m, 1))
        placed = PlacedDistances(self._placed(between))
        (one, two) = np.triu_indices(m, 1)
        from_places, known = placed[:][one, two], between[one, two]
        squares = float((from_places * from_places).sum())
        self._scale = np.sqrt((from_places * known).sum() / squares) if squares else 1.0

    def _placed(self, to_landmarks: FloatArray) -> FloatArray:
        with one_thread():
            return np.asarray(-0.5 * (to_landmarks - self._means) @ self._axes)

    def place(self, to_landmarks: FloatArray) -> FloatArray:
        """Place scenarios.

        Parameters
        ----------
        to_landmarks : ndarray of float64, shape (n, m)
            Their distances to the landmarks.

        Returns
        -------
        ndarray of float64, shape (n, p)
            Coordinates, in the root of the unit of the distances.
        """
        return self._placed(to_landmarks) * self._scale


Distances = npt.NDArray[np.float64] | PlacedDistances
"""Distances between scenarios: all of them, or places that they follow from."""
