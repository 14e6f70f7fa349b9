"""Shapes of clusters, and the archetypes that fit them: those of the paper's convex ones, and of others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from cornercase._common.errors import InputError, suggestion
from cornercase._common.typing import FloatArray, IntArray
from cornercase.reduction.archetypal_analysis import archetypal_analysis, kernel_archetypal_analysis
from cornercase.reduction.convexity import CONVEX, convexity, near_convex_parts
from cornercase.reduction.hulls import MOST_HULL_DIMENSIONS, hull_archetypes

ArchetypeMethod = Literal["auto", "hull", "pcha", "parts", "kernel"]


@dataclass(frozen=True)
class ClusterShape:
    """ClusterShape of a cluster, and how its archetypes are found for that.

    Attributes
    ----------
    cluster : int
    convexity : float
        In the parameter space, 0 to 1, as of `cornercase.reduction.convexity.convexity`.
    behaviour : float
        The same in the kernel space of the distances; NaN where that is not known.
    method : {"hull", "pcha", "parts", "kernel"}
        ``"hull"``: corners of the convex hull in the parameter space. ``"pcha"``: archetypal analysis there.
        ``"parts"``: corners of the hulls of near-convex parts. ``"kernel"``: archetypal analysis in kernel space.
    parts : tuple of ndarray of int64
        Scenarios of each part; one part but for ``"parts"``.
    """

    cluster: int
    convexity: float
    behaviour: float
    method: str
    parts: tuple[IntArray, ...]

    def archetypes(self, points: FloatArray, distances: FloatArray, most: int) -> IntArray:
        """Scenarios at the extremes of the cluster.

        Parameters
        ----------
        points : ndarray of float64, shape (n, d)
            Parameters in the unit cube.
        distances : ndarray of float64, shape (n, n)
        most : int
            How many at most; of parts each has as many as its share of the scenarios is.

        Returns
        -------
        ndarray of int64, shape (m,)
        """
        (whole, *more) = self.parts
        if self.method == "kernel":
            return whole[kernel_archetypal_analysis(distances[np.ix_(whole, whole)], most).indices]
        if self.method == "pcha":
            return whole[archetypal_analysis(points[whole], most=most).indices]
        if not more:
            return whole[hull_archetypes(points[whole], most)]
        numbers = shared(most, [len(part) for part in self.parts])
        found = [
            part[hull_archetypes(points[part], number)]
            for part, number in zip(self.parts, numbers, strict=True)
            if number
        ]
        return np.sort(np.concatenate(found))


def shapes(
    points: FloatArray, labels: IntArray, embedding: FloatArray | None = None, method: ArchetypeMethod = "auto"
) -> tuple[ClusterShape, ...]:
    """Decide for each cluster how its archetypes are found.

    Parameters
    ----------
    points : ndarray of float64, shape (n, d)
        Parameters in the unit cube.
    labels : ndarray of int64, shape (n,)
        -1 is noise.
    embedding : ndarray of float64, shape (n, e), optional
        Kernel space of the clustering.
    method : {"auto", "hull", "pcha", "parts", "kernel"}
        ``"auto"`` goes by the convexity, 0.8 being convex: a cluster that is bent in kernel space takes ``"kernel"``;
        else one that is convex in the parameter space takes ``"hull"``, or ``"pcha"`` with more than six parameters;
        else ``"parts"``. A cluster that six parts are not enough for takes ``"kernel"``.

    Returns
    -------
    tuple of ClusterShape
        Of cluster 0 first.

    Raises
    ------
    InputError
        There is no such method.
    """
    if method not in get_args(ArchetypeMethod):
        raise InputError(f"There is no method '{method}'; {suggestion(method, get_args(ArchetypeMethod))}")
    found = []
    for label in np.unique(labels[labels >= 0]).tolist():
        members = labels == label
        whole = (np.flatnonzero(members),)
        straight = convexity(points, members)
        behaviour = float("nan") if embedding is None else convexity(embedding, members)
        how: str = method
        if method == "auto":
            convex = "hull" if points.shape[1] <= MOST_HULL_DIMENSIONS else "pcha"
            how = "kernel" if behaviour < CONVEX else convex if straight >= CONVEX else "parts"
        parts = tuple(near_convex_parts(points, members)) if how == "parts" else whole
        if not parts:
            how, parts = "kernel", whole
        found.append(ClusterShape(label, straight, behaviour, how, parts))
    return tuple(found)


def shared(count: int, weights: Sequence[float]) -> list[int]:
    """Divide a number by weights, whole and as fairly as can be.

    Parameters
    ----------
    count : int
    weights : sequence of float

    Returns
    -------
    list of int
    """
    if not len(weights):
        return []
    share = count * np.asarray(weights, dtype=np.float64) / np.sum(weights)
    each = np.floor(share).astype(np.int64)
    each[np.argsort(each - share, kind="stable")[: count - int(each.sum())]] += 1
    return [int(number) for number in each]
