"""What values say of a Gaussian process of a given kernel: all of them exactly, or many by way of some points.

Both kinds say it in the same form: the mean of the process at a place is that of its covariances with some points times
`weights`, and what the values explain of its variance there is the squared length of those covariances times `inverse`.
Both take further values in: the factor is extended instead of computed anew.
"""

from __future__ import annotations

import contextlib

import numpy as np
from scipy.linalg import LinAlgError, cho_solve, cholesky
from scipy.linalg.lapack import dpotri, dtrtri

from cornercase._common.typing import FloatArray, IntArray
from cornercase.evidence.kernel import Kernel, evenly
from cornercase.evidence.products import lower_times, products_of_rows, times_lower_transposed, times_transposed

MOST_EXACT = 512
"""Number of values up to which all of them are taken exactly, and of the points that stand for more of them."""

# Points among which those are chosen that stand for all, and how many at a time.
_AMONG, _AT_ONCE = 2048, 32
# Values that are taken in at a time, so that memory does not grow with their number.
_BLOCK = 8192
# Added to the variance of the points that stand for all, and of all values, as a share of it, so that it is inverted.
_JITTER, _LITTLE = 1e-7, 1e-10
# How often ten times as much is added where that is not enough.
_TRIES = 6
# Added to the share of the variance that is explained, against rounding errors.
_SLACK = 1e-8


