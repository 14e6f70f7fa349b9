"""Gaussian process over the unit cube: what the scenarios that were run say about those that were not."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import LinAlgError, cho_solve, cholesky, solve_triangular
from scipy.linalg.blas import strmm
from scipy.optimize import minimize
from scipy.stats import norm
from threadpoolctl import threadpool_limits

from cornercase._common.platform import available_cpus
from cornercase._common.typing import FloatArray
from cornercase.scenario import ParameterSpace

Floats = npt.NDArray[np.floating[Any]]

_ROOT5 = float(np.sqrt(5.0))
_CHUNK, _LEARNED, _FEWEST = 1024, 160, 10
_MANY, _NOISES = 100, (0.02, 0.3, 1.0)
_WIDTHS, _SIGNAL, _LEAST_NOISE = (1e-2, 10.0), (1e-2, 30.0), 1e-6


def encoded(space: ParameterSpace, points: FloatArray) -> FloatArray:
    """Encode points for a kernel: choices become corners of a simplex, which are equally far from each other.

    Parameters
    ----------
    space : ParameterSpace
    points : ndarray of float64, shape (n, d)

    Returns
    -------
    ndarray of float64, shape (n, e)
    """
    columns = []
    for j, parameter in enumerate(space.parameters):
        if parameter.choices:
            columns.append(np.eye(len(parameter.choices))[parameter.numbers(points[:, j])] * np.sqrt(0.5))
        else:
            columns.append(points[:, j : j + 1])
    return np.concatenate(columns, axis=1)


def enough(points: FloatArray, scores: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return points, shape (m, d), and scores, shape (m,), without those of scenarios that failed.

    Parameters
    ----------
    points : ndarray of float64, shape (n, d)
    scores : ndarray of float64, shape (n,)
        NaN for a scenario that failed.

    Raises
    ------
    ValueError
        There are fewer than 10 scores, or all are the same.
    """
    known = np.isfinite(scores)
    if known.sum() < _FEWEST or np.ptp(scores[known]) == 0.0:
        raise ValueError(f"At least {_FEWEST} different scores are needed.")
    return points[known], scores[known]


def near_threshold(scores: FloatArray, threshold: float) -> FloatArray:
    """Scores with the threshold at 0, drawn together by a hyperbolic tangent where they are far from it.

    What lies far from the threshold says little about the boundary of the critical set, and a process that need not
    follow it follows the boundary better. But it leads to regions that were not met yet; so one standard deviation
    counts as near with up to 100 scores, and less with more of them, down to the half.

    Parameters
    ----------
    scores : ndarray of float64, shape (n,)
    threshold : float

    Returns
    -------
    ndarray of float64, shape (n,)
    """
    near = np.clip(_MANY / len(scores), 0.5, 1.0)
    return np.asarray(np.tanh((scores - threshold) / (near * np.std(scores))))


def boundary_process(points: FloatArray, scores: FloatArray, threshold: float) -> GaussianProcess:
    """Gaussian process of `near_threshold` that best predicts which scenarios are critical.

    Where scores jump, a process with much noise smooths the boundary away; where they are noisy, one with little noise
    follows the noise. So several are fitted, each with more noise allowed, and the one is taken that predicts best on
    which side of the threshold each scenario is that is left out.

    Parameters
    ----------
    points : ndarray of float64, shape (n, e)
        As `encoded`.
    scores : ndarray of float64, shape (n,)
        Not all the same.
    threshold : float

    Returns
    -------
    GaussianProcess
    """
    values = near_threshold(scores, threshold)
    side = np.where(scores <= threshold, 1.0, -1.0)
    found = [GaussianProcess(most_noise).fit(points, values) for most_noise in _NOISES]
    sure = []
    for process in found:
        mean, deviation = process.leave_one_out()
        sure.append(norm.logcdf(-side * mean / deviation).sum())
    return found[int(np.argmax(sure))]


