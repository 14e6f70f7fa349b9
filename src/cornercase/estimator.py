"""Kernel PCA and DBSCAN on distances as an estimator with scikit-learn's manners."""

from __future__ import annotations

from typing import Any, Literal, Self

import numpy as np
import numpy.typing as npt
from scipy.spatial.distance import cdist
from sklearn.base import BaseEstimator, ClusterMixin
from sklearn.cluster import HDBSCAN
from sklearn.decomposition import KernelPCA
from threadpoolctl import threadpool_limits

from cornercase.clustering import NOISE, Clustering, by_size, cluster, gaussian_kernel
from cornercase.errors import InputError, suggestion
from cornercase.typing import BoolArray, FloatArray, IntArray


class ScenarioClustering(ClusterMixin, BaseEstimator):  # type: ignore[misc]
    """Clusters scenarios by their distances, and assigns new ones to the clusters that are there.

    Parameters
    ----------
    gamma : float or "auto", default "auto"
        Kernel width, as of `cornercase.clustering.cluster`.
    eps : float or "auto", default "auto"
        Radius of the neighbourhood in the embedding.
    min_samples : int or "auto", default "auto"
    n_components : int, default 3
    method : {"dbscan", "hdbscan"}, default "dbscan"
        What finds the clusters in the embedding. HDBSCAN (Campello, Moulavi and Sander 2013) takes regions of different
        density; `eps` is then the distance below which clusters are not divided, 0 for "auto", and `gamma` what
        "dbscan" would take.

    Attributes
    ----------
    labels_ : ndarray of int64, shape (n,)
        The largest cluster is 0; -1 is noise.
    embedding_ : ndarray of float64, shape (n, n_components)
    result_ : Clustering
        What was chosen, and all candidates; of DBSCAN.
    n_features_in_ : int
        n.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase.estimator import ScenarioClustering
    >>> place = np.r_[np.linspace(0, 1, 20), np.linspace(9, 10, 20)]
    >>> distances = abs(place[:, None] - place)
    >>> model = ScenarioClustering().fit(distances)
    >>> model.predict(abs(np.array([0.5, 9.5])[:, None] - place)).tolist() == [model.labels_[0], model.labels_[-1]]
    True
    """

    def __init__(
        self,
        gamma: float | Literal["auto"] = "auto",
        eps: float | Literal["auto"] = "auto",
        min_samples: int | Literal["auto"] = "auto",
        n_components: int = 3,
        method: Literal["dbscan", "hdbscan"] = "dbscan",
    ) -> None:
        self.gamma, self.eps, self.min_samples = gamma, eps, min_samples
        self.n_components, self.method = n_components, method

    def fit(self, distances: npt.ArrayLike, y: Any = None) -> Self:
        """Cluster.

        Parameters
        ----------
        distances : array_like, shape (n, n)
            Symmetric, zero on the diagonal, finite.
        y : None
            Not used.

        Raises
        ------
        InputError
            Not a distance matrix, or a parameter that cannot be.
        """
        if self.method not in ("dbscan", "hdbscan"):
            raise InputError(f"There is no method '{self.method}'; {suggestion(self.method, ('dbscan', 'hdbscan'))}")
        eps = self.eps if self.method == "dbscan" else "auto"
        self.result_: Clustering = cluster(
            distances, gamma=self.gamma, eps=eps, min_samples=self.min_samples, n_components=self.n_components
        )
        matrix = np.asarray(distances, dtype=np.float64)
        self.embedding_, self.labels_ = self.result_.embedding, self.result_.labels
        self.n_features_in_ = len(matrix)
        with threadpool_limits(limits=1):
            self._pca = KernelPCA(min(self.n_components, len(matrix)), kernel="precomputed", random_state=0)
            # Without variance there is nothing to project on.
            self._flat = not self.embedding_.any()
            if not self._flat:
                self._pca.fit(self._kernel(matrix))
        if self.method == "hdbscan":
            self.labels_ = self._hdbscan()
        return self

    def transform(self, distances: npt.ArrayLike) -> FloatArray:
        """Place new scenarios in the kernel space.

        Parameters
        ----------
        distances : array_like, shape (m, n)
            From each new scenario to those that were clustered.

        Returns
        -------
        ndarray of float64, shape (m, n_components)

        Raises
        ------
        InputError
            There are not n distances of each, or one is not finite or negative.
        """
        matrix = np.asarray(distances, dtype=np.float64)
        if matrix.ndim != 2 or matrix.shape[1] != self.n_features_in_:
            raise InputError(
                f"Distances of shape {matrix.shape} do not go to the {self.n_features_in_} scenarios that were"
                " clustered."
            )
        if not np.isfinite(matrix).all() or (matrix < 0.0).any():
            raise InputError("A distance is negative or not finite; give finite distances of at least 0.")
        placed = np.zeros((len(matrix), self.n_components))
        if not self._flat and len(matrix):
            with threadpool_limits(limits=1):
                found = self._pca.transform(self._kernel(matrix))
            placed[:, : found.shape[1]] = found
        return placed

    def predict(self, distances: npt.ArrayLike) -> IntArray:
        """Assign new scenarios to the clusters that are there, without changing these.

        As DBSCAN would, each goes to the cluster of the nearest dense scenario within its neighbourhood, and is noise
        where there is none.

        Parameters
        ----------
        distances : array_like, shape (m, n)
            From each new scenario to those that were clustered.

        Returns
        -------
        ndarray of int64, shape (m,)
        """
        placed = self.transform(distances)
        apart = cdist(placed, self.embedding_)
        apart[:, ~self._dense()] = np.inf
        nearest = apart.argmin(axis=1)
        near = apart[np.arange(len(placed)), nearest] <= self._reach()
        return np.where(near, self.labels_[nearest], NOISE).astype(np.int64)

    def _kernel(self, distances: FloatArray) -> FloatArray:
        scaled = distances / self.result_.scale if self.result_.scale else distances
        return gaussian_kernel(scaled, self.result_.gamma)

    def _dense(self) -> BoolArray:
        """Scenarios with enough neighbours; with HDBSCAN all that are in a cluster."""
        if self.method == "hdbscan":
            return np.asarray(self.labels_ >= 0)
        between = cdist(self.embedding_, self.embedding_)
        return np.asarray((between <= self.result_.eps).sum(axis=1) >= self.result_.min_samples)

    def _reach(self) -> float:
        """Radius within which a new scenario belongs to a cluster."""
        if self.method == "dbscan":
            return self.result_.eps
        # As far as the members of the clusters are from their own min_samples-th neighbour at most.
        members = self.embedding_[self.labels_ >= 0]
        between = np.sort(cdist(members, members), axis=1)
        return float(between[:, min(self.result_.min_samples, len(members)) - 1].max(initial=0.0))

    def _hdbscan(self) -> IntArray:
        least = max(2, self.result_.min_samples)
        if len(self.embedding_) <= least:
            return np.full(len(self.embedding_), NOISE, dtype=np.int64)
        clusters = HDBSCAN(
            min_cluster_size=least,
            min_samples=least,
            cluster_selection_epsilon=0.0 if self.eps == "auto" else float(self.eps),
            copy=True,
        )
        return by_size(clusters.fit_predict(self.embedding_))
