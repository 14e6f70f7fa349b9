"""Gaussian process over the unit cube, which predicts scenarios that were not run."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import ClassVar

import numpy as np
from scipy.linalg.blas import dtrmm, strmm
from scipy.special import log_ndtr

from cornercase._common.numba.blas import single_threaded_blas
from cornercase._common.platform import count_available_cpus
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.evidence.gp._matern_kernel import (
    Floats,
    MaternKernel,
    evenly_spaced_indices,
    fit_kernel,
    indices_with_rare_values,
)
from cornercase.evidence.gp._neighbour_posterior import NearestPosterior
from cornercase.evidence.gp._posterior import (
    MAX_EXACT_VALUES,
    AnyPosterior,
    SparsePosterior,
    cholesky_with_slack,
    make_posterior,
)
from cornercase.evidence.gp._triangular_products import gram_lower_half, multiply_by_lower_transposed
from cornercase.scenario import ParameterSpace
from cornercase.study._criterion import Criterion

_POINTS_PER_CHUNK, _MIN_SCORES = 1024, 10
_FULL_SCALE_COUNT = 100  # scores up to which the squash scale is one standard deviation
_INITIAL_MAX_NOISE, _LOW_MAX_NOISE, _HIGH_MAX_NOISE = 0.3, 0.02, 1.0  # bounds of the noise: first tries, less, more
_SMOOTH_SCALE = 2.0  # squash scale, in standard deviations, for smooth functions
_UNSQUASHED_FRACTION = 0.1  # fraction of the scores, the most critical ones, that is never squashed
_MIN_RELEVANCE = 0.02  # relevance far from the threshold
# Leave-one-out log-likelihood, the process, and the number of coordinates that it may use.
_Candidate = tuple[float, "GaussianProcess", int]
# Log factors by which another study's prediction has to increase the likelihood of the scores: in total, and per score.
_MIN_TOTAL_GAIN, _MIN_GAIN_PER_SCORE = float(np.log(100.0)), float(np.log(2.0))
# Single precision is used if, at this fraction of the compared points, the error is at most this in deviations.
_COMPARED_FRACTION, _N_COMPARED, _MAX_PRECISION_ERROR = 0.9, 64, 0.1


def encode_points(space: ParameterSpace, points: FloatArray) -> FloatArray:
    """Encode points (n, d) as coordinates for a kernel, (n, e): choices become equidistant corners of a simplex."""
    columns = []
    for j, parameter in enumerate(space.parameters):
        if parameter.choices:
            columns.append(np.eye(len(parameter.choices))[parameter.level_indices(points[:, j])] * np.sqrt(0.5))
        else:
            columns.append(points[:, j : j + 1])
    return np.concatenate(columns, axis=1)


def require_enough_scores(points: FloatArray, scores: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Drop failed scenarios (NaN). ValueError if fewer than 10 scores remain, or all are the same."""
    finite = np.isfinite(scores)
    if finite.sum() < _MIN_SCORES or np.ptp(scores[finite]) == 0.0:
        raise ValueError(f"Give at least {_MIN_SCORES} scores that are not all the same.")
    return points[finite], scores[finite]


def squash_scale(scores: FloatArray) -> float:
    """Return the distance from the threshold beyond which scores are squashed: 0.5 to 1 standard deviation.

    Scores far from the threshold say little about the boundary of the critical set. A process that need not follow
    these scores fits the boundary better. But scores far from the threshold show in which direction unexplored regions
    may be critical, above all while few scores are known. So the scale is one standard deviation with up to 100 scores,
    and decreases with more scores.
    """
    return float(np.clip(_FULL_SCALE_COUNT / len(scores), 0.5, 1.0) * np.std(scores))


