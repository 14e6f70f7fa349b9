"""Features of recordings, foretold by Gaussian processes that share one kernel."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.linalg import LinAlgError, cholesky
from scipy.linalg.lapack import dpotri
from scipy.optimize import minimize

from cornercase._common.threads import one_thread
from cornercase._common.typing import FloatArray
from cornercase.evidence.kernel import Kernel, evenly

_ROOT5: Final = float(np.sqrt(5.0))
_LEARNED: Final = 200
# Wider or less noisy ones are chosen where two features say nearly the same, and then follow no other one.
_WIDTHS, _NOISE = (2e-2, 3.0), (3e-2, 0.7)
_BEGIN_WIDTH, _BEGIN_NOISE = 0.4, 0.1
# Of the prior on the logarithms of the widths: its middle, and its weight per feature.
_WIDTH, _WEIGHT = 0.5, 0.3
_LEAST: Final = 1e-9
"""Standard deviation up to which a feature is the same for all."""


class Foretold:
    """Gaussian processes of several features with one kernel, a Matérn kernel (5/2) with a width for each dimension.

    Features of a recording follow the parameters in like ways, so that all of them together tell the widths better
    than each by itself.

    Parameters
    ----------
    points : ndarray of float64, shape (n, e)
        As `encoded`.
    features : ndarray of float64, shape (n, f)
        Finite.
    kernel : Kernel, optional
        Where it is known; by default it is learned.
    start : Kernel, optional
        Where to begin to look for it.

    Attributes
    ----------
    kernel : Kernel
        Of features scaled to a standard deviation of 1.
    left_out : ndarray of float64, shape (n, g)
        What each scenario's features are by the processes of all others, scaled; g <= f, since features that are the
        same for all are left out.

    Notes
    -----
    Source: C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning" (2006), equations 5.8, 5.9
    and 5.12; the sizes of the processes are at their best values for the widths.
    """

    def __init__(
        self, points: FloatArray, features: FloatArray, kernel: Kernel | None = None, start: Kernel | None = None
    ) -> None:
        spread = features.std(axis=0)
        varied = spread > _LEAST
        scaled = (features[:, varied] - features[:, varied].mean(axis=0)) / spread[varied]
        self._points = points
        # Sums in one order, whatever the number of threads.
        with one_thread():
            self.kernel = _learned(points, scaled, start) if kernel is None else kernel
            covariance = self.kernel.covariance(points, points)
            covariance[np.diag_indices(len(points))] += self.kernel.noise**2
            inverse = _inverse(cholesky(covariance, lower=True, overwrite_a=True, check_finite=False))
            self._weights = inverse @ scaled
        self.left_out = scaled - self._weights / np.diag(inverse)[:, None]

    def predict(self, points: FloatArray) -> FloatArray:
        """Foretell the features at points.

        Parameters
        ----------
        points : ndarray of float64, shape (m, e)

        Returns
        -------
        ndarray of float64, shape (m, g)
            Scaled as `left_out`.
        """
        with one_thread():
            return np.asarray(self.kernel.single_covariance(points, self._points) @ self._weights.astype(np.float32))


def _learned(points: FloatArray, values: FloatArray, start: Kernel | None) -> Kernel:
    """Kernel of the greatest marginal likelihood of all features times a wide prior on the widths."""
    dims = points.shape[1]
    if not values.shape[1]:
        return Kernel(np.full(dims, _BEGIN_WIDTH), 1.0, _BEGIN_NOISE)
    some = evenly(len(points), _LEARNED)
    squares = ((points.T[:, some, None] - points.T[:, None, some]) ** 2).reshape(dims, -1)
    bounds = np.log([*[_WIDTHS] * dims, _NOISE])
    begin = np.append(np.full(dims, _BEGIN_WIDTH), _BEGIN_NOISE)
    if start is not None:
        begin = np.append(start.widths, start.noise)
    found = minimize(
        _loss, np.clip(np.log(begin), *bounds.T), (squares, values[some] - values[some].mean(axis=0)), jac=True,
        method="L-BFGS-B", bounds=[(low, high) for low, high in bounds.tolist()], options={"maxiter": 40},
    )  # fmt: skip
    *widths, noise = np.exp(found.x).tolist()
    return Kernel(np.array(widths), 1.0, noise)


def _loss(parameters: FloatArray, squares: FloatArray, values: FloatArray) -> tuple[float, FloatArray]:
    """Negative logarithm of the marginal likelihood and the prior, and its gradient; squares of shape (e, n n)."""
    *logs, log_noise = parameters
    count, several = values.shape
    narrow, noise2 = np.exp(-2.0 * np.array(logs)), np.exp(2.0 * log_noise)
    scaled = _ROOT5 * np.sqrt(narrow @ squares)
    fall = np.exp(-scaled)
    slope = (1.0 + scaled) * fall
    covariance = (slope + scaled * scaled * fall / 3.0).reshape(count, count)
    covariance[np.diag_indices(count)] += noise2
    try:
        lower = cholesky(covariance, lower=True, overwrite_a=True, check_finite=False)
    except LinAlgError:
        return 1e25, np.zeros_like(parameters)
    # Of a copy: NumPy's logarithm of a strided array depends, in its last digit, on where its result lies in memory.
    determinant = np.log(np.diag(lower).copy()).sum()
    inverse = _inverse(lower)
    weights = inverse @ values
    sizes = np.maximum((values * weights).sum(axis=0) / count, 1e-12)
    outer = several * inverse - (weights / sizes) @ weights.T
    gradient = np.empty_like(parameters)
    gradient[:-1] = squares @ (outer.ravel() * slope) * narrow * (5.0 / 6.0)
    gradient[-1] = noise2 * np.trace(outer)
    away = np.array(logs) - np.log(_WIDTH)
    gradient[:-1] += several * _WEIGHT * away
    likelihood = -0.5 * count * np.log(sizes).sum() - several * determinant
    return float(0.5 * several * _WEIGHT * (away @ away) - likelihood), gradient


def _inverse(lower: FloatArray) -> FloatArray:
    inverse: FloatArray = dpotri(lower, lower=1)[0]
    inverse += np.tril(inverse, -1).T
    return inverse
