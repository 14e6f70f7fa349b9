"""Features of recordings, foretold by Gaussian processes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.linalg import cholesky
from scipy.linalg.lapack import dpotri

from cornercase._common.threads import one_thread
from cornercase._common.typing import FloatArray
from cornercase.evidence.kernel import Kernel, learned_kernel

_MOST_NOISE: Final = 0.5
_LEAST: Final = 1e-9
"""Standard deviation up to which a feature is the same for all."""
# Of the variance, beside the noise, so that points that lie close to each other can be told apart.
_JITTER: Final = 1e-8


class Foretold:
    """A Gaussian process of each feature, with a Matérn kernel (5/2) of its own.

    Some features follow all parameters and jump, others hardly do: where the other is at some time depends on its own
    parameters alone. So each has its own widths and its own noise.

    Parameters
    ----------
    points : ndarray of float64, shape (n, e)
        As `encoded`.
    features : ndarray of float64, shape (n, f)
        Finite.
    kernels : sequence of Kernel or None, optional
        Of each feature, f of them, where they are known; None for a feature that is left out. By default they are
        learned.

    Attributes
    ----------
    kernels : list of Kernel or None
        Of each feature, scaled to a standard deviation of 1; None for one that is the same for all.
    left_out : ndarray of float64, shape (n, g)
        What each scenario's features are by the processes of all others, scaled; g <= f, since features that are the
        same for all are left out.

    Notes
    -----
    Source: C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning" (2006), equations 5.8, 5.9
    and 5.12.
    """

    def __init__(
        self, points: FloatArray, features: FloatArray, kernels: Sequence[Kernel | None] | None = None
    ) -> None:
        spread = features.std(axis=0)
        scaled = (features - features.mean(axis=0)) / np.maximum(spread, _LEAST)
        self._points = points
        # Sums in one order, whatever the number of threads.
        with one_thread():
            if kernels is None:
                varied = (spread > _LEAST).tolist()
                self.kernels = [
                    learned_kernel(points, scaled[:, j], _MOST_NOISE) if one else None for j, one in enumerate(varied)
                ]
            else:
                self.kernels = list(kernels)
            self._known = [j for j, kernel in enumerate(self.kernels) if kernel is not None]
            self._weights = np.empty((len(points), len(self._known)))
            self.left_out = np.empty_like(self._weights)
            for k, (kernel, values) in enumerate(self._each(scaled)):
                inverse = _inverse(kernel, points)
                self._weights[:, k] = inverse @ values
                self.left_out[:, k] = values - self._weights[:, k] / np.diag(inverse)

    def _each(self, scaled: FloatArray) -> list[tuple[Kernel, FloatArray]]:
        return [(kernel, scaled[:, j]) for j in self._known if (kernel := self.kernels[j]) is not None]

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
        weights = self._weights.astype(np.float32)
        found = np.empty((len(points), len(self._known)))
        with one_thread():
            for k, j in enumerate(self._known):
                if (kernel := self.kernels[j]) is not None:
                    found[:, k] = kernel.single_covariance(points, self._points) @ weights[:, k]
        return found


def _inverse(kernel: Kernel, points: FloatArray) -> FloatArray:
    """Inverse of the covariance of values at points, noise included."""
    covariance = kernel.covariance(points, points)
    covariance[np.diag_indices(len(points))] += kernel.noise**2 + _JITTER * kernel.signal**2
    lower = cholesky(covariance, lower=True, overwrite_a=True, check_finite=False)
    inverse: FloatArray = dpotri(lower, lower=1)[0]
    inverse += np.tril(inverse, -1).T
    return inverse