def squash_around_threshold(scores: FloatArray, criterion: Criterion, scale: float) -> FloatArray:
    """Shift the threshold to 0, and compress scores far from it by a hyperbolic tangent with a given scale.

    Several scores that equal the threshold lie on a plateau of the score, as scores of collisions do. How deep inside
    the critical set these scenarios lie is unknown. If they counted as exactly at the threshold, a process would
    predict that neighbouring scenarios are not critical. So they count as one scale beyond the threshold. If half the
    median distance of lower scores from the threshold is less, this counts instead, so that scenarios on the plateau
    stay less critical than most scenarios with lower scores.
    """
    margins = criterion.margins(scores)
    on_plateau = margins == 0.0
    if on_plateau.sum() > 1:
        lower = margins[margins < 0.0]
        depth = min(scale, -0.5 * float(np.median(lower))) if len(lower) else scale
        margins = np.where(on_plateau, -depth, margins)
    return np.asarray(np.tanh(margins / scale))


def fit_boundary_process(
    points: FloatArray, scores: FloatArray, criterion: Criterion, *, has_prediction: bool = False
) -> GaussianProcess:
    """Fit the Gaussian process of squashed scores that best predicts which scenarios are critical.

    If scores jump, a process with much noise smooths the boundary away. If scores are noisy, a process with little
    noise follows the noise. So several processes are fitted, with different bounds of the noise. The selected process
    is the one that best predicts, by leave-one-out likelihood, on which side of the threshold scores are. At most 512
    scenarios are left out, one at a time. Each is predicted from the other ones of these 512; if there are more than
    4,000 scenarios, from the nearest of all scenarios. Scores far from the threshold help to predict smooth functions,
    so a scale of two standard deviations is tried in addition to `squash_scale`. If less than a tenth of the scores is
    critical, the scale is at least the distance from the threshold to the most critical tenth. With a smaller
    scale, all scores would be squashed to nearly the same value.

    The prediction of another study is used if it makes the left-out scores 100 times as likely in total, and twice as
    likely each (geometric mean). With enough scores, even a weakly related study meets the first condition, although
    its prediction makes the estimated boundary worse. The second condition excludes such a study.

    `points` (n, e) are encoded, `scores` (n,) are not all the same. `has_prediction` says whether the last coordinate
    is the prediction of a `SourceStudyModel`.
    """
    critical = criterion.is_critical(scores)
    # Prefer scenarios of the rarer class for the subset, since length scales around them are learned from them.
    rare = critical if 2 * critical.sum() < len(critical) else ~critical
    subset = indices_with_rare_values(len(points), MAX_EXACT_VALUES, rare)
    side, dims = np.where(critical[subset], 1.0, -1.0), points.shape[1]

    densities: dict[tuple[float, int], float] = {}

    def fit_candidate(scale: float, max_noise: float, n_used: int, start: GaussianProcess | None) -> _Candidate:
        """Fit one process; also return the leave-one-out log-likelihood of the sides of the threshold."""
        values = squash_around_threshold(scores, criterion, scale)
        process = GaussianProcess(max_noise, scale).fit_hyperparameters(points, values, start, rare, n_used)
        if len(points) > GaussianProcess.max_induced_values:
            mean, deviation = process.leave_one_out_by_nearest(points, values, subset)
        else:
            mean, deviation = process.condition_on(points[subset], values[subset]).leave_one_out()
        residual = (values[subset] - mean) / deviation
        densities[scale, n_used] = float(-(0.5 * residual**2 + np.log(deviation)).sum())
        return float(log_ndtr(-side * mean / deviation).sum()), process, n_used

    # As long as hardly anything is critical, all scores would be squashed to the same value.
    least = float(np.quantile(scores, _UNSQUASHED_FRACTION)) - criterion.oriented
    scales = dict.fromkeys((max(squash_scale(scores), least), max(_SMOOTH_SCALE * float(np.std(scores)), least)))
    candidates = [
        fit_candidate(scale, _INITIAL_MAX_NOISE, used, None)
        for used in ((dims, dims - 1) if has_prediction else (dims,))
        for scale in scales
    ]
    if has_prediction:
        # The likelihood of the values shows this earlier than that of the sides.
        scale = next(iter(scales))
        improves = densities[scale, dims] - densities[scale, dims - 1] > max(
            _MIN_TOTAL_GAIN, _MIN_GAIN_PER_SCORE * len(subset)
        )
        candidates = [candidate for candidate in candidates if (candidate[2] == dims) == improves]
    _, start, used = max(candidates, key=itemgetter(0))
    # If the noise is not at its bound, another bound gives the same result.
    if start.kernel.noise > _LOW_MAX_NOISE:
        candidates.append(fit_candidate(start.squash_scale, _LOW_MAX_NOISE, used, start))
    if start.kernel.noise > 0.99 * _INITIAL_MAX_NOISE:
        candidates.append(fit_candidate(start.squash_scale, _HIGH_MAX_NOISE, used, start))
    best = max(candidates, key=itemgetter(0))[1]
    return best if len(subset) == len(points) else best.condition_on_scores(points, scores, criterion)


