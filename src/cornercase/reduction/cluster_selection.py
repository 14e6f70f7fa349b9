"""Prototype and archetypes of each cluster, as in the paper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from cornercase._common.errors import InputError
from cornercase.clustering import PlacedDistances
from cornercase.reduction.archetypal_analysis import MOST_ARCHETYPES
from cornercase.reduction.cluster_shapes import ShapedCluster, find_shapes
from cornercase.reduction.kept import Kept
from cornercase.reduction.medoids import find_prototype

PER_KEPT: Final = 10
"""One scenario of so many is kept, in the paper and by default."""


def choose_by_cluster(
    points: npt.ArrayLike,
    distances: npt.ArrayLike | PlacedDistances,
    labels: npt.ArrayLike,
    *,
    archetypes: int | Literal["auto"] = "auto",
    shaped: Sequence[ShapedCluster] | None = None,
) -> tuple[Kept, ...]:
    """Choose the scenarios that represent the clusters, as the paper does.

    Parameters
    ----------
    points : array_like, shape (n, d)
        Parameters of the scenarios in the unit cube.
    distances : array_like, shape (n, n), or PlacedDistances
        Distances by which the scenarios were clustered.
    labels : array_like of int, shape (n,)
        Cluster of each scenario; -1 is noise, of which none is kept.
    archetypes : int or "auto"
        Most archetypes of each cluster. ``"auto"`` keeps about a tenth of all scenarios, prototypes included:
        ``n // (10 * clusters) - 1``, but at least d + 1, as a hull of fewer is flat, and at most 15, as the paper.
    shaped : sequence of ShapedCluster, optional
        How archetypes are found for each cluster, as in `cornercase.reduction.cluster_shapes.find_shapes`; by the
        paper's hulls by default.

    Returns
    -------
    tuple of Kept
        By cluster, the prototype first, then the archetypes by index. No scenario is there twice: one that is
        prototype and archetype counts as the prototype, and the hull of the others gives the archetypes.

    Raises
    ------
    InputError
        The numbers of scenarios differ, or `archetypes` is not positive.
    """
    points = np.asarray(points, dtype=np.float64)
    distances = distances if isinstance(distances, PlacedDistances) else np.asarray(distances, dtype=np.float64)
    names = np.asarray(labels, dtype=np.int64)
    n = len(names)
    if points.ndim != 2 or len(points) != n or distances.shape != (n, n):
        raise InputError(
            f"There are {n} labels, points of shape {points.shape} and distances of shape {distances.shape}; "
            "give all for the same scenarios."
        )
    found = find_shapes(points, names, method="hull") if shaped is None else shaped
    if archetypes == "auto":
        lowest = min(points.shape[1] + 1, MOST_ARCHETYPES)
        most = int(np.clip(n // (PER_KEPT * max(1, len(found))) - 1, lowest, MOST_ARCHETYPES))
    elif isinstance(archetypes, (int, np.integer)) and not isinstance(archetypes, bool) and archetypes >= 1:
        most = int(archetypes)
    else:
        raise InputError(f"`archetypes` {archetypes!r}: give a whole number of at least 1, or 'auto'.")

    kept: list[Kept] = []
    for one in found:
        middle = find_prototype(distances, np.flatnonzero(names == one.shape.cluster))
        kept.append(Kept(middle, one.shape.cluster, "prototype"))
        # A scenario with the same parameters as the prototype would add nothing to it.
        others = [part[(points[part] != points[middle]).any(axis=1)] for part in one.parts]
        rest = replace(one, parts=tuple(part for part in others if len(part)))
        if rest.parts:
            corners = rest.archetypes(points, distances, most)
            kept.extend(Kept(index, one.shape.cluster, "archetype") for index in corners.tolist())
    return tuple(kept)
