"""Probability distributions of OpenSCENARIO; their quantiles map the unit interval to parameter values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any, Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.text.parse_number import parse_number
from cornercase._common.typing import FloatArray

_MIN_PROBABILITY: Final = 1e-12
# Above this, doubles have no decimals left.
_MAX_VALUE: Final = 1e15
_MAX_POISSON_VALUES: Final = 100_000


@dataclass(frozen=True)
class Distribution:
    """A probability distribution, truncated to the interval from `low` to `high`.

    `shape_parameters` depend on `kind`: none for ``"uniform"``; mean and standard deviation for ``"normal"``; mean and
    standard deviation of the logarithm for ``"lognormal"``; the mean for ``"poisson"``; all edges followed by all
    weights for ``"histogram"``; the weights for ``"set"``. ``"poisson"`` and ``"set"`` are discrete; the values of a
    ``"set"`` are the indices of its choices.
    """

    kind: str
    low: float
    high: float
    shape_parameters: tuple[float, ...] = ()

    @property
    def is_discrete(self) -> bool:
        """True for a discrete distribution (``"poisson"`` or ``"set"``)."""
        return self.kind in ("poisson", "set")

    def quantiles(self, probabilities: FloatArray) -> FloatArray:
        """Return the quantile of each probability, shape (n,); only for continuous distributions."""
        if self.kind == "uniform":
            return self.low + probabilities * (self.high - self.low)
        if self.kind == "histogram":
            edges, weights = self._histogram_edges_and_weights()
            return np.asarray(np.interp(probabilities, _cumulative_fractions(weights), edges))
        x = np.asarray(_truncated_normal(*self._truncated_normal_arguments()).ppf(probabilities))
        return np.clip(np.exp(x) if self.kind == "lognormal" else x, self.low, self.high)

    def cdf(self, value: float) -> float:
        """Return the probability of values up to `value`; only for continuous distributions."""
        if self.kind == "uniform":
            return float(np.clip((value - self.low) / (self.high - self.low), 0.0, 1.0))
        if self.kind == "histogram":
            edges, weights = self._histogram_edges_and_weights()
            return float(np.interp(value, edges, _cumulative_fractions(weights)))
        if self.kind == "lognormal":
            value = float(_log_or_minus_infinity(value))
        return float(_truncated_normal(*self._truncated_normal_arguments()).cdf(value))

    def cumulative_probabilities(self) -> FloatArray:
        """Return 0, followed by the cumulative probabilities of the n values; only for discrete distributions."""
        if self.kind == "set":
            return _cumulative_fractions(np.array(self.shape_parameters))
        return _cumulative_fractions(_poisson_probabilities(self.low, self.high, self.shape_parameters[0]))

    def to_json(self) -> dict[str, Any]:
        """Return JSON values, the inverse of `distribution_from_json`."""
        return {"kind": self.kind, "low": self.low, "high": self.high, "numbers": list(self.shape_parameters)}

    def _truncated_normal_arguments(self) -> tuple[float, float, float, float]:
        mean, deviation = self.shape_parameters
        low, high = self.low, self.high
        if self.kind == "lognormal":
            low, high = float(_log_or_minus_infinity(low)), float(_log_or_minus_infinity(high))
        return (low - mean) / deviation, (high - mean) / deviation, mean, deviation

    def _histogram_edges_and_weights(self) -> tuple[FloatArray, FloatArray]:
        half = len(self.shape_parameters) // 2 + 1
        return np.array(self.shape_parameters[:half]), np.array(self.shape_parameters[half:])


@lru_cache(maxsize=256)
def _truncated_normal(low: float, high: float, mean: float, deviation: float) -> Any:
    # Imported here: it takes half a second, and few files need it.
    from scipy import stats

    return stats.truncnorm(low, high, loc=mean, scale=deviation)


def _poisson_probabilities(low: float, high: float, mean: float) -> FloatArray:
    """Return the probability of each integer from `low` to `high`, not scaled to a sum of 1."""
    from scipy.special import gammaln, xlogy

    counts = np.arange(low, high + 1.0)
    return np.asarray(np.exp(xlogy(counts, mean) - mean - gammaln(counts + 1.0)))


def _log_or_minus_infinity(value: float) -> float:
    return float(np.log(value)) if value > 0.0 else -np.inf


def _cumulative_fractions(weights: FloatArray) -> FloatArray:
    shares = np.concatenate([[0.0], np.cumsum(weights)])
    return np.asarray(shares / shares[-1], dtype=np.float64)


def distribution_from_json(data: Mapping[str, Any]) -> Distribution:
    """Restore a distribution from `Distribution.to_json`."""
    return Distribution(data["kind"], data["low"], data["high"], tuple(data["numbers"]))


def read_distribution(element: etree._Element, path: str) -> tuple[Distribution, tuple[str, ...]]:
    """Read a ``StochasticDistribution``; also return the choices of a probability set (empty for other kinds).

    The expected value and variance of a log-normal distribution are read as mean and variance of the logarithm, as in
    the C++ standard library. A normal, log-normal or Poisson distribution without bounds in the file is truncated at
    its 0.01 % and 99.99 % quantiles.
    """
    where = f"{path}, parameter {element.get('parameterName', '')}"
    law, choices = _read_unchecked_distribution(element, where)
    if not max(abs(law.low), abs(law.high)) <= _MAX_VALUE:
        raise InputError(
            f"{where}: the distribution reaches from {law.low:g} to {law.high:g};"
            f" values beyond ±{_MAX_VALUE:g} are refused."
        )
    if not law.is_discrete and not law.low < law.high:
        raise InputError(f"{where}: almost all values are {law.low:g}; increase the variance.")
    return law, choices


def _read_unchecked_distribution(element: etree._Element, location: str) -> tuple[Distribution, tuple[str, ...]]:
    inner = next(iter(element.iterchildren("*")), None)
    tag = "" if inner is None else str(inner.tag)
    if inner is None or tag not in _KIND_BY_TAG:
        raise InputError(f"{location}: the distribution <{tag}> is not read; use one of {', '.join(_KIND_BY_TAG)}.")
    if tag == "ProbabilityDistributionSet":
        return _read_probability_set(inner, location)
    if tag == "Histogram":
        return _read_histogram(inner, location), ()
    span = inner.find("Range")
    if tag == "UniformDistribution":
        low, high = _read_range_limits(span, location)
        return Distribution("uniform", low, high), ()
    if tag == "PoissonDistribution":
        return _read_poisson(inner, location), ()
    mean, variance = (
        _parse_finite_float(inner.get("expectedValue"), location),
        _parse_finite_float(inner.get("variance"), location),
    )
    if not variance > 0:
        raise InputError(f"{location}: the variance must be above 0.")
    kind, deviation = _KIND_BY_TAG[tag], float(np.sqrt(variance))
    if span is None:
        from scipy.special import ndtri

        low, high = (mean + deviation * float(ndtri(share)) for share in (1e-4, 1 - 1e-4))
        if kind == "lognormal":
            with np.errstate(over="ignore"):
                low, high = float(np.exp(low)), float(np.exp(high))
    else:
        low, high = _read_range_limits(span, location)
        if kind == "lognormal" and high <= 0:
            raise InputError(f"{location}: log-normal values are above 0, but the range ends at {high:g}.")
    return Distribution(kind, low, high, (mean, deviation)), ()


def _read_probability_set(element: etree._Element, location: str) -> tuple[Distribution, tuple[str, ...]]:
    weights: dict[str, float] = {}
    for item in element.iterfind("Element"):
        value = item.get("value", "")
        weights[value] = weights.get(value, 0.0) + _read_weight(item, location)
    total = sum(weights.values())
    weights = {value: weight for value, weight in weights.items() if weight > _MIN_PROBABILITY * total}
    if not weights:
        raise InputError(f"{location}: no element of the set has a weight above 0.")
    return Distribution("set", 0.0, len(weights) - 1.0, tuple(weights.values())), tuple(weights)


def _read_histogram(element: etree._Element, location: str) -> Distribution:
    bins = sorted(
        (*_read_range_limits(item.find("Range"), location), _read_weight(item, location))
        for item in element.iterfind("Bin")
    )
    if not bins or any(a[1] != b[0] for a, b in pairwise(bins)):
        raise InputError(f"{location}: the bins of the <Histogram> must follow each other without gaps.")
    if not any(weight for *_, weight in bins):
        raise InputError(f"{location}: no bin of the <Histogram> has a weight above 0.")
    edges = (bins[0][0], *(b[1] for b in bins))
    return Distribution("histogram", edges[0], edges[-1], (*edges, *(b[2] for b in bins)))


def _read_poisson(element: etree._Element, location: str) -> Distribution:
    mean, span = _parse_finite_float(element.get("expectedValue"), location), element.find("Range")
    if not mean > 0:
        raise InputError(f"{location}: the expected value of a Poisson distribution must be above 0.")
    if mean > _MAX_VALUE:
        raise InputError(f"{location}: the expected value is {mean:g}; it must be at most {_MAX_VALUE:g}.")
    if span is None:
        low, high = _default_poisson_bounds(mean)
    else:
        low, high = _read_range_limits(span, location)
    low, high = max(float(np.ceil(low)), 0.0), float(np.floor(high))
    if high - low >= _MAX_POISSON_VALUES or max(low, high) > _MAX_VALUE:
        raise InputError(
            f"{location}: a Poisson distribution may have {_MAX_POISSON_VALUES} values at most; narrow its range."
        )
    # Drop counts whose part of the unit interval would be too small.
    shares = _poisson_probabilities(low, high, mean)
    likely = np.flatnonzero(shares > _MIN_PROBABILITY * shares.sum())
    if likely.size == 0:
        raise InputError(f"{location}: the range has almost no probability; include the expected value {mean:g} in it.")
    return Distribution("poisson", low + float(likely[0]), low + float(likely[-1]), (mean,))


def _default_poisson_bounds(mean: float) -> tuple[float, float]:
    """Return the 0.01 % and 99.99 % quantiles of a Poisson distribution."""
    from scipy import stats

    return float(stats.poisson.ppf(1e-4, mean)), float(stats.poisson.ppf(1 - 1e-4, mean))


def _read_range_limits(element: etree._Element | None, location: str) -> tuple[float, float]:
    if element is None:
        raise InputError(f"{location}: the distribution has no <Range>.")
    low, high = (
        _parse_finite_float(element.get("lowerLimit"), location),
        _parse_finite_float(element.get("upperLimit"), location),
    )
    if not low < high:
        raise InputError(f"{location}: the range is {low:g} to {high:g}; the lower limit must be below the upper.")
    return low, high


def _read_weight(element: etree._Element, location: str) -> float:
    weight = _parse_finite_float(element.get("weight"), location)
    if weight < 0:
        raise InputError(f"{location}: the weight {weight:g} is negative.")
    if weight > _MAX_VALUE:
        raise InputError(f"{location}: the weight {weight:g} is above {_MAX_VALUE:g}; scale all weights down.")
    return weight


def _parse_finite_float(text: str | None, location: str) -> float:
    try:
        number = parse_number(text or "")
    except ValueError:
        number = float("nan")
    if not np.isfinite(number):
        raise InputError(f"{location}: '{text or ''}' is not a finite number.")
    return number


_KIND_BY_TAG: Final = {
    "UniformDistribution": "uniform",
    "NormalDistribution": "normal",
    "LogNormalDistribution": "lognormal",
    "PoissonDistribution": "poisson",
    "Histogram": "histogram",
    "ProbabilityDistributionSet": "set",
}
