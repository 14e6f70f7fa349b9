"""Estimate how often repeated runs of a scenario are critical, and whether more runs are needed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from cornercase._common.clopper_pearson import clopper_pearson_interval
from cornercase._common.typing import FloatArray
from cornercase.study._criterion import Criterion

_TAIL_PROBABILITY: Final = 0.05

MIN_DECISIVE_RUNS: Final = 5
"""Smallest number of runs that can decide whether a scenario is critical, if all runs agree."""


def critical_run_rates(scores: Sequence[Sequence[float]], criterion: Criterion) -> FloatArray:
    """Return fraction of critical runs, and ends of its 90 % Clopper-Pearson interval, by scenario, shape (n, 3).

    `scores` has, for each scenario, the scores of all runs, with the sign changed if high scores are critical.
    """
    rows = []
    for run_scores in scores:
        n_runs, n_critical = len(run_scores), int(criterion.is_critical(np.array(run_scores)).sum())
        rows.append((n_critical / n_runs, *clopper_pearson_interval(n_critical, n_runs, _TAIL_PROBABILITY)))
    return np.array(rows, dtype=np.float64)


def is_criticality_undecided(scores: Sequence[float], criterion: Criterion) -> bool:
    """Return whether the 90 % interval of the probability that a run is critical contains 0.5.

    `scores` are the scores of the runs of one scenario (at least one), with the sign changed if high scores are
    critical.
    """
    ((_, low, high),) = critical_run_rates([scores], criterion)
    return bool(low <= 0.5 <= high)
