"""Gaussian process over the unit cube: what the scenarios that were run say about those that were not."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import replace
from operator import itemgetter

import numpy as np
from scipy.linalg.blas import dtrmm, strmm
from scipy.special import log_ndtr

from cornercase._common.platform import available_cpus
from cornercase._common.threads import one_thread
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.evidence.kernel import Floats, Kernel, chosen, evenly, learned_kernel
from cornercase.evidence.neighbours import MOST_TOGETHER, NearestPosterior
from cornercase.evidence.posterior import MOST_EXACT, Posterior, SparsePosterior, positive_factor, posterior
from cornercase.evidence.products import products_of_rows, times_lower_transposed
from cornercase.scenario import ParameterSpace

_CHUNK, _FEWEST = 1024, 10
# Most noise of the first tries, and less and more of it.
_MANY, _NOISE, _LITTLE, _MUCH = 100, 0.3, 0.02, 1.0
# Nearness, in standard deviations, for a function that is smooth all over.
_WHOLE = 2.0
# Share of the scores, the most critical ones, that is never told apart worse than at the edge of what is near.
_LOWEST = 0.1
# How much the process matters far from the threshold.
_FAR = 0.02
# Log-probability of what is left out, the process, and the number of coordinates that it may use.
_Tried = tuple[float, "GaussianProcess", int]
# Logarithms of the factors by which what another study predicts has to make scores likelier: all together, and each.
_FORETOLD, _EACH = float(np.log(100.0)), float(np.log(2.0))
# Places at which both precisions are compared, and how far they may differ at most of them, in standard deviations.
_COMPARED, _ALIKE, _MOST = 64, 0.1, 0.9


def encoded(space: ParameterSpace, points: FloatArray) -> FloatArray:
    """Encode points for a kernel: choices become corners of a simplex, which are equally far from each other.

    Parameters
    ----------
    space : ParameterSpace
    points : ndarray of float64, shape (n, d)

    Returns
    -------
    ndarray of float64, shape (n, e)
    """
    columns = []
    for j, parameter in enumerate(space.parameters):
        if parameter.choices:
            columns.append(np.eye(len(parameter.choices))[parameter.numbers(points[:, j])] * np.sqrt(0.5))
        else:
            columns.append(points[:, j : j + 1])
    return np.concatenate(columns, axis=1)


def enough(points: FloatArray, scores: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return points, shape (m, d), and scores, shape (m,), without those of scenarios that failed.

    Parameters
    ----------
    points : ndarray of float64, shape (n, d)
    scores : ndarray of float64, shape (n,)
        NaN for a scenario that failed.

    Raises
    ------
    ValueError
        There are fewer than 10 scores, or all are the same.
    """
    known = np.isfinite(scores)
    if known.sum() < _FEWEST or np.ptp(scores[known]) == 0.0:
        raise ValueError(f"At least {_FEWEST} different scores are needed.")
    return points[known], scores[known]


def nearness(scores: FloatArray) -> float:
    """Distance from the threshold up to which a score counts as near.

    What lies far from the threshold says little about the boundary of the critical set, and a process that need not
    follow it follows the boundary better. But it leads to regions that were not met yet; so one standard deviation
    counts as near with up to 100 scores, and less with more of them, down to the half.

    Parameters
    ----------
    scores : ndarray of float64, shape (n,)

    Returns
    -------
    float
    """
    return float(np.clip(_MANY / len(scores), 0.5, 1.0) * np.std(scores))


def near_threshold(scores: FloatArray, threshold: float, near: float) -> FloatArray:
    """Scores with the threshold at 0, drawn together by a hyperbolic tangent where they are far from it.

    Parameters
    ----------
    scores : ndarray of float64, shape (n,)
    threshold : float
    near : float
        What counts as near, as of `nearness`.

    Returns
    -------
    ndarray of float64, shape (n,)
    """
    return np.asarray(np.tanh((scores - threshold) / near))


