"""Committee of classifiers that predicts which scenarios are critical."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar, Final, Self

import numpy as np
from scipy.special import ndtr

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.evidence._feature_models import FeatureKernels, PerBranchFeatureModels
from cornercase.evidence.gp._gaussian_process import GaussianProcess, fit_boundary_process, squash_around_threshold
from cornercase.evidence.gp._matern_kernel import evenly_spaced_indices, indices_with_rare_values
from cornercase.metrics import Feature
from cornercase.study._criterion import Criterion

PREDICTED_CRITICAL: Final = 0.45
"""Probability from which a scenario is predicted critical: half of the F1 score, 0.9, that a search aims at.

The set with the best F1 score contains all scenarios whose probability is at least half of that score: Z. C. Lipton,
C. Elkan, B. Naryanaswamy, "Optimal thresholding of classifiers to maximize F1 measure", ECML PKDD (2014).
"""

if TYPE_CHECKING:
    from sklearn.ensemble import ExtraTreesRegressor, RandomForestRegressor

_FOLDS: Final = 5
# For the weights of the members: EM steps, and prior count of scenarios for each member.
_EM_STEPS, _PRIOR_COUNT = 30, 2.0
_MIN_PROBABILITY: Final = 0.01  # probabilities of members are clipped to this
# Features that hardly depend on the parameters or are redundant: with them trees find the boundary no better.
_UNUSED_FEATURES: Final = frozenset(
    {
        *("nearest-cos", "nearest-sin", "nearest-ego-speed", "nearest-other-speed", "nearest-way"),
        *("crossing-distance", "turn-time", "turn-way", "duration", "way", "contact"),
    }
)


class CommitteeModel:
    """Committee of three classifiers that predicts the probability that a scenario is critical.

    1. Extremely randomised trees on the parameters and predicted features of the recordings. A score jumps between the
       branches of a scenario, such as the other entity going first; features tell the branches apart. Gaussian
       processes predict the features of each scenario from all other scenarios, and from the scenarios of each branch
       (`PerBranchFeatureModels`). Without features, trees use the score instead.
    2. A random forest on the parameters, which follows jumps too.
    3. The Gaussian process of `fit_boundary_process`, which is best at smooth boundaries.

    The prediction is a weighted mean of the three probabilities. The weights maximize the likelihood of the known
    outcomes for out-of-fold predictions.

    `fit` learns everything; `condition_on` updates the data at less cost. With more than 256 scenarios the processes
    of the features use 256: half of them nearest to the threshold, the others evenly spaced among the rest. Their
    kernels are learned from at most 120. Trees use at most 4,000 scenarios: half of them nearest to the threshold, the
    others preferably of the rarer class. The process of the scores uses all scenarios.

    A subclass may use more scenarios (`max_process_scenarios`, `max_kernel_scenarios`) and more trees (`n_trees`, and
    `n_trees_per_fold` out of fold). With `may_be_alone`, a single classifier predicts if its out-of-fold log loss is
    less than the loss of all three together. Trees and a forest that do not predict are then not trained until the next
    `fit`.

    `columns` describes the features. `has_prediction` says whether the last coordinate of points is the prediction of
    another study (`SourceStudyModel`). Trees and the processes of features use this prediction only if a random forest
    with the prediction is clearly better at the known outcomes than a forest without the prediction. The Gaussian
    process of the scores has its own test (`fit_boundary_process`). `process` is this third classifier.

    Source: H. S. Seung, M. Opper, H. Sompolinsky, "Query by committee", COLT (1992); P. Geurts, D. Ernst, L. Wehenkel,
    "Extremely randomized trees", Machine Learning 63 (2006); D. H. Wolpert, "Stacked generalization", Neural Networks 5
    (1992).
    """

    max_process_scenarios: ClassVar[int] = 256
    max_tree_scenarios: ClassVar[int] = 4000
    max_kernel_scenarios: ClassVar[int | None] = 120
    n_trees: ClassVar[int] = 32
    n_trees_per_fold: ClassVar[int] = 16
    may_be_alone: ClassVar[bool] = False

    def __init__(
        self, criterion: Criterion, columns: Sequence[Feature] = (), seed: int = 0, *, has_prediction: bool = False
    ) -> None:
        self._criterion, self._seed, self._has_prediction = criterion, seed, has_prediction
        self._inputs = [j for j, feature in enumerate(columns) if feature.name not in _UNUSED_FEATURES]
        self._branches = [j for j, feature in enumerate(columns) if feature.branch]
        self._drops_prediction = False
        self.process: GaussianProcess
        self._feature_models: PerBranchFeatureModels
        # Of trees on features, forest and process.
        self._weights: FloatArray
        # Out-of-fold probabilities by each of them; None if unknown since `condition_on`.
        self._by_member: FloatArray | None

    def fit(self, points: FloatArray, scores: FloatArray, features: FloatArray | None = None) -> Self:
        """Learn kernels and weights from points (n, e), scores (n,) and features (n, f).

        The scores are finite and not all equal.
        """
        self.process = fit_boundary_process(points, scores, self._criterion, has_prediction=self._has_prediction)
        self._weights = np.ones(3)
        self._drops_prediction = self._has_prediction and not self._source_prediction_helps(points, scores)
        self._learn_features(points, scores, features)
        self._kernels = self._feature_models.kernels
        by_member = self._out_of_fold_by_member()
        self._weights = _fit_member_weights(by_member, self._critical)
        if self.may_be_alone:
            losses = _log_losses(np.column_stack([by_member, by_member @ self._weights]), self._critical)
            if (best := int(np.argmin(losses))) < len(self._weights):
                self._weights = np.eye(len(self._weights))[best]
        self._by_member = by_member
        self._trees, self._forest = self._train_trees(np.arange(len(self._points)), self.n_trees)
        return self

    def condition_on(self, points: FloatArray, scores: FloatArray, features: FloatArray | None = None) -> Self:
        """Replace the known scenarios, but keep the learned kernels and weights; arguments as for `fit`."""
        self.process.condition_on_scores(points, scores, self._criterion)
        self._by_member = None
        if not self.is_process_alone:
            # Those of a branch that appeared since are learned each time, so that earlier calls do not matter.
            self._learn_features(points, scores, features, self._kernels)
            self._trees, self._forest = self._train_trees(np.arange(len(self._points)), self.n_trees)
        return self

    @property
    def is_process_alone(self) -> bool:
        """True if the Gaussian process predicts alone, because both other classifiers have weight 0."""
        return not self._weights[:2].any()

    def _learn_features(
        self,
        points: FloatArray,
        scores: FloatArray,
        features: FloatArray | None,
        kernels: Mapping[int | None, FeatureKernels] | None = None,
    ) -> None:
        """Train the feature processes, and store the columns and classes from which the trees learn.

        If there are many scenarios, only a subset of them is used. Kernels that are not given are learned.
        """
        self._all_points, self._tree_scenarios = points, self._select_tree_scenarios(scores)
        points, scores = self._tree_coordinates(points)[self._tree_scenarios], scores[self._tree_scenarios]
        features = None if features is None else features[self._tree_scenarios]
        inputs, subset = self._feature_inputs(scores, features), self._select_process_scenarios(scores)
        self._critical, self._classes = self._criterion.is_critical(scores), self._class_labels(scores, features)
        self._labels = np.unique(self._classes)
        self._feature_models = PerBranchFeatureModels(
            points, inputs, self._classes // 2, kernels, subset, self.max_kernel_scenarios
        )
        self._points, self._columns = points, np.hstack([points, self._feature_models.leave_one_out])

    def predict(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the probability that each point is critical, and the probability of its likeliest branch, (m,) each.

        A branch is a course of events, such as the other entity going first. Without trees on features, the second
        result is 1.
        """
        mean, deviation = self.process.predict(points)
        critical, classes = self._combine_members(points, mean / np.hypot(deviation, self.process.kernel.noise))
        if self._trees is None:
            return critical, np.ones(len(points))
        branches = self._labels // 2
        by_branch = np.stack([classes[:, branches == branch].sum(axis=1) for branch in np.unique(branches)])
        return critical, np.minimum(by_branch.max(axis=0), 1.0)

    def _combine_members(self, points: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the weighted probability of being critical (m,), and the probability of each class (m, classes).

        `t` (m,) is the distance from the threshold, in standard deviations, that the process of the scores predicts; it
        is negative on the critical side.
        Without trees on features there are no classes.
        """
        points = self._tree_coordinates(points)
        classes, by_member = np.empty((len(points), 0)), [np.zeros(len(points)), np.zeros(len(points)), ndtr(-t)]
        if self._trees is not None:
            classes = _class_probabilities(
                self._trees, np.hstack([points, self._feature_models.predict_features(points)])
            )
            by_member[0] = self._critical_probability(classes)
        if self._forest is not None:
            by_member[1] = self._forest.predict(points)
        return np.asarray(self._weights @ np.stack(by_member)), classes

    def out_of_fold_probability(self) -> FloatArray:
        """Return the probability that each known scenario is critical, predicted from other scenarios, (n,).

        Trees are trained without the scenario's cross-validation fold; the Gaussian process uses all other scenarios.
        """
        if self.is_process_alone:
            mean, deviation = self.process.leave_one_out()
            return np.asarray(ndtr(-mean / deviation))
        if self._by_member is None:
            self._by_member = self._out_of_fold_by_member()
        probability = np.empty(len(self._all_points))
        probability[self._tree_scenarios] = self._by_member @ self._weights
        # The trees were not trained on the rest, so no folds are needed there.
        rest = np.setdiff1d(np.arange(len(probability)), self._tree_scenarios)
        if len(rest):
            mean, deviation = self.process.leave_one_out(rest)
            probability[rest] = self._combine_members(self._all_points[rest], mean / deviation)[0]
        return probability

    def _out_of_fold_by_member(self) -> FloatArray:
        """Return each classifier's out-of-fold probability of being critical, (n, 3), for scenarios that trees use."""
        mean, deviation = self.process.leave_one_out(self._tree_scenarios)
        probability: FloatArray = np.stack([np.zeros(len(mean)), np.zeros(len(mean)), ndtr(-mean / deviation)], axis=1)
        for train, test in self._train_test_folds(self._critical):
            trees, forest = self._train_trees(train, self.n_trees_per_fold)
            if trees is not None:
                probability[test, 0] = self._critical_probability(_class_probabilities(trees, self._columns[test]))
            if forest is not None:
                probability[test, 1] = forest.predict(self._points[test])
        return probability

    def _source_prediction_helps(self, points: FloatArray, scores: FloatArray) -> bool:
        """Return whether another study's prediction improves a random forest by more than one standard error.

        Forests with and without the prediction are compared by the log loss of scenarios outside of their fold. One
        standard error is the rule of L. Breiman et al., "Classification and regression trees" (1984), section 3.4.3.
        """
        from sklearn.ensemble import RandomForestRegressor

        selected = self._select_tree_scenarios(scores)
        points, critical = points[selected], self._criterion.is_critical(scores[selected])
        probability = np.zeros((len(points), 2))
        for train, test in self._train_test_folds(critical):
            for k, coordinates in enumerate((points[:, :-1], points)):
                # Every split considers all coordinates, so that both forests differ by the prediction alone.
                forest = RandomForestRegressor(self.n_trees, max_features=None, random_state=self._seed)
                forest.fit(coordinates[train], critical[train])
                probability[test, k] = forest.predict(coordinates[test])
        gain = np.diff(np.log(_likelihoods(probability, critical)), axis=1)
        return bool(gain.mean() > gain.std() / np.sqrt(len(gain)))

    def _tree_coordinates(self, points: FloatArray) -> FloatArray:
        """Drop the prediction of another study from the coordinates if it does not help trees and feature processes."""
        return points[:, :-1] if self._drops_prediction else points

    def _train_test_folds(self, critical: BoolArray) -> Iterator[tuple[IntArray, IntArray]]:
        smallest_class = int(np.bincount(critical, minlength=2).min())
        if smallest_class < 2:
            # A class of one scenario cannot be stratified.
            indices = np.arange(len(critical))
            order = np.random.default_rng(self._seed).permutation(indices)
            parts = np.array_split(order, min(_FOLDS, len(indices)))
            return ((np.setdiff1d(indices, part), part) for part in parts)
        from sklearn.model_selection import StratifiedKFold

        folds = StratifiedKFold(min(_FOLDS, smallest_class), shuffle=True, random_state=self._seed)
        return iter(folds.split(critical, critical))

    def _train_trees(
        self, indices: IntArray, n_trees: int
    ) -> tuple[ExtraTreesRegressor | None, RandomForestRegressor | None]:
        """Train trees from parameters and predicted features to classes, and a forest from parameters to criticality.

        A model whose weight in the committee is 0 is not trained, and None is returned for it. The trees regress
        indicators of the classes, which is faster than classification. Both give the same trees, since the split with
        the least Gini impurity also has the least variance of the indicators.
        """
        from sklearn.ensemble import ExtraTreesRegressor, RandomForestRegressor

        trees = forest = None
        if self._weights[0] > 0.0:
            # Every split considers all features, since few of them tell the branches of a scenario apart.
            trees = ExtraTreesRegressor(n_trees, max_features=None, random_state=self._seed)
            trees.fit(self._columns[indices], self._classes[indices, None] == self._labels)
        if self._weights[1] > 0.0:
            forest = RandomForestRegressor(n_trees, max_features="sqrt", random_state=self._seed)
            forest.fit(self._points[indices], self._critical[indices])
        return trees, forest

    def _critical_probability(self, class_probabilities: FloatArray) -> FloatArray:
        """Return the probability of being critical, (m,): the sum of the probabilities of the critical classes."""
        return np.asarray(np.minimum(class_probabilities[:, self._labels % 2 == 1].sum(axis=1), 1.0))

    def _select_tree_scenarios(self, scores: FloatArray) -> IntArray:
        """Return the indices of the scenarios that trees use: all scenarios, or a part if there are very many.

        Half of this part is nearest to the threshold, and the other half is preferably of the rarer class.
        """
        if len(scores) <= self.max_tree_scenarios:
            return np.arange(len(scores))
        near, rest = self._split_by_threshold_distance(scores, self.max_tree_scenarios // 2)
        critical = self._criterion.is_critical(scores[rest])
        rare = critical if 2 * critical.sum() < len(critical) else ~critical
        return np.sort(
            np.concatenate([near, rest[indices_with_rare_values(len(rest), self.max_tree_scenarios - len(near), rare)]])
        )

    def _select_process_scenarios(self, scores: FloatArray) -> IntArray | None:
        """Return the indices of the scenarios that the feature processes use; None stands for all scenarios.

        If there are many scenarios, one half of the selected scenarios are those nearest to the threshold. The other
        half is evenly spaced among the rest.
        """
        if len(scores) <= self.max_process_scenarios:
            return None
        near, rest = self._split_by_threshold_distance(scores, self.max_process_scenarios // 2)
        return np.sort(
            np.concatenate([near, rest[evenly_spaced_indices(len(rest), self.max_process_scenarios - len(near))]])
        )

    def _split_by_threshold_distance(self, scores: FloatArray, count: int) -> tuple[IntArray, IntArray]:
        """Return the indices of the `count` scores nearest to the threshold, and all other indices in order."""
        order = np.argsort(np.abs(self._criterion.margins(scores)), kind="stable")
        return order[:count], np.sort(order[count:])

    def _feature_inputs(self, scores: FloatArray, features: FloatArray | None) -> FloatArray:
        if features is None or not self._inputs:
            return squash_around_threshold(scores, self._criterion, self.process.squash_scale)[:, None]
        return features[:, self._inputs]

    def _class_labels(self, scores: FloatArray, features: FloatArray | None) -> IntArray:
        """Return the number of each scenario's class: bit 0 is set if the scenario is critical.

        Each further bit is set if a feature that tells branches apart is above 0.
        """
        classes = self._criterion.is_critical(scores).astype(np.int64)
        if features is not None:
            for k, j in enumerate(self._branches):
                classes += 2 ** (k + 1) * (features[:, j] > 0.0)
        return classes


def _class_probabilities(trees: ExtraTreesRegressor, columns: FloatArray) -> FloatArray:
    """Return the probability of each class (m, classes) that trees predict from `columns` (m, k)."""
    return np.asarray(trees.predict(columns)).reshape(len(columns), -1)


def _likelihoods(probabilities: FloatArray, critical: BoolArray) -> FloatArray:
    """Return each outcome's probability by each classifier, (n, k), from probabilities (n, k) of being critical."""
    return np.clip(np.where(critical[:, None], probabilities, 1.0 - probabilities), _MIN_PROBABILITY, 1.0)


def _log_losses(probabilities: FloatArray, critical: BoolArray) -> FloatArray:
    """Return the log loss of each classifier, (k,), from its probabilities (n, k) of being critical."""
    return np.asarray(-np.log(_likelihoods(probabilities, critical)).mean(axis=0))


def _fit_member_weights(by_member: FloatArray, critical: BoolArray) -> FloatArray:
    """Fit weights of classifiers, so that the weighted mean of their probabilities makes the outcomes most likely.

    `by_member` (n, k) holds the probabilities of being critical. The method is expectation maximization for a mixture.
    """
    likelihood = _likelihoods(by_member, critical)
    weights = np.full(likelihood.shape[1], 1.0 / likelihood.shape[1])
    for _ in range(_EM_STEPS):
        joint = weights * likelihood
        weights = (joint / joint.sum(axis=1, keepdims=True)).sum(axis=0) + _PRIOR_COUNT
        weights /= weights.sum()
    return weights
