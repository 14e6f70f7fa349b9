"""Confidence interval of a proportion."""

from __future__ import annotations


def clopper_pearson(hits: int, drawn: int, tail: float) -> tuple[float, float]:
    """Confidence interval of a proportion from `n_hits` among `n_draws` independent draws; (0, 1) without draws.

    `tail` bounds the probability of an error on either side. Source: C. J. Clopper, E. S. Pearson, "The use of
    confidence or fiducial limits illustrated in the case of the binomial", Biometrika 26 (1934).
    """
    # Imported late, as opening a study does not need it.
    from scipy.special import betaincinv

    low = float(betaincinv(hits, drawn - hits + 1, tail)) if hits else 0.0
    high = float(betaincinv(hits + 1, drawn - hits, 1.0 - tail)) if hits < drawn else 1.0
    return low, high
