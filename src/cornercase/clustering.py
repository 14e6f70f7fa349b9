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
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial.distance import pdist, squareform
from sklearn.cluster import DBSCAN
from sklearn.decomposition import KernelPCA
from sklearn.metrics import silhouette_samples
from threadpoolctl import threadpool_limits

from cornercase.errors import InputError
from cornercase.typing import FloatArray, IntArray

NOISE = -1

# What `auto` tries. Quantiles are of the distance to the min_samples-th neighbour, the usual reading of the
# "elbow" that Ester et al. look for; the factors reach on from the largest of these distances. The shares are
# of the extent of the embedding and matter where scenarios are alike to the last digit.
GAMMAS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
EPS_QUANTILES = (0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, 0.98, 1.0)
EPS_FACTORS = (1.25, 1.6, 2.0)
EPS_SHARES = (0.05, 0.1, 0.2)
MOST_CLUSTERS = 8
MOST_NOISE = 0.3
LEAST_SCORE = 0.05
NOISE_COST = 1.0
CLUSTER_COST = 0.02
SMALL_SHARE = 0.05
SMALL_COST = 0.2
# Validity is computed on so many scenarios at most, evenly spread over the order of the matrix.
MOST_SCORED = 1000
_FEWEST = 5
_CLOSEST = 1e-5


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
    score : float
        What `auto` maximises; -inf where the candidate is not eligible.
    """

    gamma: float
    eps: float
    clusters: int
    noise: float
    dbcv: float
    silhouette: float
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
    """

    labels: IntArray
    embedding: FloatArray
    gamma: float
    eps: float
    min_samples: int
    scale: float
    explained: float
    candidates: tuple[Candidate, ...]

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
) -> Clustering:
    """Cluster scenarios by their distances.

    Parameters
    ----------
    distances : array_like, shape (n, n)
        Symmetric, zero on the diagonal, finite, in any unit.
    gamma : float or "auto"
        Kernel width; without unit, see the module.
    eps : float or "auto"
        Radius of DBSCAN's neighbourhood in the embedding, without unit.
    min_samples : int or "auto"
        Scenarios in a neighbourhood, itself included, that make it dense. ``"auto"`` is ``ln(n)`` (Birant and
        Kut, ST-DBSCAN, 2007), rounded up and at least 3.
    n_components : int
        Dimensions of the embedding.

    Returns
    -------
    Clustering

    Raises
    ------
    InputError
        Not a distance matrix, or an option that is not positive.

    Notes
    -----
    ``"auto"`` tries a fixed grid of `gamma` and, for each, of `eps` at quantiles of the distance to the
    `min_samples`-th neighbour. Eligible are outcomes of 2 to 8 clusters with at most 30 % noise. Each is
    scored on the given distances, not in the embedding, as kernels of different width could not be compared
    there: by the mean of the density-based validity index, which accepts any shape, and of the silhouette
    (Rousseeuw, Silhouettes, 1987), which asks how far apart clusters are; scenarios in noise count as 0 in
    both. From this goes the share of noise, as both indices gain when the edge of a cluster is declared
    noise; 0.02 for each cluster beyond the second, so that the coarser of two equal answers wins; and up to
    0.2 where the second cluster has less than 5 % of the scenarios, so that a handful of odd ones does not
    pass as the structure of all. The best score wins, at a tie the smaller gamma and eps. With a best score
    under 0.05, as sets without structure mostly have, or with fewer than 5 scenarios, all are one
    cluster. With some ten scenarios, chance alone can look like structure.
    """
    matrix = _checked(distances)
    n = len(matrix)
    gammas = GAMMAS if gamma == "auto" else (_positive("gamma", gamma),)
    radius = None if eps == "auto" else _positive("eps", eps)
    if n_components < 1:
        raise InputError(f"n_components is {n_components}; give at least 1.")
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
    searching = gamma == "auto" or eps == "auto"
    tried: list[tuple[Candidate, IntArray, FloatArray, float]] = []
    # Threads of the linear algebra would change the last digits with their number.
    with threadpool_limits(limits=1):
        validity = _Validity(scaled)
        for width in gammas:
            embedding, explained = _embed(gaussian_kernel(scaled, width), n_components)
            for reach in _radii(embedding, needed) if radius is None else (radius,):
                labels = _dbscan(embedding, reach, needed)
                candidate = _judge(width, reach, labels, validity, searching and n >= _FEWEST)
                tried.append((candidate, labels, embedding, explained))

    best, labels, embedding, explained = max(tried, key=lambda one: one[0].score)
    if searching and best.score < LEAST_SCORE:
        whole = [one for one in tried if one[0].clusters == 1] or tried
        best, labels, embedding, explained = min(whole, key=lambda one: one[0].noise)
    return Clustering(
        labels=labels,
        embedding=embedding,
        gamma=best.gamma,
        eps=best.eps,
        min_samples=needed,
        scale=scale,
        explained=explained,
        candidates=tuple(one[0] for one in tried),
    )


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


