"""How much of a space is critical, and how much of that an exploration may have missed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from scipy.optimize import minimize
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.special import log_ndtr, ndtr
from scipy.stats import qmc

from cornercase._common.rows import row_keys
from cornercase._common.threads import one_thread
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.evidence.gaussian_process import boundary_process, encoded, enough
from cornercase.evidence.products import lower_times
from cornercase.scenario import ParameterSpace

# Points that stand for the space, those of them for which critical sets are drawn, and the number of draws.
_PLACES, _JOINT, _DRAWS = 2**14, 1500, 400
# Groups of places of nearly the same probability.
_GROUPS: Final = 1024
_INTERVAL: Final = (0.05, 0.95)
# As how many independent predictions one scenario counts. Neighbours are predicted from each other; with this figure
# the intervals hold the truth as often as they say in benchmarks/exploration.py.
_INDEPENDENT: Final = 0.8

REGION: Final = 0.01
"""Share of the space from which a region counts, unless somebody says otherwise."""


@dataclass(frozen=True)
class Estimate:
    """A quantity with its 90 % credible interval.

    Attributes
    ----------
    value, low, high : float
        Mean, 5 % and 95 % quantile.
    """

    value: float
    low: float
    high: float


class CriticalSet:
    """Estimate of the set of all critical scenarios of a space, from those that were run.

    A Gaussian process of the scores (`boundary_process`) predicts each scenario that was run from all others. How good
    these predictions are corrects the probability that a scenario is critical: ``p = Φ(-(a + b t))``, where t is the
    mean of the process over its standard deviation, and a and b are fitted to the predictions, each weighted by the
    share of the space that is nearest to its scenario. Critical sets are drawn with these probabilities, with the
    correlation of the process between places, and with a and b from their posterior.

    A critical scenario counts as found when it was run, or when the mean of the process there is beyond the
    threshold.

    Parameters
    ----------
    space : ParameterSpace
    points : ndarray of float64, shape (n, d)
        Scenarios that were run, in the unit cube.
    scores : ndarray of float64, shape (n,)
        Oriented: lower is more critical. NaN for a scenario that failed.
    threshold : float
        Oriented score up to which a scenario is critical.
    seed : int, default 0

    Raises
    ------
    ValueError
        There are fewer than 10 scores, or all are the same.

    Notes
    -----
    Leave-one-out prediction: C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning" (2006),
    equation 5.12. Correction of probabilities: J. Platt, "Probabilistic outputs for support vector machines" (1999),
    here with the normal distribution function and Laplace's approximation of the posterior.
    """

    def __init__(
        self, space: ParameterSpace, points: FloatArray, scores: FloatArray, threshold: float, seed: int = 0
    ) -> None:
        points, scores = enough(points, scores)
        self._critical = scores <= threshold
        self._places = _places(space, seed)
        self._at = encoded(space, self._places)
        self._ran = encoded(space, points)
        self._process = boundary_process(self._ran, scores, threshold)
        mean, deviation = self._process.predict(self._at)
        self._t = mean / np.hypot(deviation, self._process.kernel.noise)
        self._space = space
        self._outcome = dict(zip(row_keys(space.snap(points)), np.where(self._critical, np.inf, -np.inf), strict=True))
        self._certain = self._seen(self._places)
        self._is_found = _found(mean, self._certain)
        self._rng = np.random.default_rng(seed)
        # Sums in one order, whatever the number of threads.
        with one_thread():
            self._learn()
            self._draw()

    def _learn(self) -> None:
        """Fit the correction of the probabilities, and draw from its posterior."""
        mean, deviation = self._process.leave_one_out()
        t = mean / deviation
        nearest = np.asarray(cKDTree(self._ran).query(self._at)[1], dtype=np.int64)
        share = np.bincount(nearest, minlength=len(t)) / len(nearest)
        weights = _INDEPENDENT * share / (share**2).sum()
        sign = np.where(self._critical, 1.0, -1.0)

        def loss(parameters: FloatArray) -> float:
            a, log_b = parameters
            predicted = log_ndtr(-sign * (a + np.exp(log_b) * t))
            return float(-(weights * predicted).sum() + 0.5 * (parameters**2).sum())

        best = minimize(loss, np.zeros(2), method="BFGS")
        self._correction = self._rng.multivariate_normal(best.x, np.asarray(best.hess_inv), _DRAWS)

    def _draw(self) -> None:
        """Draw critical sets on some of the places, and the critical share on all."""
        part = slice(None, min(_JOINT, len(self._at)))
        factor, deviation = self._process.joint(self._at[part])
        normal = lower_times(factor, self._rng.standard_normal((len(factor), _DRAWS)))
        normal /= deviation[:, None]
        limit = self._limit(part)
        self._drawn: BoolArray = normal <= limit
        # The joint draws on few places give the spread, the probabilities on all places the mean.
        shares = self._drawn.mean(axis=0) + self._level() - ndtr(limit).mean(axis=0)
        self._shares = np.clip(shares, 0.0, 1.0)

    @cached_property
    def _groups(self) -> tuple[IntArray, FloatArray]:
        """Places of nearly the same probability: group of each place, and that probability by group and draw."""
        order = np.argsort(self._t[self._certain == 0.0], kind="stable")
        groups = [one for one in np.array_split(np.flatnonzero(self._certain == 0.0)[order], _GROUPS) if len(one)]
        # The last two are for what was run: first what is not critical.
        group = np.where(self._certain > 0.0, len(groups) + 1, len(groups))
        for k, one in enumerate(groups):
            group[one] = k
        a, log_b = self._correction.T.copy()
        middle = np.array([self._t[one].mean() for one in groups])
        likely = ndtr(-(a + np.exp(log_b) * middle[:, None]))
        return group, np.concatenate([likely, np.zeros((1, _DRAWS)), np.ones((1, _DRAWS))])

    def _level(self) -> FloatArray:
        """Mean probability in each draw that a place is critical, shape (draws,)."""
        group, likely = self._groups
        return np.asarray(np.bincount(group, minlength=len(likely)) @ likely / len(self._at))

    def _limit(self, part: slice) -> FloatArray:
        """Normal deviate up to which a place is critical in each draw; infinite where it was run."""
        # Copies, since NumPy's results for strided arrays depend, in the last digit, on where they lie in memory.
        a, log_b = self._correction.T.copy()
        limit = -(a + np.exp(log_b) * self._t[part, None])
        return np.where(self._certain[part, None] == 0.0, limit, self._certain[part, None])

    def found(self, points: FloatArray) -> BoolArray:
        """Predict which scenarios are critical.

        Parameters
        ----------
        points : ndarray of float64, shape (n, d)

        Returns
        -------
        ndarray of bool, shape (n,)
        """
        mean, _ = self._process.predict(encoded(self._space, points))
        return _found(mean, self._seen(points))

    def _seen(self, points: FloatArray) -> FloatArray:
        """Infinite for scenarios that were run and critical, minus infinite for others that were run, else 0; (n,)."""
        return np.array([self._outcome.get(key, 0.0) for key in row_keys(self._space.snap(points))])

    @cached_property
    def share(self) -> Estimate:
        """Critical share of the space."""
        return _estimate(self._shares)

    @cached_property
    def missed(self) -> Estimate:
        """Share of the critical set that is not found; all of it while no critical scenario was run."""
        if not self._critical.any():
            return Estimate(1.0, 1.0, 1.0)
        unseen = (self._drawn & ~self._is_found[: len(self._drawn), None]).sum(axis=0)
        return _estimate(unseen / np.maximum(self._drawn.sum(axis=0), 1))

    def share_in(self, other: CriticalSet) -> Estimate:
        """Share of the critical set that lies in another set of the same space.

        Parameters
        ----------
        other : CriticalSet
            From another score of scenarios of the same space, with the same seed; taken for independent.

        Returns
        -------
        Estimate
        """
        both = (self._drawn & other._drawn).mean(axis=0)
        # As for the share of the space: few places give the spread, all places the mean.
        weights = np.full(len(self._at), 1.0 / len(self._at))
        weights[: len(self._drawn)] -= 1.0 / len(self._drawn)
        (mine, likely), (others, likely_too) = self._groups, other._groups
        places = coo_array((weights, (mine, others)), shape=(len(likely), len(likely_too)))
        both += (likely * (places.tocsr() @ likely_too)).sum(axis=0)
        shares = np.clip(both / np.maximum(self._shares, 1e-12), 0.0, 1.0)
        return _estimate(shares)

    def overlooked(self, size: float = REGION) -> float:
        """Probability, by the process, that no scenario was run in some critical region.

        Parameters
        ----------
        size : float, default 0.01
            Share of the space from which a region counts.

        Returns
        -------
        float
        """
        count, edges = len(self._drawn), self._edges
        ran = np.broadcast_to(self._critical[:, None], (len(self._critical), _DRAWS))
        critical = np.concatenate([self._drawn, ran])
        overlooked = 0
        for one in critical.T:
            kept = edges[:, one[edges[0]] & one[edges[1]]]
            graph = coo_array((np.ones(kept.shape[1]), (kept[0], kept[1])), shape=(len(one), len(one)))
            label = connected_components(graph, directed=False)[1]
            sizes = np.bincount(label[:count][one[:count]], minlength=label.max() + 1)
            hit = np.zeros(len(sizes), dtype=np.bool_)
            hit[label[count:][self._critical]] = True
            overlooked += bool(((sizes >= max(size * count, 1.0)) & ~hit).any())
        return overlooked / _DRAWS

    def unvisited(self, size: float = REGION) -> float:
        """Share of the space around which a ball of a given size holds none of the scenarios that were run.

        It needs no assumption about the scores: a critical ball of this size at a random place is met with a
        probability of one minus this share.

        Parameters
        ----------
        size : float, default 0.01
            Share of the space that the ball takes; it keeps to one choice of each parameter with names.

        Returns
        -------
        float
        """
        numbers = [one for one in self._space.parameters if not one.choices and one.size != 1]
        dims, choices = len(numbers), math.prod(len(one.choices) or 1 for one in self._space.parameters)
        ball = np.pi ** (dims / 2) / math.gamma(dims / 2 + 1)
        radius = (size * choices / ball) ** (1 / dims) if dims else 0.0
        # Choices are at a distance of 1 from each other.
        return float(np.mean(cKDTree(self._ran).query(self._at)[0] > min(radius, 0.999)))

    @cached_property
    def _edges(self) -> IntArray:
        """Pairs of neighbours among the places and the scenarios that were run, shape (2, E)."""
        nodes = np.concatenate([self._at[: len(self._drawn)], self._ran])
        found = cKDTree(nodes).query(nodes, k=min(2 * nodes.shape[1] + 1, len(nodes)))[1]
        near = np.asarray(found, dtype=np.int64)[:, 1:]
        return np.stack([np.repeat(np.arange(len(nodes)), near.shape[1]), near.ravel()])


def _places(space: ParameterSpace, seed: int) -> FloatArray:
    """Concrete scenarios that stand for the space, each as often as it is likely."""
    with_all = space.snap(qmc.Sobol(space.dimension, seed=np.random.default_rng([seed, 1])).random(_PLACES))
    return with_all[space.admits(with_all)]


def _found(mean: FloatArray, seen: FloatArray) -> BoolArray:
    return np.where(seen == 0.0, mean <= 0.0, seen > 0.0)


def _estimate(draws: FloatArray) -> Estimate:
    low, high = np.quantile(draws, _INTERVAL)
    return Estimate(float(draws.mean()), float(low), float(high))
