"""Search for all critical scenarios: proposals about which a committee of classifiers is uncertain."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Final

import numpy as np
from scipy.spatial import cKDTree

from cornercase._common.typing import FloatArray, IntArray
from cornercase._common.validation import check_float, check_int
from cornercase.evidence._committee import CommitteeModel
from cornercase.evidence._multi_fidelity import append_source_prediction
from cornercase.evidence.gp._gaussian_process import GaussianProcess, encode_points
from cornercase.metrics import Feature
from cornercase.optimizers._dedupe import Deduplicator
from cornercase.optimizers._warm_start_optimizer import WarmStartOptimizer
from cornercase.scenario import ParameterSpace
from cornercase.study._criterion import Criterion

_TREES: Final = 64  # number of trees of the classifier of failures
_BRANCH_WEIGHT: Final = 0.5  # weight of an uncertain branch against an uncertain outcome
_MIN_SIDE: Final = 0.1  # least scale of a coordinate that the score depends on little
_MAX_DEVIATION: Final = 0.06  # greatest deviation of candidates from critical scenarios


class _LargeCommitteeModel(CommitteeModel):
    """Committee of classifiers that learns from more scenarios, with more trees, than `CommitteeModel`."""

    max_process_scenarios: ClassVar[int] = 512
    max_kernel_scenarios: ClassVar[int | None] = None
    n_trees: ClassVar[int] = 64
    n_trees_per_fold: ClassVar[int] = 24


class Committee(WarmStartOptimizer):
    """Optimizer that proposes scenarios about which a committee of classifiers (`CommitteeModel`) is most uncertain.

    The committee learns from features of the recordings, so it follows scores that jump between branches of a scenario
    (who is first, or whether both touch). Proposed scenarios have a probability of being critical near one half, or an
    uncertain branch. The points of a round are spread out, more along a coordinate with a short length scale. The first
    24 points, and a fraction of all others, are a Sobol' sequence, to find critical regions that the committee does not
    predict.

    While no scenario is critical, the optimizer looks for lower scores: the lowest score so far replaces the threshold.
    While all scenarios are critical, the second highest score replaces the threshold. If scenarios fail, trees learn
    which scenarios fail, and likely failures are avoided.

    With a warm start, the prediction of another study is an additional coordinate (`SourceStudyModel`) of those
    classifiers that predict better with this coordinate. Half of the first 10 points are on the boundary that the other
    study predicts. If the other study predicts the scores of these points well, the classifiers learn from fewer points
    than without a warm start.

    The kernels of the committee are learned again after every ten new scenarios, failed ones too, or when their number
    has grown by a quarter if that is later.

    Parameters
    ----------
    candidates : int, default 4096
        Number of candidates from which the points of a round are chosen; 85 % of them are near critical scenarios.
    filling : float, default 0.15
        Fraction of the points that come from the Sobol' sequence.

    Raises
    ------
    InputError
        An option is out of range.

    Examples
    --------
    >>> import cornercase as cc
    >>> search = cc.optimizers.Committee(filling=0.3)
    >>> str(search)
    'committee:filling=0.3'
    >>> study.explore(search, budget=200)  # doctest: +SKIP
    """

    name = "committee"
    initial = 24
    requires = frozenset({"threshold", "features"})
    relearn_growth = 0.25

    _near_fraction: ClassVar[float] = 0.85
    """Fraction of the candidates near critical scenarios."""

    _model_class: ClassVar[type[CommitteeModel]] = _LargeCommitteeModel

    def __init__(self, candidates: int = 4096, filling: float = 0.15) -> None:
        self._count = check_int("candidates", candidates, 1)
        self._filling = check_float("filling", filling, minimum=0.0, maximum=1.0)

    def prepare(self, space: ParameterSpace, seed: int, threshold: float, features: Sequence[Feature]) -> None:
        """Prepare the search of a space; without `features`, the committee learns from the scores alone."""
        super().prepare(space, seed)
        self._criterion, self._features = Criterion(threshold), tuple(features)
        self._deduplicator = Deduplicator(space)
        self._observed_features: FloatArray | None = np.zeros((0, len(self._features))) if self._features else None
        self._committee: CommitteeModel

    def tell(self, points: FloatArray, scores: FloatArray, features: FloatArray | None = None) -> None:
        """Observe the scores of one round, and the features of its recordings.

        Parameters
        ----------
        points : ndarray of float64, shape (m, d)
        scores : ndarray of float64, shape (m,)
            NaN for a scenario that failed.
        features : ndarray of float64, shape (m, f), optional
            NaN for a scenario that failed.
        """
        super().tell(points, scores)
        self._deduplicator.remember(points)
        self._observed_features = (
            None
            if self._observed_features is None or features is None
            else np.concatenate([self._observed_features, features])
        )

    def _fit_model(self, points: FloatArray, scores: FloatArray, seed: int) -> None:
        self._committee = self._model_class(
            _criterion_between_scores(scores, self._criterion),
            self._features if self._observed_features is not None else (),
            has_prediction=self._source_model is not None,
        )
        self._committee.fit(self._model_coordinates(points), scores, self._features_of_finished(len(points)))

    def _choose_points(self, points: FloatArray, scores: FloatArray, filling: FloatArray, n: int) -> FloatArray:
        candidates = self._draw_near_and_far(filling, n)
        if len(candidates) <= n:
            return candidates
        if len(points):
            self._condition_committee()
        x = encode_points(self._space, candidates)
        probabilities = self._committee.predict(append_source_prediction(self._source_model, x))
        gain = committee_acquisition(*probabilities) * (1.0 - self._failure_probability(x))
        sampled = np.concatenate([self._points, filling])
        sides = coordinate_scales(self._committee.process, x.shape[1])
        return candidates[_choose_spread_out(x * sides, gain, encode_points(self._space, sampled) * sides, sides, n)]

    def _condition_committee(self, count: int | None = None) -> None:
        """Let the committee take all finished ones of the first `count` scenarios into account, with the same kernels.

        By default, all finished scenarios are used.
        """
        finished = np.flatnonzero(self._is_finished[:count])
        self._committee.condition_on(
            self._model_coordinates(self._points[finished]),
            self._scores[finished],
            self._features_of_finished(len(finished)),
        )

    def _features_of_finished(self, count: int) -> FloatArray | None:
        return None if self._observed_features is None else self._observed_features[self._is_finished][:count]

    def _draw_near_and_far(self, filling: FloatArray, n: int) -> FloatArray:
        """Draw candidates all over the space, and candidates near some scenarios that were run.

        These scenarios are all critical scenarios and the scenarios with the lowest score.
        """
        scores = self._scores[self._is_finished]
        critical = self._points[self._is_finished][self._criterion.is_critical(scores) | (scores == scores.min())]
        near = int(self._near_fraction * self._count)
        rng = np.random.default_rng(self._round_seed)
        centers = critical[rng.integers(len(critical), size=near)]
        # Varying deviations, since the size of the critical region is unknown.
        deviations = _MAX_DEVIATION * rng.random((near, 1)) ** 2
        moved = np.clip(centers + deviations * rng.normal(size=centers.shape), 0.0, 1.0)
        everywhere = self._draw_round_candidates(max(self._count - near, n), filling)
        return np.concatenate([everywhere, self._deduplicator.filter(moved, np.concatenate([everywhere, filling]))])

    def _failure_probability(self, encoded_points: FloatArray) -> FloatArray:
        """Return the probability that each scenario fails, shape (m,)."""
        failed = ~self._is_finished
        if not failed.any():
            return np.zeros(len(encoded_points))
        from sklearn.ensemble import ExtraTreesClassifier

        trees = ExtraTreesClassifier(_TREES, random_state=0).fit(encode_points(self._space, self._points), failed)
        probability: FloatArray = trees.predict_proba(encoded_points)[:, trees.classes_].sum(axis=1)
        return probability


def coordinate_scales(process: GaussianProcess, n_coordinates: int) -> FloatArray:
    """Return the factors by which coordinates are multiplied before distances are computed, shape (e,).

    The factor is 1 for the coordinate with the shortest length scale of the process, along which scores change fastest,
    and at most 1 for the others.
    """
    # The prediction of another study is not a coordinate of the space.
    length_scales = process.kernel.length_scales[:n_coordinates]
    return np.asarray(np.maximum(length_scales.min() / length_scales, _MIN_SIDE))


def committee_acquisition(p_critical: FloatArray, p_likeliest_branch: FloatArray) -> FloatArray:
    """Return how informative scenarios are expected to be, shape (m,).

    The value is high if it is uncertain whether a scenario is critical, or to which branch it belongs. `p_critical`,
    shape (m,), is the probability of being critical. `p_likeliest_branch`, shape (m,), is the probability of the
    likeliest branch.
    """
    return np.maximum(0.5 - np.abs(p_critical - 0.5), _BRANCH_WEIGHT * (1.0 - p_likeliest_branch))


def _criterion_between_scores(scores: FloatArray, criterion: Criterion) -> Criterion:
    """Return the criterion if there are scores on both sides of its threshold.

    Otherwise return the criterion with the nearest threshold that has scores on both sides.
    """
    lowest, below_highest = np.unique(scores)[[0, -2]]
    return Criterion(float(min(max(criterion.oriented, lowest), below_highest)))


def _choose_spread_out(
    points: FloatArray, gain: FloatArray, sampled: FloatArray, sides: FloatArray, n: int
) -> IntArray:
    """Choose `n` of the points (m, e), one after the other, by the largest product of gain (m,) and distance.

    The distance is the one to the nearest point that is in `sampled` (k, e) or was chosen before. The points lie in a
    box with the lengths of sides `sides` (e,). A distance counts at most as much as the distance between neighbours if
    the sampled points were spread evenly in this box: beyond that, only the gain matters.
    """
    # Points this far apart do not differ along short sides: use the longest sides, as many as maximize the spacing.
    longest = np.sort(sides)[::-1]
    spacing = ((np.cumprod(longest) / len(sampled)) ** (1.0 / np.arange(1, len(sides) + 1))).max()
    return choose_by_gain_and_distance(points, gain, np.minimum(cKDTree(sampled).query(points)[0], spacing), n)


def choose_by_gain_and_distance(points: FloatArray, gain: FloatArray, distance: FloatArray, n: int) -> IntArray:
    """Choose `n` of the points (m, e), one after the other, by the largest product of gain (m,) and distance (m,).

    `distance` is the distance to the nearest known point. Each chosen point becomes a known point.
    """
    selected: list[int] = []
    for _ in range(n):
        value = gain * distance
        value[selected] = -1.0
        selected.append(int(np.argmax(value)))
        distance = np.minimum(distance, np.linalg.norm(points - points[selected[-1]], axis=1))
    return np.array(selected, dtype=np.int64)
