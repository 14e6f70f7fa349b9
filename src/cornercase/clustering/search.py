"""The settings of kernel and neighbourhood that suit some scenarios best."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final, Literal

import numpy as np
from scipy.spatial.distance import pdist, squareform
from threadpoolctl import threadpool_limits

from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering.clusters import NOISE, Candidate, Clustering, ClusteringMethod
from cornercase.clustering.density import find_dense_regions
from cornercase.clustering.kernel_space import KernelSpace
from cornercase.clustering.stability import Stability
from cornercase.clustering.validity import Validity

# What ``"auto"`` tries. Quantiles are of the distance to the min_samples-th neighbour, the usual reading of the
# "elbow" that Ester et al. look for; the factors reach on from the largest of these distances. The shares are
# of the extent of the embedding and matter where scenarios are alike to the last digit.
GAMMAS: Final = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
EPS_QUANTILES: Final = (0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, 0.98, 1.0)
EPS_FACTORS: Final = (1.25, 1.6, 2.0)
EPS_SHARES: Final = (0.05, 0.1, 0.2)
MOST_CLUSTERS: Final = 8
MOST_NOISE: Final = 0.3
LEAST_SCORE: Final = 0.0
DBCV_SHARE: Final = 0.65
NOISE_COST: Final = 1.0
CLUSTER_COST: Final = 0.02
SMALL_SHARE: Final = 0.05
SMALL_COST: Final = 0.2
UNSTABLE_COST: Final = 0.1
# Validity, and the loss by landmarks, is computed on so many scenarios at most.
MOST_SCORED: Final = 1000
_FEWEST: Final = 5


def search_settings(
    distances: FloatArray,
    *,
    gamma: float | Literal["auto"],
    eps: float | Literal["auto"],
    min_samples: int | Literal["auto"],
    n_components: int,
    method: ClusteringMethod,
) -> Clustering:
    """Cluster with the settings that are given, and with the best of those that are left open.

    `cornercase.clustering.ScenarioClustering` says what is best.

    Parameters
    ----------
    distances : ndarray of float64, shape (n, n)
        Symmetric, zero on the diagonal, finite.
    gamma, eps : float or "auto"
        Kernel width, and radius of the neighbourhood in the embedding.
    min_samples : int or "auto"
        Least number of scenarios in a dense neighbourhood.
    n_components : int
        Dimensions of the embedding.
    method : {"dbscan", "hdbscan"}
        Algorithm that finds the clusters.

    Returns
    -------
    Clustering
        The clusters with the best settings.
    """
    n = len(distances)
    needed = min_samples if min_samples != "auto" else max(3, math.ceil(math.log(n))) if n >= _FEWEST else 1
    between = distances[np.triu_indices(n, 1)]
    between = between[between > 0]
    scale = float(np.median(between)) if len(between) else 0.0
    scaled = distances / scale if scale else distances
    searching = "auto" in (gamma, eps)
    judged = searching and n >= _FEWEST
    order = canonical_order(distances)
    candidates: list[Candidate] = []
    labelled: list[IntArray] = []
    spaces: list[KernelSpace] = []
    # Threads of the linear algebra would change the last digits with their number.
    with threadpool_limits(limits=1):
        validity = Validity(scaled, np.sort(order[:: math.ceil(n / MOST_SCORED)]))
        for width in GAMMAS if gamma == "auto" else (gamma,):
            space = KernelSpace(width, n_components).fit(scaled)
            for reach in _radii(space.embedding, needed, method) if eps == "auto" else (eps,):
                labels = find_dense_regions(space.embedding, reach, needed, method)
                candidates.append(_judge(width, reach, labels, validity, judged))
                labelled.append(labels)
                spaces.append(space)
        if judged:
            stability = Stability(
                scaled, order, min_samples=needed, n_components=n_components, method=method, most=MOST_SCORED
            )
            _add_stability(candidates, labelled, stability)
    best = _best(candidates, searching)
    return Clustering(
        labels=labelled[best],
        embedding=spaces[best].embedding,
        gamma=candidates[best].gamma,
        eps=candidates[best].eps,
        min_samples=needed,
        scale=scale,
        explained=spaces[best].explained,
        candidates=tuple(candidates),
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


def _radii(embedding: FloatArray, min_samples: int, method: ClusteringMethod) -> Iterable[float]:
    """Neighbourhoods to try; the last holds everything."""
    between = squareform(pdist(embedding))
    reach = np.sort(between, axis=1)[:, min(min_samples, len(between)) - 1]
    largest = float(between.max(initial=0.0))
    tiny = 1e-9 + 1e-6 * largest
    # A quantile is often a distance itself. A little more keeps the neighbour at that distance within the radius, on
    # every machine: last digits of the embedding would decide otherwise.
    tried = {float(np.quantile(reach, q)) + tiny for q in EPS_QUANTILES}
    tried |= {float(reach.max()) * factor for factor in EPS_FACTORS}
    tried |= {largest * share for share in EPS_SHARES}
    return [
        *((0.0,) if method == "hdbscan" else ()),
        *sorted(eps for eps in tried if tiny < eps < largest),
        largest + tiny,
    ]


def _judge(gamma: float, eps: float, labels: IntArray, validity: Validity, wanted: bool) -> Candidate:
    clusters = int(labels.max()) + 1
    noise = float(np.mean(labels == NOISE))
    dbcv = silhouette = math.nan
    score = -math.inf
    if wanted and 2 <= clusters <= MOST_CLUSTERS and noise <= MOST_NOISE:
        dbcv, silhouette = validity.of(labels)
        second = np.mean(labels == 1)
        small = max(0.0, 1.0 - second / SMALL_SHARE)
        score = DBCV_SHARE * dbcv + (1.0 - DBCV_SHARE) * silhouette - NOISE_COST * noise
        score -= CLUSTER_COST * (clusters - 2) + SMALL_COST * float(small)
    return Candidate(gamma, eps, clusters, noise, dbcv, silhouette, math.nan, score)


def _add_stability(candidates: list[Candidate], labelled: Sequence[IntArray], stability: Stability) -> None:
    """Put the stability into all candidates that it could make the best, and into the best of each number."""
    best, numbers = -math.inf, set()
    for k in sorted(range(len(candidates)), key=lambda k: -candidates[k].score):
        one = candidates[k]
        if one.score == -math.inf or (one.score < best and one.clusters in numbers):
            continue
        numbers.add(one.clusters)
        found = stability.of(one.gamma, one.eps, labelled[k])
        candidates[k] = replace(one, stability=found, score=one.score - UNSTABLE_COST * (1.0 - found))
        best = max(best, candidates[k].score)


def _best(candidates: Sequence[Candidate], searching: bool) -> int:
    """Index of the best candidate; where none is good enough, of the one that makes all one cluster."""
    best = max(range(len(candidates)), key=lambda k: candidates[k].score)
    if not searching or candidates[best].score >= LEAST_SCORE:
        return best
    whole = [k for k, one in enumerate(candidates) if one.clusters == 1] or list(range(len(candidates)))
    return min(whole, key=lambda k: candidates[k].noise)
