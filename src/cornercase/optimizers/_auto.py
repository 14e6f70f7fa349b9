"""Search for all critical scenarios with the models that predict the observed outcomes best."""

from __future__ import annotations

import math
from typing import ClassVar, Final

import numpy as np
from scipy.spatial import cKDTree

from cornercase._common.typing import FloatArray, IntArray
from cornercase.evidence._committee import CommitteeModel
from cornercase.optimizers._candidates import MIN_NEW_SCENARIOS
from cornercase.optimizers._committee_search import (
    Committee,
    choose_by_gain_and_distance,
    committee_acquisition,
    coordinate_scales,
)
from cornercase.optimizers._local_minima import indices_below_local_minima
from cornercase.optimizers._straddle import choose_by_straddle

_LOCAL_MINIMA_FRACTION: Final = 0.15  # greatest fraction of the points that follow local minima of the scores
_MAX_FAILURE_PROBABILITY: Final = 0.25  # greatest probability of failure if the process alone chooses
_CONDITIONING_STEP: Final = 5  # the models are conditioned on new scenarios after this number


class _AnyMemberModel(CommitteeModel):
    """Committee of classifiers that may use a single classifier if this predicts the outcomes better."""

    may_be_alone: ClassVar[bool] = True


class Auto(Committee):
    """Optimizer that searches for all critical scenarios, with the models that predict the observed outcomes best.

    Three classifiers predict which scenarios are critical, as in `Committee`: trees on predicted features of the
    recordings (or on predicted scores without features), a random forest on the parameters, and the Gaussian process of
    `LevelSet`. The rules are:

    1. The first 24 points, and a fraction of all others, are a Sobol' sequence, which no score influences.
    2. While no scenario is critical, the lowest score so far replaces the threshold, and most candidates are near the
       scenario with this score. While all scenarios are critical, the second highest score replaces the threshold.
    3. Otherwise three quarters of the candidates are near critical scenarios, and the rest is all over the space.
    4. A classifier, or the weighted mean of the three, predicts the probability p that a candidate is critical. It is
       the predictor with the smallest out-of-fold log loss of the observed outcomes.
    5. If this predictor is the Gaussian process, the score is smooth. Then points are chosen by the straddle heuristic,
       as in `LevelSet`. Otherwise the points with the largest product of uncertainty and distance are chosen. The
       uncertainty is as in `Committee`: high if p is near one half, or if it is uncertain to which branch (such as who
       is first) a candidate belongs. The distance is the one to the nearest scenario that was run or chosen; it counts
       more along a coordinate with a short length scale.
    6. Up to 15 % of the points are downhill from local minima of the scores that do not reach the threshold, to find
       further critical regions.

    If scenarios fail, trees learn which scenarios fail, and likely failures are avoided. With a warm start, the
    prediction of the other study is an additional coordinate of the classifiers, as in `Committee`.

    Kernels and weights are learned again after every ten new scenarios, failed ones too, or when their number has grown
    by half if that is later: from the first 20, 30, 45, 67, 100, 150 and so on. While all scenarios are critical, or
    none, they are learned again after every ten scenarios. In between, the classifiers are trained again after every
    five scores. Features are predicted from at most 256 scenarios, half of them nearest to the threshold, so that a
    proposal takes no longer after many scenarios.

    Parameters
    ----------
    candidates : int, default 3072
        Number of candidates from which the points of a round are chosen.
    filling : float, default 0.2
        Fraction of the points that come from the Sobol' sequence, from 0 to 1.

    Raises
    ------
    InputError
        An option is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase.optimizers import Auto
    >>> from cornercase.scenario import ParameterSpace
    >>> space = ParameterSpace.from_ranges(["speed=5:15", "gap=0:40"])
    >>> search = Auto(filling=0.3).start(space, seed=1, threshold=0.25, features=())
    >>> for _ in range(4):
    ...     points = search.ask(10)
    ...     search.tell(points, np.linalg.norm(points - 0.6, axis=1))
    >>> search.ask(3).shape
    (3, 2)
    >>> Auto(filling=0.3), str(Auto(filling=0.3))
    (Auto(filling=0.3), 'auto:filling=0.3')
    """

    name = "auto"
    relearn_growth = 0.5
    _near_fraction = 0.75
    _model_class = _AnyMemberModel

    def __init__(self, candidates: int = 3072, filling: float = 0.2) -> None:
        super().__init__(candidates, filling)

    def _fit_model(self, points: FloatArray, scores: FloatArray, seed: int) -> None:
        super()._fit_model(points, scores, seed)
        self._n_conditioned = self._n_learned

    def _count_to_learn_from(self) -> int:
        """Return how many of the first scenarios the models are learned from.

        While all finished scenarios are critical, or none is, this number grows by tens, until it includes critical and
        uncritical scenarios.
        """
        number, latest = super()._count_to_learn_from(), len(self._scores) // MIN_NEW_SCENARIOS * MIN_NEW_SCENARIOS
        finished, critical = self._is_finished, self._criterion.is_critical(self._scores)
        if latest <= number or 0 < critical[:number].sum() < finished[:number].sum():
            return number
        first_by_side = [np.flatnonzero(side)[:1] for side in (critical, finished & ~critical)]
        if all(map(len, first_by_side)):
            first_both = 1 + int(np.concatenate(first_by_side).max())
            latest = min(latest, math.ceil(first_both / MIN_NEW_SCENARIOS) * MIN_NEW_SCENARIOS)
        return latest if np.ptp(self._scores[:latest][finished[:latest]]) > 0.0 else number

    def _condition_at_multiples_of_five(self) -> None:
        """Let the committee use further results, whenever the number of scenarios has reached a multiple of five."""
        count = len(self._points) // _CONDITIONING_STEP * _CONDITIONING_STEP
        if count > self._n_conditioned:
            self._condition_committee(count)
            self._n_conditioned = count

    def _choose_points(self, points: FloatArray, scores: FloatArray, filling: FloatArray, n: int) -> FloatArray:
        candidates = self._draw_near_and_far(filling, n)
        if len(candidates) <= n:
            return candidates
        below = self._points_below_local_minima(candidates, n)
        filling, n = np.concatenate([filling, below]), n - len(below)
        candidates = self._deduplicator.filter_snapped(candidates, filling)
        if len(candidates) <= n or n == 0:
            return np.concatenate([below, candidates[:n]])
        self._condition_at_multiples_of_five()
        choose = self._choose_by_gaussian_process if self._committee.is_process_alone else self._choose_by_committee
        return np.concatenate([below, candidates[choose(candidates, filling, n)]])

    def _points_below_local_minima(self, candidates: FloatArray, n: int) -> FloatArray:
        """Return candidates that lie downhill from local minima of the scores.

        How many are sought depends only on the number of points that were proposed.
        """
        before, after = (math.floor(_LOCAL_MINIMA_FRACTION * k) for k in (self._n_proposed, self._n_proposed + n))
        count = min(after - before, n)
        if count == 0:
            return candidates[:0]
        below = indices_below_local_minima(
            self._encode(self._points), self._scores, self._criterion, self._encode(candidates), count
        )
        return self._deduplicator.filter_snapped(candidates[below])

    def _choose_by_gaussian_process(self, candidates: FloatArray, filling: FloatArray, n: int) -> IntArray:
        """Choose `n` candidates by the straddle heuristic, among candidates that are unlikely to fail."""
        fails = self._failure_probability(self._encode(candidates))
        likeliest = np.argsort(fails, kind="stable")
        likely = np.sort(likeliest[: max(n, int((fails <= _MAX_FAILURE_PROBABILITY).sum()))])
        # The process does not know the scenarios since the last multiple of five.
        sampled = self._model_coordinates(np.concatenate([self._points[self._n_conditioned :], filling]))
        coordinates = self._model_coordinates(candidates[likely])
        return likely[choose_by_straddle(self._committee.process, coordinates, sampled, n)]

    def _choose_by_committee(self, candidates: FloatArray, filling: FloatArray, n: int) -> IntArray:
        """Choose `n` candidates about which the committee is uncertain.

        The chosen candidates are far from each other and from scenarios that were run.
        """
        x = self._encode(candidates)
        gain = committee_acquisition(*self._committee.predict(self._model_coordinates(candidates)))
        gain *= 1.0 - self._failure_probability(x)
        sides = coordinate_scales(self._committee.process, x.shape[1])
        sampled = self._encode(np.concatenate([self._points, filling]))
        distance = np.asarray(cKDTree(sampled * sides).query(x * sides)[0])
        return choose_by_gain_and_distance(x * sides, gain, distance, n)
