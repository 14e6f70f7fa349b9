"""How often runs of one scenario are critical, where runs differ."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cornercase._common.shares import clopper_pearson
from cornercase._common.typing import FloatArray

_TAIL = 0.05


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
