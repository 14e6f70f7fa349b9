"""The space of a Gaussian kernel of distances: where scenarios lie in it, and whom new ones join there."""

from __future__ import annotations

from typing import TYPE_CHECKING, Self

import numpy as np
from scipy.linalg import lstsq
from scipy.spatial.distance import cdist
from sklearn.decomposition import KernelPCA

from cornercase._common.typing import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from cornercase.clustering.search import Clustering


class KernelSpace:
    """Leading components of the kernel ``exp(-gamma * d**2)`` (kernel PCA).

    Parameters
    ----------
    gamma : float
    n_components : int
        Axes beyond the rank of the kernel are 0.

    Attributes
    ----------
    embedding : ndarray of float64, shape (n, n_components)
        Of the scenarios that it was fitted to.
    explained : float
        Share of the variance in kernel space that they keep, 0 to 1.
    """

    def __init__(self, gamma: float, n_components: int) -> None:
        self._gamma, self._n_components = gamma, n_components
        self.embedding: FloatArray = np.zeros((0, n_components))
        self.explained = 1.0

    def fit(self, distances: FloatArray) -> Self:
        """Find the components.

        Parameters
        ----------
        distances : ndarray of float64, shape (n, n)
            Over their scale.
        """
        kernel = self._kernel(distances)
        n = len(kernel)
        self._known = kernel
        self.embedding, self.explained, self._pca = np.zeros((n, self._n_components)), 1.0, None
        centred = kernel - kernel.mean(axis=0)
        variance = float(np.trace(centred - centred.mean(axis=1)[:, None]))
        # Without variance there is nothing to project on.
        if n >= 2 and variance > 1e-12 * n:
            self._pca = KernelPCA(min(self._n_components, n), kernel="precomputed", random_state=0)
            found = self._pca.fit_transform(kernel)
            self.embedding[:, : found.shape[1]] = found
            self.explained = float(min(1.0, self._pca.eigenvalues_.sum() / variance))
        return self

    def transform(self, distances: FloatArray) -> FloatArray:
        """Place others, shape (m, n_components), by their distances to those that were fitted, shape (m, n)."""
        placed = np.zeros((len(distances), self._n_components))
        if self._pca is not None and len(distances):
            found = self._pca.transform(self._kernel(distances))
            placed[:, : found.shape[1]] = found
        return placed

    def error(self, to_known: FloatArray, between: FloatArray) -> float:
        """How much of the kernel of others is lost when it is put together from that of those that were fitted.

        Parameters
        ----------
        to_known : ndarray of float64, shape (m, n)
            Distances of the others to those that were fitted.
        between : ndarray of float64, shape (m, m)
            Distances of the others from each other.

        Returns
        -------
        float
            Frobenius norm of the difference over that of the kernel.
        """
        cross, kernel = self._kernel(to_known), self._kernel(between)
        weights = lstsq(self._known, cross.T, cond=1e-10)[0]
        return float(np.linalg.norm(kernel - cross @ weights) / np.linalg.norm(kernel))

    def _kernel(self, distances: FloatArray) -> FloatArray:
        return np.asarray(np.exp(-self._gamma * distances**2))


def assigned(placed: FloatArray, known: Clustering) -> IntArray:
    """Clusters that others join: that of the nearest dense scenario within the neighbourhood, as DBSCAN would.

    Parameters
    ----------
    placed : ndarray of float64, shape (m, n_components)
        The others, in the same kernel space.
    known : Clustering

    Returns
    -------
    ndarray of int64, shape (m,)
        -1 where nothing dense is near.
    """
    dense = np.flatnonzero(_dense(known))
    if not len(dense):
        return np.full(len(placed), -1, dtype=np.int64)
    apart = cdist(placed, known.embedding[dense])
    nearest = apart.argmin(axis=1)
    near = apart[np.arange(len(placed)), nearest] <= _reach(known)
    return np.where(near, known.labels[dense[nearest]], -1).astype(np.int64)


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
    # As far as the members of the clusters are from their own min_samples-th neighbour at most.
    members = known.embedding[known.labels >= 0]
    between = np.sort(cdist(members, members), axis=1)
    return float(between[:, min(known.min_samples, len(members)) - 1].max(initial=0.0))
