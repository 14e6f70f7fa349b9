"""What several ways to tell critical scenarios from others say together."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import ndtr

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.evidence.foretold import ForetoldByWay, Kernels
from cornercase.evidence.gaussian_process import GaussianProcess, boundary_process, near_threshold
from cornercase.evidence.kernel import chosen, evenly
from cornercase.metrics import Feature

MOST_KNOWN: Final = 2000
"""Scenarios that the processes of features know at most."""

MOST_GROWN: Final = 4000
"""Scenarios that trees are grown from at most."""

FOUND: Final = 0.45
"""Probability from which on a scenario counts as found: half of the F1 score, 0.9, that a search is to reach.

Of all sets that are told by probabilities, the one with the best F1 score ends where the probability is half of that
score: Z. C. Lipton, C. Elkan, B. Naryanaswamy, "Optimal thresholding of classifiers to maximize F1 measure", ECML PKDD
(2014).
"""

if TYPE_CHECKING:
    from sklearn.ensemble import ExtraTreesClassifier, RandomForestClassifier

_TREES: Final = 64
_FOLDS: Final = 5
# Trees of each member by which members are weighed, rounds of doing so, and scenarios that speak for each beforehand.
_FEW_TREES, _WEIGHINGS, _BEFOREHAND = 24, 30, 2.0
# The least probability that a member is taken to mean.
_LEAST: Final = 0.01
# Features that hardly follow the parameters, or say again what others do: with them trees find the boundary less well,
# or no better.
_NOT_LEARNED: Final = frozenset(
    {
        *("nearest-cos", "nearest-sin", "nearest-ego-speed", "nearest-other-speed", "nearest-way"),
        *("crossing-distance", "turn-time", "turn-way", "duration", "way", "contact"),
    }
)


class Committee:
    """Tells which scenarios are critical by the weighed probabilities of three members.

    The first member learns from what happened in the runs. A score jumps where a scenario goes another way, such as
    where the other goes first; features of the recordings, as how near both come and when, tell the ways apart. So
    Gaussian processes predict the features of each scenario from those of all others, and from those that went each way
    alone (`ForetoldByWay`), and extremely randomised trees learn from the predicted features and the parameters what is
    critical. Where there are no features, the score stands for them. The second member is a random forest of the
    parameters, which follows jumps too; the third the `boundary_process`, which knows smooth boundaries best.

    The members are weighed by what they say of the scenarios that are known, each told by others: such that their
    weighed mean is most likely.

    `fit` does all; `know` takes further scenarios in for less. Of more than 2,000 scenarios the processes of features
    know 2,000: half of them next to the threshold, the others evenly apart among the rest. Trees are grown from 4,000
    at most: half of them next to the threshold, and of the rest those first that are rarer, critical or not. So what it
    takes does not grow further; the `boundary_process` knows all.

    Parameters
    ----------
    threshold : float
        Score up to which a scenario is critical.
    columns : sequence of Feature, optional
        What each column of the features is.
    seed : int, default 0
    foretold : bool, default False
        Whether the last coordinate of points is what another study predicts, as of `Elsewhere`.

    Attributes
    ----------
    process : GaussianProcess
        The third member.

    Notes
    -----
    Source: H. S. Seung, M. Opper, H. Sompolinsky, "Query by committee", COLT (1992); P. Geurts, D. Ernst, L. Wehenkel,
    "Extremely randomized trees", Machine Learning 63 (2006); D. H. Wolpert, "Stacked generalization", Neural Networks 5
    (1992).
    """

    def __init__(
        self, threshold: float, columns: Sequence[Feature] = (), seed: int = 0, *, foretold: bool = False
    ) -> None:
        self._threshold, self._seed, self._from_elsewhere = threshold, seed, foretold
        self._inputs = [j for j, one in enumerate(columns) if one.name not in _NOT_LEARNED]
        self._branches = [j for j, one in enumerate(columns) if one.branch]
        self.process: GaussianProcess
        self._foretold: ForetoldByWay

    def fit(self, points: FloatArray, scores: FloatArray, features: FloatArray | None = None) -> Committee:
        """Learn the kernels of the processes and the weights of the members, and know scenarios.

        Parameters
        ----------
        points : ndarray of float64, shape (n, e)
            As `encoded`.
        scores : ndarray of float64, shape (n,)
            Finite; not all the same.
        features : ndarray of float64, shape (n, f), optional
            Features of the recordings.

        Returns
        -------
        Committee
            Itself.
        """
        self.process = boundary_process(points, scores, self._threshold, foretold=self._from_elsewhere)
        self._grow(points, scores, features)
        self._weights = _weights(self._left_out(_FEW_TREES), self._critical)
        return self

    def know(self, points: FloatArray, scores: FloatArray, features: FloatArray | None = None) -> Committee:
        """Take scenarios in, instead of those before, with the kernels and the weights at hand.

        Parameters
        ----------
        points : ndarray of float64, shape (n, e)
        scores : ndarray of float64, shape (n,)
            Finite.
        features : ndarray of float64, shape (n, f), optional

        Returns
        -------
        Committee
            Itself.
        """
        self.process.know_scores(points, scores, self._threshold)
        self._grow(points, scores, features, self._foretold.kernels)
        return self

    def _grow(
        self,
        points: FloatArray,
        scores: FloatArray,
        features: FloatArray | None,
        kernels: Mapping[int | None, Kernels] | None = None,
    ) -> None:
        """Grow the trees, of all scenarios that are known now or of many of them; kernels of features are learned."""
        self._every, self._some = points, self._known_by_trees(scores)
        points, scores = points[self._some], scores[self._some]
        features = None if features is None else features[self._some]
        learned_from, known = self._learned_from(scores, features), self._known_by_processes(scores)
        self._critical, self._kinds = scores <= self._threshold, self._kinds_of(scores, features)
        self._foretold = ForetoldByWay(points, learned_from, self._kinds // 2, kernels, known)
        self._points, self._columns = points, np.hstack([points, self._foretold.left_out])
        self._trees, self._forest = self._grown(np.arange(len(points)), _TREES)

    def predict(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Tell what would happen in scenarios.

        Parameters
        ----------
        points : ndarray of float64, shape (m, e)

        Returns
        -------
        critical : ndarray of float64, shape (m,)
            Probability that it is critical.
        branch : ndarray of float64, shape (m,)
            Probability of the likeliest way that it can go, of those that the features tell apart.
        """
        mean, deviation = self.process.predict(points)
        critical, kinds = self._together(points, mean / np.hypot(deviation, self.process.kernel.noise))
        ways = self._trees.classes_ // 2
        by_way = np.stack([kinds[:, ways == way].sum(axis=1) for way in np.unique(ways)])
        return critical, np.minimum(by_way.max(axis=0), 1.0)

    def _together(self, points: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Weighed probability of being critical, and that of each kind; the process is t deviations above 0."""
        kinds = self._trees.predict_proba(np.hstack([points, self._foretold.predict(points)]))
        by_member = [_of_kinds(self._trees, kinds), _of_sides(self._forest, points), ndtr(-t)]
        return np.asarray(self._weights @ np.stack(by_member)), kinds

    def out_of_fold(self) -> FloatArray:
        """Tell of each scenario that is known by others whether it is critical.

        Returns
        -------
        ndarray of float64, shape (n,)
            Probability that it is critical: by trees that were grown without a fifth of the scenarios in which it is,
            and by the process of all others.
        """
        found = np.empty(len(self._every))
        found[self._some] = self._left_out(_TREES) @ self._weights
        # What the trees were not grown from they tell without it anyway.
        rest = np.setdiff1d(np.arange(len(found)), self._some)
        if len(rest):
            mean, deviation = self.process.leave_one_out(rest)
            found[rest] = self._together(self._every[rest], mean / deviation)[0]
        return found

    def _left_out(self, count: int) -> FloatArray:
        """What each member says of scenarios that trees know, told by others, shape (n, 3); `count` trees each."""
        mean, deviation = self.process.leave_one_out(self._some)
        found: FloatArray = np.stack([np.empty(len(mean)), np.empty(len(mean)), ndtr(-mean / deviation)], axis=1)
        for rest, some in self._folds():
            trees, forest = self._grown(rest, count)
            found[some, 0] = _of_kinds(trees, trees.predict_proba(self._columns[some]))
            found[some, 1] = _of_sides(forest, self._points[some])
        return found

    def _folds(self) -> Iterator[tuple[IntArray, IntArray]]:
        fewest = int(np.bincount(self._critical, minlength=2).min())
        if fewest < 2:
            # A lone scenario of its side has to be left out by itself: none of the others says that there is one.
            every = np.arange(len(self._points))
            parts = np.array_split(np.random.default_rng(self._seed).permutation(every), _FOLDS)
            return ((np.setdiff1d(every, part), part) for part in parts)
        from sklearn.model_selection import StratifiedKFold

        folds = StratifiedKFold(min(_FOLDS, fewest), shuffle=True, random_state=self._seed)
        return iter(folds.split(self._points, self._critical))

    def _grown(self, some: IntArray, count: int) -> tuple[ExtraTreesClassifier, RandomForestClassifier]:
        """Trees of the predicted features, which tell kinds, and a forest of the parameters, which tells critical."""
        from sklearn.ensemble import ExtraTreesClassifier, RandomForestClassifier

        # Of all features the best one is taken at each fork: few of them tell the ways of a scenario apart.
        trees = ExtraTreesClassifier(count, max_features=None, random_state=self._seed)
        forest = RandomForestClassifier(count, random_state=self._seed)
        return trees.fit(self._columns[some], self._kinds[some]), forest.fit(self._points[some], self._critical[some])

    def _known_by_trees(self, scores: FloatArray) -> IntArray:
        """Scenarios that trees are grown from: of many those next to the threshold, and others, rare ones first."""
        if len(scores) <= MOST_GROWN:
            return np.arange(len(scores))
        order = np.argsort(np.abs(scores - self._threshold), kind="stable")
        near, rest = order[: MOST_GROWN // 2], np.sort(order[MOST_GROWN // 2 :])
        critical = scores[rest] <= self._threshold
        rare = critical if 2 * critical.sum() < len(critical) else ~critical
        return np.sort(np.concatenate([near, rest[chosen(len(rest), MOST_GROWN - len(near), rare)]]))

    def _known_by_processes(self, scores: FloatArray) -> IntArray | None:
        """Scenarios that the processes of features know: of many those next to the threshold, and evenly others."""
        if len(scores) <= MOST_KNOWN:
            return None
        order = np.argsort(np.abs(scores - self._threshold), kind="stable")
        near, rest = order[: MOST_KNOWN // 2], np.sort(order[MOST_KNOWN // 2 :])
        return np.sort(np.concatenate([near, rest[evenly(len(rest), MOST_KNOWN - len(near))]]))

    def _learned_from(self, scores: FloatArray, features: FloatArray | None) -> FloatArray:
        if features is None or not self._inputs:
            return near_threshold(scores, self._threshold, self.process.near)[:, None]
        return features[:, self._inputs]

    def _kinds_of(self, scores: FloatArray, features: FloatArray | None) -> IntArray:
        """Numbers of what scenarios are: odd where critical, and apart where they go different ways."""
        critical: BoolArray = scores <= self._threshold
        kinds = critical.astype(np.int64)
        if features is not None:
            for k, j in enumerate(self._branches):
                kinds += 2 ** (k + 1) * (features[:, j] > 0.0)
        return kinds


def _of_kinds(trees: ExtraTreesClassifier, kinds: FloatArray) -> FloatArray:
    """Probability of being critical, of probabilities of kinds."""
    return np.asarray(np.minimum(kinds[:, trees.classes_ % 2 == 1].sum(axis=1), 1.0))


def _of_sides(forest: RandomForestClassifier, points: FloatArray) -> FloatArray:
    """Probability of being critical, by a forest that may know one side only."""
    return np.asarray(forest.predict_proba(points)[:, forest.classes_].sum(axis=1))


def _weights(by_member: FloatArray, critical: BoolArray) -> FloatArray:
    """Weights of members, with which their mean says best what is critical: as of a mixture, by its likelihood."""
    right = np.clip(np.where(critical[:, None], by_member, 1.0 - by_member), _LEAST, 1.0)
    weights = np.full(right.shape[1], 1.0 / right.shape[1])
    for _ in range(_WEIGHINGS):
        shares = weights * right
        weights = (shares / shares.sum(axis=1, keepdims=True)).sum(axis=0) + _BEFOREHAND
        weights /= weights.sum()
    return weights
