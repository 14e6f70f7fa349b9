"""Probabilities of events, with confidence intervals."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.special import stdtrit

from cornercase._common.shares import clopper_pearson
from cornercase._common.typing import BoolArray, FloatArray

_LEVELS: Final = (0.95, 0.9)


@dataclass(frozen=True)
class Probability:
    """A probability with its confidence intervals.

    Attributes
    ----------
    value : float
    low, high : float
        Bounds of the 95 % interval.
    low_90, high_90 : float
        Bounds of the 90 % interval.
    method : str
        How it was found, in words.
    error : float or None
        Relative standard error; None where the event was not met, or where of a finite space not all was run yet.
    scenarios, met : int
        Scenarios that it was found from, and those of them in which the event happened.
    effective : float
        Effective number of the scenarios in which the event happened: so many of equal weight say as much.
    largest : float
        Largest share of the estimate that one scenario has.
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
    def plain_scenarios(self) -> float | None:
        """Number of scenarios from which plain Monte Carlo would have the same relative standard error."""
        if not self.error or not 0.0 < self.value <= 1.0:
            return None
        return (1.0 - self.value) / (self.value * self.error**2)

    def to_json(self) -> dict[str, Any]:
        """Return plain values.

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
            "plain Monte Carlo would need": self.plain_scenarios,
        }


def of_counts(met: int, scenarios: int) -> Probability:
    """Probability from scenarios that were drawn by the law itself, with the interval of Clopper and Pearson.

    Parameters
    ----------
    met, scenarios : int
        In how many of how many the event happened.

    Returns
    -------
    Probability
    """
    value = met / scenarios if scenarios else 0.0
    bounds = _bounds(lambda tail: clopper_pearson(met, scenarios, tail))
    # What was always met may still fail once in as many and one more.
    error = math.sqrt(max(1.0 - value, 1.0 / (scenarios + 1)) / met) if met else None
    largest = 1.0 / met if met else 0.0
    return Probability(value, *bounds, "plain Monte Carlo, Clopper-Pearson", error, scenarios, met, float(met), largest)


def of_weights(weights: FloatArray, met: BoolArray, error: float = 0.0) -> Probability:
    """Probability from independent scenarios of a proposal, with an interval of its logarithm.

    Parameters
    ----------
    weights : ndarray of float64, shape (n,)
        Density of the law over that of the proposal.
    met : ndarray of bool, shape (n,)
    error : float, default 0.0
        Relative standard error that all weights have together.

    Returns
    -------
    Probability

    Notes
    -----
    The standard error of the mean is taken to the logarithm, since the estimate is skewed: most often it is too low,
    and now and then much too high. The quantiles are those of Student's t with as many degrees of freedom as the event
    was met effectively, less one.
    """
    parts = np.where(met, weights, 0.0)
    total, count = float(parts.sum()), len(parts)
    if total <= 0.0:
        return of_counts(0, 0)
    # Weights are 1 in the mean only: what nearly always happens may come out as more than certain.
    value = min(total / count, 1.0)
    spread = float(parts.std(ddof=1)) if count > 1 else value
    relative = float(np.hypot(spread / np.sqrt(count) / value, error))
    effective = total**2 / float((parts**2).sum())
    bounds = _of_logarithm(value, relative, effective)
    largest = float(parts.max()) / total
    return Probability(
        value, *bounds, "importance sampling, log-normal", relative, count, int(met.sum()), effective, largest
    )


def of_all(shares: FloatArray, met: BoolArray, total: float | None = None) -> Probability:
    """Probability from all scenarios of a finite space, which has no error; from some of them, bounds of it.

    Parameters
    ----------
    shares : ndarray of float64, shape (n,)
        Probability of each scenario that was run; those of all need not sum to 1.
    met : ndarray of bool, shape (n,)
    total : float, optional
        What the probabilities of all scenarios sum to; by default all were run.

    Returns
    -------
    Probability
        Its bounds hold whatever the scenarios are that were not run; the value is in the middle.
    """
    whole = float(shares.sum()) if total is None else total
    weights = shares / whole
    least = min(float(weights[met].sum()), 1.0)
    most = least if total is None else max(1.0 - float(weights[~met].sum()), least)
    effective = least**2 / float((weights[met] ** 2).sum()) if met.any() else 0.0
    largest = float(weights[met].max()) / least if met.any() else 0.0
    method = f"{'all' if total is None else f'only {len(shares)}'} scenarios of the space were run"
    error = 0.0 if total is None else None
    bounds = (least, most, least, most)
    return Probability(0.5 * (least + most), *bounds, method, error, len(shares), int(met.sum()), effective, largest)


def quotient(both: Probability, given: Probability) -> Probability | None:
    """Probability of an event given another, from that of both together and that of the other.

    Parameters
    ----------
    both, given : Probability
        Found from different scenarios.

    Returns
    -------
    Probability or None
        With an interval of its logarithm; None where one of them was not met.
    """
    if both.error is None or given.error is None:
        return None
    value, error = min(both.value / given.value, 1.0), float(np.hypot(both.error, given.error))
    bounds = _of_logarithm(value, error, min(both.effective, given.effective))
    return Probability(
        value, *bounds, f"quotient; {both.method}", error, both.scenarios, both.met, both.effective, both.largest
    )


Bounds = tuple[float, float, float, float]


def _bounds(interval: Callable[[float], tuple[float, float]]) -> Bounds:
    """Bounds of the intervals of both levels, each a function of the probability that it leaves out on each side."""
    wide, narrow = (0.5 * (1.0 - level) for level in _LEVELS)
    return *interval(wide), *interval(narrow)


def _of_logarithm(value: float, error: float, effective: float) -> Bounds:
    """Bounds of the intervals from the standard error of the logarithm."""

    def interval(tail: float) -> tuple[float, float]:
        # Beyond, nothing is left of a probability.
        reach = min(float(stdtrit(max(effective - 1.0, 1.0), 1.0 - tail)) * error, 700.0)
        return value * math.exp(-reach), min(value * math.exp(reach), 1.0)

    return _bounds(interval)
