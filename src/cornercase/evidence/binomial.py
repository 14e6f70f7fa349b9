"""Bounds of a share of which only some were looked at, drawn at random: nothing else is assumed."""

from __future__ import annotations

import math
from typing import Final

from scipy.optimize import brentq
from scipy.special import betaln, xlog1py, xlogy

from cornercase._common.shares import clopper_pearson
from cornercase.evidence.estimate import Estimate

_CONFIDENCE: Final = 0.9


def bounds_of_share(hits: int, drawn: int) -> Estimate:
    """Bound a share by random draws: the 90 % interval of Clopper and Pearson.

    Parameters
    ----------
    hits, drawn : int
        How many of how many draws belong to it.

    Returns
    -------
    Estimate
        The share of the draws, and an interval that holds the share in 90 % or more of all draws; 0 to 1 without any.

    Notes
    -----
    Without a hit the upper end is that of the rule of three: 3 over the draws.
    """
    if not drawn:
        return Estimate(0.5, 0.0, 1.0)
    return Estimate(hits / drawn, *clopper_pearson(hits, drawn, (1.0 - _CONFIDENCE) / 2.0))


def highest_share(hits: int, drawn: int, doubt: float = 0.05) -> float:
    """Bound a share from above by random draws, however often one looks before one stops.

    Parameters
    ----------
    hits, drawn : int
        How many of how many draws belong to it.
    doubt : float, default 0.05
        Probability that the share ever is above the bound, in all looks together.

    Returns
    -------
    float

    Notes
    -----
    The bound inverts the ratio of the likelihood that is averaged over all shares (Robbins' method of mixtures, with
    Beta(1/2, 1/2)) to that of one share, which exceeds 1/doubt with a probability of at most `doubt` at any time:
    H. Robbins, "Statistical methods related to the law of the iterated logarithm", Annals of Mathematical Statistics
    41 (1970).
    """
    if not drawn or hits == drawn:
        return 1.0
    mixed = float(betaln(hits + 0.5, drawn - hits + 0.5) - betaln(0.5, 0.5))

    def against(share: float) -> float:
        """Logarithm of the evidence against a share, less what is needed to refuse it."""
        return mixed - float(xlogy(hits, share) + xlog1py(drawn - hits, -share)) + math.log(doubt)

    return float(brentq(against, max(hits / drawn, 1e-12), 1.0 - 1e-12))
