"""Stability of clusters: agreement with the clusters that are found in random parts of the scenarios."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering._clustering import Candidate, ClusteringMethod
from cornercase.clustering._density import cluster_by_density
from cornercase.clustering._kernel_pca import KernelPca

N_RESAMPLES: Final = 10
RESAMPLED_SHARE: Final = 0.8


class StabilityScorer:
    """Scorer of the stability of clusters, which clusters ten random parts of 80 % of the scenarios.

    A part has at most `max_part_size` scenarios, and kernel PCA is fitted to it alone. `distances`, shape (n, n),
    are divided by the median distance of the analysis. `order`, shape (n,), is an order of the scenarios that depends
    only on the distances. Source: U. von Luxburg, "Clustering stability: an overview", 2010.
    """

    def __init__(
        self,
        distances: FloatArray,
        order: IntArray,
        *,
        method: ClusteringMethod,
        max_part_size: int,
    ) -> None:
        count_of_share = round(RESAMPLED_SHARE * len(order))
        count = min(max(2, count_of_share), max_part_size)
        rng = np.random.default_rng(0)
        self._parts = [np.sort(rng.choice(order, count, replace=False)) for _ in range(N_RESAMPLES)]
        # A part has fewer scenarios, so fewer neighbours make a neighbourhood dense.
        self._part_share = count / len(order)
        self._distances, self._method = distances, method
        self._spaces: dict[tuple[float, int, int], FloatArray] = {}

    def mean_rand_index(self, candidate: Candidate, labels: IntArray) -> float:
        """Return the mean adjusted Rand index, -1 to 1, of a candidate's clusters with the clusters of the parts.

        `candidate` has the settings, `labels` are the clusters that were found with these settings.
        """
        min_samples = max(min(3, candidate.min_samples), round(candidate.min_samples * self._part_share))
        scores = []
        for k, part in enumerate(self._parts):
            key = (candidate.gamma, candidate.n_components, k)
            if key not in self._spaces:
                space = KernelPca(candidate.gamma, candidate.n_components)
                self._spaces[key] = space.fit(self._distances[np.ix_(part, part)]).embedding
            part_labels = cluster_by_density(self._spaces[key], candidate.eps, min_samples, self._method)
            scores.append(_adjusted_rand_index(labels[part], part_labels))
        return float(np.mean(scores))


def _adjusted_rand_index(labels_a: IntArray, labels_b: IntArray) -> float:
    """Return the adjusted Rand index of two arrays of cluster numbers, in which -1 is noise.

    `sklearn.metrics.adjusted_rand_score` takes 30 times as long, because of its checks.
    """
    width = int(labels_b.max()) + 2
    shared = np.bincount((labels_a + 1) * width + labels_b + 1, minlength=(int(labels_a.max()) + 2) * width).reshape(
        -1, width
    )
    pairs_in_both, first, second = (int((x**2).sum()) for x in (shared, shared.sum(axis=1), shared.sum(axis=0)))
    # Numbers of pairs that share a cluster in both, in the first only, in the second only, and in neither.
    together_in_both, only_first, only_second = (
        pairs_in_both - len(labels_a),
        first - pairs_in_both,
        second - pairs_in_both,
    )
    neither = len(labels_a) ** 2 - first - only_second
    if only_first == only_second == 0:
        return 1.0
    expected = (together_in_both + only_first) * (only_first + neither) + (together_in_both + only_second) * (
        only_second + neither
    )
    return 2.0 * (together_in_both * neither - only_first * only_second) / expected
