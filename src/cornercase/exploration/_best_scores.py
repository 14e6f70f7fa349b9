"""The most critical result so far (incumbent)."""

from __future__ import annotations

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray
from cornercase.study._objective import Objective


def is_on_pareto_front(values: FloatArray) -> BoolArray:
    """Return which of m rows of values are on the Pareto front. Lower values are better.

    A row is on the front if no other row dominates it. A row with NaN is never on the front.

    Source: H. T. Kung, F. Luccio, F. P. Preparata, "On finding the maxima of a set of vectors", Journal of the ACM 22
    (1975); implemented in moocore.
    """
    is_finite = np.isfinite(values).all(axis=1)
    if not is_finite.any():
        return np.asarray(is_finite)
    front = is_finite.copy()
    if values.shape[1] == 1:
        front[is_finite] = values[is_finite, 0] == values[is_finite].min()
    else:
        # Imported late: slow to import.
        from moocore import is_nondominated

        front[is_finite] = is_nondominated(values[is_finite], keep_weakly=True)
    return np.asarray(front)


class BestScores:
    """The most critical result so far: the best score, or the Pareto front."""

    def __init__(self, objective: Objective) -> None:
        self._objective = objective
        self._front = np.zeros((0, 1))

    def update(self, scores: FloatArray) -> bool:
        """Add the scores of m scenarios, and return whether any score is an improvement.

        `scores` has shape (m,), or (m, k) for a Pareto front of k metrics. Lower scores are more critical; NaN means
        that the scenario failed. A score is an improvement if no earlier score dominates it. A score that is the
        least critical value (cap) of every metric is an improvement only the first time.
        """
        values = scores.reshape(len(scores), -1)
        values = values[np.isfinite(values).all(axis=1)]
        if not len(values):
            return False
        if values.shape[1] == 1:
            return self._update_single(values)
        before = self._front if len(self._front) else np.full((1, values.shape[1]), np.inf)
        worse = (before[:, None] <= values).all(axis=2) & (before[:, None] < values).any(axis=2)
        same = (before[:, None] == values).all(axis=2).any(axis=0)
        capped = (values >= self._objective.least_critical_scores).all(axis=1)
        is_new = ~worse.any(axis=0) & ~(same & capped)
        candidates = np.unique(np.concatenate([self._front.reshape(-1, values.shape[1]), values]), axis=0)
        self._front = candidates[is_on_pareto_front(candidates)]
        return bool(is_new.any())

    def _update_single(self, values: FloatArray) -> bool:
        """Do the same as `update` for a single metric, but faster, since this is done for every scenario."""
        best = float(self._front[0, 0]) if len(self._front) else np.inf
        is_new = (values <= best) & ~((values == best) & (values >= self._objective.least_critical_scores))
        self._front = np.full((1, 1), min(best, float(values.min())))
        return bool(is_new.any())

    @property
    def label(self) -> str:
        """Short label such as ``best 0.3 s``; empty before the first score."""
        if not len(self._front):
            return ""
        if self._objective.pareto:
            return f"front of {len(self._front)}"
        # Adding 0 turns -0, the score of a metric that is critical where it is high, into 0.
        best = self._objective.convert_orientation(float(self._front[0, 0])) + 0.0
        return f"best {best:.3g} {self._objective.unit}".rstrip()