def boundary_process(
    points: FloatArray, scores: FloatArray, threshold: float, *, foretold: bool = False
) -> GaussianProcess:
    """Gaussian process of `near_threshold` that best predicts which scenarios are critical.

    Where scores jump, a process with much noise smooths the boundary away; where they are noisy, one with little noise
    follows the noise. So several are fitted, each with more noise allowed, and the one is taken that predicts best on
    which side of the threshold each scenario is that is left out, of 512 of them at most: by the others of these, and
    of more than 4,000 scenarios by the nearest of all. A function that is smooth all over is told best by what lies far
    from the threshold too, so two standard deviations are tried beside `nearness`; and the most critical tenth of the
    scores is always near.

    What another study predicts is taken where that makes the scores that are left out 100 times as likely, and each of
    them twice as likely (the geometric mean). A study that tells a little of the scores meets the former with enough of
    them, and yet moves the boundary away.

    Parameters
    ----------
    points : ndarray of float64, shape (n, e)
        As `encoded`.
    scores : ndarray of float64, shape (n,)
        Not all the same.
    threshold : float
    foretold : bool, default False
        Whether the last coordinate is what another study predicts, as of `Elsewhere`.

    Returns
    -------
    GaussianProcess
    """
    critical = scores <= threshold
    # Of rare critical scenarios none is left out: the widths about them are learned from them.
    rare = critical if 2 * critical.sum() < len(critical) else ~critical
    some = chosen(len(points), MOST_EXACT, rare)
    side, every = np.where(critical[some], 1.0, -1.0), points.shape[1]

    densities: dict[tuple[float, int], float] = {}

    def tried(near: float, most_noise: float, used: int, start: GaussianProcess | None) -> _Tried:
        values = near_threshold(scores, threshold, near)
        process = GaussianProcess(most_noise, near).learn(points, values, start, rare, used)
        if len(points) > MOST_TOGETHER:
            mean, deviation = process.told_by_nearest(points, values, some)
        else:
            mean, deviation = process.know(points[some], values[some]).leave_one_out()
        away = (values[some] - mean) / deviation
        densities[near, used] = float(-(0.5 * away**2 + np.log(deviation)).sum())
        return float(log_ndtr(-side * mean / deviation).sum()), process, used

    # While hardly anything is critical, all scores would be far from the threshold, and told apart no more.
    least = float(np.quantile(scores, _LOWEST)) - threshold
    nears = dict.fromkeys((max(nearness(scores), least), max(_WHOLE * float(np.std(scores)), least)))
    numbers = (every, every - 1) if foretold else (every,)
    found = [tried(near, _NOISE, used, None) for used in numbers for near in nears]
    if foretold:
        # The values tell that sooner than the sides.
        near = next(iter(nears))
        tells = densities[near, every] - densities[near, every - 1] > max(_FORETOLD, _EACH * len(some))
        found = [one for one in found if (one[2] == every) == tells]
    _, start, used = max(found, key=itemgetter(0))
    # Where the noise is not at its bound, another bound gives the same.
    if start.kernel.noise > _LITTLE:
        found.append(tried(start.near, _LITTLE, used, start))
    if start.kernel.noise > 0.99 * _NOISE:
        found.append(tried(start.near, _MUCH, used, start))
    best = max(found, key=itemgetter(0))[1]
    return best if len(some) == len(points) else best.know_scores(points, scores, threshold)