@dataclass(frozen=True)
class ClosedFormPredictor:
    """Closed form of a Gaussian process: kernel, points and factors that determine its prediction at any point.

    With the covariances k (m,) of a point with `points` (m, e), the mean is `mean` + k · `weights`. The variance is the
    kernel's variance minus the squared norm of `inverse_factor` k; `inverse_factor` (m, m) is lower triangular.
    `weights` and `inverse_factor` are in single precision if that is accurate enough.
    """

    kernel: MaternKernel
    mean: float
    points: FloatArray
    weights: Floats
    inverse_factor: Floats


class GaussianProcess:
    """Gaussian process with a Matérn kernel (5/2) and a length scale per dimension.

    `fit` learns the kernel and conditions on the values. The steps are also available separately:
    `fit_hyperparameters`, `condition_on`, and `with_more_values` for additional values. `max_noise` is the greatest
    standard deviation of the noise of single values. If the values come from `squash_around_threshold`, `squash_scale`
    is the scale used there.
    """

    max_induced_values: ClassVar[int] = 4000
    """Greatest number of values with inducing points; with more values, each point uses only the nearest values."""

    def __init__(self, max_noise: float = 0.3, squash_scale: float = 1.0) -> None:
        self.max_noise, self.squash_scale = max_noise, squash_scale
        self._mean = 0.0
        self.kernel: MaternKernel
        self._posterior: AnyPosterior
        self._nearest_posterior: NearestPosterior | None

    def fit(self, points: FloatArray, values: FloatArray) -> GaussianProcess:
        """Learn the kernel, and condition on values (n,) at points (n, e)."""
        return self.fit_hyperparameters(points, values).condition_on(points, values)

    def fit_hyperparameters(
        self,
        points: FloatArray,
        values: FloatArray,
        initial: GaussianProcess | None = None,
        rare: BoolArray | None = None,
        n_used: int | None = None,
    ) -> GaussianProcess:
        """Learn the kernel, and the mean of the process far from all values.

        `initial` has a kernel to start from. `rare` (n,) marks values that are preferred if only a subset is used.
        `n_used` is the number of leading coordinates that the process may use, by default all.
        """
        self._mean = float(values.mean())
        # One thread, so that sums do not depend on the number of threads: proposals depend on the last digits.
        with single_threaded_blas():
            unused = points.shape[1] - (points.shape[1] if n_used is None else n_used)
            start = None if initial is None else initial.kernel
            if not unused:
                self.kernel = fit_kernel(points, values - self._mean, self.max_noise, start, rare)
                return self
            start = None if start is None else replace(start, length_scales=start.length_scales[:-unused])
            kernel = fit_kernel(points[:, :-unused], values - self._mean, self.max_noise, start, rare)
            # An infinite length scale ignores a coordinate.
            self.kernel = replace(kernel, length_scales=np.append(kernel.length_scales, np.full(unused, np.inf)))
        return self

    def condition_on(
        self, points: FloatArray, values: FloatArray, relevance: FloatArray | None = None
    ) -> GaussianProcess:
        """Condition the process on new values instead of the previous ones.

        The posterior of up to 512 values is exact. The posterior of more values is approximated by 512 inducing points.
        With more than 4,000 values, predictions and leave-one-out use the nearest values. `relevance` (n,), above 0,
        says how much it matters to know the process at a point.
        """
        with single_threaded_blas():
            self._set_posterior(make_posterior(self.kernel, points, values - self._mean, relevance))
        return self

    def condition_on_scores(self, points: FloatArray, scores: FloatArray, criterion: Criterion) -> GaussianProcess:
        """Condition on squashed scores; points near the threshold have more relevance."""
        values = squash_around_threshold(scores, criterion, self.squash_scale)
        # The slope of the hyperbolic tangent measures how near a score is to the threshold.
        return self.condition_on(points, values, (1.0 - values**2 + _MIN_RELEVANCE) ** 2)

    def with_more_values(self, points: FloatArray, values: FloatArray) -> GaussianProcess:
        """Return a copy of this process that is conditioned on additional values."""
        other = copy(self)
        with single_threaded_blas():
            other._set_posterior(self._posterior.with_more_values(points, values - self._mean))
        return other

    def condense(self, points: FloatArray, values: FloatArray, max_points: int) -> GaussianProcess:
        """Return a copy of this process that predicts from at most `max_points` points, for any number of values."""
        other = copy(self)
        with single_threaded_blas():
            other._set_posterior(
                make_posterior(self.kernel, points, values - self._mean, max_points=max_points),
                may_use_nearest=False,
            )
        return other

    def closed_form(self) -> ClosedFormPredictor:
        """Return all that determines predictions at any point, for programs in other languages.

        There may be at most 4,000 values, unless the process is the result of `condense`.
        """
        weights, inverse = self._factors
        return ClosedFormPredictor(self.kernel, self._mean, self._posterior.points, weights, inverse)

    def leave_one_out_by_nearest(
        self, points: FloatArray, values: FloatArray, indices: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """Predict the values at `indices` from the nearest other values; return means and deviations, (k,) each."""
        mean, deviation = NearestPosterior(self.kernel, points, values - self._mean).leave_one_out(indices)
        return self._mean + mean, deviation

    def _set_posterior(self, posterior: AnyPosterior, may_use_nearest: bool = True) -> None:
        self._posterior = posterior
        self._nearest_posterior = None
        if (
            may_use_nearest
            and isinstance(posterior, SparsePosterior)
            and len(posterior.values) > self.max_induced_values
        ):
            self._nearest_posterior = NearestPosterior(self.kernel, posterior.all_points, posterior.values)
        self._factors: tuple[Floats, Floats] = posterior.weights, np.asfortranarray(posterior.inverse_factor)
        single = posterior.weights.astype(np.float32), np.asfortranarray(posterior.inverse_factor, dtype=np.float32)
        # With values close to each other and little noise, single precision is all rounding error.
        sample = evenly_spaced_indices(len(posterior.points), _N_COMPARED)
        middles = 0.5 * (posterior.points[sample] + posterior.points[np.roll(sample, 1)])
        mean, variance, _ = self._predict_at(middles, *self._factors)
        single_mean, single_variance, _ = self._predict_at(middles, *single)
        deviation, single_deviation = (
            np.sqrt(np.maximum(v, 0.0) + self.kernel.noise**2) for v in (variance, single_variance)
        )
        error = np.maximum(np.abs(single_mean - mean), np.abs(single_deviation - deviation)) / deviation
        if np.quantile(error, _COMPARED_FRACTION) <= _MAX_PRECISION_ERROR:
            self._factors = single

    def predict(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the mean and the standard deviation of the process at points (n, e), (n,) each.

        Single precision is used if it is accurate enough, so that 100,000 points with 500 values take about a second.
        """
        if self._nearest_posterior is not None:
            mean, deviation = self._nearest_posterior.predict(points)
            return self._mean + mean, deviation
        mean, deviation, _ = self._predict_in_chunks(points, keep_projections=False)
        return mean, deviation

    def predict_with_projections(self, points: FloatArray) -> tuple[FloatArray, FloatArray, Floats]:
        """Predict as `predict` does; also return the rows (n, k) that `covariance_with_point` needs.

        There may be at most 4,000 values.
        """
        mean, deviation, parts = self._predict_in_chunks(points, keep_projections=True)
        return mean, deviation, np.concatenate(parts)

    def _predict_in_chunks(
        self, points: FloatArray, keep_projections: bool
    ) -> tuple[FloatArray, FloatArray, list[Floats]]:
        mean, variance = np.empty(len(points)), np.empty(len(points))

        def predict_chunk(first: int) -> Floats:
            chunk = slice(first, first + _POINTS_PER_CHUNK)
            mean[chunk], variance[chunk], rows = self._predict_at(points[chunk], *self._factors)
            return rows if keep_projections else rows[:0]

        # Each chunk is summed by one thread, so the result does not depend on their number.
        with single_threaded_blas(), ThreadPoolExecutor(count_available_cpus()) as pool:
            rows = list(pool.map(predict_chunk, range(0, len(points), _POINTS_PER_CHUNK)))
        lowest = 1e-8 if self._factors[1].dtype == np.float32 else 1e-12
        return mean + self._mean, np.sqrt(np.maximum(variance, lowest * self.kernel.signal**2)), rows

    def _predict_at(self, points: FloatArray, weights: Floats, inverse: Floats) -> tuple[Floats, FloatArray, Floats]:
        """Return the mean minus the overall mean, the variance, and projections, in the precision of `weights`."""
        single = inverse.dtype == np.float32
        cross = (self.kernel.covariance_in_single_precision if single else self.kernel.covariance)(
            points, self._posterior.points
        )
        mean = cross @ weights
        # In place, with half the work of a product with a full matrix.
        rows: Floats = (strmm if single else dtrmm)(1.0, inverse, cross.T, side=0, lower=1, overwrite_b=1).T
        return mean, np.asarray(self.kernel.signal**2 - np.einsum("ij,ij->i", rows, rows)), rows

    def leave_one_out(self, indices: IntArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Predict each value, or the values at `indices`, from all others: mean and standard deviation, (k,) each.

        The standard deviation includes the noise of the single value. Source: Rasmussen and Williams 2006, equation
        5.12.
        """
        if self._nearest_posterior is not None:
            mean, deviation = self._nearest_posterior.leave_one_out(indices)
            return self._mean + mean, deviation
        with single_threaded_blas():
            mean, deviation = self._posterior.leave_one_out()
        index = slice(None) if indices is None else indices
        return self._mean + mean[index], deviation[index]

    def joint_covariance_factor(self, points: FloatArray, with_noise: bool = True) -> tuple[FloatArray, FloatArray]:
        """Return the lower Cholesky factor (m, m) of the covariance at points, and the standard deviations (m,).

        If `with_noise`, both include the noise of single values.
        """
        cross = self.kernel.covariance(points, self._posterior.points)
        # The lower half is enough for the factor.
        covariance = self.kernel.covariance_lower_half(points)
        covariance -= gram_lower_half(multiply_by_lower_transposed(cross, self._posterior.inverse_factor))
        if with_noise:
            covariance[np.diag_indices(len(points))] += self.kernel.noise**2
        factor = cholesky_with_slack(covariance, 1e-6 * self.kernel.signal**2)
        return factor, np.sqrt(np.diag(covariance))

    def covariance_with_point(self, points: FloatArray, projections: Floats, i: int) -> FloatArray:
        """Return the covariance of the process at all points with the process at point `i`, (n,).

        `projections` are those of `predict_with_projections`.
        """
        prior = self.kernel.covariance(points, points[i : i + 1])[:, 0]
        return np.asarray(prior - projections @ projections[i], dtype=np.float64)
