"""Warm start of optimizers from another study."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.evidence import Elsewhere, encoded, with_foretold
from cornercase.optimizers.candidates import CandidateOptimizer
from cornercase.optimizers.straddle import Round

_BEGUN: Final = 10  # number of scores from which the other study's prediction is checked
_CHOSEN: Final = 0.5  # fraction of these points that the other study chooses
_AMONG: Final = 4096  # number of candidates for them
_MADE_UP: Final = (15, 24)  # points between which as many space-filling points are added


class BegunOptimizer(CandidateOptimizer):
    """Uses the prediction of another study as one more coordinate of its model (`SourceStudyModel`).

    Half of the first ten points are where that study predicts the boundary, to learn whether it is there, or how far
    away. Each has the largest ``1.96 s - |m|`` of 4096 candidates, with the mean m of the other study's process and the
    standard deviation s of a process with the same kernel that is conditioned on the points of the new search only.
    This spreads the points along the predicted boundary instead of concentrating them where the prediction is most
    certain.

    If that study predicts the scores of the first ten points or more, the model is learned from them; else from as many
    as without a warm start. Then additional space-filling points replace, between the 15th and the 24th point, those
    that the other study chose.
    """

    begins_from_studies = True
    threshold: float
    _elsewhere: Elsewhere | None = None

    def begin_from(self, points: FloatArray, scores: FloatArray) -> None:
        """Use the scores (n,) of another study at points (n, d), as in `Optimizer.warm_start`."""
        self._elsewhere = Elsewhere(encoded(self._space, points), scores, self.threshold)

    def _ask(self, n: int, pending: FloatArray) -> FloatArray:
        asked = len(self._points) + len(pending)
        if self._elsewhere is None or (count := _chosen(asked + n) - _chosen(asked)) == 0:
            return super()._ask(n, pending)
        filling = self._sequence.ask(n - count, besides=pending)
        known = np.concatenate([self._points, pending, filling])
        return np.concatenate([self._where_foretold(self._elsewhere, known, count, asked), filling])

    def _where_foretold(self, elsewhere: Elsewhere, known: FloatArray, n: int, asked: int) -> FloatArray:
        """Points (k, d) on the boundary that another study predicts, away from `known` points (m, d)."""
        candidates = self._drawn(self._seed_of(asked), _AMONG, known)
        count, process = len(candidates), elsewhere.process
        points = encoded(self._space, np.concatenate([candidates, known]))
        variance = np.full(len(points), process.kernel.signal**2)
        selection = Round(process, points, process.predict(points)[0], variance, np.empty((len(points), 0)))
        for i in range(count, len(points)):
            selection.learn(i)
        return candidates[selection.choose(min(n, count), count)[0]]

    def _begins(self) -> bool:
        if super()._begins():
            return True
        scores = self._scores[self._known]
        if self._elsewhere is None or len(scores) < _BEGUN or np.ptp(scores) == 0.0:
            return False
        return self._elsewhere.foretells(encoded(self._space, self._points[self._known]), scores)

    def _filled(self, told: int) -> int:
        added = 0 if self._elsewhere is None else int(np.interp(told, _MADE_UP, (0, _chosen(told))))
        return super()._filled(told) + added

    def _coordinates(self, points: FloatArray) -> FloatArray:
        """Coordinates of points for the model of the scores, (n, e), or (n, e + 1) with another study."""
        return with_foretold(self._elsewhere, encoded(self._space, points))


def _chosen(asked: int) -> int:
    """Number of points that another study chooses among the first `n_points`."""
    return math.floor(_CHOSEN * min(asked, _BEGUN))
