"""Search for the whole set of critical scenarios, by its boundary."""

from __future__ import annotations

import math

import numpy as np

from cornercase._common.typing import FloatArray, IntArray
from cornercase.evidence import GaussianProcess, boundary_process, encoded
from cornercase.optimizers.candidates import CandidateOptimizer
from cornercase.scenario import ParameterSpace

# Points before anything is learned; and candidates of greatest gain that are looked at more closely at first.
_INITIAL, _LOOKED_AT = 24, 4096


class LevelSetOptimizer(CandidateOptimizer):
    """Asks for the scenarios of which a Gaussian process knows least whether they are critical.

    A scenario is critical when its score is at most the threshold. Each point of a round has the largest
    ``1.96 s - |m - threshold|`` of all candidates (the straddle heuristic), with the mean m of a `boundary_process`
    and its standard deviation s; then s is what it would be with that point known, so that a round spreads over the
    boundary. The first 24 points, and a share of all others, are a Sobol' sequence, so that a critical region that
    the process knows nothing of is met.

    Parameters
    ----------
    space : ParameterSpace
    seed : int
    threshold : float
        Score up to which a scenario is critical.
    candidates : int, default 20000
        Points among which a round chooses; drawn anew for each.
    filling : float, default 0.2
        Share of the points that fills the space.

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
        super().__init__(space, seed, initial=_INITIAL, candidates=candidates, filling=filling)
        self.threshold = threshold

    def _process(self) -> GaussianProcess:
        points, scores = self._points[self._known], self._scores[self._known]
        return boundary_process(encoded(self._space, points), scores, self.threshold)

    def _choose(self, candidates: FloatArray, filling: FloatArray, n: int) -> IntArray:
        process = self._process()
        places = encoded(self._space, candidates)
        mean, deviation = process.predict(places)
        best = np.argsort(-_gain(mean, deviation), kind="stable")
        most = _LOOKED_AT
        while True:
            some = best[:most]
            chosen, least = _straddle(process, places[some], encoded(self._space, filling), n)
            # Gains only fall while points are chosen. So a candidate that was left out would not have been chosen if
            # its gain at the beginning is below the least one that was.
            if most >= len(best) or least >= _gain(mean, deviation)[best[most]]:
                return some[chosen]
            most *= 4


def _gain(mean: FloatArray, deviation: FloatArray) -> FloatArray:
    return np.asarray(1.96 * deviation - np.abs(mean))


def _straddle(process: GaussianProcess, candidates: FloatArray, known: FloatArray, n: int) -> tuple[IntArray, float]:
    """Choose `n` candidates, each with those before it known; and the least gain of them."""
    places = np.concatenate([candidates, known])
    mean, deviation = process.predict(places)
    rows, variance = process.projections(places), deviation**2
    # The process is computed in single precision, which cannot tell a lower variance from 0.
    lowest, noise = 1e-5 * process.signal**2, process.noise**2
    learned: list[FloatArray] = []
    chosen: list[int] = []
    least = math.inf

    def learn(i: int) -> None:
        shared = process.covariance(places, rows, i)
        for earlier in learned:
            shared = shared - earlier * earlier[i]
        step = shared / math.sqrt(max(variance[i], lowest) + noise)
        # A point cannot explain more than the variance that is left; rounding errors are cut off.
        most = np.sqrt(variance)
        learned.append(np.clip(step, -most, most))
        np.maximum(variance - learned[-1] ** 2, 0.0, out=variance)

    for i in range(len(candidates), len(places)):
        learn(i)
    for _ in range(n):
        gain = _gain(mean, np.sqrt(variance))[: len(candidates)]
        gain[chosen] = -np.inf
        chosen.append(int(np.argmax(gain)))
        least = min(least, float(gain[chosen[-1]]))
        learn(chosen[-1])
    return np.array(chosen, dtype=np.int64), least
