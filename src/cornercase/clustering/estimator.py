"""Kernel PCA and DBSCAN on distances as an estimator with scikit-learn's manners."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal, Self

import numpy as np
import numpy.typing as npt
from sklearn.base import BaseEstimator, ClusterMixin
from threadpoolctl import threadpool_limits

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering.kernel_space import KernelSpace, assigned
from cornercase.clustering.search import Clustering, cluster


class ScenarioClustering(ClusterMixin, BaseEstimator):  # type: ignore[misc]
    """Clusters scenarios by their distances, and assigns new ones to the clusters that are there.

    Parameters
    ----------
    gamma : float or "auto", default "auto"
        Kernel width, as of `cornercase.clustering.search.cluster`.
    eps : float or "auto", default "auto"
        Radius of the neighbourhood in the embedding.
    min_samples : int or "auto", default "auto"
    n_components : int, default 3
    method : {"dbscan", "hdbscan"}, default "dbscan"
        What finds the clusters in the embedding.
    landmarks : int, "auto" or None, default "auto"
        How many scenarios span the kernel space; None for all.

    Attributes
    ----------
    labels_ : ndarray of int64, shape (n,)
        The largest cluster is 0; -1 is noise.
    embedding_ : ndarray of float64, shape (n, n_components)
    result_ : Clustering
        What was chosen, and all candidates.
    n_features_in_ : int
        n.

    Examples
    --------
    >>> import numpy as np
    >>> from cornercase import ScenarioClustering
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
        landmarks: int | Literal["auto"] | None = "auto",
    ) -> None:
        self.gamma, self.eps, self.min_samples = gamma, eps, min_samples
        self.n_components, self.method, self.landmarks = n_components, method, landmarks

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
        self.result_: Clustering = cluster(distances, **self.get_params())
        matrix = np.asarray(distances, dtype=np.float64)
        self.embedding_, self.labels_ = self.result_.embedding, self.result_.labels
        self.n_features_in_ = len(matrix)
        self._spanning, self._known = np.arange(len(matrix)), self.result_
        if len(self.result_.landmarks):
            self._spanning = self.result_.landmarks
            self._known = replace(
                self.result_, labels=self.labels_[self._spanning], embedding=self.embedding_[self._spanning]
            )
        with threadpool_limits(limits=1):
            self._space = KernelSpace(self.result_.gamma, self.n_components)
            self._space.fit(self._scaled(matrix[np.ix_(self._spanning, self._spanning)]))
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
        with threadpool_limits(limits=1):
            return self._space.transform(self._scaled(matrix[:, self._spanning]))

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
        return assigned(self.transform(distances), self._known)

    def _scaled(self, distances: FloatArray) -> FloatArray:
        return distances / self.result_.scale if self.result_.scale else distances
