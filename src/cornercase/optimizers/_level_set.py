"""Search for the boundary of the critical set, that is, of all critical scenarios."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.special import ndtr

from cornercase._common.typing import BoolArray, FloatArray
from cornercase._common.validation import check_float, check_int
from cornercase.evidence.gp._gaussian_process import (
    GaussianProcess,
    encode_points,
    fit_boundary_process,
    squash_around_threshold,
)
from cornercase.optimizers._dedupe import Deduplicator
from cornercase.optimizers._local_minima import indices_below_local_minima
from cornercase.optimizers._straddle import choose_by_straddle, straddle_gains
from cornercase.optimizers._warm_start_optimizer import WarmStartOptimizer
from cornercase.scenario import ParameterSpace
from cornercase.study._criterion import Criterion

_N_BEST: Final = 4096  # best candidates that are kept until the process is learned anew
_LOCAL_MINIMA_FRACTION: Final = 0.15  # fraction of the points that follow local minima of the scores
# Greatest probability of failure of candidates, also as a multiple of the fraction that has failed; the larger counts.
_MAX_FAILURE_PROBABILITY, _FAILURE_FACTOR = 0.25, 1.25
_MIN_PROBABILITY: Final = 0.05  # probability of being critical from which a candidate belongs to the known boundary
# Fractions of the known critical set that are still uncertain, and the factors of the space-filling fraction there.
_UNCERTAIN_FRACTIONS, _FILLING_FACTORS = (0.03, 0.08), (2.5, 1.0)


class LevelSet(WarmStartOptimizer):
    """Optimizer that proposes scenarios near the boundary of the critical set, predicted by a Gaussian process.

    A scenario is critical if its score is at most the threshold. The process predicts the score of each candidate, with
    mean m and standard deviation s. Each point of a round is the candidate with the largest ``1.96 s - |m -
    threshold|`` (the straddle heuristic). Then s is updated as if the score of this point were known, so the points of
    a round spread over the boundary.

    The first 24 points, and a fraction of all others, are a Sobol' sequence, to find critical regions that the process
    does not predict. This fraction grows to 2.5 times its value as the known boundary becomes certain: as the volume
    that the process expects to misclassify falls from 8 % to 3 % of the critical volume.

    Up to 15 % of the points are downhill from local minima of the scores that do not reach the threshold
    (`suggest_below_local_minima`), to find further critical regions.

    If scenarios have failed, a second Gaussian process predicts the probability that a candidate fails. A candidate is
    excluded if this probability is above 25 %, and also above 1.25 times the fraction of scenarios that failed so far.
    Points of the Sobol' sequence, and points downhill from local minima, are not excluded.

    After every ten new scenarios, or when the number of scenarios has grown by a tenth if that is later, the kernel is
    learned again and new candidates are drawn. The best 4096 of them serve for all rounds until the next such time.

    With a warm start, the prediction of another study is an additional coordinate of the process
    (`SourceStudyModel`). Half of the first 10 points are on the boundary that the other study predicts. If the other
    study predicts the scores of these points, the process is learned from fewer points than without a warm start.

    Source: B. Bryan, J. Schneider et al., "Active learning for identifying function threshold boundaries", NIPS (2005).

    Parameters
    ----------
    candidates : int, default 20000
        Number of candidates from which the points are chosen.
    filling : float, default 0.2
        Smallest fraction of the points that come from the Sobol' sequence, from 0 to 1.

    Raises
    ------
    InputError
        An option is out of range.

    Examples
    --------
    >>> import cornercase as cc
    >>> search = cc.optimizers.LevelSet(filling=0.3)
    >>> str(search)
    'level-set:filling=0.3'
    >>> study.explore(search, budget=200)  # doctest: +SKIP
    """

    name = "level-set"
    initial = 24
    requires = frozenset({"threshold"})

    _process: GaussianProcess
    _candidates: FloatArray
    _all_candidates: FloatArray

    def __init__(self, candidates: int = 20_000, filling: float = 0.2) -> None:
        self._count = check_int("candidates", candidates, 1)
        self._min_filling = check_float("filling", filling, minimum=0.0, maximum=1.0)

    def prepare(self, space: ParameterSpace, seed: int, threshold: float) -> None:
        """Prepare the search of a space for the boundary at `threshold`."""
        super().prepare(space, seed)
        self._criterion, self._filling = Criterion(threshold), self._min_filling
        self._deduplicator = Deduplicator(space)

    def tell(self, points: FloatArray, scores: FloatArray) -> None:
        """Observe scores (m,) of points (m, d), as in `Optimizer.tell`."""
        super().tell(points, scores)
        self._deduplicator.remember(points)

    def _fit_model(self, points: FloatArray, scores: FloatArray, seed: int) -> None:
        self._process = fit_boundary_process(
            self._model_coordinates(points), scores, self._criterion, has_prediction=self._source_model is not None
        )
        candidates = self._draw_candidates(seed, self._count, points)
        mean, deviation = self._process.predict(self._model_coordinates(candidates))
        probability = ndtr(-mean / np.hypot(deviation, self._process.kernel.noise))
        self._filling = min(
            self._min_filling
            * float(np.interp(_estimate_misclassified_fraction(probability), _UNCERTAIN_FRACTIONS, _FILLING_FACTORS)),
            1.0,
        )
        best = np.argsort(-straddle_gains(mean, deviation), kind="stable")
        if len(points) < self._n_learned:
            best = best[: 2 * _N_BEST]
            best = best[self._mask_unlikely_to_fail(candidates[best])]
        self._candidates = candidates[np.sort(best[:_N_BEST])]
        self._all_candidates = candidates

    def _mask_unlikely_to_fail(self, candidates: FloatArray) -> BoolArray:
        """Return the mask of the candidates that are unlikely to fail, by a Gaussian process that predicts failures."""
        finished = self._is_finished[: self._n_learned]
        observed = encode_points(self._space, self._points[: self._n_learned])
        process = GaussianProcess(1.0).fit(observed, np.where(finished, -1.0, 1.0))
        mean, deviation = process.predict(encode_points(self._space, candidates))
        fails = ndtr(mean / np.hypot(deviation, process.kernel.noise))
        return np.asarray(fails <= max(_MAX_FAILURE_PROBABILITY, _FAILURE_FACTOR * float(np.mean(~finished))))

    def _choose_points(self, points: FloatArray, scores: FloatArray, filling: FloatArray, n: int) -> FloatArray:
        below = self._points_below_local_minima(filling, n)
        filling, n = np.concatenate([filling, below]), n - len(below)
        return np.concatenate([below, self._points_at_boundary(points, scores, filling, n)]) if n else below

    def _points_below_local_minima(self, filling: FloatArray, n: int) -> FloatArray:
        """Return points for this round that lie downhill from local minima of the scores.

        How many are sought depends only on the number of points that were proposed.
        """
        n_proposed = self._n_proposed
        count = min(
            math.floor(_LOCAL_MINIMA_FRACTION * (n_proposed + n)) - math.floor(_LOCAL_MINIMA_FRACTION * n_proposed), n
        )
        if count == 0:
            return filling[:0]
        below = indices_below_local_minima(
            self._encode(self._points), self._scores, self._criterion, self._encode(self._all_candidates), count
        )
        return self._deduplicator.filter_snapped(self._all_candidates[below], exclude=filling)

    def _points_at_boundary(self, points: FloatArray, scores: FloatArray, filling: FloatArray, n: int) -> FloatArray:
        """Return at most `n` points for this round for which it is most uncertain whether they are critical.

        Points that were observed before or are in `filling` are left out.
        """
        candidates = self._deduplicator.filter_snapped(self._candidates, exclude=filling)
        if len(candidates) < n:
            candidates = self._draw_round_candidates(max(n, min(self._count, _N_BEST)), filling)
        if len(candidates) <= n:
            return candidates
        process = self._process
        if len(points):
            # All scores show which of them lie on a plateau.
            finished = self._scores[self._is_finished]
            values = squash_around_threshold(finished, self._criterion, process.squash_scale)[-len(points) :]
            process = process.with_more_values(self._model_coordinates(points), values)
        return candidates[
            choose_by_straddle(process, self._model_coordinates(candidates), self._model_coordinates(filling), n)
        ]


def _estimate_misclassified_fraction(probabilities: FloatArray) -> float:
    """Return the volume that the process expects to misclassify, as a fraction of the critical volume.

    `probabilities` are the predicted probabilities of being critical.
    """
    near = probabilities[probabilities >= _MIN_PROBABILITY]
    return float(np.minimum(near, 1.0 - near).sum() / near.sum()) if len(near) else 0.0
