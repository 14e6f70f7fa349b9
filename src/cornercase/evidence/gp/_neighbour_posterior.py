"""Nearest-neighbour approximation of a Gaussian process with very many values."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from cornercase._common.numba.blas import single_threaded_blas
from cornercase._common.platform import count_available_cpus
from cornercase._common.typing import FloatArray, IntArray
from cornercase.evidence.gp._matern_kernel import MaternKernel, matern_correlations

# Number of nearest values: per dimension, least and most.
_NEIGHBOURS_PER_DIMENSION, _MIN_NEIGHBOURS, _MAX_NEIGHBOURS = 12, 32, 64
_POINTS_PER_CHUNK: Final = 64
_JITTER: Final = 1e-8  # added to the variance of values close to each other, as a fraction of that of the process
_MIN_VARIANCE: Final = 1e-12


class NearestPosterior:
    """Posterior of a Gaussian process that predicts each point from the values nearest to it only.

    These are 12 values per dimension, but at least 32 and at most 64. Distances are measured in length scales. The cost
    per point hardly depends on the number of values. Details stay visible that 512 inducing points would smooth away,
    but a joint distribution of several points is not available. The posterior needs more values than it uses per point.

    Source: A. V. Vecchia, "Estimation and model identification for continuous spatial processes", Journal of the Royal
    Statistical Society B 50 (1988); A. Datta, S. Banerjee, A. O. Finley, A. E. Gelfand, "Hierarchical nearest-neighbor
    Gaussian process models for large geostatistical datasets", Journal of the American Statistical Association 111
    (2016).
    """

    def __init__(self, kernel: MaternKernel, points: FloatArray, values: FloatArray) -> None:
        self._kernel, self._points, self._values = kernel, points / kernel.length_scales, values
        self._count = int(np.clip(_NEIGHBOURS_PER_DIMENSION * points.shape[1], _MIN_NEIGHBOURS, _MAX_NEIGHBOURS))

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self._points)

    def predict(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Predict the process at points (m, e); return means and standard deviations, each of shape (m,)."""
        return self._predict_excluding(points / self._kernel.length_scales, np.full(len(points), -1))

    def leave_one_out(self, indices: IntArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Predict each value, or the values at `indices`, from the other values; return means and standard deviations.

        The standard deviations include the noise of single values.
        """
        selected = np.arange(len(self._points)) if indices is None else indices
        mean, deviation = self._predict_excluding(self._points[selected], selected)
        return mean, np.hypot(deviation, self._kernel.noise)

    def _predict_excluding(self, scaled_points: FloatArray, excluded: IntArray) -> tuple[FloatArray, FloatArray]:
        """Predict the process at points (m, e) in units of the length scales; return means and standard deviations.

        The prediction at point i does not use the value with index `excluded[i]`; -1 excludes no value.
        """
        mean, variance = np.empty(len(scaled_points)), np.empty(len(scaled_points))

        def predict_chunk(first: int) -> None:
            chunk = slice(first, first + _POINTS_PER_CHUNK)
            mean[chunk], variance[chunk] = self._mean_and_variance(
                scaled_points[chunk], self._nearest_indices(scaled_points[chunk], excluded[chunk])
            )

        # Built before the threads start, since each would build its own.
        _ = self._tree
        with single_threaded_blas(), ThreadPoolExecutor(count_available_cpus()) as pool:
            list(pool.map(predict_chunk, range(0, len(scaled_points), _POINTS_PER_CHUNK)))
        return mean, np.sqrt(np.maximum(variance, _MIN_VARIANCE * self._kernel.signal**2))

    def _nearest_indices(self, scaled_points: FloatArray, excluded: IntArray) -> IntArray:
        """Return the indices, shape (m, k), of the k values nearest to each point; skip the excluded value."""
        near = np.asarray(self._tree.query(scaled_points, k=self._count + 1)[1], dtype=np.int64)
        keep = near != excluded[:, None]
        # If none is excluded, drop the farthest.
        keep[keep.all(axis=1), -1] = False
        return np.asarray(near[keep].reshape(len(scaled_points), self._count))

    def _mean_and_variance(self, scaled_points: FloatArray, near: IntArray) -> tuple[FloatArray, FloatArray]:
        signal2 = self._kernel.signal**2
        offsets = self._points[near] - scaled_points[:, None]
        squares = np.einsum("mke,mke->mk", offsets, offsets)
        pair_squares = squares[:, :, None] + squares[:, None] - 2.0 * (offsets @ offsets.transpose(0, 2, 1))
        covariance = signal2 * matern_correlations(np.sqrt(np.maximum(pair_squares, 0.0)))
        covariance[:, np.arange(self._count), np.arange(self._count)] = (
            signal2 * (1.0 + _JITTER) + self._kernel.noise**2
        )
        cross = signal2 * matern_correlations(np.sqrt(squares))
        solved = np.linalg.solve(covariance, np.stack([cross, self._values[near]], axis=2))
        mean, explained = (np.einsum("mk,mk->m", cross, solved[:, :, k]) for k in (1, 0))
        return mean, signal2 - explained
