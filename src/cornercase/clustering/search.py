"""Search for the kernel width and the neighbourhood radius that show the clusters best."""

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

# Grid of ``"auto"``. Three components, as in the paper, can separate a few clusters; a dozen clusters need more.
GAMMAS: Final = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
COMPONENTS: Final = (3, 6, 12, 24)
# With a single cluster, the kernel has fallen to 1/e at the median distance.
GAMMA_OF_ONE: Final = 1.0
# Share of the edges within clusters that a radius covers: all, or all but those to a few points that become noise.
EPS_QUANTILES: Final = (1.0, 0.99, 0.97, 0.94, 0.9, 0.8)
# Agreement with the expected clusters that ends the search.
GOOD: Final = 0.97
NOISE_COST: Final = 1.0
# Breaks ties between equal agreements in favour of the wider gap.
MARGIN_SHARE: Final = 0.02
LEAST_SCORE: Final = 0.0
LEAST_STABILITY: Final = 0.5
# The first candidate that is this stable is taken, of at most `MOST_JUDGED`.
STABLE: Final = 0.9
UNSTABLE_COST: Final = 0.1
MOST_JUDGED: Final = 6
# Largest number of scenarios on which validity and the error of landmarks are computed.
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
    """Cluster with the given settings, and with the best of those that are ``"auto"``.

    `ScenarioClustering` says what is best. `distances`, shape (n, n), are in `canonical_order`, since the assignment of
    border points depends on the order.
    """
    n = len(distances)
    positive = distances[distances > 0.0]
    scale = float(np.median(positive)) if len(positive) else 0.0
    scaled = distances / scale if scale else distances
    searching = "auto" in (gamma, eps) and n >= _FEWEST
    search = _Search(scaled, searching, method)
    spaces = list(_spaces(n, n_components, min_samples, search.smallest if searching else 0))
    has_structure = search.kinds.max() > 0 or eps != "auto"
    widths = (gamma,) if gamma != "auto" else GAMMAS if searching and has_structure else (GAMMA_OF_ONE,)
    # The last digits would depend on the number of BLAS threads.
    with (
        threadpool_limits(limits=1),
        step(len(spaces) * len(widths), "clustering", "settings at most") as update_progress,
    ):
        for k, (dimensions, neighbours) in enumerate(spaces):
            for i, width in enumerate(widths, start=1):
                search.try_width(width, eps, dimensions, neighbours)
                update_progress(k * len(widths) + i)
            if not searching or search.best_score >= GOOD:
                break
        best = search.choose(settled="auto" not in (gamma, eps)) if searching else 0
    settings, labels, space = search.tried[best]
    return Clustering(
        labels=labels,
        embedding=space.points,
        gamma=settings.gamma,
        eps=settings.eps,
        min_samples=settings.min_samples,
        scale=scale,
        explained=space.explained,
        candidates=tuple(candidate for candidate, _, _ in search.tried),
        method=method,
        landmarks=np.zeros(0, dtype=np.int64),
        error=0.0,
    )


def canonical_order(distances: FloatArray) -> IntArray:
    """Return the scenarios by rising sum of distances, an order that does not depend on how they were given."""
    return np.argsort(distances.sum(axis=1), kind="stable").astype(np.int64)


def _spaces(n: int, n_components: int | _Auto, min_samples: int | _Auto, smallest: int) -> Iterator[tuple[int, int]]:
    """Yield pairs of dimensions and `min_samples` to try, the usual ones first."""
    usual = max(3, math.ceil(math.log(n))) if n >= _FEWEST else 1
    # A cluster of five is not dense if six are needed; clusters that touch need more neighbours to be separated.
    neighbours = [value for value in (usual, 3, 2 * usual) if value <= max(smallest, 1)]
    neighbours = list(dict.fromkeys(neighbours)) or [usual]
    for value in neighbours if min_samples == "auto" else (min_samples,):
        for dimensions in COMPONENTS if n_components == "auto" else (n_components,):
            yield dimensions, value


def _agreement(labels: IntArray, kinds: IntArray) -> float:
    """Smaller of two mean F-measures: of each expected cluster with its best match, and vice versa."""
    shared = np.zeros((int(kinds.max()) + 1, int(labels.max()) + 1))
    if not shared.size:
        return 0.0
    is_member = labels != NOISE
    np.add.at(shared, (kinds[is_member], labels[is_member]), 1.0)
    sizes = np.bincount(kinds)[:, None] + np.bincount(labels[is_member], minlength=shared.shape[1])
    matches = 2.0 * shared / sizes
    return float(min(matches.max(axis=1).mean(), matches.max(axis=0).mean()))


class _Embedding(NamedTuple):
    """The part of a fitted kernel space that the search needs."""

    points: FloatArray
    explained: float


