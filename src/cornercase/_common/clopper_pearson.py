"""Confidence interval of a proportion."""

from __future__ import annotations


def clopper_pearson_interval(n_hits: int, n_draws: int, tail: float) -> tuple[float, float]:
    """Return the Clopper-Pearson confidence interval of a proportion after `n_hits` hits in `n_draws` random draws.

    The proportion lies above the interval with a probability of at most `tail`, and below the interval with a
    probability of at most `tail`. Without draws, the interval is (0, 1). Source: C. J. Clopper, E. S. Pearson, "The use
    of confidence or fiducial limits illustrated in the case of the binomial", Biometrika 26 (1934).
    """
    # Imported late, as opening a study does not need it.
    from scipy.special import betaincinv

    low = float(betaincinv(n_hits, n_draws - n_hits + 1, tail)) if n_hits else 0.0
    high = float(betaincinv(n_hits + 1, n_draws - n_hits, 1.0 - tail)) if n_hits < n_draws else 1.0
    return low, high