def _embed(kernel: FloatArray, n_components: int) -> tuple[FloatArray, float]:
    """Project on the leading components; axes beyond the rank of the kernel are 0."""
    n = len(kernel)
    embedding = np.zeros((n, n_components))
    centred = kernel - kernel.mean(axis=0)
    variance = float(np.trace(centred - centred.mean(axis=1)[:, None]))
    if n < 2 or variance <= 1e-12 * n:
        return embedding, 1.0
    pca = KernelPCA(min(n_components, n), kernel="precomputed", random_state=0)
    found = pca.fit_transform(kernel)
    embedding[:, : found.shape[1]] = found
    return embedding, float(min(1.0, pca.eigenvalues_.sum() / variance))


def _radii(embedding: FloatArray, min_samples: int) -> Iterable[float]:
    """Neighbourhoods to try; the last holds everything."""
    between = squareform(pdist(embedding))
    reach = np.sort(between, axis=1)[:, min(min_samples, len(between)) - 1]
    largest = float(between.max(initial=0.0))
    tiny = 1e-9 + 1e-6 * largest
    tried = {float(np.quantile(reach, q)) for q in EPS_QUANTILES}
    tried |= {float(reach.max()) * factor for factor in EPS_FACTORS}
    tried |= {largest * share for share in EPS_SHARES}
    return [*sorted(eps for eps in tried if tiny < eps < largest), largest + tiny]


def _dbscan(embedding: FloatArray, eps: float, min_samples: int) -> IntArray:
    return by_size(DBSCAN(eps=eps, min_samples=min_samples).fit_predict(embedding))


def gaussian_kernel(scaled: FloatArray, gamma: float) -> FloatArray:
    """Kernel of distances that were divided by their scale, of the same shape."""
    return np.asarray(np.exp(-gamma * scaled**2))


def by_size(found: npt.NDArray[np.integer[Any]]) -> IntArray:
    """Labels, shape (n,), by falling size of the cluster, at a tie by the label before; -1 stays noise."""
    sizes = np.bincount(found[found >= 0], minlength=1)
    rank = np.empty(len(sizes), dtype=np.int64)
    rank[np.argsort(-sizes, kind="stable")] = np.arange(len(sizes))
    return np.where(found >= 0, rank[found], NOISE).astype(np.int64)


def _judge(gamma: float, eps: float, labels: IntArray, validity: _Validity, wanted: bool) -> Candidate:
    clusters = int(labels.max()) + 1
    noise = float(np.mean(labels == NOISE))
    dbcv = silhouette = math.nan
    score = -math.inf
    if wanted and 2 <= clusters <= MOST_CLUSTERS and noise <= MOST_NOISE:
        dbcv, silhouette = validity.of(labels)
        second = np.mean(labels == 1)
        small = max(0.0, 1.0 - second / SMALL_SHARE)
        score = (dbcv + silhouette) / 2 - NOISE_COST * noise
        score -= CLUSTER_COST * (clusters - 2) + SMALL_COST * float(small)
    return Candidate(gamma, eps, clusters, noise, dbcv, silhouette, score)


