"""A Gaussian process in terms of random features."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular

from cornercase._common.typing import FloatArray


class FeatureProcess:
    """Gaussian process in terms of random features: a linear model of them, whose weights have a normal prior.

    Parameters
    ----------
    frequencies : ndarray of float64, shape (f, d)
    phases : ndarray of float64, shape (f,)
    amplitude : float
    mean : float
        Of the process where nothing is known.
    noise : float
        Standard deviation of single values.
    gram : ndarray of float64, shape (f, f), optional
    moment : ndarray of float64, shape (f,), optional
        Sums over the values that are known: of the products of the features, and of the features times the value above
        the mean.

    Notes
    -----
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

    def features(self, points: FloatArray) -> FloatArray:
        """Compute the features of points, shape (n, f); in single precision, in which a cosine takes a tenth."""
        frequencies, phases, amplitude = self._map
        angles = (points @ frequencies.T + phases).astype(np.float32)
        return amplitude * np.cos(angles, out=angles).astype(np.float64)

    def extended(self, points: FloatArray, values: FloatArray) -> FeatureProcess:
        """Take further values, shape (n,), at points, shape (n, d), in."""
        rows = self.features(points)
        gram, moment = self._gram + rows.T @ rows, self._moment + rows.T @ (values - self._mean)
        return FeatureProcess(*self._map, self._mean, self._noise, gram, moment)

    def expecting(self, points: FloatArray) -> FeatureProcess:
        """Take its own mean in as the values at points, shape (n, d): the mean stays, what is not sure shrinks."""
        rows = self.features(points)
        mean = cho_solve((self._precision(), False), self._moment / self._noise**2)
        gram, moment = self._gram + rows.T @ rows, self._moment + rows.T @ (rows @ mean)
        return FeatureProcess(*self._map, self._mean, self._noise, gram, moment)

    def samples(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Draw `n` samples of the weights of the features, shape (n, f)."""
        upper = self._precision()
        mean = cho_solve((upper, False), self._moment / self._noise**2)
        return np.asarray(mean + solve_triangular(upper, rng.standard_normal((n, len(mean))).T).T)

    def _precision(self) -> FloatArray:
        """Upper triangle whose square is the precision of the weights, shape (f, f)."""
        precision = self._gram / self._noise**2 + np.eye(len(self._moment))
        return np.asarray(cholesky(precision, overwrite_a=True, check_finite=False))
