"""Probabilities of events, with confidence intervals."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.special import stdtrit

from cornercase._common.clopper_pearson import clopper_pearson_interval
from cornercase._common.typing import BoolArray, FloatArray

_LEVELS: Final = (0.95, 0.9)


@dataclass(frozen=True)
class Probability:
    """A probability of an event, with its confidence intervals.

    Attributes
    ----------
    value : float
    low, high : float
        Bounds of the 95 % interval.
    low_90, high_90 : float
        Bounds of the 90 % interval.
    method : str
        Description of the method.
    error : float or None
        Relative standard error; 0 if all scenarios of a finite space were run, None if only a part of them was run, or
        if the event occurred in none of the drawn scenarios.
    scenarios, met : int
        Number of scenarios, and number of scenarios in which the event occurred.
    effective : float
        Effective sample size of the scenarios in which the event occurred.
    largest : float
        Largest fraction of the estimate that a single scenario contributes.

    Examples
    --------
    >>> import cornercase as cc
    >>> critical = cc.estimate("study.db", "estimate.db", budget=1000).critical  # doctest: +SKIP
    >>> print(critical)  # doctest: +SKIP
    0.00512 (0.00257 to 0.0102)
    >>> critical.met, round(critical.equivalent_monte_carlo_scenarios)  # doctest: +SKIP
    (12, 2062)
    """

    value: float
    low: float
    high: float
    low_90: float
    high_90: float
    method: str
    error: float | None
    scenarios: int
    met: int
    effective: float
    largest: float

    def __str__(self) -> str:
        return f"{self.value:.3g} ({self.low:.3g} to {self.high:.3g})"

    @property
    def equivalent_monte_carlo_scenarios(self) -> float | None:
        """Number of scenarios that plain Monte Carlo would need for the same relative standard error."""
        if not self.error or not 0.0 < self.value <= 1.0:
            return None
        return (1.0 - self.value) / (self.value * self.error**2)

    def to_json(self) -> dict[str, Any]:
        """Convert to plain values, for JSON.

        Returns
        -------
        dict of str to object
        """
        return {
            "probability": self.value,
            "95 % interval": [self.low, self.high],
            "90 % interval": [self.low_90, self.high_90],
            "method": self.method,
            "relative standard error": self.error,
            "scenarios": self.scenarios,
            "met in": self.met,
            "effective number met": self.effective,
            "largest share of one scenario": self.largest,
            "plain Monte Carlo would need": self.equivalent_monte_carlo_scenarios,
        }


def probability_from_counts(met: int, scenarios: int) -> Probability:
    """Estimate the probability of an event by plain Monte Carlo, with the Clopper-Pearson interval.

    The event occurred in `met` of `scenarios` scenarios, which were drawn from the distribution of the parameters.
    """
    value = met / scenarios if scenarios else 0.0
    bounds = _bounds_of_both_levels(lambda tail: clopper_pearson_interval(met, scenarios, tail))
    # An event that always occurred may still fail once in `scenarios + 1`.
    error = math.sqrt(max(1.0 - value, 1.0 / (scenarios + 1)) / met) if met else None
    largest = 1.0 / met if met else 0.0
    return Probability(value, *bounds, "plain Monte Carlo, Clopper-Pearson", error, scenarios, met, float(met), largest)


def probability_from_weights(weights: FloatArray, met: BoolArray, common_error: float = 0.0) -> Probability:
    """Estimate the probability of an event by importance sampling, from scenarios of a proposal distribution.

    `weights` (n,) are the density of the parameters' distribution over the density of the proposal. `met` (n,) marks
    the scenarios in which the event occurred. `common_error` is the relative standard error that all weights have in
    common.

    The interval is computed for the logarithm, since the estimate is skewed: mostly slightly too low, rarely much too
    high. It uses quantiles of Student's t; the degrees of freedom are the effective number of occurrences minus 1, but
    at least 1.
    """
    parts = np.where(met, weights, 0.0)
    total, count = float(parts.sum()), len(parts)
    if total <= 0.0:
        return Probability(
            0.0, 0.0, 1.0, 0.0, 1.0, "importance sampling, log-normal", None, count, int(met.sum()), 0.0, 0.0
        )
    # Weights are 1 only on average, so the estimate of a nearly certain event may exceed 1.
    value = min(total / count, 1.0)
    spread = float(parts.std(ddof=1)) if count > 1 else value
    relative = float(np.hypot(spread / np.sqrt(count) / value, common_error))
    effective = total**2 / float((parts**2).sum())
    bounds = _log_normal_bounds(value, relative, effective)
    largest = float(parts.max()) / total
    return Probability(
        value, *bounds, "importance sampling, log-normal", relative, count, int(met.sum()), effective, largest
    )


def probability_from_enumeration(probabilities: FloatArray, met: BoolArray, total: float | None = None) -> Probability:
    """Compute the probability of an event from all scenarios of a finite space, or bounds from a part of them.

    `probabilities` (n,) belong to the scenarios that were run. `total` is the sum of the probabilities of all scenarios
    of the space; None if all were run. The bounds hold whatever the outcomes of the other scenarios are. The value is
    the middle between the bounds.
    """
    normalization = float(probabilities.sum()) if total is None else total
    weights = probabilities / normalization
    low = min(float(weights[met].sum()), 1.0)
    high = low if total is None else max(1.0 - float(weights[~met].sum()), low)
    effective = low**2 / float((weights[met] ** 2).sum()) if met.any() else 0.0
    largest = float(weights[met].max()) / low if met.any() else 0.0
    method = f"{'all' if total is None else f'only {len(probabilities)}'} scenarios of the space were run"
    error = 0.0 if total is None else None
    bounds = (low, high, low, high)
    return Probability(
        0.5 * (low + high), *bounds, method, error, len(probabilities), int(met.sum()), effective, largest
    )


def conditional_probability(both: Probability, condition: Probability) -> Probability | None:
    """Estimate a conditional probability: the probability of both events over the probability of the condition.

    The two probabilities come from different scenarios. The interval is computed for the logarithm. None if either
    probability has no standard error, for example because the event did not occur, or if the condition is impossible.
    """
    if both.error is None or condition.error is None or condition.value == 0.0:
        return None
    value, error = min(both.value / condition.value, 1.0), float(np.hypot(both.error, condition.error))
    bounds = _log_normal_bounds(value, error, min(both.effective, condition.effective))
    return Probability(
        value, *bounds, f"quotient; {both.method}", error, both.scenarios, both.met, both.effective, both.largest
    )


Bounds = tuple[float, float, float, float]


def _bounds_of_both_levels(interval: Callable[[float], tuple[float, float]]) -> Bounds:
    """Return the bounds of the 95 % and 90 % intervals; `interval` computes two bounds for a tail probability."""
    wide, narrow = (0.5 * (1.0 - level) for level in _LEVELS)
    return *interval(wide), *interval(narrow)


def _log_normal_bounds(value: float, error: float, effective: float) -> Bounds:
    """Return the bounds of the 95 % and 90 % intervals around `value`, computed for the logarithm.

    `error` is the standard error of the logarithm, `effective` the effective sample size.
    """

    def interval_for_tail(tail: float) -> tuple[float, float]:
        # Limited, so that the exponential does not overflow.
        reach = min(float(stdtrit(max(effective - 1.0, 1.0), 1.0 - tail)) * error, 700.0)
        return value * math.exp(-reach), min(value * math.exp(reach), 1.0)

    return _bounds_of_both_levels(interval_for_tail)
