"""Validity of clusters by DBCV and silhouette, computed from the distances alone."""

from __future__ import annotations

import numpy as np
from sklearn.metrics import silhouette_samples

from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering._kernels.spanning_tree import fill_spanning_tree

_MIN_DISTANCE = 1e-5


class ValidityScorer:
    """Scorer of clusters by DBCV and silhouette on a sample of the scenarios; scores are cached."""

    def __init__(self, distances: FloatArray, sample: IntArray) -> None:
        self._sample = sample
        self._distances = distances[np.ix_(sample, sample)]
        self._known: dict[bytes, tuple[float, float]] = {}

    def dbcv_and_silhouette(self, labels: IntArray) -> tuple[float, float]:
        """Return DBCV and silhouette of the clusters `labels`, -1 to 1 each; a scenario in noise contributes 0.

        Both are -1 if there is only one cluster, or if a cluster has fewer than three scenarios.
        """
        labels = labels[self._sample]
        key = labels.tobytes()
        if key not in self._known:
            self._known[key] = self._compute(labels)
        return self._known[key]

    def _compute(self, labels: IntArray) -> tuple[float, float]:
        names, sizes = np.unique(labels[labels >= 0], return_counts=True)
        if len(names) < 2 or sizes.min() < 3:
            return -1.0, -1.0
        is_member = labels >= 0
        inner = self._distances[np.ix_(is_member, is_member)]
        silhouettes = silhouette_samples(inner, labels[is_member], metric="precomputed")
        return dbcv(self._distances, labels), float(silhouettes.sum() / len(labels))


def dbcv(distances: FloatArray, labels: IntArray, *, dimensions: float = 3.0) -> float:
    """Return the density-based clustering validation index (DBCV), -1 to 1, higher is better; noise contributes 0.

    `labels` has two or more clusters of three or more scenarios. `dimensions` is the exponent of the all-points core
    distance. Source: definitions 1 to 8 of Moulavi et al., "Density-based clustering validation", 2014.
    """
    positive = distances[distances > 0]
    distances = distances / np.median(positive) if len(positive) else distances
    core = np.zeros(len(labels))
    internal_nodes, sparseness = [], []
    # A sample of the scenarios may have none of a cluster.
    groups = [np.flatnonzero(labels == name) for name in np.unique(labels[labels >= 0])]
    for members in groups:
        # Identical scenarios would be infinitely dense and have no edge in the tree.
        within = np.maximum(distances[np.ix_(members, members)], _MIN_DISTANCE)
        np.fill_diagonal(within, np.inf)
        mean = (within**-dimensions).sum(axis=1) / (len(members) - 1)
        core[members] = mean ** (-1.0 / dimensions)
        reach = np.maximum(within, np.maximum(core[members][:, None], core[members]))
        # One core distance makes many values equal, and the tree would depend on the order of the scenarios. The small
        # term lets the nearer neighbour come first.
        reach += 1e-6 * within
        tree_edges, lengths = np.empty((2, len(members) - 1), dtype=np.int64), np.empty(len(members) - 1)
        fill_spanning_tree(reach, tree_edges, lengths)
        is_internal = np.bincount(tree_edges.ravel(), minlength=len(members)) > 1
        is_inner_edge = is_internal[tree_edges].all(axis=0)
        sparseness.append(lengths[is_inner_edge].max() if is_inner_edge.any() else lengths.max())
        internal_nodes.append(members[is_internal])
    separation = np.full((len(groups), len(groups)), np.inf)
    for a in range(len(groups)):
        for b in range(a):
            reach = np.maximum(
                distances[np.ix_(internal_nodes[a], internal_nodes[b])],
                np.maximum(core[internal_nodes[a]][:, None], core[internal_nodes[b]]),
            )
            separation[a, b] = separation[b, a] = reach.min()
    validity = 0.0
    for members, separation_of, sparseness_of in zip(groups, separation.min(axis=1), sparseness, strict=True):
        validity += (
            len(members) / len(labels) * float((separation_of - sparseness_of) / max(separation_of, sparseness_of))
        )
    return validity
