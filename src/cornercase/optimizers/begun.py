"""Searches of a critical set that can begin from another study."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray
from cornercase.evidence import Elsewhere, encoded, with_foretold
from cornercase.optimizers.candidates import CandidateOptimizer
from cornercase.optimizers.straddle import Round

# Points from which on it is looked whether another study predicts their scores; the share of them that it chooses, and
# among how many it does.
_BEGUN: Final = 10
_CHOSEN: Final = 0.5
_AMONG: Final = 4096
# Points between which the space is filled with as many as that study chose.
_MADE_UP: Final = (15, 24)


class BegunOptimizer(CandidateOptimizer):
    """Takes what another study predicts for one more coordinate of its model (`Elsewhere`).

    Half of the first ten points are where that study predicts the boundary, so that they tell whether it is there, or
    how far away. Each has the largest ``1.96 s - |m|`` of 4096 candidates, with the mean m of the other study's process
    and the standard deviation s of a process with the same kernel that knows the points of the new search and nothing
    else. So they are spread along the boundary, and not as close to it as the other study is sure of it.

    Where that study predicts the scores of the first points, from ten on, the model is learned from them; else from as
    many as without it. Where it is learned from them, more points fill the space between the 15th and the 24th, instead
    of those that the other study chose.

    Parameters are those of `CandidateOptimizer`, and the threshold up to which a scenario is critical.
    """

    begins_from_studies = True
    threshold: float
    _elsewhere: Elsewhere | None = None

    def begin_from(self, points: FloatArray, scores: FloatArray) -> None:
        """Take the scores of another study, shape (n,), of points, shape (n, d), as in `Optimizer.begin_from`."""
        self._elsewhere = Elsewhere(encoded(self._space, points), scores, self.threshold)

    def _ask(self, n: int, pending: FloatArray) -> FloatArray:
        asked = len(self._points) + len(pending)
        if self._elsewhere is None or (wanted := _chosen(asked + n) - _chosen(asked)) == 0:
            return super()._ask(n, pending)
        filling = self._sequence.ask(n - wanted, besides=pending)
        known = np.concatenate([self._points, pending, filling])
        return np.concatenate([self._where_foretold(self._elsewhere, known, wanted, asked), filling])

    def _where_foretold(self, elsewhere: Elsewhere, known: FloatArray, n: int, asked: int) -> FloatArray:
        """Points, shape (k, d), on the boundary as another study has it, and away from `known` ones, shape (m, d)."""
        candidates = self._drawn(self._seed_of(asked), _AMONG, known)
        count, process = len(candidates), elsewhere.process
        places = encoded(self._space, np.concatenate([candidates, known]))
        variance = np.full(len(places), process.kernel.signal**2)
        round_ = Round(process, places, process.predict(places)[0], variance, np.empty((len(places), 0)))
        for i in range(count, len(places)):
            round_.learn(i)
        return candidates[round_.choose(min(n, count), count)[0]]

    def _begins(self) -> bool:
        if super()._begins():
            return True
        scores = self._scores[self._known]
        if self._elsewhere is None or len(scores) < _BEGUN or np.ptp(scores) == 0.0:
            return False
        return self._elsewhere.foretells(encoded(self._space, self._points[self._known]), scores)

    def _filled(self, told: int) -> int:
        made_up = 0 if self._elsewhere is None else int(np.interp(told, _MADE_UP, (0, _chosen(told))))
        return super()._filled(told) + made_up

    def _coordinates(self, points: FloatArray) -> FloatArray:
        """Where the model of the scores has points, shape (n, e), or (n, e + 1) with another study."""
        return with_foretold(self._elsewhere, encoded(self._space, points))


def _chosen(asked: int) -> int:
    """How many of the first points another study chooses."""
    return math.floor(_CHOSEN * min(asked, _BEGUN))
