"""Covariance kernel of a Gaussian process, and maximum-likelihood estimation of its hyperparameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import LinAlgError, cholesky
from scipy.linalg.lapack import dpotri
from scipy.optimize import minimize

from cornercase._common.typing import BoolArray, FloatArray, IntArray

Floats = npt.NDArray[np.floating[Any]]

_TOLERANCE = 1e7 * float(np.finfo(np.float64).eps)  # as in SciPy
_ROOT5 = float(np.sqrt(5.0))
# Number of values from which length scales are learned: per dimension, least and most. The cost grows with its cube.
_VALUES_PER_DIMENSION, _MIN_VALUES, _MAX_VALUES = 40, 160, 400
# Prior of the length scales for one dimension: median and standard deviation of the logarithm. Distances in a cube grow
# with the root of its dimension. Length scales have to grow, too, or values in many dimensions would be unrelated.
_PRIOR_MEDIAN, _PRIOR_SPREAD = 0.5, 0.7
# Columns of a symmetric covariance that are computed together, down from the diagonal.
_BLOCK_SIZE = 256
_LENGTH_SCALE_BOUNDS, _SIGNAL_BOUNDS, _MIN_NOISE = (1e-2, 10.0), (1e-2, 30.0), 1e-4


@dataclass(frozen=True)
class MaternKernel:
    """Matérn kernel (5/2) with a length scale per dimension.

    `signal` is the standard deviation of the Gaussian process. `noise` is the standard deviation of the error of a
    single value.
    """

    length_scales: FloatArray
    signal: float
    noise: float

    def covariance(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Return the covariance, shape (n, m), of points `a` (n, e) with points `b` (m, e), without noise."""
        return np.asarray(self._scaled_covariance(a / self.length_scales, b / self.length_scales), dtype=np.float64)

    def covariance_lower_half(self, points: FloatArray) -> FloatArray:
        """Return the covariance, shape (n, n), of points (n, e); only the diagonal and the entries below are valid."""
        scaled = points / self.length_scales
        covariance = np.zeros((len(points), len(points)), order="F")
        for first in range(0, len(points), _BLOCK_SIZE):
            block = slice(first, first + _BLOCK_SIZE)
            covariance[first:, block] = self._scaled_covariance(scaled[block], scaled[first:]).T
        return covariance

    def covariance_in_single_precision(self, a: FloatArray, b: FloatArray) -> Floats:
        """Do the same as `covariance`, but in single precision."""
        return self._scaled_covariance(
            (a / self.length_scales).astype(np.float32), (b / self.length_scales).astype(np.float32)
        )

    def _scaled_covariance(self, a: Floats, b: Floats) -> Floats:
        covariance = matern_correlations(_pairwise_distances(a, b))
        covariance *= covariance.dtype.type(self.signal**2)
        return covariance


def evenly_spaced_indices(count: int, max_count: int) -> IntArray:
    """Return at most `max_count` evenly spaced indices of `count` values."""
    return np.unique(np.linspace(0, count - 1, max_count).astype(np.int64))


