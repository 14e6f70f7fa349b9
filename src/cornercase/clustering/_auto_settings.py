"""Search for the width of the Gaussian kernel and the radius of DBSCAN that show the clusters best."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Final, Literal, NamedTuple

import numpy as np
from scipy.spatial.distance import pdist, squareform

from cornercase._common.numba.blas import single_threaded_blas
from cornercase._common.progress import progress_step
from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering._clustering import NOISE_LABEL, Candidate, Clustering, ClusteringMethod
from cornercase.clustering._density import cluster_by_density
from cornercase.clustering._kernel_pca import KernelPca
from cornercase.clustering._kernels.spanning_tree import fill_spanning_tree
from cornercase.clustering._n_clusters import estimate_clusters
from cornercase.clustering._stability import StabilityScorer
from cornercase.clustering._validity import ValidityScorer

# Grid of ``"auto"``. Three components, as in the paper, can separate a few clusters; a dozen clusters need more.
GAMMAS: Final = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
COMPONENTS: Final = (3, 6, 12, 24)
# With a single cluster, the kernel has fallen to 1/e at the median distance.
SINGLE_CLUSTER_GAMMA: Final = 1.0
# Shares of the edges within clusters that a radius covers: all edges, or all but the longest, which lead to noise.
EPS_QUANTILES: Final = (1.0, 0.99, 0.97, 0.94, 0.9, 0.8)
# Score that ends the search: agreement with the expected clusters, less the share of noise, plus the part for the gap.
GOOD_AGREEMENT: Final = 0.97
NOISE_COST: Final = 1.0
# Weight of the gap between clusters in the score: it breaks ties between equal agreements.
MARGIN_SHARE: Final = 0.02
MIN_SCORE: Final = 0.0
MIN_STABILITY: Final = 0.5
# Of the candidates with the best scores, at most `MAX_JUDGED` are tested for stability, up to the first this stable.
GOOD_STABILITY: Final = 0.9
INSTABILITY_COST: Final = 0.1
MAX_JUDGED: Final = 6
# Largest number of scenarios on which validity and the error of landmarks are computed.
MAX_SCORED: Final = 1000
_MIN_SCENARIOS: Final = 5

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
    """Cluster scenarios with the given settings; settings that are ``"auto"`` are searched.

    `ScenarioClustering` describes the search. If `gamma` and `eps` are both given, or there are fewer than five
    scenarios, nothing is searched: of each other setting, the first candidate is taken. `distances`, shape (n, n), are
    in `canonical_order`, since the assignment of border points depends on the order of the scenarios.
    """
    n = len(distances)
    positive = distances[distances > 0.0]
    scale = float(np.median(positive)) if len(positive) else 0.0
    scaled = distances / scale if scale else distances
    searching = "auto" in (gamma, eps) and n >= _MIN_SCENARIOS
    search = _SettingsSearch(scaled, searching, method)
    spaces = list(_candidate_spaces(n, n_components, min_samples, search.smallest if searching else 0))
    has_structure = search.expected.max() > 0 or eps != "auto"
    widths = (gamma,) if gamma != "auto" else GAMMAS if searching and has_structure else (SINGLE_CLUSTER_GAMMA,)
    # The last digits would depend on the number of BLAS threads.
    with (
        single_threaded_blas(),
        progress_step(len(spaces) * len(widths), "clustering", "settings at most") as update_progress,
    ):
        for k, (dimensions, neighbours) in enumerate(spaces):
            for i, width in enumerate(widths, start=1):
                search.evaluate_kernel(width, eps, dimensions, neighbours)
                update_progress(k * len(widths) + i)
            if not searching or search.best_score >= GOOD_AGREEMENT:
                break
        best = search.find_best_candidate_index() if searching else 0
    settings, labels, space = search.candidates[best]
    return Clustering(
        labels=labels,
        embedding=space.points,
        gamma=settings.gamma,
        eps=settings.eps,
        min_samples=settings.min_samples,
        scale=scale,
        explained=space.explained,
        candidates=tuple(candidate for candidate, _, _ in search.candidates),
        method=method,
        landmarks=np.zeros(0, dtype=np.int64),
        error=0.0,
    )


def canonical_order(distances: FloatArray) -> IntArray:
    """Return the scenarios' indices by rising sum of distances: an order that does not depend on the given order."""
    return np.argsort(distances.sum(axis=1), kind="stable").astype(np.int64)


