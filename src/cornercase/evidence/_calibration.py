"""Calibration: turn the predictions of a surrogate model into probabilities of being critical."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.special import log_ndtr, logsumexp, ndtr

from cornercase._common.typing import BoolArray, FloatArray

# Points per axis of the grid of the posterior, and its half width in standard deviations of the prior.
_STEPS: Final = 49
_REACH: Final = 4.0
# Number of predictions from which each gets less weight: they lie closer together, with correlated errors.
_FULL_WEIGHT_COUNT: Final = 160
# Greatest number of bins of the predictions of each class in the likelihood.
_MAX_BINS: Final = 128
SURPRISE_RATES: Final = 0.3 * 0.5 ** np.arange(9)
"""Rates of surprises that are possible besides 0, (9,)."""


class ProbitCalibration:
    """Probit calibration: the probability that a scenario is critical is ``p = r + (1 - r) Φ(-(a + b t))``.

    t is any statistic that decreases with the probability of being critical. Examples are the mean of a Gaussian
    process over its standard deviation, and the normal deviate of another classifier's output. r is the rate of
    surprises: critical scenarios where nothing points to them, as beyond a jump of the score, or in a region thinner
    than the distance of scenarios. Without it, few surprises among many right predictions would hardly count, because a
    normal distribution has no place for them. The parameters a, b and r have a posterior. Their prior is standard
    normal in a and log b, centred at the identity (a = 0, b = 1). The rate is above 0 with the prior probability
    `p_surprises`; its logarithm is then uniform between those of 0.0012 and 0.3.

    `t` (n,) holds out-of-sample predictions, `critical` (n,) the outcomes. `prediction_weight` is the weight of one
    prediction in the likelihood; it is below 1 if errors of neighbours are correlated. With more than 160 predictions
    each gets less weight: the total weight grows with the square root of their number, and the posterior narrows with
    the fourth root.

    `chosen` are predictions and outcomes of scenarios that were chosen by scores. They inform a and b. Since a search
    looks for critical scenarios where something points to them, they do not show how rare surprises are: surprises
    among them have a rate of their own, with the same prior, over which their likelihood is averaged.

    Source: J. Platt, "Probabilistic outputs for support vector machines" (1999), here with the normal distribution
    function and the full posterior on a grid. The rate is the lapse rate of psychometric functions: F. A. Wichmann,
    N. J. Hill, "The psychometric function: I. Fitting, sampling, and goodness of fit", Perception & Psychophysics 63
    (2001).
    """

    def __init__(
        self,
        t: FloatArray,
        critical: BoolArray,
        prediction_weight: float = 1.0,
        p_surprises: float = 0.5,
        chosen: tuple[FloatArray, BoolArray] | None = None,
    ) -> None:
        a, log_b = (axis.ravel() for axis in np.meshgrid(*[np.linspace(-_REACH, _REACH, _STEPS)] * 2, indexing="ij"))
        slope, rates = np.exp(log_b), np.append(0.0, SURPRISE_RATES)[:, None]
        n_rates = len(SURPRISE_RATES)
        log_prior = np.log(np.append(1.0 - p_surprises, np.full(n_rates, p_surprises / n_rates)))[:, None]

        def log_likelihood(t: FloatArray, critical: BoolArray) -> FloatArray:
            """Log-likelihood of a record for each rate, and each pair of a and b, (rates, pairs)."""
            weight = prediction_weight * min(1.0, (_FULL_WEIGHT_COUNT / max(len(t), 1)) ** 0.5)
            # Whatever the rate, the likelihood of outcomes that are not critical has the same factor.
            common = np.zeros(len(a))
            for count, mean in _group_predictions(t[~critical]):
                common += weight * count * log_ndtr(a + slope * mean)
            log_likelihood = np.log1p(-rates) * (weight * np.count_nonzero(~critical)) + common
            for count, mean in _group_predictions(t[critical]):
                deviate = -(a + slope * mean)
                log_likelihood[0] += weight * count * log_ndtr(deviate)
                log_likelihood[1:] += weight * count * np.log(rates[1:] + (1.0 - rates[1:]) * ndtr(deviate))
            return np.asarray(log_likelihood)

        log_posterior = log_prior - 0.5 * (a**2 + log_b**2) + log_likelihood(t, critical)
        if chosen is not None:
            log_posterior = log_posterior + logsumexp(log_prior + log_likelihood(*chosen), axis=0)
        density = np.exp(log_posterior - log_posterior.max())
        self._a, self._b, self._rate = (np.broadcast_to(values, density.shape).ravel() for values in (a, slope, rates))
        self._posterior = (density / density.sum()).ravel()

    def draw_parameters(self, count: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Draw `count` values of a, b and r from the posterior by stratified sampling, shape (count,) each."""
        # One draw in each of `count` strata of equal probability, in a random order.
        quantiles = (rng.permutation(count) + rng.random(count)) / count
        index = np.minimum(np.searchsorted(np.cumsum(self._posterior), quantiles), len(self._a) - 1)
        return self._a[index], self._b[index], self._rate[index]

    def probability_of_critical(self, t: FloatArray) -> FloatArray:
        """Probability of being critical for statistics t, (n,), at the posterior means of a, b and r."""
        a, b, rate = (float(self._posterior @ values) for values in (self._a, self._b, self._rate))
        return np.asarray(rate + (1.0 - rate) * ndtr(-(a + b * t)))


def _group_predictions(predictions: FloatArray) -> list[tuple[int, float]]:
    """Group neighbouring predictions; return the number and the mean of each of at most 128 groups."""
    groups = np.array_split(np.sort(predictions), min(_MAX_BINS, max(len(predictions), 1)))
    return [(len(group), float(group.mean())) for group in groups if len(group)]
