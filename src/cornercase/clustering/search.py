"""The settings of kernel and neighbourhood that suit some scenarios best."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Final, Literal, NamedTuple

import numpy as np
from scipy.spatial.distance import pdist, squareform
from threadpoolctl import threadpool_limits

from cornercase._common.progress import step
from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering.clusters import NOISE, Candidate, Clustering, ClusteringMethod
from cornercase.clustering.density import find_dense_regions
from cornercase.clustering.kernel_space import KernelSpace
from cornercase.clustering.kinds import find_kinds
from cornercase.clustering.spanning_tree import find_tree
from cornercase.clustering.stability import Stability
from cornercase.clustering.validity import Validity

# What ``"auto"`` tries. Three components, as in the paper, hold a few kinds; a dozen need more.
GAMMAS: Final = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
COMPONENTS: Final = (3, 6, 12, 24)
# Where there is one kind, the kernel has fallen to 1/e at the median distance.
GAMMA_OF_ONE: Final = 1.0
# Steps within kinds that a neighbourhood reaches over: all, or all but those to a few that become noise.
EPS_QUANTILES: Final = (1.0, 0.99, 0.97, 0.94, 0.9, 0.8)
# Clusters that agree so well with the kinds end the search.
GOOD: Final = 0.97
NOISE_COST: Final = 1.0
# Among clusters that agree equally, those count a little more that a wider gap divides.
MARGIN_SHARE: Final = 0.02
LEAST_SCORE: Final = 0.0
LEAST_STABILITY: Final = 0.5
# The first that is so stable is taken, of so many at most.
STABLE: Final = 0.9
UNSTABLE_COST: Final = 0.1
MOST_JUDGED: Final = 6
# Validity, and the loss by landmarks, is computed on so many scenarios at most.
MOST_SCORED: Final = 1000
_FEWEST: Final = 5

_Auto = Literal["auto"]


def search_settings(
    distances: FloatArray,
    *,
    gamma: float | _Auto,
    eps: float | _Auto,
    min_samples: int | _Auto,
    n_components: int | _Auto,
    method: ClusteringMethod,
) -> Clustering:
    """Cluster with the settings that are given, and with the best of those that are left open.

    `cornercase.clustering.ScenarioClustering` says what is best.

    Parameters
    ----------
    distances : ndarray of float64, shape (n, n)
        Symmetric, zero on the diagonal, finite; in `canonical_order`, as clusters that touch depend on the order.
    gamma, eps : float or "auto"
        Kernel width, and radius of the neighbourhood in the embedding.
    min_samples : int or "auto"
        Least number of scenarios in a dense neighbourhood.
    n_components : int or "auto"
        Dimensions of the embedding.
    method : {"dbscan", "hdbscan"}
        Algorithm that finds the clusters.

    Returns
    -------
    Clustering
        The clusters with the best settings.
    """
    n = len(distances)
    positive = distances[distances > 0.0]
    scale = float(np.median(positive)) if len(positive) else 0.0
    scaled = distances / scale if scale else distances
    searching = "auto" in (gamma, eps) and n >= _FEWEST
    search = _Search(scaled, searching, method)
    spaces = list(_spaces(n, n_components, min_samples, search.smallest if searching else 0))
    several = search.kinds.max() > 0 or eps != "auto"
    widths = (gamma,) if gamma != "auto" else GAMMAS if searching and several else (GAMMA_OF_ONE,)
    # Threads of the linear algebra would change the last digits with their number.
    with threadpool_limits(limits=1), step(len(spaces) * len(widths), "clustering", "settings at most") as tell:
        for k, (axes, needed) in enumerate(spaces):
            for i, width in enumerate(widths, start=1):
                search.try_width(width, eps, axes, needed)
                tell(k * len(widths) + i)
            if not searching or search.best_score >= GOOD:
                break
        best = search.choose(settled="auto" not in (gamma, eps)) if searching else 0
    chosen, labels, space = search.tried[best]
    return Clustering(
        labels=labels,
        embedding=space.points,
        gamma=chosen.gamma,
        eps=chosen.eps,
        min_samples=chosen.min_samples,
        scale=scale,
        explained=space.explained,
        candidates=tuple(one for one, _, _ in search.tried),
        method=method,
        landmarks=np.zeros(0, dtype=np.int64),
        error=0.0,
    )


def canonical_order(distances: FloatArray) -> IntArray:
    """Order of scenarios that does not depend on the one in which they are given.

    Parameters
    ----------
    distances : ndarray of float64, shape (n, n)
        Between all scenarios, in any unit.

    Returns
    -------
    ndarray of int64, shape (n,)
        By rising sum of distances.
    """
    return np.argsort(distances.sum(axis=1), kind="stable").astype(np.int64)


def _spaces(n: int, n_components: int | _Auto, min_samples: int | _Auto, smallest: int) -> Iterator[tuple[int, int]]:
    """Dimensions and numbers of neighbours to try, the usual ones first."""
    usual = max(3, math.ceil(math.log(n))) if n >= _FEWEST else 1
    # Five that are alike are not dense where six are needed; and where two kinds touch, more must be.
    needed = [one for one in (usual, 3, 2 * usual) if one <= max(smallest, 1)]
    needed = list(dict.fromkeys(needed)) or [usual]
    for one in needed if min_samples == "auto" else (min_samples,):
        for axes in COMPONENTS if n_components == "auto" else (n_components,):
            yield axes, one


def _agreement(labels: IntArray, kinds: IntArray) -> float:
    """How well clusters and kinds match: mean F-measure of each with what it shares most with, the lesser of both."""
    shared = np.zeros((int(kinds.max()) + 1, int(labels.max()) + 1))
    if not shared.size:
        return 0.0
    inside = labels != NOISE
    np.add.at(shared, (kinds[inside], labels[inside]), 1.0)
    sizes = np.bincount(kinds)[:, None] + np.bincount(labels[inside], minlength=shared.shape[1])
    matches = 2.0 * shared / sizes
    return float(min(matches.max(axis=1).mean(), matches.max(axis=0).mean()))


class _Embedding(NamedTuple):
    """What is kept of a kernel space while others are tried."""

    points: FloatArray
    explained: float


class _Search:
    """Candidates, and how well they show the kinds that the distances show, where settings are searched."""

    def __init__(self, scaled: FloatArray, searching: bool, method: ClusteringMethod) -> None:
        self._scaled, self._searching, self._method = scaled, searching, method
        self.kinds = find_kinds(scaled) if searching else np.zeros(len(scaled), dtype=np.int64)
        self.smallest = int(np.bincount(self.kinds).min())
        self.tried: list[tuple[Candidate, IntArray, _Embedding]] = []
        self._known: dict[tuple[float, int], _Embedding] = {}

    @property
    def best_score(self) -> float:
        """Of all candidates so far."""
        return max(one.score for one, _, _ in self.tried)

    def try_width(self, gamma: float, eps: float | _Auto, axes: int, needed: int) -> None:
        """Try neighbourhoods of one kernel."""
        if (gamma, axes) not in self._known:
            fitted = KernelSpace(gamma, axes).fit(self._scaled)
            self._known[gamma, axes] = _Embedding(fitted.embedding, fitted.explained)
        space = self._known[gamma, axes]
        steps = _Steps(space.points, self.kinds, needed)
        for reach in steps.radii(self._method) if eps == "auto" else (eps,):
            labels = find_dense_regions(space.points, reach, needed, self._method)
            clusters, noise = int(labels.max()) + 1, float(np.mean(labels == NOISE))
            agreement, score = math.nan, -math.inf
            if self._searching:
                agreement = _agreement(labels, self.kinds)
                score = agreement - NOISE_COST * noise + MARGIN_SHARE * steps.margin
            one = Candidate(gamma, reach, clusters, noise, math.nan, math.nan, math.nan, score, axes, needed, agreement)
            self.tried.append((one, labels, space))

    def choose(self, settled: bool) -> int:
        """Index of the best candidate; validity and stability go into it, and into the best of a few other numbers."""
        every = np.arange(len(self._scaled))
        self._stability = Stability(self._scaled, every, method=self._method, most=MOST_SCORED)
        # Of neighbourhoods that do equally well, the wider one goes on doing so when scenarios are left out.
        falling = sorted(range(len(self.tried)), key=lambda k: (-self.tried[k][0].score, -self.tried[k][0].eps))
        highest = self.tried[falling[0]][0].score
        judged: dict[tuple[float, int, int], int] = {}
        for k in falling:
            one, _, _ = self.tried[k]
            if one.score < highest - UNSTABLE_COST or len(judged) == MOST_JUDGED:
                break
            key = (one.gamma, one.n_components, one.min_samples)
            if key in judged:
                continue
            judged[key] = k
            if self._judge(k) >= STABLE:
                break
        best = max(judged.values(), key=lambda k: self.tried[k][0].score)
        numbers = {one.clusters: k for k in reversed(falling) for one in [self.tried[k][0]]}
        numbers[self.tried[best][0].clusters] = best
        shown = sorted(numbers.values(), key=lambda k: -self.tried[k][0].score)[:MOST_JUDGED]
        validity = Validity(self._scaled, every[:: math.ceil(len(every) / MOST_SCORED)])
        for k in {*shown, *([numbers[1]] if 1 in numbers else [])}:
            self._judge(k)
            one, labels, space = self.tried[k]
            if one.clusters > 1:
                dbcv, silhouette = validity.of(labels)
                self.tried[k] = replace(one, dbcv=dbcv, silhouette=silhouette), labels, space
        chosen = self.tried[best][0]
        if not settled and 1 in numbers and (chosen.score < LEAST_SCORE or chosen.stability < LEAST_STABILITY):
            return numbers[1]
        return best

    def _judge(self, k: int) -> float:
        """Put the stability of a candidate into it and into its score."""
        one, labels, space = self.tried[k]
        if math.isnan(one.stability):
            found = self._stability.of(one, labels)
            one = replace(one, stability=found, score=one.score - UNSTABLE_COST * (1.0 - found))
            self.tried[k] = one, labels, space
        return one.stability


class _Steps:
    """Steps from scenario to scenario in an embedding: within kinds, and between them."""

    def __init__(self, points: FloatArray, kinds: IntArray, needed: int) -> None:
        n, between = len(points), squareform(pdist(points))
        self._largest = float(between.max(initial=0.0))
        core = np.partition(between, min(needed, n) - 1, axis=1)[:, min(needed, n) - 1]
        ends, lengths = np.empty((2, n - 1), dtype=np.int64), np.empty(n - 1)
        find_tree(np.maximum(between, np.maximum(core[:, None], core)), ends, lengths)
        across = kinds[ends[0]] != kinds[ends[1]]
        self._within, self._across = lengths[~across], lengths[across]

    @property
    def margin(self) -> float:
        """How clear the gap is, 0 to 1."""
        if not len(self._across) or not len(self._within):
            return 0.0
        return max(0.0, 1.0 - float(self._within.max() / max(self._across.min(), 1e-300)))

    def radii(self, method: ClusteringMethod) -> Iterable[float]:
        """Neighbourhoods to try: between the steps within kinds and those across; the last holds everything."""
        tiny = 1e-9 + 1e-6 * self._largest
        # A radius that is a distance itself would leave it to the last digits who is a neighbour.
        everything = self._largest + tiny
        if not len(self._across) or not len(self._within):
            return (everything,)
        gap = float(self._across.min())
        steps = {float(np.quantile(self._within, q)) + tiny for q in EPS_QUANTILES}
        tried = {math.sqrt(step * gap) for step in steps if step < gap} | {step for step in steps if step >= gap}
        return [*sorted(tried), everything, *((0.0,) if method == "hdbscan" else ())]
