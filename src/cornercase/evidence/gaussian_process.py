"""Gaussian process over the unit cube, which predicts scenarios that were not run."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import replace
from operator import itemgetter
from typing import ClassVar

import numpy as np
from scipy.linalg.blas import dtrmm, strmm
from scipy.special import log_ndtr

from cornercase._common.platform import available_cpus
from cornercase._common.threads import one_thread
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.evidence.kernel import Floats, Kernel, chosen, evenly, learned_kernel
from cornercase.evidence.neighbours import NearestPosterior
from cornercase.evidence.posterior import MOST_EXACT, Posterior, SparsePosterior, positive_factor, posterior
from cornercase.evidence.products import products_of_rows, times_lower_transposed
from cornercase.scenario import ParameterSpace

_CHUNK, _FEWEST = 1024, 10
_MANY = 100  # scores up to which the squash scale is one standard deviation
_NOISE, _LITTLE, _MUCH = 0.3, 0.02, 1.0  # bounds of the noise: first tries, less, more
_WHOLE = 2.0  # squash scale, in standard deviations, for smooth functions
_LOWEST = 0.1  # fraction of the scores, the most critical ones, that is never squashed
_FAR = 0.02  # relevance far from the threshold
# Leave-one-out log-likelihood, the process, and the number of coordinates that it may use.
_Tried = tuple[float, "GaussianProcess", int]
# Log factors by which another study's prediction has to increase the likelihood of the scores: in total, and per score.
_FORETOLD, _EACH = float(np.log(100.0)), float(np.log(2.0))
# Single precision is used if, at this fraction of the compared points, the error is at most this in deviations.
_MOST, _COMPARED, _ALIKE = 0.9, 64, 0.1


def encoded(space: ParameterSpace, points: FloatArray) -> FloatArray:
    """Encode points (n, d) for a kernel, (n, e): choices become equidistant corners of a simplex."""
    columns = []
    for j, parameter in enumerate(space.parameters):
        if parameter.choices:
            columns.append(np.eye(len(parameter.choices))[parameter.numbers(points[:, j])] * np.sqrt(0.5))
        else:
            columns.append(points[:, j : j + 1])
    return np.concatenate(columns, axis=1)


def enough(points: FloatArray, scores: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Drop failed scenarios (NaN). ValueError if fewer than 10 scores remain, or all are the same."""
    finite = np.isfinite(scores)
    if finite.sum() < _FEWEST or np.ptp(scores[finite]) == 0.0:
        raise ValueError(f"At least {_FEWEST} different scores are needed.")
    return points[finite], scores[finite]


def nearness(scores: FloatArray) -> float:
    """Distance from the threshold beyond which scores are squashed: 0.5 to 1 standard deviation.

    Scores far from the threshold say little about the boundary of the critical set, and a process that need not follow
    them fits the boundary better. But they lead to regions not seen yet; so it is one standard deviation with up to 100
    scores, and less with more of them.
    """
    return float(np.clip(_MANY / len(scores), 0.5, 1.0) * np.std(scores))


def near_threshold(scores: FloatArray, threshold: float, near: float) -> FloatArray:
    """Shift the threshold to 0, and squash scores far from it by a hyperbolic tangent of the given scale."""
    return np.asarray(np.tanh((scores - threshold) / near))


def boundary_process(
    points: FloatArray, scores: FloatArray, threshold: float, *, foretold: bool = False
) -> GaussianProcess:
    """Gaussian process of squashed scores that best predicts which scenarios are critical.

    If scores jump, a process with much noise smooths the boundary away; if they are noisy, one with little noise
    follows the noise. So several are fitted, with increasing bounds of the noise, and the one is selected with the best
    leave-one-out likelihood of the side of the threshold, of at most 512 scenarios: from the others of these, and with
    more than 4,000 scenarios from the nearest of all. Smooth functions are predicted best from scores far from the
    threshold too, so two standard deviations are tried in addition to `squash_scale`. The most critical tenth of the
    scores is never squashed.

    The prediction of another study is used if it makes the left-out scores 100 times as likely, and each of them twice
    as likely (geometric mean). A weakly related study meets the former with enough scores, and yet moves the boundary
    away.

    `points` (n, e) are encoded, `scores` (n,) not all the same. `has_prediction`: whether the last coordinate is the
    prediction of a `SourceStudyModel`.
    """
    critical = scores <= threshold
    # Keep all scenarios of the rarer class in the subset, since length scales around them are learned from them.
    rare = critical if 2 * critical.sum() < len(critical) else ~critical
    subset = chosen(len(points), MOST_EXACT, rare)
    side, dims = np.where(critical[subset], 1.0, -1.0), points.shape[1]

    densities: dict[tuple[float, int], float] = {}

    def tried(near: float, most_noise: float, used: int, start: GaussianProcess | None) -> _Tried:
        """Fit one process; return its leave-one-out log-likelihood of the sides."""
        values = near_threshold(scores, threshold, near)
        process = GaussianProcess(most_noise, near).learn(points, values, start, rare, used)
        if len(points) > GaussianProcess.max_induced_values:
            mean, deviation = process.told_by_nearest(points, values, subset)
        else:
            mean, deviation = process.know(points[subset], values[subset]).leave_one_out()
        residual = (values[subset] - mean) / deviation
        densities[near, used] = float(-(0.5 * residual**2 + np.log(deviation)).sum())
        return float(log_ndtr(-side * mean / deviation).sum()), process, used

    # As long as hardly anything is critical, all scores would be squashed to the same value.
    least = float(np.quantile(scores, _LOWEST)) - threshold
    scales = dict.fromkeys((max(nearness(scores), least), max(_WHOLE * float(np.std(scores)), least)))
    candidates = [
        tried(scale, _NOISE, used, None) for used in ((dims, dims - 1) if foretold else (dims,)) for scale in scales
    ]
    if foretold:
        # The likelihood of the values shows this earlier than that of the sides.
        scale = next(iter(scales))
        improves = densities[scale, dims] - densities[scale, dims - 1] > max(_FORETOLD, _EACH * len(subset))
        candidates = [candidate for candidate in candidates if (candidate[2] == dims) == improves]
    _, start, used = max(candidates, key=itemgetter(0))
    # If the noise is not at its bound, another bound gives the same result.
    if start.kernel.noise > _LITTLE:
        candidates.append(tried(start.near, _LITTLE, used, start))
    if start.kernel.noise > 0.99 * _NOISE:
        candidates.append(tried(start.near, _MUCH, used, start))
    best = max(candidates, key=itemgetter(0))[1]
    return best if len(subset) == len(points) else best.know_scores(points, scores, threshold)


