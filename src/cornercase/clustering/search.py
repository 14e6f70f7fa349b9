"""Which kinds of scenario there are: kernel PCA and DBSCAN on a distance matrix.

As in the paper: the distances d become a Gaussian kernel, the kernel is projected to three dimensions by
kernel PCA (Mika et al., Kernel PCA and de-noising in feature spaces, 1998), and DBSCAN (Ester et al., A
density-based algorithm for discovering clusters in large spatial databases with noise, 1996) finds the dense
regions there.

The kernel is ``exp(-gamma * (d / scale)**2)``, where `scale` is the median distance of two scenarios that
differ. So `gamma` has no unit and means the same for trajectories in metres and courses in seconds: at 1 the
kernel has fallen to 1/e at the typical distance.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final, Literal, get_args

import numpy as np
import numpy.typing as npt
from scipy.spatial.distance import pdist, squareform
from sklearn.cluster import DBSCAN, HDBSCAN
from sklearn.metrics import adjusted_rand_score
from threadpoolctl import threadpool_limits

from cornercase._common.errors import InputError, suggestion
from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering.kernel_space import KernelSpace, assigned
from cornercase.clustering.validity import Validity

NOISE: Final = -1

ClusteringMethod = Literal["dbscan", "hdbscan"]

# What `auto` tries. Quantiles are of the distance to the min_samples-th neighbour, the usual reading of the
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
RESAMPLES: Final = 10
RESAMPLED: Final = 0.8
# Validity, and what is left out, is computed on so many scenarios at most.
MOST_SCORED: Final = 1000
# Beyond so many scenarios the kernel space is that of so many landmarks.
MOST_EXACT: Final = 5000
LANDMARKS: Final = 2000
_FEWEST: Final = 5


@dataclass(frozen=True)
class Candidate:
    """One setting that was tried.

    Attributes
    ----------
    gamma, eps : float
        Kernel width and neighbourhood.
    clusters : int
        Number of clusters found.
    noise : float
        Share of the scenarios in none.
    dbcv, silhouette : float
        Validity on the given distances, -1 to 1; NaN where it was not computed.
    stability : float
        Mean adjusted Rand index of these clusters with those found in ten random parts of 80 %; NaN where it was not
        computed, as it could not have made the candidate the best.
    score : float
        What `auto` maximises; -inf where the candidate is not eligible. Without stability, what it is at most.
    """

    gamma: float
    eps: float
    clusters: int
    noise: float
    dbcv: float
    silhouette: float
    stability: float
    score: float


@dataclass(frozen=True)
class Clustering:
    """Clusters of n scenarios.

    Attributes
    ----------
    labels : ndarray of int64, shape (n,)
        Cluster of each scenario, the largest cluster is 0; -1 is noise.
    embedding : ndarray of float64, shape (n, n_components)
        Coordinates in kernel space. The sign of an axis is such that its entry of largest magnitude is
        positive.
    gamma, eps : float
        What was given or found.
    min_samples : int
        What was given or found.
    scale : float
        What the distances were divided by; 0 where all are 0.
    explained : float
        Share of the variance in kernel space that the embedding keeps, 0 to 1.
    candidates : tuple of Candidate
        All that was tried, in the order of gamma and eps.
    method : {"dbscan", "hdbscan"}
    landmarks : ndarray of int64, shape (m,)
        Scenarios whose kernel space it is; none where it is that of all.
    error : float
        Of the approximation by landmarks: the root of the mean squared difference of kernel and approximated kernel
        over that of the kernel, between scenarios that are no landmarks; 0 without landmarks.
    """

    labels: IntArray
    embedding: FloatArray
    gamma: float
    eps: float
    min_samples: int
    scale: float
    explained: float
    candidates: tuple[Candidate, ...]
    method: str
    landmarks: IntArray
    error: float

    @property
    def stability(self) -> float | None:
        """Mean adjusted Rand index with the clusters of random parts; None where the search did not ask for it."""
        for one in self.candidates:
            if (one.gamma, one.eps) == (self.gamma, self.eps) and not math.isnan(one.stability):
                return one.stability
        return None

    @property
    def n_clusters(self) -> int:
        """Number of clusters, without noise."""
        return int(self.labels.max(initial=NOISE)) + 1

    @property
    def noise(self) -> float:
        """Share of the scenarios that are in no cluster."""
        return float(np.mean(self.labels == NOISE)) if len(self.labels) else 0.0


def cluster(
    distances: npt.ArrayLike,
    *,
    gamma: float | Literal["auto"] = "auto",
    eps: float | Literal["auto"] = "auto",
    min_samples: int | Literal["auto"] = "auto",
    n_components: int = 3,
    method: ClusteringMethod = "dbscan",
    landmarks: int | Literal["auto"] | None = "auto",
) -> Clustering:
    """Cluster scenarios by their distances.

    Parameters
    ----------
    distances : array_like, shape (n, n)
        Symmetric, zero on the diagonal, finite, in any unit.
    gamma : float or "auto"
        Kernel width; without unit, see the module.
    eps : float or "auto"
        Radius of DBSCAN's neighbourhood in the embedding, without unit; of HDBSCAN the distance below which clusters
        are not divided.
    min_samples : int or "auto"
        Scenarios in a neighbourhood, itself included, that make it dense. ``"auto"`` is ``ln(n)`` (Birant and
        Kut, ST-DBSCAN, 2007), rounded up and at least 3.
    n_components : int
        Dimensions of the embedding.
    method : {"dbscan", "hdbscan"}
        What finds the clusters in the embedding. HDBSCAN (Campello, Moulavi and Sander 2013) takes regions of different
        density.
    landmarks : int, "auto" or None
        How many scenarios span the kernel space; the others are projected on it (C. Williams, M. Seeger, "Using the
        Nyström method to speed up kernel machines", 2001) and join the cluster of the nearest dense landmark. None for
        all; ``"auto"`` is 2,000 where there are more than 5,000 scenarios.

    Returns
    -------
    Clustering

    Raises
    ------
    InputError
        Not a distance matrix, or an option that cannot be.

    Notes
    -----
    ``"auto"`` tries a fixed grid of `gamma` and, for each, of `eps` at quantiles of the distance to the
    `min_samples`-th neighbour. Eligible are outcomes of 2 to 8 clusters with at most 30 % noise. Each is
    scored on the given distances, not in the embedding, as kernels of different width could not be compared
    there: by 0.65 of the density-based validity index, which accepts any shape, and 0.35 of the silhouette
    (Rousseeuw, Silhouettes, 1987), which asks how far apart clusters are; scenarios in noise count as 0 in
    both. From this goes the share of noise, as both indices gain when the edge of a cluster is declared
    noise; 0.02 for each cluster beyond the second, so that the coarser of two equal answers wins; up to
    0.2 where the second cluster has less than 5 % of the scenarios, so that a handful of odd ones does not
    pass as the structure of all; and up to 0.1 where other clusters are found in random parts of 80 % of the
    scenarios, with the same settings (stability under resampling: U. von Luxburg, "Clustering stability: an overview",
    2010). The best score wins, at a tie the smaller gamma and eps. With a best score under 0, as sets
    without structure mostly have, or with fewer than 5 scenarios, all are one cluster. With some ten scenarios, chance
    alone can look like structure.

    Stability is computed for all that could win, and for the best candidate of each number of clusters.
    """
    if method not in get_args(ClusteringMethod):
        raise InputError(f"There is no method '{method}'; {suggestion(method, get_args(ClusteringMethod))}")
    if n_components < 1:
        raise InputError(f"n_components is {n_components}; give at least 1.")
    matrix = _checked(distances)
    n = len(matrix)
    gammas = GAMMAS if gamma == "auto" else (_positive("gamma", gamma),)
    # HDBSCAN takes a radius of 0: it merges nothing then.
    radius = None if eps == "auto" else 0.0 if method == "hdbscan" and eps == 0.0 else _positive("eps", eps)
    if landmarks == "auto":
        landmarks = LANDMARKS if n > MOST_EXACT else None
    elif landmarks is not None and not (isinstance(landmarks, (int, np.integer)) and landmarks >= 2):
        raise InputError(f"landmarks is {landmarks!r}; give a whole number of at least 2, None or 'auto'.")
    chosen = _canonical(matrix)
    if landmarks is not None and landmarks < n:
        chosen = np.sort(np.random.default_rng(0).choice(chosen, int(landmarks), replace=False))
        found = _of_all(matrix[np.ix_(chosen, chosen)], gammas, radius, min_samples, n_components, method)
        return _extended(found, matrix, chosen, n_components)
    return _of_all(matrix, gammas, radius, min_samples, n_components, method)


def _of_all(
    matrix: FloatArray,
    gammas: tuple[float, ...],
    radius: float | None,
    min_samples: int | Literal["auto"],
    n_components: int,
    method: ClusteringMethod,
) -> Clustering:
    """Cluster without landmarks."""
    n = len(matrix)
    if min_samples == "auto":
        needed = max(3, math.ceil(math.log(n))) if n >= _FEWEST else 1
    elif isinstance(min_samples, (int, np.integer)) and min_samples >= 1:
        needed = int(min_samples)
    else:
        raise InputError(f"min_samples is {min_samples!r}; give a whole number of at least 1, or 'auto'.")
    positive = matrix[np.triu_indices(n, 1)]
    positive = positive[positive > 0]
    scale = float(np.median(positive)) if len(positive) else 0.0
    scaled = matrix / scale if scale else matrix
    searching = len(gammas) > 1 or radius is None
    order = _canonical(matrix)
    candidates: list[Candidate] = []
    labelled: list[IntArray] = []
    spaces: list[tuple[FloatArray, float]] = []
    # Threads of the linear algebra would change the last digits with their number.
    with threadpool_limits(limits=1):
        validity = Validity(scaled, np.sort(order[:: math.ceil(n / MOST_SCORED)]))
        for width in gammas:
            space = KernelSpace(width, n_components).fit(scaled)
            for reach in _radii(space.embedding, needed, method) if radius is None else (radius,):
                labels = _clusters(space.embedding, reach, needed, method)
                candidates.append(_judge(width, reach, labels, validity, searching and n >= _FEWEST))
                labelled.append(labels)
                spaces.append((space.embedding, space.explained))
        if searching and n >= _FEWEST:
            _add_stability(candidates, labelled, _Resampling(scaled, order, needed, n_components, method))

    best = max(range(len(candidates)), key=lambda k: candidates[k].score)
    if searching and candidates[best].score < LEAST_SCORE:
        whole = [k for k, one in enumerate(candidates) if one.clusters == 1] or list(range(len(candidates)))
        best = min(whole, key=lambda k: candidates[k].noise)
    return Clustering(
        labels=labelled[best],
        embedding=spaces[best][0],
        gamma=candidates[best].gamma,
        eps=candidates[best].eps,
        min_samples=needed,
        scale=scale,
        explained=spaces[best][1],
        candidates=tuple(candidates),
        method=method,
        landmarks=np.zeros(0, dtype=np.int64),
        error=0.0,
    )


def _extended(found: Clustering, matrix: FloatArray, landmarks: IntArray, n_components: int) -> Clustering:
    """Clusters of the landmarks, joined by all others."""
    scale = found.scale or 1.0
    with threadpool_limits(limits=1):
        space = KernelSpace(found.gamma, n_components).fit(matrix[np.ix_(landmarks, landmarks)] / scale)
        embedding = space.transform(matrix[:, landmarks] / scale)
        embedding[landmarks] = found.embedding
        labels = assigned(embedding, found)
        labels[landmarks] = found.labels
        others = np.setdiff1d(np.arange(len(matrix)), landmarks)
        some = others[:: math.ceil(len(others) / MOST_SCORED)]
        error = space.error(matrix[np.ix_(some, landmarks)] / scale, matrix[np.ix_(some, some)] / scale)
    return replace(found, labels=by_size(labels), embedding=embedding, landmarks=landmarks, error=error)


def _canonical(matrix: FloatArray) -> IntArray:
    """Scenarios in an order that does not depend on that in which they are given."""
    return np.argsort(matrix.sum(axis=1), kind="stable").astype(np.int64)


def _checked(distances: npt.ArrayLike) -> FloatArray:
    matrix = np.asarray(distances, dtype=np.float64)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or not len(matrix):
        raise InputError(f"A distance matrix of shape {matrix.shape} is not square; give shape (n, n), n >= 1.")
    if not np.isfinite(matrix).all() or (matrix < 0).any():
        i, j = np.argwhere(~np.isfinite(matrix) | (matrix < 0))[0]
        raise InputError(f"The distance of {i} and {j} is {matrix[i, j]}; give finite distances of at least 0.")
    if not np.array_equal(matrix, matrix.T) or matrix.diagonal().any():
        raise InputError("The distance matrix is not symmetric with a zero diagonal; give distances both ways.")
    return matrix


def _positive(name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
        raise InputError(f"{name} is {value!r}; give a number above 0, or 'auto'.")
    if not 0 < value < math.inf:
        raise InputError(f"{name} is {value!r}; give a number above 0, or 'auto'.")
    return float(value)


def _radii(embedding: FloatArray, min_samples: int, method: ClusteringMethod) -> Iterable[float]:
    """Neighbourhoods to try; the last holds everything."""
    between = squareform(pdist(embedding))
    reach = np.sort(between, axis=1)[:, min(min_samples, len(between)) - 1]
    largest = float(between.max(initial=0.0))
    tiny = 1e-9 + 1e-6 * largest
    tried = {float(np.quantile(reach, q)) for q in EPS_QUANTILES}
    tried |= {float(reach.max()) * factor for factor in EPS_FACTORS}
    tried |= {largest * share for share in EPS_SHARES}
    return [
        *((0.0,) if method == "hdbscan" else ()),
        *sorted(eps for eps in tried if tiny < eps < largest),
        largest + tiny,
    ]


def _clusters(embedding: FloatArray, eps: float, min_samples: int, method: ClusteringMethod) -> IntArray:
    if method == "dbscan":
        return by_size(DBSCAN(eps=eps, min_samples=min_samples).fit_predict(embedding))
    least = max(2, min_samples)
    if np.ptp(embedding, axis=0).max() <= eps or len(embedding) <= least:
        return np.zeros(len(embedding), dtype=np.int64)
    model = HDBSCAN(min_cluster_size=least, min_samples=least, cluster_selection_epsilon=eps, copy=True)
    return by_size(model.fit_predict(embedding))


def by_size(found: npt.NDArray[np.int_]) -> IntArray:
    """Labels, shape (n,), by falling size of the cluster, at a tie by the label before; -1 stays noise."""
    sizes = np.bincount(found[found >= 0], minlength=1)
    rank = np.empty(len(sizes), dtype=np.int64)
    rank[np.argsort(-sizes, kind="stable")] = np.arange(len(sizes))
    return np.where(found >= 0, rank[found], NOISE).astype(np.int64)


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


def _add_stability(candidates: list[Candidate], labelled: list[IntArray], resampling: _Resampling) -> None:
    """Put the stability into all candidates that it could make the best, and into the best of each number."""
    best, numbers = -math.inf, set()
    for k in sorted(range(len(candidates)), key=lambda k: -candidates[k].score):
        one = candidates[k]
        if one.score == -math.inf or (one.score < best and one.clusters in numbers):
            continue
        numbers.add(one.clusters)
        stability = resampling.stability(one.gamma, one.eps, labelled[k])
        candidates[k] = replace(one, stability=stability, score=one.score - UNSTABLE_COST * (1.0 - stability))
        best = max(best, candidates[k].score)


class _Resampling:
    """Random parts of the scenarios, each in the kernel space of its own."""

    def __init__(
        self, scaled: FloatArray, order: IntArray, needed: int, n_components: int, method: ClusteringMethod
    ) -> None:
        count = min(max(2, round(RESAMPLED * len(order))), MOST_SCORED)
        rng = np.random.default_rng(0)
        self._parts = [np.sort(rng.choice(order, count, replace=False)) for _ in range(RESAMPLES)]
        # A part that is thinner by far than the whole is dense with fewer.
        self._needed = needed if count == round(RESAMPLED * len(order)) else max(3, round(needed * count / len(order)))
        self._scaled, self._n_components, self._method = scaled, n_components, method
        self._spaces: dict[tuple[float, int], FloatArray] = {}

    def stability(self, gamma: float, eps: float, labels: IntArray) -> float:
        """Mean adjusted Rand index of some clusters with those of the parts."""
        found = []
        for k, part in enumerate(self._parts):
            if (gamma, k) not in self._spaces:
                space = KernelSpace(gamma, self._n_components).fit(self._scaled[np.ix_(part, part)])
                self._spaces[gamma, k] = space.embedding
            again = _clusters(self._spaces[gamma, k], eps, self._needed, self._method)
            found.append(adjusted_rand_score(labels[part], again))
        return float(np.mean(found))
