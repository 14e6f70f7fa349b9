"""Probability distributions of OpenSCENARIO, as maps between the unit interval and values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any, Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.numbers import number_of
from cornercase._common.typing import FloatArray

_LEAST_SHARE: Final = 1e-12
# Above this, doubles have no decimals left.
_LARGEST: Final = 1e15
_MOST_COUNTS: Final = 100_000


@dataclass(frozen=True)
class Distribution:
    """A probability distribution, truncated to an interval; ``"poisson"`` and ``"set"`` are discrete.

    `shape_parameters` are mean and standard deviation (normal; of the logarithm for lognormal), mean (poisson), all
    edges followed by all weights (histogram), or weights (set).
    """

    kind: str
    low: float
    high: float
    numbers: tuple[float, ...] = ()

    @property
    def discrete(self) -> bool:
        """Whether it is discrete."""
        return self.kind in ("poisson", "set")

    def quantiles(self, u: FloatArray) -> FloatArray:
        """Return the quantiles of probabilities, shape (n,); for continuous kinds."""
        if self.kind == "uniform":
            return self.low + u * (self.high - self.low)
        if self.kind == "histogram":
            edges, weights = self._bins()
            return np.asarray(np.interp(u, _cumulated(weights), edges))
        x = np.asarray(_cut_normal(*self._normal()).ppf(u))
        return np.clip(np.exp(x) if self.kind == "lognormal" else x, self.low, self.high)

    def place(self, value: float) -> float:
        """Return the cumulative probability of a value; for continuous kinds."""
        if self.kind == "uniform":
            return float(np.clip((value - self.low) / (self.high - self.low), 0.0, 1.0))
        if self.kind == "histogram":
            edges, weights = self._bins()
            return float(np.interp(value, edges, _cumulated(weights)))
        if self.kind == "lognormal":
            value = float(_logarithm(value))
        return float(_cut_normal(*self._normal()).cdf(value))

    def edges(self) -> FloatArray:
        """Return the cumulative probabilities of the values, starting with 0, shape (n + 1,); for discrete kinds."""
        if self.kind == "set":
            return _cumulated(np.array(self.numbers))
        return _cumulated(_poisson(self.low, self.high, self.numbers[0]))

    def to_json(self) -> dict[str, Any]:
        """Return JSON values, the inverse of `distribution_from_json`."""
        return {"kind": self.kind, "low": self.low, "high": self.high, "numbers": list(self.numbers)}

    def _normal(self) -> tuple[float, float, float, float]:
        mean, deviation = self.numbers
        low, high = self.low, self.high
        if self.kind == "lognormal":
            low, high = float(_logarithm(low)), float(_logarithm(high))
        return (low - mean) / deviation, (high - mean) / deviation, mean, deviation

    def _bins(self) -> tuple[FloatArray, FloatArray]:
        half = len(self.numbers) // 2 + 1
        return np.array(self.numbers[:half]), np.array(self.numbers[half:])


@lru_cache(maxsize=256)
def _cut_normal(low: float, high: float, mean: float, deviation: float) -> Any:
    # Imported here: it takes half a second, and few files need it.
    from scipy import stats

    return stats.truncnorm(low, high, loc=mean, scale=deviation)


def _poisson(low: float, high: float, mean: float) -> FloatArray:
    """Return the probability of each count from `low` to `high`."""
    from scipy.special import gammaln, xlogy

    counts = np.arange(low, high + 1.0)
    return np.asarray(np.exp(xlogy(counts, mean) - mean - gammaln(counts + 1.0)))


def _logarithm(value: float) -> float:
    return float(np.log(value)) if value > 0.0 else -np.inf


def _cumulated(weights: FloatArray) -> FloatArray:
    shares = np.concatenate([[0.0], np.cumsum(weights)])
    return np.asarray(shares / shares[-1], dtype=np.float64)


def from_json(plain: Mapping[str, Any]) -> Distribution:
    """Restore a distribution from `Distribution.to_json`."""
    return Distribution(plain["kind"], plain["low"], plain["high"], tuple(plain["numbers"]))


def read_distribution(element: etree._Element, path: str) -> tuple[Distribution, tuple[str, ...]]:
    """Read a ``StochasticDistribution``, and the values of a probability set.

    Expected value and variance of a log-normal distribution are those of the logarithm, as in the C++ standard library.
    Without bounds, 0.01 % are cut off on each side.
    """
    where = f"{path}, parameter {element.get('parameterName', '')}"
    law, choices = _read_law(element, where)
    if not max(abs(law.low), abs(law.high)) <= _LARGEST:
        raise InputError(
            f"{where}: the distribution reaches from {law.low:g} to {law.high:g}; the largest value is {_LARGEST:g}."
        )
    if not law.discrete and not law.low < law.high:
        raise InputError(f"{where}: almost all values are {law.low:g}; increase the variance.")
    return law, choices


def _read_law(element: etree._Element, where: str) -> tuple[Distribution, tuple[str, ...]]:
    inner = next(iter(element.iterchildren("*")), None)
    tag = "" if inner is None else str(inner.tag)
    if inner is None or tag not in _KINDS:
        raise InputError(f"{where}: the distribution <{tag}> is not read; use one of {', '.join(_KINDS)}.")
    if tag == "ProbabilityDistributionSet":
        return _read_set(inner, where)
    if tag == "Histogram":
        return _read_histogram(inner, where), ()
    span = inner.find("Range")
    if tag == "UniformDistribution":
        low, high = _bounds(span, where)
        return Distribution("uniform", low, high), ()
    if tag == "PoissonDistribution":
        return _read_poisson(inner, where), ()
    mean, variance = _number(inner.get("expectedValue"), where), _number(inner.get("variance"), where)
    if not variance > 0:
        raise InputError(f"{where}: the variance must be above 0.")
    kind, deviation = _KINDS[tag], float(np.sqrt(variance))
    if span is None:
        from scipy.special import ndtri

        low, high = (mean + deviation * float(ndtri(share)) for share in (1e-4, 1 - 1e-4))
        if kind == "lognormal":
            with np.errstate(over="ignore"):
                low, high = float(np.exp(low)), float(np.exp(high))
    else:
        low, high = _bounds(span, where)
        if kind == "lognormal" and high <= 0:
            raise InputError(f"{where}: a log-normal value is above 0, the range ends at {high:g}.")
    return Distribution(kind, low, high, (mean, deviation)), ()


def _read_set(element: etree._Element, where: str) -> tuple[Distribution, tuple[str, ...]]:
    weights: dict[str, float] = {}
    for item in element.iterfind("Element"):
        value = item.get("value", "")
        weights[value] = weights.get(value, 0.0) + _weight(item, where)
    total = sum(weights.values())
    weights = {value: weight for value, weight in weights.items() if weight > _LEAST_SHARE * total}
    if not weights:
        raise InputError(f"{where}: no element of the set has a weight above 0.")
    return Distribution("set", 0.0, len(weights) - 1.0, tuple(weights.values())), tuple(weights)


def _read_histogram(element: etree._Element, where: str) -> Distribution:
    bins = sorted((*_bounds(item.find("Range"), where), _weight(item, where)) for item in element.iterfind("Bin"))
    if not bins or any(a[1] != b[0] for a, b in pairwise(bins)):
        raise InputError(f"{where}: the bins of the <Histogram> must follow each other without gaps.")
    if not any(weight for *_, weight in bins):
        raise InputError(f"{where}: no bin of the <Histogram> has a weight above 0.")
    edges = (bins[0][0], *(b[1] for b in bins))
    return Distribution("histogram", edges[0], edges[-1], (*edges, *(b[2] for b in bins)))


def _read_poisson(element: etree._Element, where: str) -> Distribution:
    mean, span = _number(element.get("expectedValue"), where), element.find("Range")
    if not mean > 0:
        raise InputError(f"{where}: the expected value of a Poisson distribution must be above 0.")
    if mean > _LARGEST:
        raise InputError(f"{where}: the expected value is {mean:g}; the largest is {_LARGEST:g}.")
    if span is None:
        low, high = _poisson_bounds(mean)
    else:
        low, high = _bounds(span, where)
    low, high = max(float(np.ceil(low)), 0.0), float(np.floor(high))
    if high - low > _MOST_COUNTS or max(low, high) > _LARGEST:
        raise InputError(f"{where}: a Poisson distribution may have {_MOST_COUNTS} values at most; narrow its range.")
    # Drop counts whose part of the unit interval would be too small.
    shares = _poisson(low, high, mean)
    likely = np.flatnonzero(shares > _LEAST_SHARE * shares.sum())
    if likely.size == 0:
        raise InputError(f"{where}: the range has almost no probability; move it to {mean:g}.")
    return Distribution("poisson", low + float(likely[0]), low + float(likely[-1]), (mean,))


def _poisson_bounds(mean: float) -> tuple[float, float]:
    """Return the 0.01 % and 99.99 % quantiles."""
    from scipy import stats

    return float(stats.poisson.ppf(1e-4, mean)), float(stats.poisson.ppf(1 - 1e-4, mean))


def _bounds(element: etree._Element | None, where: str) -> tuple[float, float]:
    if element is None:
        raise InputError(f"{where}: the distribution has no <Range>.")
    low, high = _number(element.get("lowerLimit"), where), _number(element.get("upperLimit"), where)
    if not low < high:
        raise InputError(f"{where}: the range is {low:g} to {high:g}; the lower limit must be below the upper.")
    return low, high


def _weight(element: etree._Element, where: str) -> float:
    weight = _number(element.get("weight"), where)
    if weight < 0:
        raise InputError(f"{where}: the weight {weight:g} is negative.")
    if weight > _LARGEST:
        raise InputError(f"{where}: the weight {weight:g} is above {_LARGEST:g}; scale all weights down.")
    return weight


def _number(text: str | None, where: str) -> float:
    try:
        number = number_of(text or "")
    except ValueError:
        number = float("nan")
    if not np.isfinite(number):
        raise InputError(f"{where}: '{text or ''}' is not a finite number.")
    return number


_KINDS: Final = {
    "UniformDistribution": "uniform",
    "NormalDistribution": "normal",
    "LogNormalDistribution": "lognormal",
    "PoissonDistribution": "poisson",
    "Histogram": "histogram",
    "ProbabilityDistributionSet": "set",
}