class _Search:
    """Candidate settings and how well each shows the clusters that the distances show."""

    def __init__(self, scaled: FloatArray, searching: bool, method: ClusteringMethod) -> None:
        self._scaled, self._searching, self._method = scaled, searching, method
        self.kinds = find_kinds(scaled) if searching else np.zeros(len(scaled), dtype=np.int64)
        self.smallest = int(np.bincount(self.kinds).min())
        self.tried: list[tuple[Candidate, IntArray, _Embedding]] = []
        self._known: dict[tuple[float, int], _Embedding] = {}

    @property
    def best_score(self) -> float:
        """Highest score of all candidates so far."""
        return max(candidate.score for candidate, _, _ in self.tried)

    def try_width(self, gamma: float, eps: float | _Auto, axes: int, needed: int) -> None:
        """Try all neighbourhood radii for one kernel."""
        if (gamma, axes) not in self._known:
            fitted = KernelSpace(gamma, axes).fit(self._scaled)
            self._known[gamma, axes] = _Embedding(fitted.embedding, fitted.explained)
        space = self._known[gamma, axes]
        steps = _Steps(space.points, self.kinds, needed)
        for radius in steps.radii(self._method) if eps == "auto" else (eps,):
            labels = find_dense_regions(space.points, radius, needed, self._method)
            clusters, noise = int(labels.max()) + 1, float(np.mean(labels == NOISE))
            agreement, score = math.nan, -math.inf
            if self._searching:
                agreement = _agreement(labels, self.kinds)
                score = agreement - NOISE_COST * noise + MARGIN_SHARE * steps.margin
            candidate = Candidate(
                gamma, radius, clusters, noise, math.nan, math.nan, math.nan, score, axes, needed, agreement
            )
            self.tried.append((candidate, labels, space))

    def choose(self, settled: bool) -> int:
        """Return the index of the best candidate, after judging the best few by stability and validity."""
        indices = np.arange(len(self._scaled))
        self._stability = Stability(self._scaled, indices, method=self._method, most=MOST_SCORED)
        # At equal scores the wider radius is more robust when scenarios are left out.
        by_score = sorted(range(len(self.tried)), key=lambda k: (-self.tried[k][0].score, -self.tried[k][0].eps))
        highest = self.tried[by_score[0]][0].score
        judged: dict[tuple[float, int, int], int] = {}
        for k in by_score:
            candidate, _, _ = self.tried[k]
            if candidate.score < highest - UNSTABLE_COST or len(judged) == MOST_JUDGED:
                break
            key = (candidate.gamma, candidate.n_components, candidate.min_samples)
            if key in judged:
                continue
            judged[key] = k
            if self._judge(k) >= STABLE:
                break
        best = max(judged.values(), key=lambda k: self.tried[k][0].score)
        best_by_count = {candidate.clusters: k for k in reversed(by_score) for candidate in [self.tried[k][0]]}
        best_by_count[self.tried[best][0].clusters] = best
        compared = sorted(best_by_count.values(), key=lambda k: -self.tried[k][0].score)[:MOST_JUDGED]
        validity = Validity(self._scaled, indices[:: math.ceil(len(indices) / MOST_SCORED)])
        for k in {*compared, *([best_by_count[1]] if 1 in best_by_count else [])}:
            self._judge(k)
            candidate, labels, space = self.tried[k]
            if candidate.clusters > 1:
                dbcv, silhouette = validity.of(labels)
                self.tried[k] = replace(candidate, dbcv=dbcv, silhouette=silhouette), labels, space
        winner = self.tried[best][0]
        if not settled and 1 in best_by_count and (winner.score < LEAST_SCORE or winner.stability < LEAST_STABILITY):
            return best_by_count[1]
        return best

    def _judge(self, k: int) -> float:
        """Add the stability of a candidate to it and to its score."""
        candidate, labels, space = self.tried[k]
        if math.isnan(candidate.stability):
            stability = self._stability.of(candidate, labels)
            candidate = replace(
                candidate, stability=stability, score=candidate.score - UNSTABLE_COST * (1.0 - stability)
            )
            self.tried[k] = candidate, labels, space
        return candidate.stability


class _Steps:
    """Edges of the minimum spanning tree in an embedding: within the expected clusters, and between them."""

    def __init__(self, points: FloatArray, kinds: IntArray, needed: int) -> None:
        n, distances = len(points), squareform(pdist(points))
        self._largest = float(distances.max(initial=0.0))
        core = np.partition(distances, min(needed, n) - 1, axis=1)[:, min(needed, n) - 1]
        edges, lengths = np.empty((2, n - 1), dtype=np.int64), np.empty(n - 1)
        find_tree(np.maximum(distances, np.maximum(core[:, None], core)), edges, lengths)
        is_across = kinds[edges[0]] != kinds[edges[1]]
        self._within, self._across = lengths[~is_across], lengths[is_across]

    @property
    def margin(self) -> float:
        """How clear the gap between clusters is, 0 to 1."""
        if not len(self._across) or not len(self._within):
            return 0.0
        return max(0.0, 1.0 - float(self._within.max() / max(self._across.min(), 1e-300)))

    def radii(self, method: ClusteringMethod) -> Iterable[float]:
        """Radii to try: between the edges within clusters and those across; the largest connects everything."""
        tiny = 1e-9 + 1e-6 * self._largest
        # A radius equal to a distance would make neighbours depend on the last digits.
        connects_all = self._largest + tiny
        if not len(self._across) or not len(self._within):
            return (connects_all,)
        gap = float(self._across.min())
        steps = {float(np.quantile(self._within, q)) + tiny for q in EPS_QUANTILES}
        radii = {math.sqrt(step * gap) for step in steps if step < gap} | {step for step in steps if step >= gap}
        return [*sorted(radii), connects_all, *((0.0,) if method == "hdbscan" else ())]
