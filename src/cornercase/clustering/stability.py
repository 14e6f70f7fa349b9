"""Whether the same clusters are found again in random parts of the scenarios."""

from __future__ import annotations

from typing import Final

import numpy as np
from sklearn.metrics import adjusted_rand_score

from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering.clusters import ClusteringMethod
from cornercase.clustering.density import find_dense_regions
from cornercase.clustering.kernel_space import KernelSpace

RESAMPLES: Final = 10
RESAMPLED: Final = 0.8


class Stability:
    """Clusters of ten random parts of 80 % of the scenarios, each in a kernel space of its own.

    Parameters
    ----------
    distances : ndarray of float64, shape (n, n)
        Divided by their scale.
    order : ndarray of int64, shape (n,)
        Scenarios in an order that depends on nothing but the distances.
    min_samples, n_components : int
        Settings of the clustering.
    method : {"dbscan", "hdbscan"}
    most : int
        Largest number of scenarios in a part.

    Notes
    -----
    U. von Luxburg, "Clustering stability: an overview", 2010.
    """

    def __init__(
        self,
        distances: FloatArray,
        order: IntArray,
        *,
        min_samples: int,
        n_components: int,
        method: ClusteringMethod,
        most: int,
    ) -> None:
        whole = round(RESAMPLED * len(order))
        count = min(max(2, whole), most)
        rng = np.random.default_rng(0)
        self._parts = [np.sort(rng.choice(order, count, replace=False)) for _ in range(RESAMPLES)]
        # A part that is much thinner than the whole is dense with fewer neighbours.
        self._needed = min_samples if count == whole else max(3, round(min_samples * count / len(order)))
        self._distances, self._n_components, self._method = distances, n_components, method
        self._spaces: dict[tuple[float, int], FloatArray] = {}

    def of(self, gamma: float, eps: float, labels: IntArray) -> float:
        """Mean adjusted Rand index of clusters with those that the same settings find in the parts.

        Parameters
        ----------
        gamma, eps : float
            Settings that `labels` were found with.
        labels : ndarray of int64, shape (n,)
            Cluster of each scenario; -1 is noise.

        Returns
        -------
        float
            -1 to 1; 1 where the clusters are the same.
        """
        found = []
        for k, part in enumerate(self._parts):
            if (gamma, k) not in self._spaces:
                space = KernelSpace(gamma, self._n_components).fit(self._distances[np.ix_(part, part)])
                self._spaces[gamma, k] = space.embedding
            again = find_dense_regions(self._spaces[gamma, k], eps, self._needed, self._method)
            found.append(adjusted_rand_score(labels[part], again))
        return float(np.mean(found))
