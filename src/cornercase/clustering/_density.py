"""Density-based clusters in an embedding, and assignment of further points to them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial.distance import cdist
from sklearn.cluster import HDBSCAN

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.clustering._clustering import NOISE_LABEL, Clustering, ClusteringMethod
from cornercase.clustering._kernels.dbscan import dbscan_labels


def cluster_by_density(embedding: FloatArray, eps: float, min_samples: int, method: ClusteringMethod) -> IntArray:
    """Cluster points, shape (n, n_components), by DBSCAN or HDBSCAN; the largest cluster is 0, -1 is noise.

    For DBSCAN, `eps` is the radius of a neighbourhood. HDBSCAN keeps parts together that are less than `eps` apart.

    M. Ester et al., "A density-based algorithm for discovering clusters in large spatial databases with noise", 1996;
    R. Campello, D. Moulavi, J. Sander, "Density-based clustering based on hierarchical density estimates", 2013.
    """
    if method == "dbscan":
        labels = np.empty(len(embedding), dtype=np.int64)
        dbscan_labels(np.ascontiguousarray(embedding, dtype=np.float64), eps, min_samples, labels)
        return renumber_by_size(labels)
    min_size = _hdbscan_min_samples(min_samples)
    if np.ptp(embedding, axis=0).max() <= eps or len(embedding) <= min_size:
        return np.zeros(len(embedding), dtype=np.int64)
    model = HDBSCAN(min_cluster_size=min_size, min_samples=min_size, cluster_selection_epsilon=eps, copy=True)
    return renumber_by_size(model.fit_predict(embedding))


def assign_to_nearest_cluster(new_points: FloatArray, clustering: Clustering) -> IntArray:
    """Return the cluster that each new point in kernel space joins, shape (m,): that of the nearest dense point.

    A dense point is a clustered point with many neighbours; for HDBSCAN, any clustered point. A new point is noise (-1)
    if the nearest dense point is farther away than `_assignment_radius`.
    """
    dense = np.flatnonzero(_is_dense(clustering))
    if not len(dense):
        return np.full(len(new_points), NOISE_LABEL, dtype=np.int64)
    distances = cdist(new_points, clustering.embedding[dense])
    nearest = distances.argmin(axis=1)
    is_near = distances[np.arange(len(new_points)), nearest] <= _assignment_radius(clustering)
    return np.where(is_near, clustering.labels[dense[nearest]], NOISE_LABEL).astype(np.int64)


def renumber_by_size(labels: npt.NDArray[np.int_]) -> IntArray:
    """Renumber clusters by falling size; clusters of equal size keep their order, and -1 stays noise."""
    sizes = np.bincount(labels[labels >= 0], minlength=1)
    rank = np.empty(len(sizes), dtype=np.int64)
    rank[np.argsort(-sizes, kind="stable")] = np.arange(len(sizes))
    return np.where(labels >= 0, rank[labels], NOISE_LABEL).astype(np.int64)


def _is_dense(clustering: Clustering) -> BoolArray:
    """Return True for each scenario that has many neighbours; for HDBSCAN, for each scenario in a cluster."""
    if clustering.method == "hdbscan":
        return np.asarray(clustering.labels >= 0)
    distances = cdist(clustering.embedding, clustering.embedding)
    return np.asarray((distances <= clustering.eps).sum(axis=1) >= clustering.min_samples)


def _assignment_radius(clustering: Clustering) -> float:
    """Return the largest distance to a dense point at which a new scenario joins a cluster."""
    if clustering.method == "dbscan":
        return clustering.eps
    # HDBSCAN has no radius: take the largest distance of a member to its min_samples-th neighbour, as HDBSCAN counts.
    members = clustering.embedding[clustering.labels >= 0]
    distances = np.sort(cdist(members, members), axis=1)
    number = min(_hdbscan_min_samples(clustering.min_samples), len(members))
    return float(distances[:, number - 1].max(initial=0.0))


def _hdbscan_min_samples(min_samples: int) -> int:
    return max(2, min_samples)
