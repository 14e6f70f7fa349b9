"""Searches of a critical set that can begin from another study."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.evidence import Elsewhere, encoded, with_foretold
from cornercase.optimizers.candidates import CandidateOptimizer

# Points from which on it is looked whether another study predicts their scores.
_BEGUN: Final = 10


class BegunOptimizer(CandidateOptimizer):
    """Takes what another study predicts for one more coordinate of its model (`Elsewhere`).

    Where that study predicts the scores of the first points, from ten on, the model is learned from them; else from as
    many as without it.

    Parameters are those of `CandidateOptimizer`, and the threshold up to which a scenario is critical.
    """

    begins_from_studies = True
    threshold: float
    _elsewhere: Elsewhere | None = None

    def begin_from(self, points: FloatArray, scores: FloatArray) -> None:
        """Take the scores of another study, shape (n,), of points, shape (n, d), as in `Optimizer.begin_from`."""
        self._elsewhere = Elsewhere(encoded(self._space, points), scores, self.threshold)

    def _begins(self) -> bool:
        if super()._begins():
            return True
        scores = self._scores[self._known]
        if self._elsewhere is None or len(scores) < _BEGUN or np.ptp(scores) == 0.0:
            return False
        return self._elsewhere.foretells(encoded(self._space, self._points[self._known]), scores)

    def _coordinates(self, points: FloatArray) -> FloatArray:
        """Where the model of the scores has points, shape (n, e), or (n, e + 1) with another study."""
        return with_foretold(self._elsewhere, encoded(self._space, points))
