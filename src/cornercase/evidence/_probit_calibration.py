"""Calibration of a surrogate model: convert its predictions to probabilities that scenarios are critical."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import log_ndtr, logsumexp, ndtr

from cornercase._common.typing import BoolArray, FloatArray, IntArray

# Points per axis of the grid of the posterior, and its half width in standard deviations of the prior.
_STEPS: Final = 49
_REACH: Final = 4.0
# With more predictions than this, each gets less weight: close to each other, predictions have correlated errors.
_FULL_WEIGHT_COUNT: Final = 160
# Greatest number of bins of the predictions of each class in the likelihood.
_MAX_BINS: Final = 128
SURPRISE_RATES: Final = 0.3 * 0.5 ** np.arange(9)
"""Possible rates above 0 of surprises (critical scenarios to which no prediction points), (9,)."""
# All possible rates of surprises, (10, 1).
_RATES: Final = np.append(0.0, SURPRISE_RATES)[:, None]


@dataclass(frozen=True)
class CalibrationPrior:
    """Prior of a calibration: means and standard deviations of a and log b, and the probability that r is above 0."""

    offset_mean: float = 0.0
    offset_deviation: float = 1.0
    log_slope_mean: float = 0.0
    log_slope_deviation: float = 1.0
    p_surprises: float = 0.5


class ProbitCalibration:
    """Probit calibration: the probability that a scenario is critical is ``p = r + (1 - r) Φ(-(a + b t))``.

    t is a statistic that is lower for scenarios that are more probably critical. Examples are the mean of a Gaussian
    process over its standard deviation, and the normal deviate of another classifier's output. r is the rate of
    surprises: critical scenarios to which no prediction points, for example beyond a jump of the score, or in a region
    thinner than the distance between scenarios. Without r, a few surprises among many right predictions would hardly
    count, because a normal distribution does not provide for them. The parameters a, b and r have a posterior. The
    `prior` is normal in a and log b, by default standard normal, so centred at the identity (a = 0, b = 1). The rate r
    is above 0 with the probability `prior.p_surprises`; its logarithm is then uniform between the logarithms of 0.0012
    and 0.3.

    `t` (n,) holds out-of-sample predictions, `critical` (n,) the outcomes. `prediction_weight` is the weight of one
    prediction in the likelihood; it is below 1 if errors of neighbours are correlated. With more than 160 predictions
    each gets less weight: the total weight grows with the square root of their number, and the posterior narrows with
    the fourth root.

    `chosen` holds predictions and outcomes of scenarios that a search chose by scores. They inform a and b, but do not
    show how rare surprises are, since a search looks for critical scenarios where predictions point to them. So the
    chosen scenarios have a rate of surprises of their own, with the same prior. The likelihood of their
    outcomes is averaged over this rate. Their predictions have the weight `chosen_weight`, as they lie near each other.

    Source: J. Platt, "Probabilistic outputs for support vector machines" (1999), here with the normal distribution
    function and the full posterior on a grid. The rate is the lapse rate of psychometric functions: F. A. Wichmann, N.
    J. Hill, "The psychometric function: I. Fitting, sampling, and goodness of fit", Perception & Psychophysics 63
    (2001).
    """

    def __init__(
        self,
        t: FloatArray,
        critical: BoolArray,
        prediction_weight: float = 1.0,
        prior: CalibrationPrior = CalibrationPrior(),
        chosen: tuple[FloatArray, BoolArray] | None = None,
        chosen_weight: float = 1.0,
    ) -> None:
        # Standard deviations from the prior means.
        u, v = (axis.ravel() for axis in np.meshgrid(*[np.linspace(-_REACH, _REACH, _STEPS)] * 2, indexing="ij"))
        a = prior.offset_mean + prior.offset_deviation * u
        slope, n_rates = np.exp(prior.log_slope_mean + prior.log_slope_deviation * v), len(SURPRISE_RATES)
        log_prior = np.log(np.append(1.0 - prior.p_surprises, np.full(n_rates, prior.p_surprises / n_rates)))[:, None]
        log_posterior = log_prior - 0.5 * (u**2 + v**2) + _log_likelihood(t, critical, a, slope, prediction_weight)
        if chosen is not None:
            by_rate = log_prior + _log_likelihood(*chosen, a, slope, chosen_weight)
            log_posterior = log_posterior + logsumexp(by_rate, axis=0)
        density = np.exp(log_posterior - log_posterior.max())
        self._a, self._b, self._rate = (np.broadcast_to(values, density.shape).ravel() for values in (a, slope, _RATES))
        self._posterior = (density / density.sum()).ravel()

    def draw_parameters(self, count: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Draw `count` values of each calibration parameter from the posterior, shape (count,) each.

        The parameters are the offset a, the slope b and the rate of surprises r. Sampling is stratified.
        """
        index = draw_stratified_indices(self._posterior, count, rng)
        return self._a[index], self._b[index], self._rate[index]

    def probability_of_critical(self, t: FloatArray) -> FloatArray:
        """Return the probability that scenarios with predictions `t` (n,) are critical, for the means of a, b and r."""
        a, b, rate = (float(self._posterior @ values) for values in (self._a, self._b, self._rate))
        return np.asarray(rate + (1.0 - rate) * ndtr(-(a + b * t)))


def draw_stratified_indices(probability: FloatArray, count: int, rng: np.random.Generator) -> IntArray:
    """Draw `count` indices with given probabilities (n,) by stratified sampling, in random order."""
    quantiles = (rng.permutation(count) + rng.random(count)) / count
    return np.minimum(np.searchsorted(np.cumsum(probability), quantiles), len(probability) - 1)


def _log_likelihood(
    t: FloatArray, critical: BoolArray, a: FloatArray, slope: FloatArray, prediction_weight: float
) -> FloatArray:
    """Return the log-likelihood of outcomes for each surprise rate and each pair of `a` and `slope`, (rates, pairs)."""
    weight = prediction_weight * min(1.0, (_FULL_WEIGHT_COUNT / max(len(t), 1)) ** 0.5)
    # Whatever the rate, the likelihood of outcomes that are not critical has the same factor.
    not_critical = np.zeros(len(a))
    for count, mean in _group_predictions(t[~critical]):
        not_critical += weight * count * log_ndtr(a + slope * mean)
    by_rate = np.log1p(-_RATES) * (weight * np.count_nonzero(~critical)) + not_critical
    for count, mean in _group_predictions(t[critical]):
        deviate = -(a + slope * mean)
        by_rate[0] += weight * count * log_ndtr(deviate)
        by_rate[1:] += weight * count * np.log(_RATES[1:] + (1.0 - _RATES[1:]) * ndtr(deviate))
    return np.asarray(by_rate)


def _group_predictions(predictions: FloatArray) -> list[tuple[int, float]]:
    """Group neighbouring predictions into at most 128 groups; return the size and the mean of each group."""
    groups = np.array_split(np.sort(predictions), min(_MAX_BINS, max(len(predictions), 1)))
    return [(len(group), float(group.mean())) for group in groups if len(group)]
