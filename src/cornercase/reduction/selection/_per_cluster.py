"""Selection of the prototype and the archetypes (extreme scenarios) of each cluster, as in the paper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from cornercase._common.errors import InputError
from cornercase.clustering._embedding import EmbeddedDistances
from cornercase.reduction._archetypal_analysis import MAX_ARCHETYPES
from cornercase.reduction._cluster_shapes import ShapedCluster, classify_cluster_shapes
from cornercase.reduction._medoids import find_prototype
from cornercase.reduction._selection_state import Selected

SCENARIOS_PER_SELECTED: Final = 10
"""Number of scenarios for each selected scenario, in the paper that cornercase follows and by default."""


def select_per_cluster(
    points: npt.ArrayLike,
    distances: npt.ArrayLike | EmbeddedDistances,
    labels: npt.ArrayLike,
    *,
    archetypes: int | Literal["auto"] = "auto",
    shaped_clusters: Sequence[ShapedCluster] | None = None,
) -> tuple[Selected, ...]:
    """Select the prototype and at most `archetypes` archetypes of each cluster; noise is left out.

    This is the selection of the paper that cornercase follows. A prototype is the most central scenario of a cluster,
    archetypes are extreme scenarios. ``"auto"`` selects about a tenth of all scenarios, including prototypes:
    ``n // (10 * clusters) - 1`` archetypes per cluster. But it allows at least d + 1 archetypes per cluster, since
    fewer points in d dimensions span a flat hull, and at most 15, as in the paper. For each cluster, the prototype
    comes first, then the archetypes by index. No scenario is selected twice, since the prototype is not a candidate for
    an archetype. `points`, shape (n, d), are in the unit cube. By default, archetypes are corners of the convex hull of
    each cluster; `shaped_clusters` can name other methods.
    """
    points = np.asarray(points, dtype=np.float64)
    distances = distances if isinstance(distances, EmbeddedDistances) else np.asarray(distances, dtype=np.float64)
    label_array = np.asarray(labels, dtype=np.int64)
    n = len(label_array)
    if points.ndim != 2 or len(points) != n or distances.shape != (n, n):
        raise InputError(
            f"There are {n} labels, points of shape {points.shape} and distances of shape {distances.shape}; "
            "give all for the same scenarios."
        )
    clusters = (
        classify_cluster_shapes(points, label_array, method="hull") if shaped_clusters is None else shaped_clusters
    )
    if archetypes == "auto":
        fewest = min(points.shape[1] + 1, MAX_ARCHETYPES)
        max_archetypes = int(np.clip(n // (SCENARIOS_PER_SELECTED * max(1, len(clusters))) - 1, fewest, MAX_ARCHETYPES))
    elif isinstance(archetypes, (int, np.integer)) and not isinstance(archetypes, bool) and archetypes >= 1:
        max_archetypes = int(archetypes)
    else:
        raise InputError(f"`archetypes` {archetypes!r}: give a whole number of at least 1, or 'auto'.")

    selected: list[Selected] = []
    for cluster in clusters:
        prototype = find_prototype(distances, np.flatnonzero(label_array == cluster.shape.cluster))
        selected.append(Selected(prototype, cluster.shape.cluster, "prototype"))
        # A scenario with the parameters of the prototype would add nothing.
        others = [part[(points[part] != points[prototype]).any(axis=1)] for part in cluster.parts]
        remaining = replace(cluster, parts=tuple(part for part in others if len(part)))
        if remaining.parts:
            corners = remaining.find_archetypes(points, distances, max_archetypes)
            selected.extend(Selected(index, cluster.shape.cluster, "archetype") for index in corners.tolist())
    return tuple(selected)