class GaussianProcess:
    """Gaussian process with a Matérn kernel (5/2) and a width of its own for each dimension.

    Widths, size and noise are those of the greatest marginal likelihood times a wide prior on the widths, which
    keeps them from running away while there are few points (Rasmussen and Williams, Gaussian Processes for Machine
    Learning, 2006, equations 4.17, 5.8 and 5.9).

    Parameters
    ----------
    most_noise : float, default 0.3
        Greatest standard deviation of single values.

    Attributes
    ----------
    widths : ndarray of float64, shape (e,)
    signal, noise : float
        Standard deviations of the process and of single values.
    """

    def __init__(self, most_noise: float = 0.3) -> None:
        self._most_noise = most_noise
        self.widths, self.signal, self.noise = np.zeros(0), 1.0, 0.1

    def fit(self, points: FloatArray, values: FloatArray) -> GaussianProcess:
        """Learn from values at points.

        Parameters
        ----------
        points : ndarray of float64, shape (n, e)
        values : ndarray of float64, shape (n,)
            Widths and noise are learned from 160 of them at most.

        Returns
        -------
        GaussianProcess
            Itself.
        """
        dims = points.shape[1]
        start = np.log(np.append(np.full(dims, 0.4), (1.0, min(0.05, self._most_noise))))
        bounds = np.log([*[_WIDTHS] * dims, _SIGNAL, (_LEAST_NOISE, self._most_noise)])
        mean = float(values.mean())
        some = np.unique(np.linspace(0, len(values) - 1, _LEARNED).astype(np.int64))
        squares = (points[some, None] - points[some]) ** 2
        # Sums in one order, whatever the number of threads: the points that follow hang on the last digits.
        with threadpool_limits(limits=1):
            found = minimize(
                _loss, start, (squares, values[some] - mean), jac=True, method="L-BFGS-B",
                bounds=[(low, high) for low, high in bounds.tolist()], options={"maxiter": 50},
            )  # fmt: skip
            *widths, self.signal, self.noise = np.exp(found.x)
            self.widths = np.array(widths)
            self._points, self._mean, self._values = points / self.widths, mean, values - mean
            covariance = self.signal**2 * _correlation(_distances(self._points, self._points))
            covariance[np.diag_indices(len(points))] += self.noise**2
            lower = cholesky(covariance, lower=True)
            self._weights = cho_solve((lower, True), self._values)
            self._inverse = solve_triangular(lower, np.eye(len(points)), lower=True)
            self._single_inverse = np.asfortranarray(self._inverse, dtype=np.float32)
        return self

    def predict(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation of the process at points.

        In single precision, so that 100,000 points and 400 values take a second or so.

        Parameters
        ----------
        points : ndarray of float64, shape (n, e)

        Returns
        -------
        mean, deviation : ndarray of float64, shape (n,)
        """
        mean, deviation = np.empty(len(points)), np.empty(len(points))
        weights = self._weights.astype(np.float32)

        def part(first: int) -> None:
            these = slice(first, first + _CHUNK)
            cross = self._cross(points[these])
            mean[these] = cross @ weights
            rows = self._project(cross)
            deviation[these] = np.einsum("ij,ij->i", rows, rows)

        # Each part is summed by one thread, so their number does not show.
        with threadpool_limits(limits=1), ThreadPoolExecutor(available_cpus()) as pool:
            list(pool.map(part, range(0, len(points), _CHUNK)))
        return mean + self._mean, np.sqrt(np.maximum(self.signal**2 - deviation, 1e-8 * self.signal**2))

    def projections(self, points: FloatArray) -> Floats:
        """Compute what `covariance` needs of points.

        Parameters
        ----------
        points : ndarray of float64, shape (n, e)

        Returns
        -------
        ndarray of float32, shape (n, values)
        """
        with threadpool_limits(limits=1):
            return self._project(self._cross(points))

    def _cross(self, points: FloatArray) -> Floats:
        """Covariance of points with those that were learned."""
        known = self._points.astype(np.float32)
        cross = _correlation(_distances((points / self.widths).astype(np.float32), known))
        cross *= np.float32(self.signal**2)
        return cross

    def _project(self, cross: Floats) -> Floats:
        """Product with the inverse factor, in place: half the work of that with a full matrix."""
        found: Floats = strmm(1.0, self._single_inverse, cross.T, side=0, lower=1, overwrite_b=1).T
        return found

    def leave_one_out(self) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation of each value by the process of all others.

        Returns
        -------
        mean, deviation : ndarray of float64, shape (n,)
            The deviation includes the noise of the single value.

        Notes
        -----
        Source: Rasmussen and Williams 2006, equation 5.12.
        """
        precision = (self._inverse**2).sum(axis=0)
        return self._mean + self._values - self._weights / precision, 1.0 / np.sqrt(precision)

    def joint(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Covariance of the values at points, noise included.

        Parameters
        ----------
        points : ndarray of float64, shape (m, e)

        Returns
        -------
        factor : ndarray of float64, shape (m, m)
            Lower Cholesky factor.
        deviation : ndarray of float64, shape (m,)
        """
        scaled = points / self.widths
        rows = self.signal**2 * _correlation(_distances(scaled, self._points)) @ self._inverse.T
        covariance = self.signal**2 * _correlation(_distances(scaled, scaled)) - rows @ rows.T
        covariance[np.diag_indices(len(points))] += self.noise**2 + 1e-6 * self.signal**2
        return cholesky(covariance, lower=True), np.sqrt(np.diag(covariance))

    def covariance(self, points: FloatArray, rows: Floats, i: int) -> FloatArray:
        """Covariance of the process at all points with that at one of them.

        Parameters
        ----------
        points : ndarray of float64, shape (n, e)
        rows : ndarray of float32, shape (n, values)
            What `projections` gives of the points.
        i : int
            Index of the one.

        Returns
        -------
        ndarray of float64, shape (n,)
        """
        prior = self.signal**2 * _correlation(_distances(points / self.widths, points[i : i + 1] / self.widths))[:, 0]
        return np.asarray(prior - rows @ rows[i], dtype=np.float64)


def _distances(a: Floats, b: Floats) -> Floats:
    squares: Floats = (a * a).sum(1)[:, None] + (b * b).sum(1) - 2.0 * (a @ b.T)
    np.sqrt(np.maximum(squares, 0.0, out=squares), out=squares)
    return squares


def _correlation(distance: Floats) -> Floats:
    """Matérn correlation (5/2) at scaled distances; the array is used up."""
    number = distance.dtype.type
    distance *= number(_ROOT5)
    polynomial = distance * number(1.0 / 3.0)
    polynomial += number(1.0)
    polynomial *= distance
    polynomial += number(1.0)
    np.exp(np.negative(distance, out=distance), out=distance)
    polynomial *= distance
    return polynomial


def _matern(distance: Floats) -> tuple[Floats, Floats]:
    """Correlation at scaled distances, and its derivative by the logarithm of a width, divided by the square."""
    scaled = distance * distance.dtype.type(_ROOT5)
    fall = np.exp(-scaled)
    slope = (1.0 + scaled) * fall
    return slope + (scaled * scaled) * fall * scaled.dtype.type(1.0 / 3.0), slope * scaled.dtype.type(5.0 / 3.0)


def _loss(parameters: FloatArray, squares: FloatArray, values: FloatArray) -> tuple[float, FloatArray]:
    """Negative logarithm of the marginal likelihood and the prior, and its gradient."""
    *logs, log_signal, log_noise = parameters
    widths, signal2, noise2 = np.exp(logs), np.exp(2.0 * log_signal), np.exp(2.0 * log_noise)
    scaled = squares / widths**2
    correlation, slope = _matern(np.sqrt(scaled.sum(-1)))
    covariance = signal2 * correlation
    covariance[np.diag_indices(len(values))] += noise2
    try:
        lower = cholesky(covariance, lower=True)
    except LinAlgError:
        return 1e25, np.zeros_like(parameters)
    weights = cho_solve((lower, True), values)
    inverse = cho_solve((lower, True), np.eye(len(values)))
    outer = np.outer(weights, weights) - inverse
    gradient = np.empty_like(parameters)
    common = outer * slope * signal2
    gradient[: len(widths)] = [0.5 * np.sum(common * scaled[..., j]) for j in range(len(widths))]
    gradient[-2] = np.sum(outer * correlation) * signal2
    gradient[-1] = np.trace(outer) * noise2
    # Of a copy: NumPy's logarithm of a strided array depends, in its last digit, on where its result lies in memory.
    likelihood = -0.5 * values @ weights - np.log(np.diag(lower).copy()).sum()
    away = np.asarray(logs) - np.log(0.5)
    gradient[: len(widths)] -= away
    return float(-(likelihood - 0.5 * away @ away)), -gradient
