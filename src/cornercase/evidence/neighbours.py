"""What very many values say of a Gaussian process at a place: those nearest to it."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from cornercase._common.platform import available_cpus
from cornercase._common.threads import one_thread
from cornercase._common.typing import FloatArray, IntArray
from cornercase.evidence.kernel import Kernel, correlations

MOST_TOGETHER: Final = 4000
"""Number of values up to which some points stand for all; of more each place is told by the values nearest to it."""

# Values that a place is told by, for each dimension and within bounds, and places at a time.
_NEAREST, _FEWEST, _MOST = 12, 32, 64
_CHUNK: Final = 64
# Added to the variance of the values as a share of that of the process, since values lie close to each other.
_JITTER: Final = 1e-8
_LEAST: Final = 1e-12


class NearestPosterior:
    """Process given the values that are nearest to each place by the widths of the kernel: 12 a dimension, 32 to 64.

    It takes as long for a place whatever the number of values, and follows what 512 points that stand for all smooth
    away. But it says nothing of how places go together.

    Parameters
    ----------
    kernel : Kernel
    points : ndarray of float64, shape (n, e)
    values : ndarray of float64, shape (n,)
        More than 64.

    Notes
    -----
    Source: A. V. Vecchia, "Estimation and model identification for continuous spatial processes", Journal of the Royal
    Statistical Society B 50 (1988); A. Datta, S. Banerjee, A. O. Finley, A. E. Gelfand, "Hierarchical nearest-neighbor
    Gaussian process models for large geostatistical datasets", Journal of the American Statistical Association 111
    (2016).
    """

    def __init__(self, kernel: Kernel, points: FloatArray, values: FloatArray) -> None:
        self._kernel, self._points, self._values = kernel, points / kernel.widths, values
        self._count = int(np.clip(_NEAREST * points.shape[1], _FEWEST, _MOST))

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self._points)

    def predict(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation of the process at points.

        Parameters
        ----------
        points : ndarray of float64, shape (m, e)

        Returns
        -------
        mean, deviation : ndarray of float64, shape (m,)
        """
        places = points / self._kernel.widths
        return self._between(places, np.full(len(places), -1))

    def leave_one_out(self, some: IntArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation of values by the process of others.

        Parameters
        ----------
        some : ndarray of int64, shape (k,), optional
            Which values; by default all.

        Returns
        -------
        mean, deviation : ndarray of float64, shape (k,)
            The deviation includes the noise of the single value.
        """
        at = np.arange(len(self._points)) if some is None else some
        mean, deviation = self._between(self._points[at], at)
        return mean, np.hypot(deviation, self._kernel.noise)

    def _between(self, places: FloatArray, themselves: IntArray) -> tuple[FloatArray, FloatArray]:
        """Mean and deviation at scaled places, shape (m, e), each without the value of a number, -1 for none."""
        mean, variance = np.empty(len(places)), np.empty(len(places))

        def part(first: int) -> None:
            these = slice(first, first + _CHUNK)
            mean[these], variance[these] = self._at(places[these], self._near(places[these], themselves[these]))

        # Made before the threads begin, which would each make one.
        _ = self._tree
        with one_thread(), ThreadPoolExecutor(available_cpus()) as pool:
            list(pool.map(part, range(0, len(places), _CHUNK)))
        return mean, np.sqrt(np.maximum(variance, _LEAST * self._kernel.signal**2))

    def _near(self, places: FloatArray, themselves: IntArray) -> IntArray:
        """Values that are nearest to places, those themselves not among them, shape (m, k)."""
        near = np.asarray(self._tree.query(places, k=self._count + 1)[1], dtype=np.int64)
        other = near != themselves[:, None]
        # Where all are others, the last one is too many.
        other[other.all(axis=1), -1] = False
        return np.asarray(near[other].reshape(len(places), self._count))

    def _at(self, places: FloatArray, near: IntArray) -> tuple[FloatArray, FloatArray]:
        signal2 = self._kernel.signal**2
        around = self._points[near] - places[:, None]
        squares = np.einsum("mke,mke->mk", around, around)
        between = squares[:, :, None] + squares[:, None] - 2.0 * (around @ around.transpose(0, 2, 1))
        covariance = signal2 * correlations(np.sqrt(np.maximum(between, 0.0)))
        covariance[:, np.arange(self._count), np.arange(self._count)] = (
            signal2 * (1.0 + _JITTER) + self._kernel.noise**2
        )
        cross = signal2 * correlations(np.sqrt(squares))
        solved = np.linalg.solve(covariance, np.stack([cross, self._values[near]], axis=2))
        mean, explained = (np.einsum("mk,mk->m", cross, solved[:, :, k]) for k in (1, 0))
        return mean, signal2 - explained
