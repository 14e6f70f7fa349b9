"""Gaussian process that is approximated by random features."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular

from cornercase._common.typing import FloatArray


class RandomFeatureProcess:
    """Gaussian process approximated by f random features: a linear model with a normal prior on the weights.

    `frequencies`, shape (f, d), `phases`, shape (f,), and `amplitude` define the features. `mean` is the prior mean,
    `noise` the standard deviation of the noise of single values. `gram`, shape (f, f), is the sum of the products of
    features over all known values. `moment`, shape (f,), is the sum of features times (value less mean).

    Source: A. Rahimi, B. Recht, "Random features for large-scale kernel machines", NIPS (2007).
    """

    def __init__(
        self,
        frequencies: FloatArray,
        phases: FloatArray,
        amplitude: float,
        mean: float,
        noise: float,
        gram: FloatArray | None = None,
        moment: FloatArray | None = None,
    ) -> None:
        self._map = frequencies, phases, amplitude
        self._mean, self._noise = mean, noise
        self._gram = np.zeros([len(phases)] * 2) if gram is None else gram
        self._moment = np.zeros(len(phases)) if moment is None else moment

    def random_features(self, points: FloatArray) -> FloatArray:
        """Return the features of points (n, d), shape (n, f).

        Cosines are computed in single precision, which takes a tenth of the time.
        """
        frequencies, phases, amplitude = self._map
        angles = (points @ frequencies.T + phases).astype(np.float32)
        return amplitude * np.cos(angles, out=angles).astype(np.float64)

    def with_more_values(self, points: FloatArray, values: FloatArray) -> RandomFeatureProcess:
        """Return the process conditioned on additional values, shape (n,), at points, shape (n, d)."""
        rows = self.random_features(points)
        gram, moment = self._gram + rows.T @ rows, self._moment + rows.T @ (values - self._mean)
        return RandomFeatureProcess(*self._map, self._mean, self._noise, gram, moment)

    def conditioned_on_own_mean(self, points: FloatArray) -> RandomFeatureProcess:
        """Return the process conditioned on its own mean at points, shape (n, d).

        The mean stays the same, and the variance shrinks.
        """
        rows = self.random_features(points)
        mean = cho_solve((self._precision_factor(), False), self._moment / self._noise**2)
        gram, moment = self._gram + rows.T @ rows, self._moment + rows.T @ (rows @ mean)
        return RandomFeatureProcess(*self._map, self._mean, self._noise, gram, moment)

    def draw_weights(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Draw `n` samples of the weights of the f features, shape (n, f)."""
        upper = self._precision_factor()
        mean = cho_solve((upper, False), self._moment / self._noise**2)
        return np.asarray(mean + solve_triangular(upper, rng.standard_normal((n, len(mean))).T).T)

    def _precision_factor(self) -> FloatArray:
        """Return the upper Cholesky factor of the precision matrix of the weights, shape (f, f)."""
        precision = self._gram / self._noise**2 + np.eye(len(self._moment))
        return np.asarray(cholesky(precision, overwrite_a=True, check_finite=False))
