"""Archetypal analysis in the parameter space and in kernel space; archetypes are scenarios that were run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg import eigh
from scipy.spatial.distance import cdist

from cornercase._common.errors import InputError
from cornercase._common.numba.blas import single_threaded_blas
from cornercase._common.typing import FloatArray, IntArray
from cornercase.reduction._simplex_kernel import project_on_simplex

MAX_ARCHETYPES: Final = 15
"""Greatest number of archetypes (extreme scenarios) of a hull, as in the paper that cornercase follows."""

# An archetype is added as long as it explains at least this share of the variance.
_MIN_EXPLAINED_GAIN: Final = 0.02
# Kernel width relative to the median distance within the cluster; narrow enough that every scenario along a horseshoe
# is extreme in kernel space.
_KERNEL_GAMMA: Final = 4.0
# Greatest number of scenarios in kernel space: the time grows with its cube.
_MAX_IN_KERNEL: Final = 2000
# Greatest number of scenarios of a cluster in studies with embedded distances, for which more would take minutes.
_MAX_EVENLY_SPACED: Final = 400
_EXPLAINED_VARIANCE: Final = 0.99
_ITERATIONS: Final = 300
# The fit ends earlier if an iteration lowers the residual by less.
_RESIDUAL_TOLERANCE: Final = 1e-4
# Largest number of step lengths that are tried, each half as long.
_STEP_TRIALS: Final = 10


@dataclass(frozen=True)
class Archetypes:
    """Archetypes of a cluster: indices, in rising order, of extreme scenarios that mix to approximately all others.

    `explained_variance` is the share of the variance that mixtures of 1, 2, … archetypes explain, before archetypes are
    replaced by the nearest scenarios. If the number of archetypes was given, there is only the share for this number.
    """

    indices: IntArray
    explained_variance: tuple[float, ...]


def find_archetypes(points: FloatArray, k: int | None = None, *, max_k: int = MAX_ARCHETYPES) -> Archetypes:
    """Find `k` archetypes such that every point is approximately a mixture of them; return the points nearest to them.

    By default `k` is at the bend of the curve of the explained variance: the first number, up to `max_k`, after which
    another archetype adds less than 0.02. The method is from A. Cutler, L. Breiman, "Archetypal analysis", 1994. The
    algorithm (projected gradients, first archetypes by FurthestSum) is from M. Mørup, L. K. Hansen, "Archetypal
    analysis for machine learning and data mining", 2012.
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
    """Find `k` archetypes of a cluster in kernel space, from the distances between its n scenarios, shape (n, n).

    Similarities are a Gaussian kernel of the distances, and the inner products of coordinates in kernel space are the
    centred kernel. The kernel is so narrow that scenarios far from each other along a bent cluster count as unrelated.
    So archetypes spread all along the cluster. Of more than 2,000 scenarios only 2,000 are used, evenly spaced by the
    sum of their distances to the others.
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
    with single_threaded_blas():
        values, vectors = eigh(centred)
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    n_axes = int(np.searchsorted(np.cumsum(values) / values.sum(), _EXPLAINED_VARIANCE)) + 1
    return find_archetypes(vectors[:, :n_axes] * np.sqrt(values[:n_axes]), k)


def pick_evenly_spaced(members: IntArray) -> IntArray:
    """Return at most 400 of the members, evenly spaced in their order, since archetypal analysis of more is slow."""
    count = min(_MAX_EVENLY_SPACED, len(members))
    return members[np.linspace(0, len(members) - 1, count).astype(np.int64)]


def _fit_archetypal_analysis(points: FloatArray, k: int) -> tuple[FloatArray, float]:
    """Fit `k` archetypes, shape (k, d); also return the residual sum of squares.

    Archetypes are mixtures of points, ``mixing @ points``. Points are approximated by mixtures of archetypes,
    ``shares @ archetypes``. Each row of the matrices ``shares`` and ``mixing`` is nonnegative and sums to 1. The two
    matrices are improved in turn by projected gradients. The step length doubles after an improvement, and is halved
    otherwise.
    """
    if k == 1:
        center = points.mean(axis=0, keepdims=True)
        return center, float(((points - center) ** 2).sum())
    rng = np.random.RandomState(0)
    mixing = np.zeros((k, len(points)))
    mixing[np.arange(k), _choose_far_points(points, k, rng)] = 1.0
    shares = np.zeros((len(points), k))
    shares[np.arange(len(points)), rng.choice(k, len(points))] = 1.0
    with single_threaded_blas():
        total, share_step, mixing_step = float((points**2).sum()), 1.0, 1.0
        archetypes = mixing @ points
        to_archetypes, among_archetypes, weights = points @ archetypes.T, archetypes @ archetypes.T, shares.T @ shares
        residual = total - 2.0 * float((shares * to_archetypes).sum()) + float((among_archetypes * weights).sum())
        for _ in range(_ITERATIONS):
            previous = residual
            gradient = shares @ among_archetypes - to_archetypes
            for _ in range(_STEP_TRIALS):
                new_shares: FloatArray = shares - share_step * gradient
                project_on_simplex(new_shares)
                new_weights: FloatArray = new_shares.T @ new_shares
                new_residual = (
                    total
                    - 2.0 * float((new_shares * to_archetypes).sum())
                    + float((among_archetypes * new_weights).sum())
                )
                if new_residual < residual:
                    shares, weights, residual, share_step = new_shares, new_weights, new_residual, 2.0 * share_step
                    break
                share_step *= 0.5
            sums = shares.T @ points
            gradient = (weights @ archetypes - sums) @ points.T
            for _ in range(_STEP_TRIALS):
                new_mixing: FloatArray = mixing - mixing_step * gradient
                project_on_simplex(new_mixing)
                new_archetypes = new_mixing @ points
                new_among = new_archetypes @ new_archetypes.T
                new_residual = total - 2.0 * float((sums * new_archetypes).sum()) + float((new_among * weights).sum())
                if new_residual < residual:
                    mixing, archetypes, among_archetypes = new_mixing, new_archetypes, new_among
                    to_archetypes = points @ archetypes.T
                    residual, mixing_step = new_residual, 2.0 * mixing_step
                    break
                mixing_step *= 0.5
            if abs(previous - residual) < _RESIDUAL_TOLERANCE:
                break
    return archetypes, residual


def _choose_far_points(points: FloatArray, k: int, rng: np.random.RandomState) -> list[int]:
    """Choose `k` points as first archetypes by FurthestSum; return their indices.

    Each is the point with the largest sum of distances to the points chosen before.
    """

    def distances_to(index: int) -> FloatArray:
        return np.asarray(np.linalg.norm(points - points[index], axis=1))

    chosen = [int(rng.choice(len(points)))]
    to_first = distances_to(chosen[0])
    sums: FloatArray = to_first.copy()
    for _ in range(k - 1):
        sums[chosen] = 0.0
        chosen.append(int(sums.argmax()))
        sums = sums + distances_to(chosen[-1])
    # The first point was random, so another one replaces it.
    sums -= to_first
    sums[chosen[1:]] = 0.0
    return [*chosen[1:], int(sums.argmax())]


def _snap_to_points(archetypes: FloatArray, points: FloatArray) -> IntArray:
    """Return the rising indices of the points nearest to the archetypes, shape (k,); no point is used twice."""
    distances = cdist(archetypes, points)
    nearest: list[int] = []
    for row in distances:
        row[nearest] = np.inf
        nearest.append(int(row.argmin()))
    return np.sort(np.array(nearest, dtype=np.int64))