class _Validity:
    """Density-based validity and silhouette of labels on one distance matrix, each labelling once."""

    def __init__(self, distances: FloatArray) -> None:
        stride = math.ceil(len(distances) / MOST_SCORED)
        self._stride = stride
        self._distances = np.ascontiguousarray(distances[::stride, ::stride])
        self._known: dict[bytes, tuple[float, float]] = {}

    def of(self, labels: IntArray) -> tuple[float, float]:
        labels = labels[:: self._stride]
        key = labels.tobytes()
        if key not in self._known:
            self._known[key] = self._compute(labels)
        return self._known[key]

    def _compute(self, labels: IntArray) -> tuple[float, float]:
        names, sizes = np.unique(labels[labels >= 0], return_counts=True)
        if len(names) < 2 or sizes.min() < 3:
            return -1.0, -1.0
        kept = labels >= 0
        inner = self._distances[np.ix_(kept, kept)]
        silhouettes = silhouette_samples(inner, labels[kept], metric="precomputed")
        return density_validity(self._distances, labels), float(silhouettes.sum() / len(labels))


def density_validity(distances: FloatArray, labels: IntArray, *, dimensions: float = 3.0) -> float:
    """Density-based clustering validity index, DBCV.

    Parameters
    ----------
    distances : ndarray of float64, shape (n, n)
    labels : ndarray of int64, shape (n,)
        Two clusters or more, each of three or more; -1 is noise.
    dimensions : float
        Exponent of the all-points core distance, the dimension that the data are taken to have.

    Returns
    -------
    float
        -1 to 1, higher is better; noise counts as 0. Definitions 1 to 8 of Moulavi et al., Density-based
        clustering validation, SIAM International Conference on Data Mining, 2014.
    """
    positive = distances[distances > 0]
    distances = distances / np.median(positive) if len(positive) else distances
    core = np.zeros(len(labels))
    inner, sparseness = [], []
    groups = [np.flatnonzero(labels == name) for name in range(int(labels.max()) + 1)]
    for members in groups:
        # Scenarios that are the same would be infinitely dense, and no edge to the tree.
        between = np.maximum(distances[np.ix_(members, members)], _CLOSEST)
        np.fill_diagonal(between, np.inf)
        mean = (between**-dimensions).sum(axis=1) / (len(members) - 1)
        core[members] = mean ** (-1.0 / dimensions)
        reach = np.maximum(between, np.maximum(core[members][:, None], core[members]))
        # Many reaches are equal, as one core distance holds for many neighbours. The tree, and with it the
        # index, would depend on the order of the scenarios; so the nearer neighbour comes first.
        reach += 1e-6 * between
        np.fill_diagonal(reach, 0.0)
        tree = minimum_spanning_tree(reach).tocoo()
        degree = np.bincount(np.concatenate((tree.row, tree.col)), minlength=len(members))
        internal = degree > 1
        edges = internal[tree.row] & internal[tree.col]
        sparseness.append(tree.data[edges].max() if edges.any() else tree.data.max())
        inner.append(members[internal])
    separation = np.full((len(groups), len(groups)), np.inf)
    for a in range(len(groups)):
        for b in range(a):
            reach = np.maximum(
                distances[np.ix_(inner[a], inner[b])], np.maximum(core[inner[a]][:, None], core[inner[b]])
            )
            separation[a, b] = separation[b, a] = reach.min()
    validity = 0.0
    for members, apart, sparse in zip(groups, separation.min(axis=1), sparseness, strict=True):
        validity += len(members) / len(labels) * float((apart - sparse) / max(apart, sparse))
    return validity