class GaussianProcess:
    """Gaussian process with a Matérn kernel (5/2) and a length scale per dimension.

    `fit` learns the kernel and conditions on the values. The steps are also available separately:
    `fit_hyperparameters`, `condition_on`, and `with_more_values` for additional values. `max_noise` is the greatest
    standard deviation of single values, `squash_scale` that of `squash_around_threshold`, if the values come from it.
    """

    max_induced_values: ClassVar[int] = 4000
    """Number of values up to which inducing points are used; with more, each point uses the values nearest to it."""

    def __init__(self, most_noise: float = 0.3, near: float = 1.0) -> None:
        self.most_noise, self.near = most_noise, near
        self._mean = 0.0
        self.kernel: Kernel
        self._known: Posterior
        self._nearest: NearestPosterior | None

    def fit(self, points: FloatArray, values: FloatArray) -> GaussianProcess:
        """Learn the kernel, and condition on values (n,) at points (n, e)."""
        return self.learn(points, values).know(points, values)

    def learn(
        self,
        points: FloatArray,
        values: FloatArray,
        near: GaussianProcess | None = None,
        rare: BoolArray | None = None,
        used: int | None = None,
    ) -> GaussianProcess:
        """Learn the kernel, and the mean far from all values.

        `initial` has a kernel to start from, `rare` (n,) marks values that must not be lost if only a subset is used,
        and `n_used` is the number of leading coordinates that the process may use, by default all.
        """
        self._mean = float(values.mean())
        # One thread, so that sums do not depend on the number of threads: proposals depend on the last digits.
        with one_thread():
            unused = points.shape[1] - (points.shape[1] if used is None else used)
            start = None if near is None else near.kernel
            if not unused:
                self.kernel = learned_kernel(points, values - self._mean, self.most_noise, start, rare)
                return self
            start = None if start is None else replace(start, widths=start.widths[:-unused])
            kernel = learned_kernel(points[:, :-unused], values - self._mean, self.most_noise, start, rare)
            # An infinite length scale ignores a coordinate.
            self.kernel = replace(kernel, widths=np.append(kernel.widths, np.full(unused, np.inf)))
        return self

    def know(self, points: FloatArray, values: FloatArray, matters: FloatArray | None = None) -> GaussianProcess:
        """Condition on values instead of the previous ones: exactly for up to 512, else by as many inducing points.

        With more than 4,000 values, predictions and leave-one-out use the nearest values. `relevance` (n,), above 0, is
        how much it matters to know the process at a point.
        """
        with one_thread():
            self._take(posterior(self.kernel, points, values - self._mean, matters))
        return self

    def know_scores(self, points: FloatArray, scores: FloatArray, threshold: float) -> GaussianProcess:
        """Condition on squashed scores, with more relevance near the threshold."""
        values = near_threshold(scores, threshold, self.near)
        # The slope of the hyperbolic tangent measures how near a score is to the threshold.
        return self.know(points, values, (1.0 - values**2 + _FAR) ** 2)

    def extended(self, points: FloatArray, values: FloatArray) -> GaussianProcess:
        """Copy of this process that is conditioned on additional values."""
        other = copy(self)
        with one_thread():
            other._take(self._known.extended(points, values - self._mean))
        return other

    def told_by_nearest(self, points: FloatArray, values: FloatArray, some: IntArray) -> tuple[FloatArray, FloatArray]:
        """Leave-one-out mean and deviation, (k,), of the values at `indices` by the nearest other values."""
        mean, deviation = NearestPosterior(self.kernel, points, values - self._mean).leave_one_out(some)
        return self._mean + mean, deviation

    def _take(self, known: Posterior) -> None:
        self._known = known
        self._nearest = None
        if isinstance(known, SparsePosterior) and len(known.values) > self.max_induced_values:
            self._nearest = NearestPosterior(self.kernel, known.known, known.values)
        self._factors: tuple[Floats, Floats] = known.weights, np.asfortranarray(known.inverse)
        single = known.weights.astype(np.float32), np.asfortranarray(known.inverse, dtype=np.float32)
        # With values close to each other and little noise, single precision is all rounding error.
        sample = evenly(len(known.points), _COMPARED)
        middles = 0.5 * (known.points[sample] + known.points[np.roll(sample, 1)])
        mean, variance, _ = self._at(middles, *self._factors)
        single_mean, single_variance, _ = self._at(middles, *single)
        deviation, single_deviation = (
            np.sqrt(np.maximum(v, 0.0) + self.kernel.noise**2) for v in (variance, single_variance)
        )
        error = np.maximum(np.abs(single_mean - mean), np.abs(single_deviation - deviation)) / deviation
        if np.quantile(error, _MOST) <= _ALIKE:
            self._factors = single

    def predict(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation at points, (n,) each.

        In single precision if that is accurate enough, so that 100,000 points with 500 values take about a second.
        """
        if self._nearest is not None:
            mean, deviation = self._nearest.predict(points)
            return self._mean + mean, deviation
        mean, deviation, _ = self._predict(points, keep=False)
        return mean, deviation

    def predict_with_projections(self, points: FloatArray) -> tuple[FloatArray, FloatArray, Floats]:
        """As `predict`, for up to 4,000 values, and additionally the rows (n, k) that `covariance_with_point` needs."""
        mean, deviation, parts = self._predict(points, keep=True)
        return mean, deviation, np.concatenate(parts)

    def _predict(self, points: FloatArray, keep: bool) -> tuple[FloatArray, FloatArray, list[Floats]]:
        mean, variance = np.empty(len(points)), np.empty(len(points))

        def part(first: int) -> Floats:
            chunk = slice(first, first + _CHUNK)
            mean[chunk], variance[chunk], rows = self._at(points[chunk], *self._factors)
            return rows if keep else rows[:0]

        # Each chunk is summed by one thread, so the result does not depend on their number.
        with one_thread(), ThreadPoolExecutor(available_cpus()) as pool:
            rows = list(pool.map(part, range(0, len(points), _CHUNK)))
        lowest = 1e-8 if self._factors[1].dtype == np.float32 else 1e-12
        return mean + self._mean, np.sqrt(np.maximum(variance, lowest * self.kernel.signal**2)), rows

    def _at(self, points: FloatArray, weights: Floats, inverse: Floats) -> tuple[Floats, FloatArray, Floats]:
        """Mean less the overall mean, variance and projections at points, in the precision of the factors."""
        single = inverse.dtype == np.float32
        cross = (self.kernel.single_covariance if single else self.kernel.covariance)(points, self._known.points)
        mean = cross @ weights
        # In place, with half the work of a product with a full matrix.
        rows: Floats = (strmm if single else dtrmm)(1.0, inverse, cross.T, side=0, lower=1, overwrite_b=1).T
        return mean, np.asarray(self.kernel.signal**2 - np.einsum("ij,ij->i", rows, rows)), rows

    def leave_one_out(self, some: IntArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation of each value, or of `indices`, by the process of all others, (k,) each.

        The deviation includes the noise of the single value. Source: Rasmussen and Williams 2006, equation 5.12.
        """
        if self._nearest is not None:
            mean, deviation = self._nearest.leave_one_out(some)
            return self._mean + mean, deviation
        with one_thread():
            mean, deviation = self._known.leave_one_out()
        index = slice(None) if some is None else some
        return self._mean + mean[index], deviation[index]

    def joint(self, points: FloatArray, noisy: bool = True) -> tuple[FloatArray, FloatArray]:
        """Lower Cholesky factor (m, m) of the covariance at points, and the standard deviations (m,).

        `with_noise`: with the noise of single values.
        """
        cross = self.kernel.covariance(points, self._known.points)
        covariance = self.kernel.covariance(points, points)
        # The lower half is enough for the factor.
        covariance -= products_of_rows(times_lower_transposed(cross, self._known.inverse))
        if noisy:
            covariance[np.diag_indices(len(points))] += self.kernel.noise**2
        factor = positive_factor(covariance, 1e-6 * self.kernel.signal**2)
        return factor, np.sqrt(np.diag(covariance))

    def covariance(self, points: FloatArray, rows: Floats, i: int) -> FloatArray:
        """Covariance of the process at all points with that at point `i`, (n,).

        `projections` are those of `predict_with_projections`.
        """
        prior = self.kernel.covariance(points, points[i : i + 1])[:, 0]
        return np.asarray(prior - rows @ rows[i], dtype=np.float64)
