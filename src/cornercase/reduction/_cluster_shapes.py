"""Shapes of clusters, which determine the method that finds the archetypes (extreme scenarios) of each cluster."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering._embedding import Distances, EmbeddedDistances
from cornercase.reduction._archetypal_analysis import find_archetypes, find_kernel_archetypes, pick_evenly_spaced
from cornercase.reduction._convexity import MIN_CONVEXITY, measure_convexity, split_into_convex_parts
from cornercase.reduction._hulls import MAX_HULL_DIMENSIONS, find_hull_archetypes

ArchetypeMethod = Literal["auto", "hull", "pcha", "parts", "kernel"]
"""Method that finds archetypes (extreme scenarios); ``"auto"`` chooses by the convexity of each cluster."""


@dataclass(frozen=True)
class ClusterShape:
    """Shape of a cluster, and the method that finds its archetypes (extreme scenarios).

    Attributes
    ----------
    cluster : int
    convexity : float
        Convexity in the parameter space, 0 to 1, as in `cornercase.reduction._convexity.measure_convexity`.
    kernel_convexity : float
        Convexity in the kernel space of the distances; NaN if unknown.
    method : {"hull", "pcha", "parts", "kernel"}
        ``"hull"``: corners of the convex hull in the parameter space. ``"pcha"``: archetypal analysis in the parameter
        space. ``"parts"``: corners of the hulls of near-convex parts in the parameter space. ``"kernel"``: archetypal
        analysis in kernel space.
    parts : int
        Number of near-convex parts; 1 except for ``"parts"``.

    Examples
    --------
    >>> import cornercase as cc
    >>> for shape in cc.reduce("study.db", "reduced", size=10).shapes:  # doctest: +SKIP
    ...     print(f"cluster {shape.cluster}: convexity {shape.convexity:.2f}, archetypes by {shape.method}")
    cluster 0: convexity 0.99, archetypes by hull
    cluster 1: convexity 0.97, archetypes by hull
    """

    cluster: int
    convexity: float
    kernel_convexity: float
    method: str
    parts: int


@dataclass(frozen=True, eq=False)
class ShapedCluster:
    """A cluster with its shape.

    `parts` are the indices of the scenarios in each near-convex part of the cluster. There is a single part, except for
    the method ``"parts"``.
    """

    shape: ClusterShape
    parts: tuple[IntArray, ...]

    def find_archetypes(self, points: FloatArray, distances: Distances, max_count: int) -> IntArray:
        """Return the indices of at most `max_count` extreme scenarios of the cluster.

        If the cluster has several parts, the number is divided among them in proportion to their sizes.
        """
        (whole, *more) = self.parts
        if self.shape.method in ("kernel", "pcha") and isinstance(distances, EmbeddedDistances):
            whole = pick_evenly_spaced(whole)
        if self.shape.method == "kernel":
            return whole[find_kernel_archetypes(distances[np.ix_(whole, whole)], max_count).indices]
        if self.shape.method == "pcha":
            return whole[find_archetypes(points[whole], max_k=max_count).indices]
        if not more:
            return whole[find_hull_archetypes(points[whole], max_count)]
        numbers = divide_in_proportion(max_count, [len(part) for part in self.parts])
        indices = [
            part[find_hull_archetypes(points[part], number)]
            for part, number in zip(self.parts, numbers, strict=True)
            if number
        ]
        return np.sort(np.concatenate(indices))


def classify_cluster_shapes(
    points: FloatArray, labels: IntArray, embedding: FloatArray | None = None, method: ArchetypeMethod = "auto"
) -> tuple[ShapedCluster, ...]:
    """Measure the shape of each cluster, and choose the method that finds its archetypes, cluster 0 first.

    With ``"auto"`` the method depends on the convexity. A cluster that is not convex in kernel space (convexity below
    0.8) gets ``"kernel"``. A cluster that is convex in both spaces gets ``"hull"``, or ``"pcha"`` with more than six
    parameters. A cluster that is not convex in the parameter space gets ``"parts"``, or ``"kernel"`` if six parts are
    not enough. `points`, shape (n, d), are in the parameter space. `embedding`, shape (n, e), has coordinates in the
    kernel space of the clustering. Without `embedding`, clusters count as convex in kernel space.
    """
    require_archetype_method(method)
    shaped = []
    for label in np.unique(labels[labels >= 0]).tolist():
        members = labels == label
        whole = (np.flatnonzero(members),)
        convexity = measure_convexity(points, members)
        kernel_convexity = float("nan") if embedding is None else measure_convexity(embedding, members)
        chosen_method: str = method
        if method == "auto":
            convex = "hull" if points.shape[1] <= MAX_HULL_DIMENSIONS else "pcha"
            chosen_method = (
                "kernel" if kernel_convexity < MIN_CONVEXITY else convex if convexity >= MIN_CONVEXITY else "parts"
            )
        parts = tuple(split_into_convex_parts(points, members)) if chosen_method == "parts" else whole
        if not parts:
            chosen_method, parts = "kernel", whole
        shaped.append(ShapedCluster(ClusterShape(label, convexity, kernel_convexity, chosen_method, len(parts)), parts))
    return tuple(shaped)


def require_archetype_method(method: str) -> None:
    """Raise `InputError` unless `method` is one of the methods for finding archetypes."""
    if method not in get_args(ArchetypeMethod):
        raise InputError(f"`archetypes_by` {method}: {suggest_name(method, get_args(ArchetypeMethod))}")


def divide_in_proportion(total: int, weights: Sequence[float]) -> list[int]:
    """Divide `total` into whole numbers in proportion to weights, by the method of largest remainders."""
    if not len(weights):
        return []
    share = total * np.asarray(weights, dtype=np.float64) / np.sum(weights)
    whole_numbers = np.floor(share).astype(np.int64)
    whole_numbers[np.argsort(whole_numbers - share, kind="stable")[: total - int(whole_numbers.sum())]] += 1
    return [int(number) for number in whole_numbers]
