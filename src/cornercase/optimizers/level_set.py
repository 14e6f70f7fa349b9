"""Search for the whole set of critical scenarios, by its boundary."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.spatial.distance import cdist
from scipy.special import ndtr

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.evidence import (
    GaussianProcess,
    boundary_process,
    encoded,
    near_threshold,
)
from cornercase.optimizers.begun import BegunOptimizer
from cornercase.optimizers.dips import below_dips
from cornercase.optimizers.straddle import Round, gains
from cornercase.optimizers.unseen import Unseen
from cornercase.scenario import ParameterSpace

# Points before anything is learned; and candidates of greatest gain that are kept until more is learned.
_INITIAL: Final = 24
_KEPT: Final = 4096
# Of those the ones that are looked at first.
_LIKELY: Final = 512
# Share of the points that follow scores which fall towards the threshold elsewhere.
_FOLLOWING: Final = 0.15
# Probability of failing up to which a candidate is asked for, or that much more than has failed where that is more.
_MOST_FAILING, _MORE = 0.25, 1.25
# Probability of being critical below which a candidate says nothing of the boundary of what is known.
_REMOTE: Final = 0.05
# Share of the known critical set whose boundary is still unknown, and times what the points are that fill the space.
_OPEN, _TIMES = (0.03, 0.08), (2.5, 1.0)


class LevelSetOptimizer(BegunOptimizer):
    """Asks for the scenarios of which a Gaussian process knows least whether they are critical.

    A scenario is critical when its score is at most the threshold. Each point of a round has the largest
    ``1.96 s - |m - threshold|`` of all candidates (the straddle heuristic), with the mean m of a `boundary_process`
    and its standard deviation s; then s is what it would be with that point known, so that a round spreads over the
    boundary. The first 24 points, and a share of all others, are a Sobol' sequence, so that a critical region that
    the process knows nothing of is met. That share grows to 2.5 times as much where the boundary of what is known is
    found: where the process expects to be wrong about a volume of 3 % of the critical one instead of 8 %.

    Up to 15 % of the points follow scores which fall towards the threshold without reaching it (`below_dips`), so that
    further regions are met that are felt from afar.

    Where scenarios have failed, a process of that keeps the search from asking for what is likely to fail too, with a
    probability of more than 25 %, or of 1.25 times the share that has failed where that is more. Only the Sobol'
    sequence goes on there.

    The kernel of the process is learned, and candidates are drawn, each time that ten scenarios more were told, or a
    tenth more where that is more. The 4096 candidates that are best then are those of the rounds until the next time.

    With another study to begin from, what it predicts is one more coordinate of the process (`Elsewhere`). Half of the
    first 10 points are where it predicts the boundary, and the process is learned from fewer points where it predicts
    the first 10 of them, or more.

    Parameters
    ----------
    space : ParameterSpace
    seed : int
    threshold : float
        Score up to which a scenario is critical.
    candidates : int, default 20000
        Points among which is chosen.
    filling : float, default 0.2
        Share of the points that fills the space, at least; below 1.

    Notes
    -----
    Source: B. Bryan, J. Schneider et al., "Active learning for identifying function threshold boundaries", NIPS
    (2005).
    """

    name = "level-set"
    needs = frozenset({"threshold"})

    def __init__(
        self, space: ParameterSpace, seed: int, threshold: float, candidates: int = 20_000, filling: float = 0.2
    ) -> None:
        super().__init__(space, seed, initial=_INITIAL, filling=filling)
        self.threshold = threshold
        self._count, self._least = candidates, filling
        self._unseen = Unseen(space)
        self._process: GaussianProcess
        self._candidates: FloatArray
        self._everywhere: FloatArray

    def tell(self, points: FloatArray, scores: FloatArray) -> None:
        """Take scores, shape (m,), of points, shape (m, d), as in `Optimizer.tell`."""
        super().tell(points, scores)
        self._unseen.tell(points)

    def _learn(self, points: FloatArray, scores: FloatArray, seed: int) -> None:
        self._process = boundary_process(
            self._coordinates(points), scores, self.threshold, foretold=self._elsewhere is not None
        )
        candidates = self._drawn(seed, self._count, points)
        mean, deviation = self._process.predict(self._coordinates(candidates))
        likely = ndtr(-mean / np.hypot(deviation, self._process.kernel.noise))
        self._filling = min(self._least * float(np.interp(_open(likely), _OPEN, _TIMES)), 1.0)
        best = np.argsort(-gains(mean, deviation), kind="stable")
        if len(points) < self._learned:
            best = best[: 2 * _KEPT]
            best = best[self._runs(candidates[best])]
        self._candidates = candidates[np.sort(best[:_KEPT])]
        self._everywhere = candidates

    def _runs(self, candidates: FloatArray) -> BoolArray:
        """Tell which candidates are not likely to fail, by a process of what has failed."""
        known = self._known[: self._learned]
        told = encoded(self._space, self._points[: self._learned])
        process = GaussianProcess(1.0).fit(told, np.where(known, -1.0, 1.0))
        mean, deviation = process.predict(encoded(self._space, candidates))
        fails = ndtr(mean / np.hypot(deviation, process.kernel.noise))
        return np.asarray(fails <= max(_MOST_FAILING, _MORE * float(np.mean(~known))))

    def _choose(self, points: FloatArray, scores: FloatArray, filling: FloatArray, n: int) -> FloatArray:
        sought = self._below_dips(filling, n)
        filling, n = np.concatenate([filling, sought]), n - len(sought)
        return np.concatenate([sought, self._at_boundary(points, scores, filling, n)]) if n else sought

    def _below_dips(self, filling: FloatArray, n: int) -> FloatArray:
        """Points of this round that follow scores which fall towards the threshold; their share is the same always."""
        asked = self._asked
        most = min(math.floor(_FOLLOWING * (asked + n)) - math.floor(_FOLLOWING * asked), n)
        if most == 0:
            return filling[:0]
        places = below_dips(encoded(self._space, self._points), self._scores, self.threshold, most)
        if not len(places) or not len(self._everywhere):
            return filling[:0]
        # They are too few for a tree of all candidates.
        nearest = cdist(places, encoded(self._space, self._everywhere), "sqeuclidean").argmin(axis=1)
        return self._unseen.left(self._everywhere[nearest], besides=filling)

    def _at_boundary(self, points: FloatArray, scores: FloatArray, filling: FloatArray, n: int) -> FloatArray:
        """Points of this round where it is least known whether they are critical; parameters as of `_choose`."""
        candidates = self._unseen.left(self._candidates, besides=filling)
        if len(candidates) < n:
            candidates = self._new(max(n, min(self._count, _KEPT)), filling)
        if len(candidates) <= n:
            return candidates
        process = self._process
        if len(points):
            values = near_threshold(scores, self.threshold, process.near)
            process = process.extended(self._coordinates(points), values)
        return candidates[_straddle(process, self._coordinates(candidates), self._coordinates(filling), n)]


def _open(likely: FloatArray) -> float:
    """Volume on whose side the process expects to be wrong, as a share of the critical one, by its probabilities."""
    near = likely[likely >= _REMOTE]
    return float(np.minimum(near, 1.0 - near).sum() / near.sum()) if len(near) else 0.0


def _straddle(process: GaussianProcess, candidates: FloatArray, known: FloatArray, n: int) -> IntArray:
    """Choose `n` candidates, each with those before it and the `known` ones known."""
    mean, deviation, rows = process.predict_with_projections(np.concatenate([candidates, known]))
    variance, others = deviation**2, np.arange(len(candidates), len(mean))
    gain = gains(mean, np.sqrt(variance))[: len(candidates)]
    falling, most = np.argsort(-gain, kind="stable"), max(_LIKELY, n)
    while True:
        some = np.sort(falling[:most])
        these = np.concatenate([some, others])
        round_ = Round(process, np.concatenate([candidates[some], known]), mean[these], variance[these], rows[these])
        for i in range(len(some), len(these)):
            round_.learn(i)
        chosen, least = round_.choose(n, len(some))
        # What a candidate gains can only fall as others are known; so none of the rest can be better.
        if most >= len(candidates) or least > gain[falling[most]]:
            return some[chosen]
        most *= 4
