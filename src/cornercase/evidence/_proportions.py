"""Confidence bounds of a proportion from random draws, without further assumptions."""

from __future__ import annotations

import math
from typing import Final

from scipy.optimize import brentq
from scipy.special import betaln, xlog1py, xlogy

from cornercase._common.clopper_pearson import clopper_pearson_interval
from cornercase.evidence._interval_estimate import Estimate

_CONFIDENCE: Final = 0.9


def proportion_interval(hits: int, draws: int) -> Estimate:
    """Estimate a proportion, with the Clopper-Pearson 90 % interval, from `hits` of `draws` random draws.

    Without draws the interval is 0 to 1. Without a hit the upper end is about 3 / `draws` (the rule of three).
    """
    if not draws:
        return Estimate(0.5, 0.0, 1.0)
    return Estimate(hits / draws, *clopper_pearson_interval(hits, draws, (1.0 - _CONFIDENCE) / 2.0))


def anytime_upper_bound(hits: int, draws: int, error_probability: float = 0.05) -> float:
    """Return an upper bound of a proportion that holds even if draws are continued until the bound is low enough.

    The probability that the true proportion ever exceeds the bound is at most `error_probability`. The bound compares
    the likelihood of a proportion with the likelihood of a Beta(1/2, 1/2) mixture. The ratio exceeds 1 /
    `error_probability` at any time with a probability of at most `error_probability`: H. Robbins, "Statistical methods
    related to the law of the iterated logarithm", Annals of Mathematical Statistics 41 (1970).
    """
    if not draws or hits == draws:
        return 1.0
    mixture = float(betaln(hits + 0.5, draws - hits + 0.5) - betaln(0.5, 0.5))

    def log_evidence_against(proportion: float) -> float:
        """Logarithm of the evidence against a proportion, minus the evidence needed to reject it."""
        return (
            mixture - float(xlogy(hits, proportion) + xlog1py(draws - hits, -proportion)) + math.log(error_probability)
        )

    return float(brentq(log_evidence_against, max(hits / draws, 1e-12), 1.0 - 1e-12))
