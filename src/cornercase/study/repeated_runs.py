"""How often runs of one scenario are critical, where runs differ, and whether more runs are needed to say so."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from cornercase._common.shares import clopper_pearson
from cornercase._common.typing import FloatArray

_TAIL: Final = 0.05

FEWEST_CLEAR_RUNS: Final = 5
"""Fewest runs that can tell on which side of the threshold a scenario is: all of them, or none, are critical."""


def shares_of_runs(scores: Sequence[Sequence[float]], threshold: float) -> FloatArray:
    """Share of the runs of each scenario that are critical, with the interval of Clopper and Pearson.

    Parameters
    ----------
    scores : sequence of sequence of float, length n
        Oriented scores of the runs of each scenario.
    threshold : float
        Oriented score up to which a run is critical.

    Returns
    -------
    ndarray of float64, shape (n, 3)
        Share, and bounds of the 90 % interval.
    """
    rows = []
    for one in scores:
        runs, met = len(one), sum(score <= threshold for score in one)
        rows.append((met / runs, *clopper_pearson(met, runs, _TAIL)))
    return np.array(rows, dtype=np.float64)


def are_open(scores: Sequence[float], threshold: float) -> bool:
    """Tell whether the runs of a scenario leave open on which side of the threshold it is.

    Parameters
    ----------
    scores : sequence of float
        Oriented scores of its runs; one at least.
    threshold : float
        Oriented score up to which a run is critical.

    Returns
    -------
    bool
        Whether the 90 % interval of the probability that a run is critical, as of `shares_of_runs`, holds 0.5.
    """
    ((_, low, high),) = shares_of_runs([scores], threshold)
    return bool(low <= 0.5 <= high)
