"""Archetypal analysis in the parameter space and in kernel space; archetypes are scenarios that were run."""

from __future__ import annotations

import io
from contextlib import redirect_stdout
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.linalg import eigh
from scipy.spatial.distance import cdist
from threadpoolctl import threadpool_limits

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray, IntArray

MAX_ARCHETYPES: Final = 15
"""Number per hull in the paper."""

# An archetype is added as long as it explains at least this share of the variance.
_MIN_EXPLAINED_GAIN: Final = 0.02
# Kernel width relative to the median distance within the cluster; narrow enough that every scenario along a horseshoe
# is extreme in kernel space.
_KERNEL_GAMMA: Final = 4.0
# The time grows with the cube of the number of scenarios.
_MAX_IN_KERNEL: Final = 2000
# The same for studies with landmarks, where more would take minutes.
_MAX_EVENLY_SPACED: Final = 400
_KEPT_VARIANCE: Final = 0.99
_ITERATIONS: Final = 300


@dataclass(frozen=True)
class Archetypes:
    """Scenarios at the extremes of a cluster, as rising indices; all others are approximately mixtures of them.

    `explained_variance` is the share of the variance that mixtures of 1, 2, … archetypes explain, before archetypes are
    replaced by the nearest scenarios. If the number of archetypes was given, it has only the value for this number.
    """

    indices: IntArray
    explained_variance: tuple[float, ...]


def find_archetypes(points: FloatArray, k: int | None = None, *, max_k: int = MAX_ARCHETYPES) -> Archetypes:
    """Find `k` archetypes such that every point is approximately a mixture of them; return the nearest scenarios.

    By default `k` is at the bend of the curve of the explained variance: the first number, up to `max_k`, after which
    another archetype adds less than 0.02. A. Cutler, L. Breiman, "Archetypal analysis", 1994; projected gradients and
    the FurthestSum start of M. Mørup, L. K. Hansen, "Archetypal analysis for machine learning and data mining", 2012.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or not len(points):
        raise InputError(f"Points of shape {points.shape} have no archetypes; give shape (n, d) with n at least 1.")
    if (max_k if k is None else k) < 1:
        raise InputError(f"`{'max_k' if k is None else 'k'}` {max_k if k is None else k}: give at least 1.")
    distinct = np.unique(points, axis=0)
    variance = float(((points - points.mean(axis=0)) ** 2).sum())
    if len(distinct) <= (1 if k is None else k) or variance == 0.0:
        return Archetypes(_snap_to_points(distinct, points), (1.0,))
    if k is not None:
        archetypes, residual = _fit_archetypal_analysis(points, k)
        return Archetypes(_snap_to_points(archetypes, points), (1.0 - residual / variance,))
    explained: list[float] = []
    best = points.mean(axis=0, keepdims=True)
    for number in range(1, min(max_k, len(distinct) - 1) + 1):
        archetypes, residual = _fit_archetypal_analysis(points, number)
        share = 1.0 - residual / variance
        if explained and share - explained[-1] < _MIN_EXPLAINED_GAIN:
            break
        explained.append(share)
        best = archetypes
    return Archetypes(_snap_to_points(best, points), tuple(explained))


def find_kernel_archetypes(cluster_distances: FloatArray, k: int) -> Archetypes:
    """Find `k` archetypes of a cluster in the space of a Gaussian kernel of the distances in it, shape (n, n).

    The kernel falls so fast that scenarios far from each other along a bent cluster are unrelated, so archetypes spread
    all along the cluster. The inner products of the coordinates are the centred kernel. Of more than 2,000 scenarios
    only 2,000 are used, evenly spaced by the sum of their distances to the others.
    """
    if len(cluster_distances) > _MAX_IN_KERNEL:
        order = np.argsort(cluster_distances.sum(axis=1), kind="stable")
        sample = np.sort(order[np.linspace(0, len(order) - 1, _MAX_IN_KERNEL).astype(np.int64)])
        archetypes = find_kernel_archetypes(cluster_distances[np.ix_(sample, sample)], k)
        return Archetypes(np.asarray(sample[archetypes.indices], dtype=np.int64), archetypes.explained_variance)
    positive = cluster_distances[cluster_distances > 0.0]
    if not len(positive):
        return find_archetypes(np.zeros((len(cluster_distances), 1)), k)
    kernel = np.exp(-_KERNEL_GAMMA * (cluster_distances / np.median(positive)) ** 2)
    centred = kernel - kernel.mean(axis=0)
    centred -= centred.mean(axis=1)[:, None]
    # The last digits would depend on the number of BLAS threads.
    with threadpool_limits(limits=1):
        values, vectors = eigh(centred)
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    n_axes = int(np.searchsorted(np.cumsum(values) / values.sum(), _KEPT_VARIANCE)) + 1
    return find_archetypes(vectors[:, :n_axes] * np.sqrt(values[:n_axes]), k)


def pick_evenly_spaced(members: IntArray) -> IntArray:
    """Return at most 400 of the members, evenly spaced in their order; with more, archetypal analysis would be slow."""
    count = min(_MAX_EVENLY_SPACED, len(members))
    return members[np.linspace(0, len(members) - 1, count).astype(np.int64)]


def _fit_archetypal_analysis(points: FloatArray, k: int) -> tuple[FloatArray, float]:
    """Fit `k` archetypes, shape (k, d); also return the residual sum of squares."""
    # The package prints its array library on import.
    with redirect_stdout(io.StringIO()):
        from archetypes import AA
    model: Any = AA(k, method="pgd", init="furthest_sum", max_iter=_ITERATIONS, random_state=0)
    with threadpool_limits(limits=1):
        model.fit(points)
    return np.asarray(model.archetypes_, dtype=np.float64), float(model.rss_)


def _snap_to_points(archetypes: FloatArray, points: FloatArray) -> IntArray:
    """Index of the nearest point to each archetype, shape (k,); no point is used twice."""
    distances = cdist(archetypes, points)
    nearest: list[int] = []
    for row in distances:
        row[nearest] = np.inf
        nearest.append(int(row.argmin()))
    return np.sort(np.array(nearest, dtype=np.int64))
