"""Calibration: turn the predictions of a surrogate model into probabilities of being critical."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.special import log_ndtr, ndtr

from cornercase._common.typing import BoolArray, FloatArray

# Points per axis of the grid of the posterior, and its half width in standard deviations of the prior.
_STEPS: Final = 49
_REACH: Final = 4.0
# Number of predictions from which each gets less weight: they lie closer together, with correlated errors.
_FULL_WEIGHT_COUNT: Final = 160
# Greatest number of bins of the predictions of each class in the likelihood.
_MAX_BINS: Final = 128


class ProbitCalibration:
    """Probit calibration: the probability that a scenario is critical is ``p = Φ(-(a + b t))``, for a statistic t.

    t is any statistic that decreases with the probability of being critical. Examples are the mean of a Gaussian
    process over its standard deviation, and the normal deviate of another classifier's output. The parameters a and b
    have a posterior. Their prior is standard normal in a and log b, centred at the identity (a = 0, b = 1).

    `t` (n,) holds out-of-sample predictions, `critical` (n,) the outcomes. `prediction_weight` is the weight of one
    prediction in the likelihood; it is below 1 if errors of neighbours are correlated. With more than 160 predictions
    each gets less weight: the total weight grows with the square root of their number, and the posterior narrows with
    the fourth root.

    Source: J. Platt, "Probabilistic outputs for support vector machines" (1999), here with the normal distribution
    function and the full posterior on a grid.
    """

    def __init__(self, t: FloatArray, critical: BoolArray, prediction_weight: float = 1.0) -> None:
        a, log_b = (axis.ravel() for axis in np.meshgrid(*[np.linspace(-_REACH, _REACH, _STEPS)] * 2, indexing="ij"))
        log_posterior = -0.5 * (a**2 + log_b**2)
        slope, weight = np.exp(log_b), prediction_weight * min(1.0, (_FULL_WEIGHT_COUNT / max(len(t), 1)) ** 0.5)
        for sign, predictions in ((1.0, t[critical]), (-1.0, t[~critical])):
            for group in np.array_split(np.sort(predictions), min(_MAX_BINS, max(len(predictions), 1))):
                if len(group):
                    log_posterior += weight * len(group) * log_ndtr(-sign * (a + slope * group.mean()))
        density = np.exp(log_posterior - log_posterior.max())
        self._a, self._b, self._posterior = a, slope, density / density.sum()

    def draw_parameters(self, count: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Draw `count` values of a and of b from the posterior by stratified sampling, shape (count,) each."""
        # One draw in each of `count` strata of equal probability, in a random order.
        quantiles = (rng.permutation(count) + rng.random(count)) / count
        index = np.minimum(np.searchsorted(np.cumsum(self._posterior), quantiles), len(self._a) - 1)
        return self._a[index], self._b[index]

    def probability_of_critical(self, t: FloatArray) -> FloatArray:
        """Probability of being critical for statistics t, (n,), at the posterior mean of a and b."""
        return np.asarray(ndtr(-(self._posterior @ self._a + (self._posterior @ self._b) * t)))