class ExactPosterior:
    """Process given values at points.

    Parameters
    ----------
    kernel : Kernel
    points : ndarray of float64, shape (n, e)
    values : ndarray of float64, shape (n,)
    inverse : ndarray of float64, shape (n, n), optional
        Inverse of the lower Cholesky factor of the covariance of the values, where it is known.

    Attributes
    ----------
    points : ndarray of float64, shape (n, e)
    weights : ndarray of float64, shape (n,)
    inverse : ndarray of float64, shape (n, n)
        Lower triangular.

    Notes
    -----
    Source: C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning" (2006), equations 2.25, 2.26.
    """

    def __init__(
        self, kernel: Kernel, points: FloatArray, values: FloatArray, inverse: FloatArray | None = None
    ) -> None:
        self._kernel, self.points, self._values = kernel, points, values
        little = _LITTLE * kernel.signal**2
        self.inverse = _inverse(_noisy(kernel, points), little) if inverse is None else inverse
        self.weights = self.inverse.T @ (self.inverse @ values)

    def extended(self, points: FloatArray, values: FloatArray) -> ExactPosterior:
        """Take further values in.

        Parameters
        ----------
        points : ndarray of float64, shape (m, e)
        values : ndarray of float64, shape (m,)

        Returns
        -------
        ExactPosterior
            The same, but for rounding, as of all values at once.
        """
        cross = self._kernel.covariance(points, self.points) @ self.inverse.T
        corner = _inverse(_noisy(self._kernel, points) - cross @ cross.T, _LITTLE * self._kernel.signal**2)
        inverse = np.zeros([len(self.points) + len(points)] * 2)
        inverse[: len(self.points), : len(self.points)] = self.inverse
        inverse[len(self.points) :, : len(self.points)] = -corner @ (cross @ self.inverse)
        inverse[len(self.points) :, len(self.points) :] = corner
        every = np.concatenate([self.points, points]), np.concatenate([self._values, values])
        return ExactPosterior(self._kernel, *every, inverse)

    def leave_one_out(self) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation of each value by the process of all others, both of shape (n,)."""
        precision = (self.inverse**2).sum(axis=0)
        return self._values - self.weights / precision, 1.0 / np.sqrt(precision)


class SparsePosterior:
    """Process given many values, by way of the process at some of their points.

    What these points leave open of the process at the others is taken for independent noise (FITC).

    Parameters
    ----------
    kernel : Kernel
    points : ndarray of float64, shape (n, e)
    values : ndarray of float64, shape (n,)
    matters : ndarray of float64, shape (n,), optional
        How much it matters to know the process at a point: the larger, the likelier it is one of those that stand for
        all. Above 0; by default the same everywhere.
    before : SparsePosterior, optional
        The same points stand for all, and the values come on top of those there.

    Attributes
    ----------
    points : ndarray of float64, shape (k, e)
        Those that stand for all.
    weights : ndarray of float64, shape (k,)
    inverse : ndarray of float64, shape (k, k)
        Lower triangular.
    known : ndarray of float64, shape (n, e)
        All points.
    values : ndarray of float64, shape (n,)

    Notes
    -----
    Source: E. Snelson, Z. Ghahramani, "Sparse Gaussian processes using pseudo-inputs", NIPS (2005). The points are
    chosen as in Y. Chen, E. N. Epperly, J. A. Tropp, R. J. Webber, "Randomly pivoted Cholesky", Communications on Pure
    and Applied Mathematics 78 (2025).
    """

    def __init__(
        self,
        kernel: Kernel,
        points: FloatArray,
        values: FloatArray,
        matters: FloatArray | None = None,
        before: SparsePosterior | None = None,
    ) -> None:
        self._kernel = kernel
        if before is None:
            self.points = points[_standing_for(kernel, points, matters)]
            prior = kernel.covariance(self.points, self.points)
            self._whiten = _inverse(prior, _JITTER * kernel.signal**2)
            self._precision, self._moment = np.eye(len(prior)), np.zeros(len(prior))
        else:
            self.points, self._whiten = before.points, before._whiten
            self._precision, self._moment = before._precision, before._moment
        for these in _blocks(len(points)):
            rows, root = self._rows(points[these])
            rows /= root[:, None]
            # Its lower half, which is all that is looked at.
            self._precision = self._precision + products_of_rows(rows.T)
            self._moment = self._moment + rows.T @ (values[these] / root)
        lower = cholesky(self._precision, lower=True)
        self._mean = cho_solve((lower, True), self._moment)
        self._narrowed = np.asarray(dtrtri(lower, lower=1)[0])
        covariance = dpotri(lower, lower=1)[0]
        covariance += np.tril(covariance, -1).T
        self.known, self.values = points, values
        if before is not None:
            self.known = np.concatenate([before.known, points])
            self.values = np.concatenate([before.values, values])
        self.weights = self._whiten.T @ self._mean
        # Of the variance explained, 1 - covariance, the factor whose transpose stands first.
        explained = np.ascontiguousarray((np.eye(len(lower)) - covariance)[::-1, ::-1])
        factor = positive_factor(explained, _SLACK)
        self.inverse = lower_times(np.ascontiguousarray(factor[::-1, ::-1]).T, self._whiten)

    def extended(self, points: FloatArray, values: FloatArray) -> SparsePosterior:
        """Take further values in.

        Parameters
        ----------
        points : ndarray of float64, shape (m, e)
        values : ndarray of float64, shape (m,)

        Returns
        -------
        SparsePosterior
            The same, but for rounding, as of all values at once if the same points stood for them.
        """
        return SparsePosterior(self._kernel, points, values, before=self)

    def leave_one_out(self) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation of each value by the process of all others, both of shape (n,)."""
        each = [self._left_out(self.known[these], self.values[these]) for these in _blocks(len(self.known))]
        mean, deviation = map(np.concatenate, zip(*each, strict=True))
        return mean, deviation

    def _left_out(self, points: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """As `leave_one_out`, of some of the values that are known."""
        rows, root = self._rows(points)
        left = times_lower_transposed(rows, self._narrowed)
        explained = np.einsum("ij,ij->i", left, left)
        precision = (1.0 - explained / root**2) / root**2
        error = (values - rows @ self._mean) / root**2 / precision
        return values - error, 1.0 / np.sqrt(precision)

    def _rows(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Process at points in terms of independent variables, and the deviation of what they leave open."""
        rows = times_lower_transposed(self._kernel.covariance(points, self.points), self._whiten)
        variance = self._kernel.signal**2
        left = variance - np.einsum("ij,ij->i", rows, rows)
        return rows, np.sqrt(np.maximum(left, _JITTER * variance) + self._kernel.noise**2)


Posterior = ExactPosterior | SparsePosterior


def _blocks(count: int) -> list[slice]:
    """Parts of so many values that are worked through one after the other; one of no more than 8192."""
    return [slice(first, first + _BLOCK) for first in range(0, count, _BLOCK)] or [slice(0, 0)]


def positive_factor(covariance: FloatArray, slack: float) -> FloatArray:
    """Lower Cholesky factor of a covariance that rounding errors may have left short of positive definite.

    Parameters
    ----------
    covariance : ndarray of float64, shape (n, n)
        Of which the lower half is looked at. What is added to its diagonal stays there.
    slack : float
        What is added at least.

    Returns
    -------
    ndarray of float64, shape (n, n)
    """
    diagonal = np.diag_indices(len(covariance))
    for _ in range(_TRIES):
        covariance[diagonal] += slack
        with contextlib.suppress(LinAlgError):
            return np.asarray(cholesky(covariance, lower=True, check_finite=False))
        # Values close to each other that have little noise leave larger errors.
        slack *= 10.0
    return np.asarray(cholesky(covariance, lower=True))


def posterior(kernel: Kernel, points: FloatArray, values: FloatArray, matters: FloatArray | None = None) -> Posterior:
    """What values say of a process: exactly up to 512 of them, else by way of as many points.

    Parameters
    ----------
    kernel : Kernel
    points : ndarray of float64, shape (n, e)
    values : ndarray of float64, shape (n,)
    matters : ndarray of float64, shape (n,), optional
        As for `SparsePosterior`.

    Returns
    -------
    ExactPosterior or SparsePosterior
    """
    if len(points) <= MOST_EXACT:
        return ExactPosterior(kernel, points, values)
    return SparsePosterior(kernel, points, values, matters)


def _standing_for(kernel: Kernel, points: FloatArray, matters: FloatArray | None) -> IntArray:
    """Indices of the points whose process tells most of that at all points, above all where it matters."""
    among = evenly(len(points), _AMONG)
    rng = np.random.default_rng(0)
    share = np.ones(len(among)) if matters is None else matters[among]
    left, rows = np.ones(len(among)), np.zeros((len(among), MOST_EXACT), order="F")
    chosen = np.zeros(0, dtype=np.int64)
    for done in range(0, MOST_EXACT, _AT_ONCE):
        left[chosen] = 0.0
        new = rng.choice(len(among), _AT_ONCE, replace=False, p=left * share / (left @ share))
        cross = kernel.covariance(points[among], points[among[new]]) / kernel.signal**2
        cross -= times_transposed(rows[:, :done], rows[new, :done])
        more = cross @ _inverse(cross[new], _JITTER).T
        rows[:, done : done + _AT_ONCE] = more
        left = np.maximum(left - (more**2).sum(axis=1), 1e-12)
        chosen = np.concatenate([chosen, new])
    return np.sort(among[chosen])


def _noisy(kernel: Kernel, points: FloatArray) -> FloatArray:
    covariance = kernel.covariance(points, points)
    covariance[np.diag_indices(len(points))] += kernel.noise**2
    return covariance


def _inverse(covariance: FloatArray, slack: float) -> FloatArray:
    """Inverse of the lower Cholesky factor."""
    return np.asarray(dtrtri(positive_factor(covariance, slack), lower=1)[0])
