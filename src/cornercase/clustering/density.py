"""Density-based clusters in an embedding, and assignment of further points to them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial.distance import cdist
from sklearn.cluster import HDBSCAN

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.clustering.clusters import NOISE, Clustering, ClusteringMethod
from cornercase.clustering.dbscan import find_clusters


def find_dense_regions(embedding: FloatArray, eps: float, min_samples: int, method: ClusteringMethod) -> IntArray:
    """Cluster points, shape (n, n_components), by DBSCAN or HDBSCAN; the largest cluster is 0, -1 is noise.

    For HDBSCAN, clusters nearer than `eps` are not divided. M. Ester et al., "A density-based algorithm for discovering
    clusters in large spatial databases with noise", 1996; R. Campello, D. Moulavi, J. Sander, "Density-based clustering
    based on hierarchical density estimates", 2013.
    """
    if method == "dbscan":
        labels = np.empty(len(embedding), dtype=np.int64)
        find_clusters(np.ascontiguousarray(embedding, dtype=np.float64), eps, min_samples, labels)
        return order_by_size(labels)
    min_size = max(2, min_samples)
    if np.ptp(embedding, axis=0).max() <= eps or len(embedding) <= min_size:
        return np.zeros(len(embedding), dtype=np.int64)
    model = HDBSCAN(min_cluster_size=min_size, min_samples=min_size, cluster_selection_epsilon=eps, copy=True)
    return order_by_size(model.fit_predict(embedding))


def join_nearest(placed: FloatArray, known: Clustering) -> IntArray:
    """Assign new points of the same kernel space to the cluster of the nearest dense point in reach, else noise."""
    dense = np.flatnonzero(_dense(known))
    if not len(dense):
        return np.full(len(placed), NOISE, dtype=np.int64)
    distances = cdist(placed, known.embedding[dense])
    nearest = distances.argmin(axis=1)
    is_near = distances[np.arange(len(placed)), nearest] <= _reach(known)
    return np.where(is_near, known.labels[dense[nearest]], NOISE).astype(np.int64)


def order_by_size(found: npt.NDArray[np.int_]) -> IntArray:
    """Renumber clusters by falling size; ties keep their order, -1 stays noise."""
    sizes = np.bincount(found[found >= 0], minlength=1)
    rank = np.empty(len(sizes), dtype=np.int64)
    rank[np.argsort(-sizes, kind="stable")] = np.arange(len(sizes))
    return np.where(found >= 0, rank[found], NOISE).astype(np.int64)


def _dense(known: Clustering) -> BoolArray:
    """Mask of the dense scenarios; for HDBSCAN, of all that are in a cluster."""
    if known.method == "hdbscan":
        return np.asarray(known.labels >= 0)
    distances = cdist(known.embedding, known.embedding)
    return np.asarray((distances <= known.eps).sum(axis=1) >= known.min_samples)


def _reach(known: Clustering) -> float:
    """Radius within which a further scenario belongs to a cluster."""
    if known.method == "dbscan":
        return known.eps
    # HDBSCAN has no radius: take the largest distance of a member to its min_samples-th neighbour.
    members = known.embedding[known.labels >= 0]
    distances = np.sort(cdist(members, members), axis=1)
    return float(distances[:, min(known.min_samples, len(members)) - 1].max(initial=0.0))
