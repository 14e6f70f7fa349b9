"""Stochastic distributions of OpenSCENARIO, as maps between the unit interval and values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from lxml import etree
from scipy import stats

from cornercase.errors import InputError


@dataclass(frozen=True)
class Distribution:
    """A distribution cut off at bounds.

    Attributes
    ----------
    kind : str
        ``"uniform"``, ``"normal"``, ``"lognormal"``, ``"poisson"`` or ``"histogram"``.
    low, high : float
        Bounds.
    numbers : tuple of float
        Mean and standard deviation; the mean; or edges and then weights.
    """

    kind: str
    low: float
    high: float
    numbers: tuple[float, ...] = ()

    def quantile(self, u: float) -> float:
        """Value below which the share `u` of the cut-off distribution lies."""
        if self.kind == "uniform":
            return self.low + u * (self.high - self.low)
        if self.kind == "histogram":
            edges, weights = self._bins()
            shares = np.concatenate([[0.0], np.cumsum(weights) / weights.sum()])
            return float(np.interp(u, shares, edges))
        law = self._law()
        below = law.cdf(self.low - 1) if self.kind == "poisson" else law.cdf(self.low)
        return float(np.clip(law.ppf(below + u * (law.cdf(self.high) - below)), self.low, self.high))

    def place(self, value: float) -> float:
        """Share of the cut-off distribution that lies below `value`."""
        if self.kind == "uniform":
            return float(np.clip((value - self.low) / (self.high - self.low), 0.0, 1.0))
        if self.kind == "histogram":
            edges, weights = self._bins()
            shares = np.concatenate([[0.0], np.cumsum(weights) / weights.sum()])
            return float(np.interp(value, edges, shares))
        law = self._law()
        below = law.cdf(self.low - 1) if self.kind == "poisson" else law.cdf(self.low)
        at = 0.5 * (law.cdf(value - 1) + law.cdf(value)) if self.kind == "poisson" else law.cdf(value)
        return float(np.clip((at - below) / (law.cdf(self.high) - below), 0.0, 1.0))

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {"kind": self.kind, "low": self.low, "high": self.high, "numbers": list(self.numbers)}

    def _law(self) -> Any:
        if self.kind == "normal":
            return stats.norm(self.numbers[0], self.numbers[1])
        if self.kind == "lognormal":
            return stats.lognorm(s=self.numbers[1], scale=np.exp(self.numbers[0]))
        return stats.poisson(self.numbers[0])

    def _bins(self) -> tuple[Any, Any]:
        half = len(self.numbers) // 2 + 1
        return np.array(self.numbers[:half]), np.array(self.numbers[half:])


def from_json(plain: Mapping[str, Any]) -> Distribution:
    """Distribution from `Distribution.to_json`."""
    return Distribution(plain["kind"], plain["low"], plain["high"], tuple(plain["numbers"]))


def read_distribution(element: etree._Element, path: str) -> tuple[Distribution | None, tuple[str, ...]]:
    """Read a ``StochasticDistribution``: a distribution, or the values of a probability set.

    Raises
    ------
    InputError
        It is user-defined, or its numbers cannot be used.
    """
    where = f"{path}, parameter {element.get('parameterName', '')}"
    inner = next(iter(element.iterchildren("*")), None)
    tag = "" if inner is None else inner.tag
    if inner is None or tag not in _KINDS:
        raise InputError(f"{where}: the distribution <{tag}> is not read; use one of {', '.join(_KINDS)}.")
    if tag == "ProbabilityDistributionSet":
        return None, tuple(e.get("value", "") for e in inner.iterfind("Element"))
    if tag == "Histogram":
        bins = sorted(
            (*_bounds(e.find("Range"), where), _number(e.get("weight"), where)) for e in inner.iterfind("Bin")
        )
        if not bins or any(a[1] != b[0] for a, b in pairwise(bins)):
            raise InputError(f"{where}: the bins of the <Histogram> must follow each other without gaps.")
        edges = (bins[0][0], *(b[1] for b in bins))
        return Distribution("histogram", edges[0], edges[-1], (*edges, *(b[2] for b in bins))), ()
    span = inner.find("Range")
    if tag == "UniformDistribution":
        low, high = _bounds(span, where)
        return Distribution("uniform", low, high), ()
    if tag == "PoissonDistribution":
        mean = _number(inner.get("expectedValue"), where)
        low, high = (0.0, mean + 10.0 * np.sqrt(mean) + 1.0) if span is None else _bounds(span, where)
        return Distribution("poisson", low, high, (mean,)), ()
    mean, deviation = (
        _number(inner.get("expectedValue"), where),
        np.sqrt(_number(inner.get("variance"), where)),
    )
    kind = _KINDS[tag]
    if not deviation > 0:
        raise InputError(f"{where}: the variance must be above 0.")
    if span is not None:
        low, high = _bounds(span, where)
        return Distribution(kind, low, high, (mean, float(deviation))), ()
    law = Distribution(kind, -np.inf, np.inf, (mean, float(deviation)))._law()
    return Distribution(kind, float(law.ppf(1e-4)), float(law.ppf(1 - 1e-4)), (mean, float(deviation))), ()


def _bounds(element: etree._Element | None, where: str) -> tuple[float, float]:
    if element is None:
        raise InputError(f"{where}: the distribution has no <Range>.")
    low, high = _number(element.get("lowerLimit"), where), _number(element.get("upperLimit"), where)
    if not low < high:
        raise InputError(f"{where}: the range is {low:g} to {high:g}; the lower limit must be below the upper.")
    return low, high


def _number(text: str | None, where: str) -> float:
    try:
        number = float(text or "")
    except ValueError:
        number = float("nan")
    if not np.isfinite(number):
        raise InputError(f"{where}: '{text}' is not a finite number.")
    return number


_KINDS = {
    "UniformDistribution": "uniform",
    "NormalDistribution": "normal",
    "LogNormalDistribution": "lognormal",
    "PoissonDistribution": "poisson",
    "Histogram": "histogram",
    "ProbabilityDistributionSet": "set",
}