class GaussianProcess:
    """Gaussian process with a Matérn kernel (5/2) and a width of its own for each dimension.

    `fit` learns the kernel and takes the values in. What is costly can be had apart: `learn` learns the kernel, `know`
    takes values in for the kernel at hand, and `extend` takes in more of them.

    Parameters
    ----------
    most_noise : float, default 0.3
        Greatest standard deviation of single values.
    near : float, default 1.0
        Where the values are those of `near_threshold`, what counts as near.

    Attributes
    ----------
    kernel : Kernel
        As learned.
    most_noise, near : float
        As given; further values of a `boundary_process` are made with it.
    """

    def __init__(self, most_noise: float = 0.3, near: float = 1.0) -> None:
        self.most_noise, self.near = most_noise, near
        self._mean = 0.0
        self.kernel: Kernel
        self._known: Posterior
        self._nearest: NearestPosterior | None

    def fit(self, points: FloatArray, values: FloatArray) -> GaussianProcess:
        """Learn the kernel, and know values at points.

        Parameters
        ----------
        points : ndarray of float64, shape (n, e)
        values : ndarray of float64, shape (n,)

        Returns
        -------
        GaussianProcess
            Itself.
        """
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

        Parameters
        ----------
        points : ndarray of float64, shape (n, e)
        values : ndarray of float64, shape (n,)
        near : GaussianProcess, optional
            With a kernel near which to look.
        rare : ndarray of bool, shape (n,), optional
            Values that must not be lost where only some of many are learned from.
        used : int, optional
            Number of coordinates, the first ones, that the process may use; by default all.

        Returns
        -------
        GaussianProcess
            Itself.
        """
        self._mean = float(values.mean())
        # Sums in one order, whatever the number of threads: the points that follow depend on the last digits.
        with one_thread():
            left = points.shape[1] - (points.shape[1] if used is None else used)
            start = None if near is None else near.kernel
            if not left:
                self.kernel = learned_kernel(points, values - self._mean, self.most_noise, start, rare)
                return self
            start = None if start is None else replace(start, widths=start.widths[:-left])
            kernel = learned_kernel(points[:, :-left], values - self._mean, self.most_noise, start, rare)
            # Along a coordinate of infinite width nothing is apart.
            self.kernel = replace(kernel, widths=np.append(kernel.widths, np.full(left, np.inf)))
        return self

    def know(self, points: FloatArray, values: FloatArray, matters: FloatArray | None = None) -> GaussianProcess:
        """Take values in, instead of those before: exactly up to 512 of them, else by way of as many points.

        Of more than 4,000 the nearest ones tell what is predicted, and what each value is by the others.

        Parameters
        ----------
        points : ndarray of float64, shape (n, e)
        values : ndarray of float64, shape (n,)
        matters : ndarray of float64, shape (n,), optional
            How much it matters to know the process at a point, above 0; by default the same everywhere.

        Returns
        -------
        GaussianProcess
            Itself.
        """
        with one_thread():
            self._take(posterior(self.kernel, points, values - self._mean, matters))
        return self

    def know_scores(self, points: FloatArray, scores: FloatArray, threshold: float) -> GaussianProcess:
        """Take scores in as `near_threshold` gives them, those near the threshold above all.

        Parameters
        ----------
        points : ndarray of float64, shape (n, e)
        scores : ndarray of float64, shape (n,)
        threshold : float

        Returns
        -------
        GaussianProcess
            Itself.
        """
        values = near_threshold(scores, threshold, self.near)
        # The slope of the hyperbolic tangent says how near a score is to the threshold.
        return self.know(points, values, (1.0 - values**2 + _FAR) ** 2)

    def extended(self, points: FloatArray, values: FloatArray) -> GaussianProcess:
        """Process of the same kernel that knows more values.

        Parameters
        ----------
        points : ndarray of float64, shape (n, e)
        values : ndarray of float64, shape (n,)

        Returns
        -------
        GaussianProcess
            Another one.
        """
        other = copy(self)
        with one_thread():
            other._take(self._known.extended(points, values - self._mean))
        return other

    def told_by_nearest(self, points: FloatArray, values: FloatArray, some: IntArray) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation of some of many values by the nearest others, without taking them in.

        Parameters
        ----------
        points : ndarray of float64, shape (n, e)
        values : ndarray of float64, shape (n,)
        some : ndarray of int64, shape (k,)

        Returns
        -------
        mean, deviation : ndarray of float64, shape (k,)
            As of `leave_one_out`.
        """
        mean, deviation = NearestPosterior(self.kernel, points, values - self._mean).leave_one_out(some)
        return self._mean + mean, deviation

    def _take(self, known: Posterior) -> None:
        self._known = known
        self._nearest = None
        if isinstance(known, SparsePosterior) and len(known.values) > MOST_TOGETHER:
            self._nearest = NearestPosterior(self.kernel, known.known, known.values)
        self._factors: tuple[Floats, Floats] = known.weights, np.asfortranarray(known.inverse)
        in_single = known.weights.astype(np.float32), np.asfortranarray(known.inverse, dtype=np.float32)
        # Where values lie close to each other and have little noise, single precision is all rounding error.
        some = evenly(len(known.points), _COMPARED)
        between = 0.5 * (known.points[some] + known.points[np.roll(some, 1)])
        mean, variance, _ = self._at(between, *self._factors)
        rough, rough_variance, _ = self._at(between, *in_single)
        noise2 = self.kernel.noise**2
        deviation, other = (np.sqrt(np.maximum(one, 0.0) + noise2) for one in (variance, rough_variance))
        wrong = np.maximum(np.abs(rough - mean), np.abs(other - deviation)) / deviation
        if np.quantile(wrong, _MOST) <= _ALIKE:
            self._factors = in_single

    def predict(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation of the process at points.

        In single precision where that makes no difference, so that 100,000 points and 500 values take a second or so.

        Parameters
        ----------
        points : ndarray of float64, shape (n, e)

        Returns
        -------
        mean, deviation : ndarray of float64, shape (n,)
        """
        if self._nearest is not None:
            mean, deviation = self._nearest.predict(points)
            return self._mean + mean, deviation
        mean, deviation, _ = self._predict(points, keep=False)
        return mean, deviation

    def predict_with_projections(self, points: FloatArray) -> tuple[FloatArray, FloatArray, Floats]:
        """As `predict` of up to 4,000 values, and what `covariance` needs of the points.

        Parameters
        ----------
        points : ndarray of float64, shape (n, e)

        Returns
        -------
        mean, deviation : ndarray of float64, shape (n,)
        rows : ndarray of float32 or float64, shape (n, k)
        """
        mean, deviation, parts = self._predict(points, keep=True)
        return mean, deviation, np.concatenate(parts)

    def _predict(self, points: FloatArray, keep: bool) -> tuple[FloatArray, FloatArray, list[Floats]]:
        mean, variance = np.empty(len(points)), np.empty(len(points))

        def part(first: int) -> Floats:
            these = slice(first, first + _CHUNK)
            mean[these], variance[these], rows = self._at(points[these], *self._factors)
            return rows if keep else rows[:0]

        # Each part is summed by one thread, so their number does not show.
        with one_thread(), ThreadPoolExecutor(available_cpus()) as pool:
            rows = list(pool.map(part, range(0, len(points), _CHUNK)))
        lowest = 1e-8 if self._factors[1].dtype == np.float32 else 1e-12
        return mean + self._mean, np.sqrt(np.maximum(variance, lowest * self.kernel.signal**2)), rows

    def _at(self, points: FloatArray, weights: Floats, inverse: Floats) -> tuple[Floats, FloatArray, Floats]:
        """Mean above that far from all values, variance and projections at points, in the precision of the factors."""
        single = inverse.dtype == np.float32
        cross = (self.kernel.single_covariance if single else self.kernel.covariance)(points, self._known.points)
        mean = cross @ weights
        # In place, and half the work of a product with a full matrix.
        rows: Floats = (strmm if single else dtrmm)(1.0, inverse, cross.T, side=0, lower=1, overwrite_b=1).T
        return mean, np.asarray(self.kernel.signal**2 - np.einsum("ij,ij->i", rows, rows)), rows

    def leave_one_out(self, some: IntArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation of each value by the process of all others.

        Parameters
        ----------
        some : ndarray of int64, shape (k,), optional
            Which values; by default all.

        Returns
        -------
        mean, deviation : ndarray of float64, shape (k,)
            The deviation includes the noise of the single value.

        Notes
        -----
        Source: Rasmussen and Williams 2006, equation 5.12.
        """
        if self._nearest is not None:
            mean, deviation = self._nearest.leave_one_out(some)
            return self._mean + mean, deviation
        with one_thread():
            mean, deviation = self._known.leave_one_out()
        these = slice(None) if some is None else some
        return self._mean + mean[these], deviation[these]

    def joint(self, points: FloatArray, noisy: bool = True) -> tuple[FloatArray, FloatArray]:
        """Covariance of the values at points.

        Parameters
        ----------
        points : ndarray of float64, shape (m, e)
        noisy : bool, default True
            Whether the noise of single values is included.

        Returns
        -------
        factor : ndarray of float64, shape (m, m)
            Lower Cholesky factor.
        deviation : ndarray of float64, shape (m,)
        """
        cross = self.kernel.covariance(points, self._known.points)
        covariance = self.kernel.covariance(points, points)
        # Of both halves, which are the same, one is enough for the factor.
        covariance -= products_of_rows(times_lower_transposed(cross, self._known.inverse))
        if noisy:
            covariance[np.diag_indices(len(points))] += self.kernel.noise**2
        factor = positive_factor(covariance, 1e-6 * self.kernel.signal**2)
        return factor, np.sqrt(np.diag(covariance))

    def covariance(self, points: FloatArray, rows: Floats, i: int) -> FloatArray:
        """Covariance of the process at all points with that at one of them.

        Parameters
        ----------
        points : ndarray of float64, shape (n, e)
        rows : ndarray of float32 or float64, shape (n, k)
            What `predict_with_projections` gives of the points.
        i : int
            Index of the one.

        Returns
        -------
        ndarray of float64, shape (n,)
        """
        prior = self.kernel.covariance(points, points[i : i + 1])[:, 0]
        return np.asarray(prior - rows @ rows[i], dtype=np.float64)
