"""Shapes of clusters, and the way to find archetypes that suits each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from cornercase._common.errors import InputError, suggestion
from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering import Distances, PlacedDistances
from cornercase.reduction.archetypal_analysis import find_archetypes, find_kernel_archetypes, spread
from cornercase.reduction.convexity import CONVEX, find_convex_parts, measure_convexity
from cornercase.reduction.hulls import MOST_HULL_DIMENSIONS, find_hull_archetypes

ArchetypeMethod = Literal["auto", "hull", "pcha", "parts", "kernel"]
"""How archetypes are found; ``"auto"`` depends on the convexity of each cluster."""


@dataclass(frozen=True)
class ClusterShape:
    """Shape of a cluster, and how its archetypes are found.

    Attributes
    ----------
    cluster : int
    convexity : float
        In the parameter space, 0 to 1, as in `cornercase.reduction.convexity.measure_convexity`.
    kernel_convexity : float
        The same in the kernel space of the distances; NaN where that is not known.
    method : {"hull", "pcha", "parts", "kernel"}
        ``"hull"``: corners of the convex hull in the parameter space. ``"pcha"``: archetypal analysis there.
        ``"parts"``: corners of the hulls of near-convex parts. ``"kernel"``: archetypal analysis in kernel space.
    parts : int
        Number of near-convex parts; 1 but for ``"parts"``.
    """

    cluster: int
    convexity: float
    kernel_convexity: float
    method: str
    parts: int


@dataclass(frozen=True, eq=False)
class ShapedCluster:
    """A cluster of which the shape is known.

    Attributes
    ----------
    shape : ClusterShape
    parts : tuple of ndarray of int64
        Scenarios of each part, by index; one part but for the method ``"parts"``.
    """

    shape: ClusterShape
    parts: tuple[IntArray, ...]

    def archetypes(self, points: FloatArray, distances: Distances, most: int) -> IntArray:
        """Find scenarios at the extremes of the cluster.

        Parameters
        ----------
        points : ndarray of float64, shape (n, d)
            Parameters in the unit cube.
        distances : ndarray of float64, shape (n, n), or PlacedDistances
            Between all scenarios, in any unit.
        most : int
            Largest number; a part has its share of them, by its number of scenarios.

        Returns
        -------
        ndarray of int64, shape (m,)
            Indices.
        """
        (whole, *more) = self.parts
        if self.shape.method in ("kernel", "pcha") and isinstance(distances, PlacedDistances):
            whole = spread(whole)
        if self.shape.method == "kernel":
            return whole[find_kernel_archetypes(distances[np.ix_(whole, whole)], most).indices]
        if self.shape.method == "pcha":
            return whole[find_archetypes(points[whole], most=most).indices]
        if not more:
            return whole[find_hull_archetypes(points[whole], most)]
        numbers = divide_fairly(most, [len(part) for part in self.parts])
        found = [
            part[find_hull_archetypes(points[part], number)]
            for part, number in zip(self.parts, numbers, strict=True)
            if number
        ]
        return np.sort(np.concatenate(found))


def find_shapes(
    points: FloatArray, labels: IntArray, embedding: FloatArray | None = None, method: ArchetypeMethod = "auto"
) -> tuple[ShapedCluster, ...]:
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
    tuple of ShapedCluster
        Of cluster 0 first.

    Raises
    ------
    InputError
        There is no such method.
    """
    require_archetype_method(method)
    found = []
    for label in np.unique(labels[labels >= 0]).tolist():
        members = labels == label
        whole = (np.flatnonzero(members),)
        convexity = measure_convexity(points, members)
        in_kernel = float("nan") if embedding is None else measure_convexity(embedding, members)
        how: str = method
        if method == "auto":
            convex = "hull" if points.shape[1] <= MOST_HULL_DIMENSIONS else "pcha"
            how = "kernel" if in_kernel < CONVEX else convex if convexity >= CONVEX else "parts"
        parts = tuple(find_convex_parts(points, members)) if how == "parts" else whole
        if not parts:
            how, parts = "kernel", whole
        found.append(ShapedCluster(ClusterShape(label, convexity, in_kernel, how, len(parts)), parts))
    return tuple(found)


def require_archetype_method(method: str) -> None:
    """Refuse a method that there is not.

    Parameters
    ----------
    method : str
        Its name.

    Raises
    ------
    InputError
        There is no such method.
    """
    if method not in get_args(ArchetypeMethod):
        raise InputError(f"`archetypes_by` {method}: {suggestion(method, get_args(ArchetypeMethod))}")


def divide_fairly(count: int, weights: Sequence[float]) -> list[int]:
    """Divide a number into whole numbers in proportion to weights.

    Parameters
    ----------
    count : int
        Number to divide.
    weights : sequence of float
        One for each part.

    Returns
    -------
    list of int
        Its sum is `count`; the remainders are given to the largest fractions.
    """
    if not len(weights):
        return []
    share = count * np.asarray(weights, dtype=np.float64) / np.sum(weights)
    each = np.floor(share).astype(np.int64)
    each[np.argsort(each - share, kind="stable")[: count - int(each.sum())]] += 1
    return [int(number) for number in each]
