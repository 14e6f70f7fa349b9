"""Estimate of the critical fraction of a parameter space, and of the part that an exploration may have missed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Final

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.special import ndtri

from cornercase._common.numba.blas import single_threaded_blas
from cornercase._common.row_keys import row_keys
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.evidence._committee import PREDICTED_CRITICAL, CommitteeModel
from cornercase.evidence._critical_set_draws import N_DRAWS, CriticalSetDraws
from cornercase.evidence._interval_estimate import Estimate
from cornercase.evidence._multi_fidelity import SourceStudyModel, append_source_prediction
from cornercase.evidence._out_of_sample import cross_validate_scores
from cornercase.evidence._probit_calibration import (
    SURPRISE_RATES,
    CalibrationPrior,
    ProbitCalibration,
    draw_stratified_indices,
)
from cornercase.evidence._proportions import anytime_upper_bound, proportion_interval
from cornercase.evidence._space_sample import SpaceSample
from cornercase.evidence.gp._gaussian_process import (
    encode_points,
    fit_boundary_process,
    require_enough_scores,
    squash_around_threshold,
)
from cornercase.evidence.gp._triangular_products import multiply_lower_triangular
from cornercase.metrics import Feature
from cornercase.scenario import ParameterSpace
from cornercase.study._criterion import Criterion

# Number of points for which critical sets are drawn jointly.
_JOINT_POINTS: Final = 1000
# Added to the standard deviation of outcomes, so that some nearly certain points are sampled too.
_MIN_DEVIATION: Final = 0.02
# Least number, for intervals, of scenarios chosen independently of scores. How many of them are critical does not
# matter, on the halves "train" of benchmarks/calibration.py and "choose" of benchmarks/intervals.py.
_MIN_SCENARIOS: Final = 20
# Weight of one prediction in the likelihood; below 1 because errors of neighbouring predictions are correlated. Chosen
# on the halves "choose" of benchmarks/calibration.py and benchmarks/intervals.py.
_PREDICTION_WEIGHT: Final = 0.5
# The same for predictions of scenarios that a search chose, which lie nearer to each other.
_CHOSEN_WEIGHT: Final = 0.25
# Prior of the calibration of the Gaussian process, and of a committee, which is rarely wrong by as much: offsets and
# slopes that would be right on the 12 scenarios of the half "choose" of benchmarks/intervals.py, with somewhat larger
# deviations.
_PROCESS_PRIOR: Final = CalibrationPrior()
_COMMITTEE_PRIOR: Final = CalibrationPrior(-0.1, 0.6, 0.6, 0.6, 0.2)
# The probability of surprises decreases in proportion if predictions from other scenarios leave less than this fraction
# of the variance of the scores unexplained. Chosen on the half "choose" of benchmarks/intervals.py.
_UNEXPLAINED: Final = 0.1
# Prior probability that there is a critical region to which no score points.
_P_HIDDEN: Final = 0.5
# Probability that a hidden region at a random place contains no scenario that was run.
_ESCAPE_PROBABILITY: Final = 0.05
# Probabilities are clipped to this and to one minus this.
_MIN_PROBABILITY: Final = 1e-3

MIN_REGION_FRACTION: Final = 0.01
"""Default of the smallest fraction of the space that counts as a region."""
DEFAULT_CONFIDENCE: Final = 0.95
"""Default probability with which the missed fraction is below its upper bound."""
# Greatest difference of ranks up to which two calibrations count as the same.
_MAX_RANK_DIFFERENCE: Final = 10
# Draws whose connected regions are found in one go.
_DRAWS_AT_ONCE: Final = 40


class CriticalSet:
    """Estimate of the set of all critical scenarios of a space, from the scenarios that were run.

    A Gaussian process of the scores (`fit_boundary_process`) predicts each scenario of the initial design from all
    others of `points`, and each audit (scenario drawn at random as a check) from all of `points`. The quality of these
    predictions calibrates the probability that a scenario is critical (`ProbitCalibration`). Critical sets are drawn
    with these probabilities. The correlation between points is that of the process. Each draw has its own calibration,
    from the posterior of the calibration.

    A critical scenario counts as found if it is one of `points`, or if the mean of the process there is at or beyond
    the threshold.
    Audits never affect what is found. With `features`, a `CommitteeModel` of three classifiers, including the
    process, predicts instead of the process alone. A scenario then counts as found if the predicted probability is at
    least `PREDICTED_CRITICAL`. The committee's predictions of the scenarios that the search chose calibrate the
    probability, too. The process still provides the correlation.

    `points` (n, d) were run and have `scores` (n,); lower is more critical, NaN for a failed scenario. `initial_design`
    (n,) marks the scenarios chosen independently of scores, by default all. `audits` are random points and their
    scores, which the optimizer has not observed. `features` are the columns and their values (n, f). `source_model`
    adds the prediction of another study as a coordinate of the process. The coordinate is dropped if it misleads.
    Outcomes of the other study are never used for the calibration. `sample` is ``SpaceSample.from_space(space, seed)``
    if the caller already has it. ValueError if there are fewer than 10 scores, or all are the same.

    Leave-one-out prediction: C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning" (2006),
    equation 5.12.
    """

    def __init__(
        self,
        space: ParameterSpace,
        points: FloatArray,
        scores: FloatArray,
        criterion: Criterion,
        seed: int = 0,
        *,
        initial_design: BoolArray | None = None,
        audits: tuple[FloatArray, FloatArray] | None = None,
        features: tuple[Sequence[Feature], FloatArray] | None = None,
        source_model: SourceStudyModel | None = None,
        sample: SpaceSample | None = None,
    ) -> None:
        finished = np.isfinite(scores)
        self._is_initial_design = (
            np.ones(int(finished.sum()), dtype=np.bool_) if initial_design is None else initial_design[finished]
        )
        points, scores = require_enough_scores(points, scores)
        self._space, self._seed = space, seed
        self._critical = criterion.is_critical(scores)
        self._sample = SpaceSample.from_space(space, seed) if sample is None else sample
        self._encoded_points, self._source_model = encode_points(space, points), source_model
        coordinates, has_prediction = (
            append_source_prediction(source_model, self._encoded_points),
            source_model is not None,
        )
        self._committee: CommitteeModel | None = None
        if features is not None and 0 < self._critical.sum() < len(scores):
            columns, values = features
            self._committee = CommitteeModel(criterion, columns, seed, has_prediction=has_prediction)
            self._committee.fit(coordinates, scores, values[finished])
            self._process = self._committee.process
        else:
            self._process = fit_boundary_process(coordinates, scores, criterion, has_prediction=has_prediction)
        mean, self._z = self._predict_margin_and_deviate(self._sample.encoded_points)
        self._outcome_by_key = dict(
            zip(row_keys(space.snap(points)), np.where(self._critical, np.inf, -np.inf), strict=True)
        )
        self._known_outcome = self._outcomes_of(self._sample.points)
        self._is_found = _is_predicted_critical(mean, self._known_outcome)
        audit_points, audit_scores = audits if audits is not None else (points[:0], scores[:0])
        self._audit_points = audit_points[np.isfinite(audit_scores)]
        self._audit_is_critical = criterion.is_critical(audit_scores[np.isfinite(audit_scores)])
        # One thread, so that sums do not depend on the number of threads.
        with single_threaded_blas():
            self._scores_record = cross_validate_scores(
                self._process, coordinates, scores, criterion, np.flatnonzero(self._is_initial_design)
            )
            if self._committee is not None:
                # Of all scenarios, as normal deviates.
                self._out_of_fold = _normal_deviate(self._committee.out_of_fold_probability())
            t, critical = self._collect_unbiased_predictions()
            edge = 0.0 if self._committee is None else float(_normal_deviate(np.array(PREDICTED_CRITICAL)))
            self._missed_none = not (critical & (t > edge)).any()
            self._calibration = ProbitCalibration(
                t,
                critical,
                _PREDICTION_WEIGHT,
                self._calibration_prior(scores, criterion),
                self._collect_chosen_predictions(),
                _CHOSEN_WEIGHT,
            )

    @property
    def uses_committee(self) -> bool:
        """True if a `CommitteeModel` of three classifiers predicts instead of the Gaussian process alone.

        This requires features, and both critical and other scenarios among the scenarios that were run.
        """
        return self._committee is not None

    def _predict_margin_and_deviate(self, encoded_points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return two predictions at encoded points (m, e), (m,) each: the margin, and the deviate z.

        The margin is 0 or less if the model predicts *critical*. z is the distance to the threshold in standard
        deviations.
        """
        encoded_points = append_source_prediction(self._source_model, encoded_points)
        if self._committee is not None:
            t = _normal_deviate(self._committee.predict(encoded_points)[0])
            return t - _normal_deviate(np.array(PREDICTED_CRITICAL)), t
        mean, deviation = self._process.predict(encoded_points)
        return mean, mean / np.hypot(deviation, self._process.kernel.noise)

    def _collect_unbiased_predictions(self) -> tuple[FloatArray, BoolArray]:
        """Return out-of-sample predictions for scenarios chosen independently of scores, and whether each was critical.

        These scenarios are the initial design and the audits (scenarios drawn at random as a check). A prediction is
        the distance to the threshold in standard deviations.
        """
        if self._committee is not None:
            t = self._out_of_fold[self._is_initial_design]
        else:
            mean, deviation = self._scores_record
            t = mean / deviation
        critical = self._critical[self._is_initial_design]
        if len(self._audit_points):
            t = np.concatenate([t, self._predict_margin_and_deviate(encode_points(self._space, self._audit_points))[1]])
            critical = np.concatenate([critical, self._audit_is_critical])
        return t, critical

    def _collect_chosen_predictions(self) -> tuple[FloatArray, BoolArray] | None:
        """Return the committee's out-of-fold predictions for scenarios chosen by scores, and whether each was critical.

        None without a committee: if the process's predictions of these scenarios were used for the calibration,
        intervals contained the true value less often. This was measured on one half of the problems, the half "choose"
        of benchmarks/intervals.py.
        """
        if self._committee is None:
            return None
        chosen = ~self._is_initial_design
        return self._out_of_fold[chosen], self._critical[chosen]

    def _calibration_prior(self, scores: FloatArray, criterion: Criterion) -> CalibrationPrior:
        """Return the prior of the calibration; surprises are improbable if the process predicts left-out scores well.

        This requires a smooth score, and scenarios that are dense enough to follow the score.
        """
        prior = _PROCESS_PRIOR if self._committee is None else _COMMITTEE_PRIOR
        values = squash_around_threshold(scores, criterion, self._process.squash_scale)[self._is_initial_design]
        if len(values) < 2 or np.ptp(values) == 0.0:
            return prior
        unexplained = float(np.square(values - self._scores_record[0]).mean() / values.var())
        return replace(
            prior, p_surprises=prior.p_surprises * min(max(unexplained / _UNEXPLAINED, _MIN_PROBABILITY), 1.0)
        )

    @cached_property
    def _joint_points(self) -> tuple[IntArray, FloatArray]:
        """Indices of the points for which critical sets are drawn jointly, and the fraction of the space of each."""
        probability = np.where(self._known_outcome == 0.0, self._calibration.probability_of_critical(self._z), 0.0)
        return self._sample.subset(np.sqrt(probability * (1.0 - probability)) + _MIN_DEVIATION, _JOINT_POINTS)

    def _draw_standardized_errors(self, indices: IntArray, key: int) -> FloatArray:
        """Draw standardized errors of the predictions at some points, (m, draws), with the correlation of the process.

        Each `key` gives independent draws.
        """
        factor, deviation = self._process.joint_covariance_factor(
            append_source_prediction(self._source_model, self._sample.encoded_points[indices])
        )
        standard = np.random.default_rng([self._seed, key]).standard_normal((len(factor), N_DRAWS))
        normal = multiply_lower_triangular(factor, standard)
        normal /= deviation[:, None]
        return normal

    @cached_property
    def _samples(self) -> CriticalSetDraws:
        """Critical sets drawn from the posterior."""
        return CriticalSetDraws(
            self._calibration,
            self._seed,
            self._sample.weights,
            self._z,
            self._known_outcome,
            self._joint_points,
            lambda: self._joint_errors,
        )

    @cached_property
    def _joint_errors(self) -> FloatArray:
        """Standardized errors of the predictions at the points with joint draws, (m, draws)."""
        with single_threaded_blas():
            return self._draw_standardized_errors(self._joint_points[0], 4)

    def predict(self, points: FloatArray) -> BoolArray:
        """Return whether each of n scenarios is critical, shape (n,); `points` has a row per scenario, shape (n, d).

        A scenario that was run has its observed outcome, any other scenario the predicted one.
        """
        if not len(points):
            return np.zeros(0, dtype=np.bool_)
        return _is_predicted_critical(
            self._predict_margin_and_deviate(encode_points(self._space, points))[0], self._outcomes_of(points)
        )

    def _outcomes_of(self, points: FloatArray) -> FloatArray:
        """Return outcomes of scenarios, (n,): inf if run and critical, -inf if run and not critical, 0 if not run."""
        return np.array([self._outcome_by_key.get(key, 0.0) for key in row_keys(self._space.snap(points))])

    @cached_property
    def is_exhausted(self) -> bool:
        """True if all scenarios of a space of at most 16,384 were run: the fraction is exact, and nothing is missed."""
        return self._sample.is_complete and bool((self._known_outcome != 0.0).all())

    @property
    def has_both_classes(self) -> bool:
        """True if both critical scenarios and other scenarios were run."""
        return bool(self._critical.any() and not self._critical.all())

    @property
    def interval_unavailable(self) -> str | None:
        """Reason why `critical_fraction` and `missed_fraction` have no interval; None if `critical_fraction` has one.

        An interval needs enough scenarios that were chosen independently of scores. The other scenarios do not show how
        often predictions are wrong in the rest of the space.
        """
        count = int(self._is_initial_design.sum()) + len(self._audit_points)
        if count >= _MIN_SCENARIOS or self.is_exhausted:
            return None
        return (
            f"only {count} scenarios were chosen without looking at scores; {_MIN_SCENARIOS} are"
            f" needed, audits are such"
        )

    @property
    def missed_interval_unavailable(self) -> str | None:
        """Reason why `missed_fraction` has no interval; None if it has one."""
        if self.interval_unavailable is not None or self._critical.any() or self.is_exhausted:
            return self.interval_unavailable
        return "no critical scenario besides audits was run"

    @cached_property
    def critical_fraction(self) -> Estimate:
        """Fraction of the space that is critical.

        If all scenarios that ran have the same outcome, the model gives no interval. The interval then comes from the
        known outcomes, and from the scenarios that were not chosen by scores. These are the initial design and the
        audits (scenarios drawn at random as a check).
        """
        if self.has_both_classes:
            return Estimate.from_draws(self._samples.critical_fraction)
        hits = int(self._critical[self._is_initial_design].sum() + self._audit_is_critical.sum())
        bounds = proportion_interval(hits, int(self._is_initial_design.sum()) + len(self._audit_is_critical))
        # Bounds that hold whatever the scenarios are that were not run.
        critical, others = (
            float(self._sample.weights[mask].sum()) for mask in (self._known_outcome > 0.0, self._known_outcome < 0.0)
        )
        low, high = max(bounds.low, min(critical, 1.0)), min(bounds.high, max(1.0 - others, 0.0))
        return Estimate(min(max(float(self._samples.critical_fraction.mean()), low), high), low, high)

    @cached_property
    def missed_fraction(self) -> Estimate:
        """Fraction of the critical set that was neither run nor predicted to be critical.

        The fraction is 1 while nothing critical was run, and 0 if all scenarios were run.
        """
        if not self._critical.any():
            return Estimate(*[float(not self.is_exhausted)] * 3)
        not_found, critical = self._not_found_and_critical_draws
        estimate = Estimate.from_draws(not_found / critical) if len(critical) else Estimate(1.0, 0.0, 1.0)
        # As long as no prediction missed a critical scenario, it is possible that none is missed.
        return replace(estimate, low=0.0) if self._missed_none else estimate

    @cached_property
    def _not_found_and_critical_draws(self) -> tuple[FloatArray, FloatArray]:
        """Draws of two fractions of the space: critical but not found, and critical in total.

        Draws in which no point is critical are left out, since the fraction that was missed has no meaning there.
        """
        critical = self._samples.critical_fraction
        with single_threaded_blas():
            not_found = np.clip(self._samples.critical_fraction_within(~self._is_found), 0.0, critical)
        return not_found[critical > 0.0], critical[critical > 0.0]

    def missed_upper_bound(self, confidence: float = DEFAULT_CONFIDENCE) -> float:
        """Return an upper bound of the missed fraction of the critical set; 1 if there is no interval.

        While nothing critical was run, the bound is 1, or 0 if all scenarios were run. The missed fraction is below the
        bound with the probability `confidence`. In contrast to `missed_fraction`, each draw may have one more critical
        region: a ball at a random place, in which no scenario was run and to which no score points. The prior odds of
        this region are even, and all sizes of `SURPRISE_RATES` are equally probable. Each size is weighted by the
        probability that a region of this size escapes the scenarios that were run (`unexplored_fraction`).
        """
        if self.missed_interval_unavailable or not self._critical.any():
            return float(not self.is_exhausted)
        not_found, critical = self._not_found_and_critical_draws
        if not len(critical):
            return 1.0
        sizes = np.append(0.0, SURPRISE_RATES)
        escapes = [_P_HIDDEN / len(SURPRISE_RATES) * self.unexplored_fraction(size) for size in sizes[1:]]
        probability = np.array([1.0 - _P_HIDDEN, *escapes])
        rng = np.random.default_rng([self._seed, 8])
        hidden = sizes[draw_stratified_indices(probability / probability.sum(), len(critical), rng)]
        return float(np.quantile((not_found + hidden) / (critical + hidden), confidence))

    @cached_property
    def max_fraction_in_empty_region(self) -> float:
        """Fraction of the critical set that an unexplored region may hold, in addition to `missed_fraction`.

        The region is a ball in which no scenario was run. Its volume is chosen so that, for 95 % of random centres, the
        largest ball without such a scenario is smaller. The volume of the ball depends on where scenarios were run, not
        on predicted scores.
        """
        ball = float(np.quantile(self._empty_ball_fractions, 1.0 - _ESCAPE_PROBABILITY))
        return ball / max(ball + self.critical_fraction.value, 1e-12)

    @cached_property
    def audited_critical_fraction(self) -> Estimate:
        """Critical fraction of the space, from the audits (scenarios drawn at random as a check) alone."""
        return proportion_interval(int(self._audit_is_critical.sum()), len(self._audit_is_critical))

    @cached_property
    def _missed_audits_and_total(self) -> tuple[int, int]:
        critical = self._audit_points[self._audit_is_critical]
        return int((~self.predict(critical)).sum()), len(critical)

    @property
    def audited_missed_fraction(self) -> Estimate:
        """Missed fraction of the critical set: share of critical audits (random checks) predicted to be uncritical."""
        return proportion_interval(*self._missed_audits_and_total)

    @property
    def audited_missed_upper_bound(self) -> float:
        """Upper bound of `audited_missed_fraction` that holds even if audits are run until the bound is low enough."""
        return anytime_upper_bound(*self._missed_audits_and_total)

    def estimate_for_other_scores(self, points: FloatArray, scores: FloatArray, criterion: Criterion) -> CriticalSet:
        """Estimate the critical set of other scores in the same space, for a comparison with this set.

        ValueError if there are fewer than 10 scores, or all are the same.
        """
        return CriticalSet(self._space, points, scores, criterion, self._seed, sample=self._sample)

    def fraction_inside(self, other: CriticalSet) -> Estimate:
        """Return the fraction of this critical set that lies in the critical set `other`.

        `other` is an estimate for another score in the same space, with the same seed.
        """
        with single_threaded_blas():
            both = self._samples.overlap_fraction(
                other._samples, other._draw_standardized_errors(self._joint_points[0], 5), np.arange(N_DRAWS)
            )
        nonempty = self._samples.critical_fraction > 0.0
        fractions = (
            np.clip(both[nonempty] / self._samples.critical_fraction[nonempty], 0.0, 1.0)
            if nonempty.any()
            else np.ones(1)
        )
        return Estimate.from_draws(fractions)

    def draw_overlap_with(self, other: CriticalSet) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Draw the fractions of the space that are critical in this set, in `other`, and in both, shape (draws,) each.

        `other` is an estimate from other scenarios of the same space, with the same seed. The draws of both sets are
        independent.
        """
        # The calibrations of both are drawn with the same random numbers; permuted, they are independent.
        order = np.random.default_rng([self._seed, 6]).permutation(N_DRAWS)
        fractions, other_fractions = (
            self._samples.critical_fraction,
            other._samples.critical_fraction[order],
        )
        with single_threaded_blas():
            both = self._samples.overlap_fraction(
                other._samples, other._draw_standardized_errors(self._joint_points[0], 5), order
            )
        return fractions, other_fractions, np.clip(both, 0.0, np.minimum(fractions, other_fractions))

    def draw_changes_to(self, other: CriticalSet) -> FloatArray:
        """Draw the critical fraction of `other` minus the critical fraction of this set, (pairs,).

        `other` is an estimate from other scenarios of the same space. Draws of both sets are independent. Two draws are
        paired if their calibrations have nearly the same rank: both then have a similar rate of surprises (critical
        scenarios to which no prediction points).
        """
        fractions, other_fractions = (
            samples.critical_fraction[samples.order_by_calibration] for samples in (self._samples, other._samples)
        )
        shifts = [k for k in range(-_MAX_RANK_DIFFERENCE, _MAX_RANK_DIFFERENCE + 1) if k]
        ranks = [np.arange(max(0, -shift), min(N_DRAWS, N_DRAWS - shift)) for shift in shifts]
        return np.concatenate(
            [other_fractions[rank + shift] - fractions[rank] for rank, shift in zip(ranks, shifts, strict=True)]
        )

    def draw_parameter_means(self) -> FloatArray:
        """Draw the mean of each parameter over the critical set, (draws, d), in the parameters' units.

        NaN for a parameter with choices, and for draws without anything critical.
        """
        values = self._space.values(self._sample.points)
        means = np.full((N_DRAWS, self._space.dimension), np.nan)
        with single_threaded_blas():
            whole = self._samples.critical_fraction_within(np.ones(len(self._z)))
            for k, parameter in enumerate(self._space.parameters):
                if not parameter.choices:
                    x = np.array([parameter.extract_number(value) for value in values])
                    with np.errstate(divide="ignore", invalid="ignore"):
                        mean = np.clip(
                            self._samples.critical_fraction_within(x - x.min()) / whole + x.min(),
                            x.min(),
                            x.max(),
                        )
                    means[:, k] = np.where(self._samples.critical_fraction > 0.0, mean, np.nan)
        return means

    def p_overlooked_region(self, size: float = MIN_REGION_FRACTION) -> float:
        """Return the probability that a critical region contains no scenario that was run, according to the process.

        `size` is the smallest fraction of the space that counts as a region. While nothing critical was run, the result
        is the probability for a region at a random place (`unexplored_fraction`).
        """
        if not self._critical.any():
            return self.unexplored_fraction(size)
        drawn = self._samples.joint_draws
        edges, regions = self._neighbour_graph
        weights = np.concatenate([self._joint_points[1], np.zeros(regions)])
        count = 0
        is_node = np.concatenate([drawn, np.ones((regions, N_DRAWS), dtype=np.bool_)]).T
        for is_critical in np.array_split(is_node, np.arange(_DRAWS_AT_ONCE, N_DRAWS, _DRAWS_AT_ONCE)):
            # The graphs of some draws side by side are one graph.
            draw, edge = np.nonzero(is_critical[:, edges[0]] & is_critical[:, edges[1]])
            label = _label_components(edges[:, edge] + draw * is_critical.shape[1], is_critical.size)
            sizes = np.bincount(label, weights=(weights * is_critical).ravel())
            label = label.reshape(is_critical.shape)
            has_run = np.zeros(len(sizes), dtype=np.bool_)
            has_run[label[:, len(drawn) :]] = True
            count += int(((sizes >= size) & ~has_run)[label].any(axis=1).sum())
        return count / N_DRAWS

    def unexplored_fraction(self, size: float = MIN_REGION_FRACTION) -> float:
        """Return the fraction of centres in the space for which a ball of volume `size` has no scenario that was run.

        This is the probability that a critical ball of this size at a random place was missed. It needs no assumption
        about the scores. `size` is a fraction of the space; parts of the ball outside the space do not count.
        """
        return float((self._empty_ball_fractions > size).mean())

    @cached_property
    def _empty_ball_fractions(self) -> FloatArray:
        with single_threaded_blas():
            return self._sample.empty_ball_fractions(self._encoded_points)

    @cached_property
    def _neighbour_graph(self) -> tuple[IntArray, int]:
        """Graph of neighbours: pairs of nodes, (2, E), and the number of critical regions.

        The nodes are sampled points, followed by critical regions. A region consists of neighbouring critical scenarios
        that were run. These scenarios are critical in every draw, so each region can be a single node.
        """
        sample = self._sample.encoded_points[self._joint_points[0]]
        count = len(sample)
        edges = _neighbour_pairs(np.concatenate([sample, self._encoded_points]))
        is_node = np.concatenate([np.ones(count, dtype=np.bool_), self._critical])
        edges = edges[:, is_node[edges[0]] & is_node[edges[1]]]
        was_run = edges >= count
        region = _label_components(edges[:, was_run.all(axis=0)] - count, len(self._encoded_points))
        node = np.concatenate([np.arange(count), count + region])
        edges = np.unique(np.sort(node[edges[:, ~was_run.all(axis=0)]], axis=0), axis=1)
        # Drop regions without a neighbour among the sampled points, and renumber the others.
        regions, index = np.unique(edges[edges >= count], return_inverse=True)
        edges[edges >= count] = count + index
        return edges, len(regions)


def _neighbour_pairs(points: FloatArray) -> IntArray:
    """Return pairs of neighbouring points, (2, E) indices, for points (n, e)."""
    if points.shape[1] == 1:
        # The two nearest points may lie on the same side, so connect each point with the next one instead.
        order = np.argsort(points[:, 0], kind="stable")
        return np.stack([order[:-1], order[1:]])
    nearest = cKDTree(points).query(points, k=min(2 * points.shape[1] + 1, len(points)))[1]
    near = np.asarray(nearest, dtype=np.int64)[:, 1:]
    return np.stack([np.repeat(np.arange(len(points)), near.shape[1]), near.ravel()])


def _label_components(edges: IntArray, count: int) -> IntArray:
    """Return the label of the connected component of each node, (count,); `edges` (2, E) are pairs of nodes."""
    graph = coo_array((np.ones(edges.shape[1]), (edges[0], edges[1])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def _normal_deviate(probability: FloatArray) -> FloatArray:
    """Convert the probability that a scenario is critical to a normal deviate, negative for a probability above 0.5."""
    return np.asarray(-ndtri(np.clip(probability, _MIN_PROBABILITY, 1.0 - _MIN_PROBABILITY)))


def _is_predicted_critical(margin: FloatArray, known_outcome: FloatArray) -> BoolArray:
    return np.where(known_outcome == 0.0, margin <= 0.0, known_outcome > 0.0)