def _candidate_spaces(
    n_scenarios: int, n_components: int | _Auto, min_samples: int | _Auto, smallest_cluster: int
) -> Iterator[tuple[int, int]]:
    """Yield the pairs (dimensions of the kernel space, `min_samples`) to try.

    The usual pair comes first. If `min_samples` is ``"auto"``, values above the size of the smallest expected cluster
    are left out, the usual value included; if no value remains, the usual value is tried.
    """
    usual = max(3, math.ceil(math.log(n_scenarios))) if n_scenarios >= _MIN_SCENARIOS else 1
    # A cluster of five is not dense if six are needed; clusters that touch need more neighbours to be separated.
    neighbours = [value for value in (usual, 3, 2 * usual) if value <= max(smallest_cluster, 1)]
    neighbours = list(dict.fromkeys(neighbours)) or [usual]
    for value in neighbours if min_samples == "auto" else (min_samples,):
        for dimensions in COMPONENTS if n_components == "auto" else (n_components,):
            yield dimensions, value


def _mean_f_measure(labels: IntArray, expected: IntArray) -> float:
    """Return how well two clusterings match, 0 to 1: the lower of two means of F-measures.

    One is the mean over the `expected` clusters, each compared with the most similar cluster of `labels`; the other is
    the mean over the clusters of `labels`, each compared with the most similar expected cluster.
    """
    shared = np.zeros((int(expected.max()) + 1, int(labels.max()) + 1))
    if not shared.size:
        return 0.0
    is_member = labels != NOISE_LABEL
    np.add.at(shared, (expected[is_member], labels[is_member]), 1.0)
    sizes = np.bincount(expected)[:, None] + np.bincount(labels[is_member], minlength=shared.shape[1])
    matches = 2.0 * shared / sizes
    return float(min(matches.max(axis=1).mean(), matches.max(axis=0).mean()))


class _Embedding(NamedTuple):
    """Coordinates of scenarios in kernel space, shape (n, dimensions), and the share of the variance that they keep."""

    points: FloatArray
    explained: float


class _SettingsSearch:
    """Search for the settings with which kernel PCA and DBSCAN find the clusters that the distances show.

    `expected` are the clusters that the distances show, as estimated. `candidates` are all settings tried so far.
    """

    def __init__(self, distances: FloatArray, searching: bool, method: ClusteringMethod) -> None:
        self._scaled, self._searching, self._method = distances, searching, method
        self.expected = estimate_clusters(distances) if searching else np.zeros(len(distances), dtype=np.int64)
        self.smallest = int(np.bincount(self.expected).min())
        self.candidates: list[tuple[Candidate, IntArray, _Embedding]] = []
        self._embeddings: dict[tuple[float, int], _Embedding] = {}

    @property
    def best_score(self) -> float:
        """Highest score of all candidates so far."""
        return max(candidate.score for candidate, _, _ in self.candidates)

    def evaluate_kernel(self, gamma: float, eps: float | _Auto, n_components: int, min_samples: int) -> None:
        """Try all radii, or the given radius `eps`, in one kernel space; add each radius as a candidate."""
        if (gamma, n_components) not in self._embeddings:
            fitted = KernelPca(gamma, n_components).fit(self._scaled)
            self._embeddings[gamma, n_components] = _Embedding(fitted.embedding, fitted.explained)
        space = self._embeddings[gamma, n_components]
        steps = _SpanningTreeEdges(space.points, self.expected, min_samples)
        for radius in steps.candidate_radii(self._method) if eps == "auto" else (eps,):
            labels = cluster_by_density(space.points, radius, min_samples, self._method)
            clusters, noise = int(labels.max()) + 1, float(np.mean(labels == NOISE_LABEL))
            agreement, score = math.nan, -math.inf
            if self._searching:
                agreement = _mean_f_measure(labels, self.expected)
                score = agreement - NOISE_COST * noise + MARGIN_SHARE * steps.gap_clearness
            candidate = Candidate(
                gamma,
                radius,
                clusters,
                noise,
                math.nan,
                math.nan,
                math.nan,
                score,
                n_components,
                min_samples,
                agreement,
            )
            self.candidates.append((candidate, labels, space))

    def find_best_candidate_index(self) -> int:
        """Return the index of the best candidate.

        The stability of the few candidates with the highest scores is computed, up to the first stable one. Stability
        and validity are also computed for the best candidate of each of a few numbers of clusters. If the best of the
        candidates with the highest scores scores too low or is too unstable, a candidate with a single cluster wins
        instead, if there is one.
        """
        indices = np.arange(len(self._scaled))
        self._stability = StabilityScorer(self._scaled, indices, method=self._method, max_part_size=MAX_SCORED)
        # At equal scores the wider radius is more robust when scenarios are left out.
        by_score = sorted(
            range(len(self.candidates)), key=lambda k: (-self.candidates[k][0].score, -self.candidates[k][0].eps)
        )
        highest = self.candidates[by_score[0]][0].score
        judged: dict[tuple[float, int, int], int] = {}
        for k in by_score:
            candidate, _, _ = self.candidates[k]
            if candidate.score < highest - INSTABILITY_COST or len(judged) == MAX_JUDGED:
                break
            key = (candidate.gamma, candidate.n_components, candidate.min_samples)
            if key in judged:
                continue
            judged[key] = k
            if self._add_stability(k) >= GOOD_STABILITY:
                break
        best = max(judged.values(), key=lambda k: self.candidates[k][0].score)
        best_by_count = {candidate.clusters: k for k in reversed(by_score) for candidate in [self.candidates[k][0]]}
        best_by_count[self.candidates[best][0].clusters] = best
        compared = sorted(best_by_count.values(), key=lambda k: -self.candidates[k][0].score)[:MAX_JUDGED]
        validity = ValidityScorer(self._scaled, indices[:: math.ceil(len(indices) / MAX_SCORED)])
        for k in {*compared, *([best_by_count[1]] if 1 in best_by_count else [])}:
            self._add_stability(k)
            candidate, labels, space = self.candidates[k]
            if candidate.clusters > 1:
                dbcv, silhouette = validity.dbcv_and_silhouette(labels)
                self.candidates[k] = replace(candidate, dbcv=dbcv, silhouette=silhouette), labels, space
        winner = self.candidates[best][0]
        if 1 in best_by_count and (winner.score < MIN_SCORE or winner.stability < MIN_STABILITY):
            return best_by_count[1]
        return best

    def _add_stability(self, index: int) -> float:
        """Compute the stability of a candidate, lower its score if it is unstable, and return the stability."""
        candidate, labels, space = self.candidates[index]
        if math.isnan(candidate.stability):
            stability = self._stability.mean_rand_index(candidate, labels)
            candidate = replace(
                candidate, stability=stability, score=candidate.score - INSTABILITY_COST * (1.0 - stability)
            )
            self.candidates[index] = candidate, labels, space
        return candidate.stability


