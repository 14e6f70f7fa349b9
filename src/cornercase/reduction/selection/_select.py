"""Selection of a reduced set, from all scenarios or from the training part of a cross-validation fold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cornercase._common.progress import progress_step
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.clustering._embedding import Distances
from cornercase.reduction._cluster_shapes import ArchetypeMethod, ShapedCluster, classify_cluster_shapes
from cornercase.reduction._held_out_coverage import Fold, draw_folds
from cornercase.reduction._mutant_selection import select_killing
from cornercase.reduction._random_selections import submatrix
from cornercase.reduction._selection_state import Selected, Selection
from cornercase.reduction.selection._greedy import select_scenarios
from cornercase.reduction.selection._per_cluster import select_per_cluster


@dataclass(frozen=True)
class SelectionRequest:
    """Requested size of a reduced set: exactly one of `size`, `cover` and `archetypes` is given.

    `size` is the number of scenarios. With `cover`, scenarios are selected until every scenario has a selected one
    within this share of the largest distance of any two scenarios. `archetypes` is the number of archetypes (extreme
    scenarios) per cluster, besides the prototype. `archetypes_by` is the method that finds archetypes.
    """

    size: int | None
    cover: float | None
    archetypes: int | Literal["auto"] | None
    archetypes_by: ArchetypeMethod


@dataclass(frozen=True, eq=False)
class SelectionInput:
    """Scenarios to select from.

    `points`, shape (n, d), are in the unit cube. `distances` belong to all clusterings. `labels`, `embedding` and
    `critical_clusters` belong to the first clustering. `is_critical`, shape (n,), marks critical scenarios. `kills`,
    shape (n, m), says which scenario kills which mutant; None if mutants do not take part in the selection.
    """

    points: FloatArray
    distances: Sequence[Distances]
    labels: IntArray
    embedding: FloatArray
    critical_clusters: Sequence[int]
    is_critical: BoolArray
    kills: BoolArray | None = None

    def subset(self, rows: IntArray) -> SelectionInput:
        """Return the scenarios `rows`; they keep the cluster labels that were computed with all scenarios."""
        return SelectionInput(
            self.points[rows],
            [submatrix(matrix, rows, rows) for matrix in self.distances],
            self.labels[rows],
            self.embedding[rows],
            self.critical_clusters,
            self.is_critical[rows],
            None if self.kills is None else self.kills[rows],
        )


def select_reduced_set(
    selection_input: SelectionInput, request: SelectionRequest
) -> tuple[tuple[Selected, ...], tuple[ShapedCluster, ...]]:
    """Select scenarios for a reduced set, in order.

    Also returns the shape of each cluster, with the method that found its archetypes.
    """
    points, labels = selection_input.points, selection_input.labels
    shaped = classify_cluster_shapes(points, labels, selection_input.embedding, request.archetypes_by)
    if request.archetypes is not None:
        selected = select_per_cluster(
            points, selection_input.distances[0], labels, archetypes=request.archetypes, shaped_clusters=shaped
        )
    else:
        selected = select_scenarios(
            points,
            selection_input.distances,
            labels,
            selection_input.critical_clusters,
            selection_input.is_critical,
            size=request.size,
            cover=request.cover,
            shaped_clusters=shaped,
        )
    selected = _put_critical_first(selection_input, selected)
    if selection_input.kills is not None:
        selected = _put_killing_first(selection_input, selected)
    return selected, shaped


def _put_critical_first(selection_input: SelectionInput, selected: Sequence[Selected]) -> tuple[Selected, ...]:
    """Sort scenarios: critical prototypes and archetypes first, then other prototypes and archetypes, then the rest."""
    is_critical = selection_input.is_critical
    if not is_critical.any():
        return tuple(selected)
    return tuple(sorted(selected, key=lambda entry: 2 if entry.role == "gap" else 0 if is_critical[entry.index] else 1))


def _put_killing_first(selection_input: SelectionInput, selected: Sequence[Selected]) -> tuple[Selected, ...]:
    """Put scenarios that kill mutants of the driver first; at most as many scenarios as before are kept.

    Scenarios similar to one that kills mutants are dropped, then the last ones.
    """
    assert selection_input.kills is not None
    distances, labels = selection_input.distances, selection_input.labels
    selection = Selection(distances, len(selected))
    for index in select_killing(selection_input.kills, selection.distances_to, len(selected)):
        selection.add(Selected(index, int(labels[index]), "exposing"))
    for candidate in selected:
        selection.add(candidate)
    return tuple(selection.selected)


def cross_validate(selection_input: SelectionInput, request: SelectionRequest) -> list[Fold]:
    """Cross-validate the selection: for each fold, select a set from the scenarios outside of the fold.

    The clusters of all scenarios are used for every fold, so held-out scenarios have influenced the clusters.
    """
    indices = np.arange(len(selection_input.labels))
    folds = []
    parts = list(draw_folds(len(indices)))
    with progress_step(len(parts), "choosing", "sets, to judge the choice") as update_progress:
        for held_out in parts:
            rows = np.setdiff1d(indices, held_out)
            selected, _ = select_reduced_set(selection_input.subset(rows), request)
            folds.append(Fold(rows, rows[[scenario.index for scenario in selected]], held_out))
            update_progress(len(folds))
    return folds
