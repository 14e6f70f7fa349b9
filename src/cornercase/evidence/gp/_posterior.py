"""Posterior of a Gaussian process with a given kernel: exact, or with inducing points.

Both kinds predict a point from its covariances with the attribute `points`. The mean is the scalar product of these
covariances and `weights`. The variance explained by the values is the squared norm of `inverse_factor` times these
covariances. More values can be added to both kinds of posterior, without computing everything again.
"""

from __future__ import annotations

import contextlib

import numpy as np
from scipy.linalg import LinAlgError, cho_solve, cholesky
from scipy.linalg.lapack import dpotri, dtrtri

from cornercase._common.typing import FloatArray, IntArray
from cornercase.evidence.gp._matern_kernel import MaternKernel, evenly_spaced_indices
from cornercase.evidence.gp._triangular_products import (
    gram_lower_half,
    multiply_by_lower_transposed,
    multiply_by_transposed,
    multiply_lower_triangular,
)

MAX_EXACT_VALUES = 512
"""Greatest number of values of the exact posterior, and number of inducing points for more values."""

# Number of candidates for inducing points, and number that is chosen at a time.
_N_CANDIDATES, _PIVOTS_PER_STEP = 2048, 32
_BLOCK_SIZE = 8192  # values processed at a time, so that memory does not grow with their number
# Fractions of the variance that are added to the variance of inducing points, and of all values, so that covariances
# can be inverted.
_INDUCING_JITTER, _VALUE_JITTER = 1e-7, 1e-10
_TRIES = 6  # attempts with ten times the slack each
_SLACK = 1e-8  # added to the explained fraction of the variance, against rounding errors


class ExactPosterior:
    """Exact posterior for values (n,) at points (n, e).

    `inverse_factor` (n, n) is the inverse of the lower Cholesky factor of the values' covariance.

    Source: C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning" (2006), equations 2.25, 2.26.
    """

    def __init__(
        self, kernel: MaternKernel, points: FloatArray, values: FloatArray, inverse: FloatArray | None = None
    ) -> None:
        self._kernel, self.points, self._values = kernel, points, values
        slack = _VALUE_JITTER * kernel.signal**2
        self.inverse_factor = (
            _inverse_cholesky_factor(_covariance_with_noise(kernel, points), slack) if inverse is None else inverse
        )
        self.weights = self.inverse_factor.T @ (self.inverse_factor @ values)

    def with_more_values(self, points: FloatArray, values: FloatArray) -> ExactPosterior:
        """Return the posterior of the old and the new values; up to rounding, as if computed from all at once."""
        cross = self._kernel.covariance(points, self.points) @ self.inverse_factor.T
        corner = _inverse_cholesky_factor(
            _covariance_with_noise(self._kernel, points) - cross @ cross.T, _VALUE_JITTER * self._kernel.signal**2
        )
        inverse = np.zeros([len(self.points) + len(points)] * 2)
        inverse[: len(self.points), : len(self.points)] = self.inverse_factor
        inverse[len(self.points) :, : len(self.points)] = -corner @ (cross @ self.inverse_factor)
        inverse[len(self.points) :, len(self.points) :] = corner
        points, values = np.concatenate([self.points, points]), np.concatenate([self._values, values])
        return ExactPosterior(self._kernel, points, values, inverse)

    def leave_one_out(self) -> tuple[FloatArray, FloatArray]:
        """Predict each value from all other values; return means and standard deviations, (n,) each."""
        precision = (self.inverse_factor**2).sum(axis=0)
        return self._values - self.weights / precision, 1.0 / np.sqrt(precision)


