"""Bounds of shares of which only some draws are known."""

from __future__ import annotations


def clopper_pearson(hits: int, drawn: int, tail: float) -> tuple[float, float]:
    """Bound a share by independent draws, as C. J. Clopper and E. S. Pearson do.

    Parameters
    ----------
    hits, drawn : int
        How many of how many draws belong to it.
    tail : float
        Probability that the share is below the interval, and that it is above, at most.

    Returns
    -------
    low, high : float
        0 and 1 without any draws.

    Notes
    -----
    Source: C. J. Clopper, E. S. Pearson, "The use of confidence or fiducial limits illustrated in the case of the
    binomial", Biometrika 26 (1934).
    """
    # Loaded here, since opening a study does not need it.
    from scipy.special import betaincinv

    low = float(betaincinv(hits, drawn - hits + 1, tail)) if hits else 0.0
    high = float(betaincinv(hits + 1, drawn - hits, 1.0 - tail)) if hits < drawn else 1.0
    return low, high