def indices_with_rare_values(count: int, max_count: int, is_rare: BoolArray | None) -> IntArray:
    """Choose at most `max_count` of `count` values; return their indices.

    If there are more values, at most half of `max_count` are rare ones. The chosen rare values are evenly spaced among
    all rare values, the chosen other values among all other values.
    """
    if is_rare is None or count <= max_count or not is_rare.any():
        return evenly_spaced_indices(count, max_count)
    rare_indices, common = np.flatnonzero(is_rare), np.flatnonzero(~is_rare)
    selected = rare_indices[evenly_spaced_indices(len(rare_indices), max_count // 2)]
    rest = common[evenly_spaced_indices(len(common), max_count - len(selected))] if len(common) else common
    return np.sort(np.concatenate([selected, rest]))


def fit_kernel(
    points: FloatArray,
    values: FloatArray,
    max_noise: float,
    start: MaternKernel | None = None,
    is_rare: BoolArray | None = None,
    tolerance: float = _TOLERANCE,
) -> MaternKernel:
    """Fit a kernel: maximize the marginal likelihood times a log-normal prior on the length scales.

    The prior keeps the length scales in a plausible range if there are few points. The median of the prior grows with
    the root of the number of dimensions. `values` must have a mean of 0. The fit uses up to 40 values per dimension,
    with a limit of at least 160 and at most 400 values in total. If there are more values than this limit, at most half
    of the limit are rare values (`is_rare`). The search for the maximum ends after 50 steps, or when a step improves
    the logarithm of the objective by less than the fraction `tolerance`; if the logarithm is between -1 and 1, by less
    than `tolerance` itself.

    Source: C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning" (2006), equations 4.17, 5.8
    and 5.9. The prior is scaled as in C. Hvarfner, E. O. Hellsten, L. Nardi, "Vanilla Bayesian optimization performs
    great in high dimensions", ICML (2024).
    """
    dims = points.shape[1]
    bounds = np.log([*[_LENGTH_SCALE_BOUNDS] * dims, _SIGNAL_BOUNDS, (_MIN_NOISE, max_noise)])
    initial = np.append(np.full(dims, 0.4), (1.0, 0.05))
    if start is not None:
        initial = np.append(start.length_scales, (start.signal, start.noise))
    subset = indices_with_rare_values(
        len(values), int(np.clip(_VALUES_PER_DIMENSION * dims, _MIN_VALUES, _MAX_VALUES)), is_rare
    )
    squares = np.square(points.T[:, subset, None] - points.T[:, None, subset]).reshape(dims, -1)
    result = minimize(
        _NegativeLogPosterior(squares, values[subset]),
        np.clip(np.log(initial), *bounds.T),
        jac=True,
        method="L-BFGS-B",
        bounds=[(low, high) for low, high in bounds.tolist()],
        options={"maxiter": 50, "ftol": tolerance},
    )
    *widths, signal, noise = np.exp(result.x).tolist()
    return MaternKernel(np.array(widths), signal, noise)


class _NegativeLogPosterior:
    """Objective of the fit, with its gradient: the negative logarithm of the product of marginal likelihood and prior.

    `squares`, shape (e, n * n), holds the squared differences between all pairs of n points in each of e dimensions.
    """

    def __init__(self, squares: FloatArray, values: FloatArray) -> None:
        self._squares, self._values = squares, values
        # Buffers for all calls: allocating them costs more than filling them.
        self._work = np.empty((5, squares.shape[1]))

    def __call__(self, parameters: FloatArray) -> tuple[float, FloatArray]:
        *logs, log_signal, log_noise = parameters
        squares, values, count = self._squares, self._values, len(self._values)
        narrow, signal2, noise2 = np.exp(-2.0 * np.array(logs)), np.exp(2.0 * log_signal), np.exp(2.0 * log_noise)
        correlation, slope, flat, fall = self._work[:4]
        scaled = np.matmul(narrow, squares, out=flat)
        np.sqrt(scaled, out=scaled)
        scaled *= _ROOT5
        np.exp(np.negative(scaled, out=fall), out=fall)
        # Derivative of the correlation by the logarithm of a length scale, divided by the square.
        np.multiply(np.add(scaled, 1.0, out=slope), fall, out=slope)
        np.multiply(scaled, scaled, out=correlation)
        correlation *= fall
        correlation *= 1.0 / 3.0
        correlation += slope
        # In column-major order, so that LAPACK works in place.
        covariance = np.multiply(correlation, signal2, out=fall).reshape(count, count).T
        covariance[np.diag_indices(count)] += noise2
        try:
            lower = cholesky(covariance, lower=True, overwrite_a=True, check_finite=False)
        except LinAlgError:
            return 1e25, np.zeros_like(parameters)
        # Copied, since the last digit of NumPy's logarithm of a strided array depends on where its result is in memory.
        determinant = np.log(np.diag(lower).copy()).sum()
        half = dpotri(lower, lower=1, overwrite_c=1)[0]
        inverse = np.add(half, half.T, out=self._work[4].reshape(count, count).T)
        np.fill_diagonal(inverse, np.diag(half))
        weights = inverse @ values
        outer = np.outer(weights, weights, out=flat.reshape(count, count))
        outer -= inverse
        gradient = np.empty_like(parameters)
        gradient[-2] = flat @ correlation * signal2
        gradient[-1] = np.trace(outer) * noise2
        gradient[:-2] = squares @ np.multiply(flat, slope, out=slope) * narrow * (signal2 * 5.0 / 6.0)
        likelihood = -0.5 * values @ weights - determinant
        deviation = (np.asarray(logs) - np.log(_PRIOR_MEDIAN * np.sqrt(len(logs)))) / _PRIOR_SPREAD
        gradient[:-2] -= deviation / _PRIOR_SPREAD
        return float(-(likelihood - 0.5 * deviation @ deviation)), -gradient


def _pairwise_distances(a: Floats, b: Floats) -> Floats:
    squares: Floats = a @ (b * b.dtype.type(-2.0)).T
    squares += (a * a).sum(1)[:, None]
    squares += (b * b).sum(1)
    np.sqrt(np.maximum(squares, 0.0, out=squares), out=squares)
    return squares


def matern_correlations(distance: Floats) -> Floats:
    """Compute Matérn correlations (5/2) from distances in units of the length scale; `distance` is overwritten."""
    number = distance.dtype.type
    distance *= number(_ROOT5)
    polynomial = distance * number(1.0 / 3.0)
    polynomial += number(1.0)
    polynomial *= distance
    polynomial += number(1.0)
    np.exp(np.negative(distance, out=distance), out=distance)
    polynomial *= distance
    return polynomial
