"""How good clusters are, on the distances alone."""

from __future__ import annotations

import numpy as np
from sklearn.metrics import silhouette_samples

from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering.spanning_tree import find_tree

_CLOSEST = 1e-5


class Validity:
    """Density-based validity and silhouette of labels on one distance matrix, each labelling once.

    Parameters
    ----------
    distances : ndarray of float64, shape (n, n)
        Between all scenarios, in any unit.
    some : ndarray of int64, shape (m,)
        Scenarios on which they are computed.
    """

    def __init__(self, distances: FloatArray, some: IntArray) -> None:
        self._some = some
        self._distances = distances[np.ix_(some, some)]
        self._known: dict[bytes, tuple[float, float]] = {}

    def of(self, labels: IntArray) -> tuple[float, float]:
        """Return validity and silhouette of some clusters.

        Parameters
        ----------
        labels : ndarray of int64, shape (n,)
            Cluster of each scenario; -1 is noise, which counts as 0 in both.

        Returns
        -------
        dbcv, silhouette : float
            -1 to 1; both are -1 where a cluster has fewer than three scenarios.
        """
        labels = labels[self._some]
        key = labels.tobytes()
        if key not in self._known:
            self._known[key] = self._compute(labels)
        return self._known[key]

    def _compute(self, labels: IntArray) -> tuple[float, float]:
        names, sizes = np.unique(labels[labels >= 0], return_counts=True)
        if len(names) < 2 or sizes.min() < 3:
            return -1.0, -1.0
        kept = labels >= 0
        inner = self._distances[np.ix_(kept, kept)]
        silhouettes = silhouette_samples(inner, labels[kept], metric="precomputed")
        return density_validity(self._distances, labels), float(silhouettes.sum() / len(labels))


def density_validity(distances: FloatArray, labels: IntArray, *, dimensions: float = 3.0) -> float:
    """Density-based clustering validity index, DBCV.

    Parameters
    ----------
    distances : ndarray of float64, shape (n, n)
        Between all scenarios, in any unit.
    labels : ndarray of int64, shape (n,)
        Two clusters or more, each of three or more; -1 is noise.
    dimensions : float
        Exponent of the all-points core distance, the dimension that the data are taken to have.

    Returns
    -------
    float
        -1 to 1, higher is better; noise counts as 0. Definitions 1 to 8 of Moulavi et al., Density-based
        clustering validation, SIAM International Conference on Data Mining, 2014.
    """
    positive = distances[distances > 0]
    distances = distances / np.median(positive) if len(positive) else distances
    core = np.zeros(len(labels))
    inner, sparseness = [], []
    groups = [np.flatnonzero(labels == name) for name in range(int(labels.max()) + 1)]
    for members in groups:
        # Identical scenarios would be infinitely dense, and without an edge in the tree.
        between = np.maximum(distances[np.ix_(members, members)], _CLOSEST)
        np.fill_diagonal(between, np.inf)
        mean = (between**-dimensions).sum(axis=1) / (len(members) - 1)
        core[members] = mean ** (-1.0 / dimensions)
        reach = np.maximum(between, np.maximum(core[members][:, None], core[members]))
        # One core distance can decide the reach of many neighbours. Many reaches then are equal, and the tree would
        # depend on the order of the scenarios. The small term lets the nearer neighbour come first.
        reach += 1e-6 * between
        ends, lengths = np.empty((2, len(members) - 1), dtype=np.int64), np.empty(len(members) - 1)
        find_tree(reach, ends, lengths)
        internal = np.bincount(ends.ravel(), minlength=len(members)) > 1
        edges = internal[ends].all(axis=0)
        sparseness.append(lengths[edges].max() if edges.any() else lengths.max())
        inner.append(members[internal])
    separation = np.full((len(groups), len(groups)), np.inf)
    for a in range(len(groups)):
        for b in range(a):
            reach = np.maximum(
                distances[np.ix_(inner[a], inner[b])], np.maximum(core[inner[a]][:, None], core[inner[b]])
            )
            separation[a, b] = separation[b, a] = reach.min()
    validity = 0.0
    for members, apart, sparse in zip(groups, separation.min(axis=1), sparseness, strict=True):
        validity += len(members) / len(labels) * float((apart - sparse) / max(apart, sparse))
    return validity
