"""Whether the same clusters are found again in random parts of the scenarios."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering.clusters import Candidate, ClusteringMethod
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
        method: ClusteringMethod,
        most: int,
    ) -> None:
        whole = round(RESAMPLED * len(order))
        count = min(max(2, whole), most)
        rng = np.random.default_rng(0)
        self._parts = [np.sort(rng.choice(order, count, replace=False)) for _ in range(RESAMPLES)]
        # A part that is thinner than the whole is dense with fewer neighbours.
        self._thinned = count / len(order)
        self._distances, self._method = distances, method
        self._spaces: dict[tuple[float, int, int], FloatArray] = {}

    def of(self, candidate: Candidate, labels: IntArray) -> float:
        """Mean adjusted Rand index of clusters with those that the same settings find in the parts.

        Parameters
        ----------
        candidate : Candidate
            Settings that `labels` were found with.
        labels : ndarray of int64, shape (n,)
            Cluster of each scenario; -1 is noise.

        Returns
        -------
        float
            -1 to 1; 1 where the clusters are the same.
        """
        needed = max(min(3, candidate.min_samples), round(candidate.min_samples * self._thinned))
        found = []
        for k, part in enumerate(self._parts):
            key = (candidate.gamma, candidate.n_components, k)
            if key not in self._spaces:
                space = KernelSpace(candidate.gamma, candidate.n_components)
                self._spaces[key] = space.fit(self._distances[np.ix_(part, part)]).embedding
            again = find_dense_regions(self._spaces[key], candidate.eps, needed, self._method)
            found.append(_agreement(labels[part], again))
        return float(np.mean(found))


def _agreement(one: IntArray, two: IntArray) -> float:
    """Adjusted Rand index of two labellings, each from -1 on; scikit-learn's checks take 30 times as long."""
    most = int(two.max()) + 2
    shared = np.bincount((one + 1) * most + two + 1, minlength=(int(one.max()) + 2) * most).reshape(-1, most)
    both, first, second = (int((x**2).sum()) for x in (shared, shared.sum(axis=1), shared.sum(axis=0)))
    # Pairs that are together in both, in the first only, in the second only, and in neither.
    together, only_first, only_second = both - len(one), first - both, second - both
    neither = len(one) ** 2 - first - only_second
    if only_first == only_second == 0:
        return 1.0
    against = (together + only_first) * (only_first + neither) + (together + only_second) * (only_second + neither)
    return 2.0 * (together * neither - only_first * only_second) / against
