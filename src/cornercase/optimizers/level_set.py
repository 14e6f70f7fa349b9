"""Search for the boundary of the whole critical set."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.spatial.distance import cdist
from scipy.special import ndtr

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.evidence import GaussianProcess, boundary_process, encoded, near_threshold
from cornercase.optimizers.begun import BegunOptimizer
from cornercase.optimizers.dips import below_dips
from cornercase.optimizers.straddle import Round, gains
from cornercase.optimizers.unseen import Unseen
from cornercase.scenario import ParameterSpace

_INITIAL: Final = 24  # points before anything is learned
_KEPT: Final = 4096  # best candidates that are kept until the process is learned anew
_LIKELY: Final = 512  # of these, how many are tried first
_FOLLOWING: Final = 0.15  # fraction of the points that follow local minima of the scores
# Greatest probability of failure of candidates, also as a multiple of the fraction that has failed; the larger counts.
_MOST_FAILING, _MORE = 0.25, 1.25
_REMOTE: Final = 0.05  # probability of being critical from which a candidate belongs to the known boundary
# Fractions of the known critical set that are still uncertain, and the factors of the space-filling fraction there.
_OPEN, _TIMES = (0.03, 0.08), (2.5, 1.0)


class LevelSetOptimizer(BegunOptimizer):
    """Proposes the scenarios about which a Gaussian process is most uncertain whether they are critical.

    A scenario is critical if its score is at most the threshold. Each point of a round has the largest ``1.96 s - |m -
    threshold|`` of all candidates (the straddle heuristic), with the mean m of a boundary process and its standard
    deviation s; then s is updated as if that point were known, so that a round spreads over the boundary. The first 24
    points, and a fraction of all others, are a Sobol' sequence, to find critical regions that the process does not
    predict. This fraction grows to 2.5 times its value when the known boundary is found: when the process expects to be
    wrong about a volume of 3 % of the critical one instead of 8 %.

    Up to 15 % of the points follow local minima of the scores that do not reach the threshold
    (`suggest_below_local_minima`), to find further critical regions.

    If scenarios have failed, a process of failures excludes candidates that fail with a probability of more than 25 %,
    or of 1.25 times the fraction that has failed if that is more. Only the Sobol' sequence continues there.

    The kernel is learned anew, and candidates are drawn, for every ten new scenarios, or every tenth more if that is
    more. The best 4096 candidates are kept for the rounds until then.

    With a warm start, the prediction of the other study is one more coordinate of the process (`SourceStudyModel`).
    Half of the first 10 points are where it predicts the boundary, and the process is learned from fewer points if it
    predicts these.

    Source: B. Bryan, J. Schneider et al., "Active learning for identifying function threshold boundaries", NIPS (2005).

    Parameters
    ----------
    space : ParameterSpace
    seed : int
    threshold : float
        Score up to which a scenario is critical.
    candidates : int, default 20000
        Number of points from which is chosen.
    filling : float, default 0.2
        Least fraction of the points that fills the space; below 1.
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
        """Observe scores (m,) of points (m, d), as in `Optimizer.tell`."""
        super().tell(points, scores)
        self._unseen.tell(points)

    def _learn(self, points: FloatArray, scores: FloatArray, seed: int) -> None:
        self._process = boundary_process(
            self._coordinates(points), scores, self.threshold, foretold=self._elsewhere is not None
        )
        candidates = self._drawn(seed, self._count, points)
        mean, deviation = self._process.predict(self._coordinates(candidates))
        probability = ndtr(-mean / np.hypot(deviation, self._process.kernel.noise))
        self._filling = min(self._least * float(np.interp(_open(probability), _OPEN, _TIMES)), 1.0)
        best = np.argsort(-gains(mean, deviation), kind="stable")
        if len(points) < self._learned:
            best = best[: 2 * _KEPT]
            best = best[self._runs(candidates[best])]
        self._candidates = candidates[np.sort(best[:_KEPT])]
        self._everywhere = candidates

    def _runs(self, candidates: FloatArray) -> BoolArray:
        """Which candidates are not likely to fail, by a process of failures."""
        finished = self._known[: self._learned]
        observed = encoded(self._space, self._points[: self._learned])
        process = GaussianProcess(1.0).fit(observed, np.where(finished, -1.0, 1.0))
        mean, deviation = process.predict(encoded(self._space, candidates))
        fails = ndtr(mean / np.hypot(deviation, process.kernel.noise))
        return np.asarray(fails <= max(_MOST_FAILING, _MORE * float(np.mean(~finished))))

    def _choose(self, points: FloatArray, scores: FloatArray, filling: FloatArray, n: int) -> FloatArray:
        below = self._below_dips(filling, n)
        filling, n = np.concatenate([filling, below]), n - len(below)
        return np.concatenate([below, self._at_boundary(points, scores, filling, n)]) if n else below

    def _below_dips(self, filling: FloatArray, n: int) -> FloatArray:
        """Points of this round downhill from local minima; their number depends on the number of proposals only."""
        asked = self._asked
        count = min(math.floor(_FOLLOWING * (asked + n)) - math.floor(_FOLLOWING * asked), n)
        if count == 0:
            return filling[:0]
        suggestions = below_dips(encoded(self._space, self._points), self._scores, self.threshold, count)
        if not len(suggestions) or not len(self._everywhere):
            return filling[:0]
        # For so few points, a tree of all candidates would be slower.
        nearest = cdist(suggestions, encoded(self._space, self._everywhere), "sqeuclidean").argmin(axis=1)
        return self._unseen.left(self._everywhere[nearest], besides=filling)

    def _at_boundary(self, points: FloatArray, scores: FloatArray, filling: FloatArray, n: int) -> FloatArray:
        """Points of this round that are most uncertain; parameters as of `_choose`."""
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
    """Volume that the process expects to misclassify, as a fraction of the critical volume, from probabilities."""
    near = likely[likely >= _REMOTE]
    return float(np.minimum(near, 1.0 - near).sum() / near.sum()) if len(near) else 0.0


def _straddle(process: GaussianProcess, candidates: FloatArray, known: FloatArray, n: int) -> IntArray:
    """Choose `n` candidates by the straddle heuristic, each given those before it and the `known` ones."""
    mean, deviation, rows = process.predict_with_projections(np.concatenate([candidates, known]))
    variance, others = deviation**2, np.arange(len(candidates), len(mean))
    gain = gains(mean, np.sqrt(variance))[: len(candidates)]
    order, count = np.argsort(-gain, kind="stable"), max(_LIKELY, n)
    while True:
        best = np.sort(order[:count])
        index = np.concatenate([best, others])
        selection = Round(process, np.concatenate([candidates[best], known]), mean[index], variance[index], rows[index])
        for i in range(len(best), len(index)):
            selection.learn(i)
        chosen, least = selection.choose(n, len(best))
        # Gains only decrease as other points become known, so none of the remaining candidates can be better.
        if count >= len(candidates) or least > gain[order[count]]:
            return best[chosen]
        count *= 4
