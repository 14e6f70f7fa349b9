"""The covariance of a Gaussian process, and how its widths, size and noise are learned."""

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

_ROOT5 = float(np.sqrt(5.0))
# Values that widths are learned from, for each dimension and within bounds: what it takes grows with their cube.
_LEARNED, _FEWEST, _MOST = 40, 160, 400
# Median of the widths before anything is known, for one dimension, and how far their logarithms lie about it. Distances
# in a cube grow with the root of its dimension; so must widths, or a process of many dimensions knows nothing between
# its values.
_MEDIAN, _SPREAD = 0.5, 0.7
_WIDTHS, _SIGNAL, _LEAST_NOISE = (1e-2, 10.0), (1e-2, 30.0), 1e-4


@dataclass(frozen=True)
class Kernel:
    """Matérn kernel (5/2) with a width of its own for each dimension.

    Attributes
    ----------
    widths : ndarray of float64, shape (e,)
    signal, noise : float
        Standard deviations of the process and of single values.
    """

    widths: FloatArray
    signal: float
    noise: float

    def covariance(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Covariance of the process at points with that at others, without noise.

        Parameters
        ----------
        a : ndarray of float64, shape (n, e)
        b : ndarray of float64, shape (m, e)

        Returns
        -------
        ndarray of float64, shape (n, m)
        """
        return np.asarray(self._covariance(a / self.widths, b / self.widths), dtype=np.float64)

    def single_covariance(self, a: FloatArray, b: FloatArray) -> Floats:
        """As `covariance`, in single precision."""
        return self._covariance((a / self.widths).astype(np.float32), (b / self.widths).astype(np.float32))

    def _covariance(self, a: Floats, b: Floats) -> Floats:
        found = correlations(_distances(a, b))
        found *= found.dtype.type(self.signal**2)
        return found


def evenly(count: int, most: int) -> IntArray:
    """Indices of at most so many of `count` values, evenly apart.

    Parameters
    ----------
    count, most : int

    Returns
    -------
    ndarray of int64, shape (k,)
    """
    return np.unique(np.linspace(0, count - 1, most).astype(np.int64))


def chosen(count: int, most: int, rare: BoolArray | None) -> IntArray:
    """Indices of at most so many of `count` values, up to half of them rare ones, and evenly apart among their kind.

    Parameters
    ----------
    count, most : int
    rare : ndarray of bool, shape (count,), or None
        Values that would be lost among many others.

    Returns
    -------
    ndarray of int64
    """
    if rare is None or count <= most or not rare.any():
        return evenly(count, most)
    kinds = np.flatnonzero(rare), np.flatnonzero(~rare)
    first = kinds[0][evenly(len(kinds[0]), most // 2)]
    rest = kinds[1][evenly(len(kinds[1]), most - len(first))] if len(kinds[1]) else kinds[1]
    return np.sort(np.concatenate([first, rest]))


def learned_kernel(
    points: FloatArray,
    values: FloatArray,
    most_noise: float,
    start: Kernel | None = None,
    rare: BoolArray | None = None,
) -> Kernel:
    """Kernel of the greatest marginal likelihood times a log-normal prior on the widths.

    The prior keeps the widths from running away while there are few points. Its median grows with the root of the
    number of dimensions.

    Parameters
    ----------
    points : ndarray of float64, shape (n, e)
    values : ndarray of float64, shape (n,)
        With a mean of 0; 40 for each dimension are looked at, but 160 at least and 400 at most.
    most_noise : float
        Greatest standard deviation of single values.
    start : Kernel, optional
        Where to begin.
    rare : ndarray of bool, shape (n,), optional
        Values of which as many as can be are looked at, up to half of all that are.

    Returns
    -------
    Kernel

    Notes
    -----
    Source: C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning" (2006), equations 4.17, 5.8
    and 5.9. The prior is scaled as in C. Hvarfner, E. O. Hellsten, L. Nardi, "Vanilla Bayesian optimization performs
    great in high dimensions", ICML (2024).
    """
    dims = points.shape[1]
    bounds = np.log([*[_WIDTHS] * dims, _SIGNAL, (_LEAST_NOISE, most_noise)])
    begin = np.append(np.full(dims, 0.4), (1.0, 0.05))
    if start is not None:
        begin = np.append(start.widths, (start.signal, start.noise))
    some = chosen(len(values), int(np.clip(_LEARNED * dims, _FEWEST, _MOST)), rare)
    squares = np.square(points.T[:, some, None] - points.T[:, None, some]).reshape(dims, -1)
    found = minimize(
        _Loss(squares, values[some]), np.clip(np.log(begin), *bounds.T), jac=True, method="L-BFGS-B",
        bounds=[(low, high) for low, high in bounds.tolist()], options={"maxiter": 50},
    )  # fmt: skip
    *widths, signal, noise = np.exp(found.x).tolist()
    return Kernel(np.array(widths), signal, noise)


class _Loss:
    """Negative logarithm of the marginal likelihood and the prior, and its gradient.

    Parameters
    ----------
    squares : ndarray of float64, shape (e, n * n)
        Squared differences of all pairs of points.
    values : ndarray of float64, shape (n,)
    """

    def __init__(self, squares: FloatArray, values: FloatArray) -> None:
        self._squares, self._values = squares, values
        # Used by all calls: to hand memory back and take it anew costs more than to compute what goes into it.
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
        # The derivative of the correlation by the logarithm of a width, divided by the square.
        np.multiply(np.add(scaled, 1.0, out=slope), fall, out=slope)
        np.multiply(scaled, scaled, out=correlation)
        correlation *= fall
        correlation *= 1.0 / 3.0
        correlation += slope
        # Column by column, as LAPACK works in place on it then.
        covariance = np.multiply(correlation, signal2, out=fall).reshape(count, count).T
        covariance[np.diag_indices(count)] += noise2
        try:
            lower = cholesky(covariance, lower=True, overwrite_a=True, check_finite=False)
        except LinAlgError:
            return 1e25, np.zeros_like(parameters)
        # Of a copy: NumPy's logarithm of a strided array depends, in its last digit, on where its result lies in
        # memory.
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
        away = (np.asarray(logs) - np.log(_MEDIAN * np.sqrt(len(logs)))) / _SPREAD
        gradient[:-2] -= away / _SPREAD
        return float(-(likelihood - 0.5 * away @ away)), -gradient


def _distances(a: Floats, b: Floats) -> Floats:
    squares: Floats = a @ (b * b.dtype.type(-2.0)).T
    squares += (a * a).sum(1)[:, None]
    squares += (b * b).sum(1)
    np.sqrt(np.maximum(squares, 0.0, out=squares), out=squares)
    return squares


def correlations(distance: Floats) -> Floats:
    """Matérn correlation (5/2) at distances that are divided by the widths.

    Parameters
    ----------
    distance : ndarray of float32 or float64
        Used up.

    Returns
    -------
    ndarray of float32 or float64
        Of the same shape.
    """
    number = distance.dtype.type
    distance *= number(_ROOT5)
    polynomial = distance * number(1.0 / 3.0)
    polynomial += number(1.0)
    polynomial *= distance
    polynomial += number(1.0)
    np.exp(np.negative(distance, out=distance), out=distance)
    polynomial *= distance
    return polynomial