class SparsePosterior:
    """Approximate posterior for many values, by inducing points.

    Inducing points are k of the n points, through which all values are taken into account. The variance at a point that
    the inducing points do not explain is treated as independent noise (FITC). Points with a higher `relevance` (n,),
    above 0, are more likely to become inducing points. If a posterior `base` is given, its inducing points are used
    again, and `points` and `values` are added to those of `base`. The number of inducing points, `n_inducing`, is a
    multiple of 32, by default 512.

    The attribute `points` (k, e) holds the inducing points; `weights` (k,) and `inverse_factor` (k, k) have the same
    meaning as in `ExactPosterior`. `all_points` (n, e) and `values` (n,) are all points and values.

    Source: E. Snelson, Z. Ghahramani, "Sparse Gaussian processes using pseudo-inputs", NIPS (2005). Inducing points are
    chosen as in Y. Chen, E. N. Epperly, J. A. Tropp, R. J. Webber, "Randomly pivoted Cholesky", Communications on Pure
    and Applied Mathematics 78 (2025).
    """

    def __init__(
        self,
        kernel: MaternKernel,
        points: FloatArray,
        values: FloatArray,
        relevance: FloatArray | None = None,
        base: SparsePosterior | None = None,
        n_inducing: int | None = None,
    ) -> None:
        self._kernel = kernel
        if base is None:
            self.points = points[_choose_inducing_points(kernel, points, relevance, n_inducing or MAX_EXACT_VALUES)]
            prior = kernel.covariance(self.points, self.points)
            self._whitening = _inverse_cholesky_factor(prior, _INDUCING_JITTER * kernel.signal**2)
            self._precision, self._moment = np.eye(len(prior)), np.zeros(len(prior))
        else:
            self.points, self._whitening = base.points, base._whitening
            self._precision, self._moment = base._precision, base._moment
        for block in _block_slices(len(points)):
            rows, deviation = self._project_on_inducing_points(points[block])
            rows /= deviation[:, None]
            # Only the lower half is used.
            self._precision = self._precision + gram_lower_half(rows.T)
            self._moment = self._moment + rows.T @ (values[block] / deviation)
        lower = cholesky(self._precision, lower=True)
        self._mean = cho_solve((lower, True), self._moment)
        self._inverse_precision_factor = np.asarray(dtrtri(lower, lower=1)[0])
        covariance = dpotri(lower, lower=1)[0]
        covariance += np.tril(covariance, -1).T
        self.all_points, self.values = points, values
        if base is not None:
            self.all_points = np.concatenate([base.all_points, points])
            self.values = np.concatenate([base.values, values])
        self.weights = self._whitening.T @ self._mean
        # Factor the explained variance, 1 - covariance, as transpose times factor.
        explained = np.ascontiguousarray((np.eye(len(lower)) - covariance)[::-1, ::-1])
        factor = cholesky_with_slack(explained, _SLACK)
        self.inverse_factor = multiply_lower_triangular(np.ascontiguousarray(factor[::-1, ::-1]).T, self._whitening)

    def with_more_values(self, points: FloatArray, values: FloatArray) -> SparsePosterior:
        """Return the posterior with additional values and the same inducing points."""
        return SparsePosterior(self._kernel, points, values, base=self)

    def leave_one_out(self) -> tuple[FloatArray, FloatArray]:
        """Predict each value from all other values; return means and standard deviations, (n,) each."""
        parts = [
            self._leave_one_out_block(self.all_points[block], self.values[block])
            for block in _block_slices(len(self.all_points))
        ]
        mean, deviation = map(np.concatenate, zip(*parts, strict=True))
        return mean, deviation

    def _leave_one_out_block(self, points: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Predict a block of known values, each from all other values; return means and standard deviations."""
        rows, root = self._project_on_inducing_points(points)
        projections = multiply_by_lower_transposed(rows, self._inverse_precision_factor)
        explained = np.einsum("ij,ij->i", projections, projections)
        precision = (1.0 - explained / root**2) / root**2
        error = (values - rows @ self._mean) / root**2 / precision
        return values - error, 1.0 / np.sqrt(precision)

    def _project_on_inducing_points(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return whitened covariances of points with the inducing points, and the unexplained standard deviations."""
        rows = multiply_by_lower_transposed(self._kernel.covariance(points, self.points), self._whitening)
        variance = self._kernel.signal**2
        unexplained = variance - np.einsum("ij,ij->i", rows, rows)
        return rows, np.sqrt(np.maximum(unexplained, _INDUCING_JITTER * variance) + self._kernel.noise**2)


AnyPosterior = ExactPosterior | SparsePosterior


def _block_slices(count: int) -> list[slice]:
    """Return slices of at most 8192 values each, which together cover `count` values."""
    return [slice(first, first + _BLOCK_SIZE) for first in range(0, count, _BLOCK_SIZE)] or [slice(0, 0)]


def cholesky_with_slack(covariance: FloatArray, slack: float) -> FloatArray:
    """Return the lower Cholesky factor of a covariance that may be indefinite because of rounding errors.

    `slack`, or more if needed, is added to the diagonal of `covariance` in place. Only the lower half is read.
    """
    diagonal = np.diag_indices(len(covariance))
    for _ in range(_TRIES):
        covariance[diagonal] += slack
        with contextlib.suppress(LinAlgError):
            return np.asarray(cholesky(covariance, lower=True, check_finite=False))
        # Values close to each other with little noise cause larger errors.
        slack *= 10.0
    return np.asarray(cholesky(covariance, lower=True))


def make_posterior(
    kernel: MaternKernel,
    points: FloatArray,
    values: FloatArray,
    relevance: FloatArray | None = None,
    max_points: int | None = None,
) -> AnyPosterior:
    """Return the posterior of a process: exact for few values, otherwise with inducing points.

    The posterior is exact for up to `max_points` values, by default 512. For more values, the posterior has
    `max_points` inducing points.
    """
    if len(points) <= (max_points or MAX_EXACT_VALUES):
        return ExactPosterior(kernel, points, values)
    return SparsePosterior(kernel, points, values, relevance, n_inducing=max_points)


def _choose_inducing_points(
    kernel: MaternKernel, points: FloatArray, relevance: FloatArray | None, count: int
) -> IntArray:
    """Choose inducing points by randomly pivoted Cholesky factorization, weighted by relevance."""
    candidates = evenly_spaced_indices(len(points), _N_CANDIDATES)
    rng = np.random.default_rng(0)
    weights = np.ones(len(candidates)) if relevance is None else relevance[candidates]
    residual, rows = np.ones(len(candidates)), np.zeros((len(candidates), count), order="F")
    pivots = np.zeros(0, dtype=np.int64)
    for done in range(0, count, _PIVOTS_PER_STEP):
        residual[pivots] = 0.0
        new = rng.choice(len(candidates), _PIVOTS_PER_STEP, replace=False, p=residual * weights / (residual @ weights))
        cross = kernel.covariance(points[candidates], points[candidates[new]]) / kernel.signal**2
        cross -= multiply_by_transposed(rows[:, :done], rows[new, :done])
        added = cross @ _inverse_cholesky_factor(cross[new], _INDUCING_JITTER).T
        rows[:, done : done + _PIVOTS_PER_STEP] = added
        residual = np.maximum(residual - (added**2).sum(axis=1), 1e-12)
        pivots = np.concatenate([pivots, new])
    return np.sort(candidates[pivots])


def _covariance_with_noise(kernel: MaternKernel, points: FloatArray) -> FloatArray:
    """Return the covariance of the values at points, including the noise of the values."""
    covariance = kernel.covariance(points, points)
    covariance[np.diag_indices(len(points))] += kernel.noise**2
    return covariance


def _inverse_cholesky_factor(covariance: FloatArray, slack: float) -> FloatArray:
    """Return the inverse of the lower Cholesky factor of a covariance."""
    return np.asarray(dtrtri(cholesky_with_slack(covariance, slack), lower=1)[0])
