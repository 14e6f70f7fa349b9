"""k-means for very many clusters, up to a tenth of the points; each point is compared only with nearby centres.

The result is the same as from `sklearn.cluster.KMeans` with seed 0, one start and at most 30 iterations, unless a
cluster becomes empty. D. Arthur, S. Vassilvitskii, "k-means++: The advantages of careful seeding", 2007; S. Lloyd,
"Least squares quantization in PCM", 1982.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering._cells import AXES_PER_STAGE, make_cells, pad_axes
from cornercase.clustering._kernels.k_means_start import choose_centers

_MAX_ITERATIONS: Final = 30
# Squared shift of all centres, relative to the mean variance of an axis, up to which the centres count as fixed.
_TOLERANCE: Final = 1e-4


def find_k_means(points: FloatArray, k: int) -> tuple[IntArray, FloatArray]:
    """Divide points, shape (n, p), into k clusters by k-means.

    Returns the cluster of each point, shape (n,), and the centres, shape (k, p). Clusters may be empty.
    """
    mean = points.mean(axis=0)
    points = pad_axes(points - mean)
    centers = points[_choose_starts(points, k)]
    tolerance = _TOLERANCE * float(points[:, : len(mean)].var(axis=0).mean())
    labels = np.full(len(points), -1, dtype=np.int64)
    for _ in range(_MAX_ITERATIONS):
        previous_labels, labels = labels, _nearest_center(points, centers)
        previous_centers, centers = centers, _mean_per_cluster(points, labels, centers)
        if np.array_equal(labels, previous_labels):
            break
        if float(((centers - previous_centers) ** 2).sum()) <= tolerance:
            labels = _nearest_center(points, centers)
            break
    else:
        labels = _nearest_center(points, centers)
    return labels, centers[:, : len(mean)] + mean


def _choose_starts(points: FloatArray, k: int) -> IntArray:
    """Choose the points that are the initial centres, as scikit-learn does with seed 0; return their indices."""
    rng = np.random.RandomState(0)
    first = int(rng.choice(len(points), p=np.full(len(points), 1.0 / len(points))))
    random_numbers = rng.uniform(size=(k - 1, 2 + int(math.log(k))))
    stages = points.reshape(len(points), -1, AXES_PER_STAGE)
    chosen: IntArray = choose_centers(stages, make_cells(points), first, random_numbers)
    return chosen


def _nearest_center(points: FloatArray, centers: FloatArray) -> IntArray:
    return np.asarray(cKDTree(centers).query(points)[1], dtype=np.int64)


def _mean_per_cluster(points: FloatArray, labels: IntArray, centers: FloatArray) -> FloatArray:
    """Return the mean of the points of each cluster, shape (k, p); the centre of an empty cluster stays as it is."""
    order = np.argsort(labels, kind="stable")
    used, starts, counts = np.unique(labels[order], return_index=True, return_counts=True)
    means = centers.copy()
    means[used] = np.add.reduceat(points[order], starts, axis=0) / counts[:, None]
    return means
