"""Archetypal analysis, snapped to scenarios that were run: in the parameter space, and in kernel space."""

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

MOST_ARCHETYPES: Final = 15
"""Number that the paper keeps on each hull."""

# An archetype is added as long as it explains at least this share of the variance.
_ELBOW: Final = 0.02
# Kernel width over the median distance within the cluster. It bends a horseshoe so much in kernel space that every
# scenario along it is extreme.
_GAMMA: Final = 4.0
# The time grows with the cube of the number of scenarios.
_MOST_IN_KERNEL: Final = 2000
# The same where there are many scenarios in all, so that it takes no minutes.
_MOST_SPREAD: Final = 400
_KEPT_VARIANCE: Final = 0.99
_ITERATIONS: Final = 300


@dataclass(frozen=True)
class Archetypes:
    """Scenarios at the extremes: all others lie between them.

    Attributes
    ----------
    indices : ndarray of int64, shape (k,)
        Scenarios, rising; fewer than were asked for where there are no more.
    explained : tuple of float
        Share of the variance that mixtures of 1, 2, … archetypes explain, before they were snapped to scenarios; only
        the last where the number was given.
    """

    indices: IntArray
    explained: tuple[float, ...]


def find_archetypes(points: FloatArray, k: int | None = None, *, most: int = MOST_ARCHETYPES) -> Archetypes:
    """Find k mixtures of some points such that every point is, nearly, a mixture of these.

    Parameters
    ----------
    points : ndarray of float64, shape (n, d)
        Parameters in the unit cube.
    k : int, optional
        How many. By default where the curve of the explained variance bends: the first number after which one more
        adds less than 0.02.
    most : int, default 15
        The largest number, where `k` is not given.

    Returns
    -------
    Archetypes
        The scenarios that are nearest to them.

    Raises
    ------
    InputError
        There are no points, or `k` or `most` is not positive.

    Notes
    -----
    A. Cutler, L. Breiman, "Archetypal analysis" (1994); projected gradients and the FurthestSum start of M. Mørup,
    L. K. Hansen, "Archetypal analysis for machine learning and data mining" (2012).
    """
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or not len(points):
        raise InputError(f"Points of shape {points.shape} have no archetypes; give shape (n, d) with n at least 1.")
    if (most if k is None else k) < 1:
        raise InputError(f"`{'most' if k is None else 'k'}` {most if k is None else k}: keep at least 1 archetype.")
    places = np.unique(points, axis=0)
    variance = float(((points - points.mean(axis=0)) ** 2).sum())
    if len(places) <= (1 if k is None else k) or variance == 0.0:
        return Archetypes(_snapped(places, points), (1.0,))
    if k is not None:
        found, left = _fitted(points, k)
        return Archetypes(_snapped(found, points), (1.0 - left / variance,))
    explained: list[float] = []
    best = points.mean(axis=0, keepdims=True)
    for number in range(1, min(most, len(places) - 1) + 1):
        found, left = _fitted(points, number)
        share = 1.0 - left / variance
        if explained and share - explained[-1] < _ELBOW:
            break
        explained.append(share)
        best = found
    return Archetypes(_snapped(best, points), tuple(explained))


def find_kernel_archetypes(distances: FloatArray, k: int) -> Archetypes:
    """Find archetypes in the space of a Gaussian kernel of distances.

    The kernel falls so fast that scenarios far apart along a bent cluster are unrelated, so archetypes come to lie all
    along it. The coordinates in kernel space are those whose inner products are the centred kernel. Of more than 2,000
    scenarios, 2,000 are looked at, evenly spread over all by the sum of their distances to the others.

    Parameters
    ----------
    distances : ndarray of float64, shape (n, n)
        Of the scenarios of one cluster.
    k : int
        Number of archetypes.

    Returns
    -------
    Archetypes
        The scenarios that are nearest to them.

    Raises
    ------
    InputError
        As `find_archetypes`.
    """
    if len(distances) > _MOST_IN_KERNEL:
        order = np.argsort(distances.sum(axis=1), kind="stable")
        some = np.sort(order[np.linspace(0, len(order) - 1, _MOST_IN_KERNEL).astype(np.int64)])
        found = find_kernel_archetypes(distances[np.ix_(some, some)], k)
        return Archetypes(np.asarray(some[found.indices], dtype=np.int64), found.explained)
    positive = distances[distances > 0.0]
    if not len(positive):
        return find_archetypes(np.zeros((len(distances), 1)), k)
    kernel = np.exp(-_GAMMA * (distances / np.median(positive)) ** 2)
    centred = kernel - kernel.mean(axis=0)
    centred -= centred.mean(axis=1)[:, None]
    # Threads of the linear algebra would change the last digits with their number.
    with threadpool_limits(limits=1):
        values, vectors = eigh(centred)
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    enough = int(np.searchsorted(np.cumsum(values) / values.sum(), _KEPT_VARIANCE)) + 1
    return find_archetypes(vectors[:, :enough] * np.sqrt(values[:enough]), k)


def spread(members: IntArray) -> IntArray:
    """Take scenarios that are few enough for archetypal analysis.

    Parameters
    ----------
    members : ndarray of int64, shape (n,)
        Indices.

    Returns
    -------
    ndarray of int64, shape (m,)
        All of up to 400; of more so many, evenly spread over their order.
    """
    count = min(_MOST_SPREAD, len(members))
    return members[np.linspace(0, len(members) - 1, count).astype(np.int64)]


def _fitted(points: FloatArray, k: int) -> tuple[FloatArray, float]:
    """Archetypes, shape (k, d), and the sum of squares that they leave."""
    # Says on import which array library it uses.
    with redirect_stdout(io.StringIO()):
        from archetypes import AA
    model: Any = AA(k, method="pgd", init="furthest_sum", max_iter=_ITERATIONS, random_state=0)
    with threadpool_limits(limits=1):
        model.fit(points)
    return np.asarray(model.archetypes_, dtype=np.float64), float(model.rss_)


def _snapped(places: FloatArray, points: FloatArray) -> IntArray:
    """Nearest point to each place, none twice, shape (k,)."""
    away = cdist(places, points)
    taken: list[int] = []
    for row in away:
        row[taken] = np.inf
        taken.append(int(row.argmin()))
    return np.sort(np.array(taken, dtype=np.int64))