class _SpanningTreeEdges:
    """Edges of the minimum spanning tree of the mutual reachability distance in an embedding.

    The edges are divided into edges within an expected cluster and edges between two expected clusters.
    """

    def __init__(self, points: FloatArray, expected: IntArray, min_samples: int) -> None:
        n, distances = len(points), squareform(pdist(points))
        self._largest = float(distances.max(initial=0.0))
        core = np.partition(distances, min(min_samples, n) - 1, axis=1)[:, min(min_samples, n) - 1]
        edges, lengths = np.empty((2, n - 1), dtype=np.int64), np.empty(n - 1)
        fill_spanning_tree(np.maximum(distances, np.maximum(core[:, None], core)), edges, lengths)
        is_across = expected[edges[0]] != expected[edges[1]]
        self._within, self._across = lengths[~is_across], lengths[is_across]

    @property
    def gap_clearness(self) -> float:
        """How much shorter the longest edge within clusters is than the shortest edge between them: a share, 0 to 1."""
        if not len(self._across) or not len(self._within):
            return 0.0
        return max(0.0, 1.0 - float(self._within.max() / max(self._across.min(), 1e-300)))

    def candidate_radii(self, method: ClusteringMethod) -> Iterable[float]:
        """Return radii to try: above most edges within clusters, and if possible below the edges between clusters.

        One more radius connects all points; it is the only radius unless there are edges within clusters and edges
        between clusters. Otherwise, 0 is also tried for HDBSCAN.
        """
        tiny = 1e-9 + 1e-6 * self._largest
        # A radius equal to a distance would make neighbours depend on the last digits.
        connects_all = self._largest + tiny
        if not len(self._across) or not len(self._within):
            return (connects_all,)
        gap = float(self._across.min())
        steps = {float(np.quantile(self._within, q)) + tiny for q in EPS_QUANTILES}
        radii = {math.sqrt(step * gap) for step in steps if step < gap} | {step for step in steps if step >= gap}
        return [*sorted(radii), connects_all, *((0.0,) if method == "hdbscan" else ())]
