"""Dense regions of an embedding, and the one that another scenario joins."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial.distance import cdist
from sklearn.cluster import HDBSCAN

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.clustering.clusters import NOISE, Clustering, ClusteringMethod
from cornercase.clustering.dbscan import find_clusters


def find_dense_regions(embedding: FloatArray, eps: float, min_samples: int, method: ClusteringMethod) -> IntArray:
    """Cluster points by density.

    Parameters
    ----------
    embedding : ndarray of float64, shape (n, n_components)
        Coordinates of the points.
    eps : float
        Radius of the neighbourhood; with HDBSCAN the distance below which clusters are not divided.
    min_samples : int
        Points in a neighbourhood, itself included, that make it dense.
    method : {"dbscan", "hdbscan"}

    Returns
    -------
    ndarray of int64, shape (n,)
        The largest cluster is 0; -1 is noise.

    Notes
    -----
    M. Ester et al., "A density-based algorithm for discovering clusters in large spatial databases with noise", 1996;
    R. Campello, D. Moulavi, J. Sander, "Density-based clustering based on hierarchical density estimates", 2013.
    """
    if method == "dbscan":
        labels = np.empty(len(embedding), dtype=np.int64)
        find_clusters(np.ascontiguousarray(embedding, dtype=np.float64), eps, min_samples, labels)
        return order_by_size(labels)
    least = max(2, min_samples)
    if np.ptp(embedding, axis=0).max() <= eps or len(embedding) <= least:
        return np.zeros(len(embedding), dtype=np.int64)
    model = HDBSCAN(min_cluster_size=least, min_samples=least, cluster_selection_epsilon=eps, copy=True)
    return order_by_size(model.fit_predict(embedding))


def join_nearest(placed: FloatArray, known: Clustering) -> IntArray:
    """Cluster that each of some new points joins: that of the nearest dense point within the neighbourhood.

    Parameters
    ----------
    placed : ndarray of float64, shape (m, n_components)
        The new points, in the kernel space of `known`.
    known : Clustering
        Clusters that are there already.

    Returns
    -------
    ndarray of int64, shape (m,)
        -1 where no dense point is near.
    """
    dense = np.flatnonzero(_dense(known))
    if not len(dense):
        return np.full(len(placed), NOISE, dtype=np.int64)
    apart = cdist(placed, known.embedding[dense])
    nearest = apart.argmin(axis=1)
    near = apart[np.arange(len(placed)), nearest] <= _reach(known)
    return np.where(near, known.labels[dense[nearest]], NOISE).astype(np.int64)


def order_by_size(found: npt.NDArray[np.int_]) -> IntArray:
    """Number clusters anew by falling size.

    Parameters
    ----------
    found : ndarray of int, shape (n,)
        Labels; -1 is noise.

    Returns
    -------
    ndarray of int64, shape (n,)
        The largest cluster is 0, of two of one size the one that had the lower label comes first; -1 stays noise.
    """
    sizes = np.bincount(found[found >= 0], minlength=1)
    rank = np.empty(len(sizes), dtype=np.int64)
    rank[np.argsort(-sizes, kind="stable")] = np.arange(len(sizes))
    return np.where(found >= 0, rank[found], NOISE).astype(np.int64)


def _dense(known: Clustering) -> BoolArray:
    """Scenarios with enough neighbours; with HDBSCAN all that are in a cluster."""
    if known.method == "hdbscan":
        return np.asarray(known.labels >= 0)
    between = cdist(known.embedding, known.embedding)
    return np.asarray((between <= known.eps).sum(axis=1) >= known.min_samples)


def _reach(known: Clustering) -> float:
    """Radius within which another scenario belongs to a cluster."""
    if known.method == "dbscan":
        return known.eps
    # HDBSCAN has no radius: take the largest distance of a member to its own min_samples-th neighbour.
    members = known.embedding[known.labels >= 0]
    between = np.sort(cdist(members, members), axis=1)
    return float(between[:, min(known.min_samples, len(members)) - 1].max(initial=0.0))
