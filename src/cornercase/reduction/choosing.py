"""Selection of a reduced set, from all scenarios or from the training part of a fold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cornercase._common.progress import step
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.clustering import Distances
from cornercase.reduction.cluster_selection import choose_by_cluster
from cornercase.reduction.cluster_shapes import ArchetypeMethod, ShapedCluster, find_shapes
from cornercase.reduction.draws import part_of
from cornercase.reduction.exposing import choose_exposing
from cornercase.reduction.held_out import Trial, divide
from cornercase.reduction.kept import Kept, Selection
from cornercase.reduction.selection import choose_scenarios


@dataclass(frozen=True)
class Wish:
    """How many scenarios to select, and of what role; one of `size`, `cover` and `archetypes` is given.

    `cover` is the largest distance left, as a share of the largest one; `archetypes` is the number per cluster, besides
    its prototype, and `archetypes_by` how they are found.
    """

    size: int | None
    cover: float | None
    archetypes: int | Literal["auto"] | None
    archetypes_by: ArchetypeMethod


@dataclass(frozen=True, eq=False)
class Material:
    """Scenarios to select from.

    `points`, shape (n, d), are in the unit cube; `distances` are those of all clusterings; `labels`, `embedding` and
    `critical_clusters` belong to the first; `kills`, shape (n, m), says which scenario kills which mutant, if mutants
    select first.
    """

    points: FloatArray
    distances: Sequence[Distances]
    labels: IntArray
    embedding: FloatArray
    critical: Sequence[int]
    exposed: BoolArray | None = None

    def part(self, rows: IntArray) -> Material:
        """Return some of the scenarios; the clusters remain those of all."""
        return Material(
            self.points[rows],
            [part_of(matrix, rows, rows) for matrix in self.distances],
            self.labels[rows],
            self.embedding[rows],
            self.critical,
            None if self.exposed is None else self.exposed[rows],
        )


def choose(material: Material, wish: Wish) -> tuple[tuple[Kept, ...], tuple[ShapedCluster, ...]]:
    """Select scenarios; return them in order, and how archetypes were found for each cluster."""
    points, labels = material.points, material.labels
    shaped = find_shapes(points, labels, material.embedding, wish.archetypes_by)
    if wish.archetypes is not None:
        selected = choose_by_cluster(points, material.distances[0], labels, archetypes=wish.archetypes, shaped=shaped)
    else:
        selected = choose_scenarios(
            points, material.distances, labels, material.critical, size=wish.size, cover=wish.cover, shaped=shaped
        )
    if material.exposed is not None:
        selected = _exposing_first(material, selected)
    return selected, shaped


def _exposing_first(material: Material, others: Sequence[Kept]) -> tuple[Kept, ...]:
    """Replace the last scenarios by ones that kill mutants, which come first."""
    assert material.exposed is not None
    distances, labels = material.distances, material.labels
    selection = Selection(distances, len(others))
    for index in choose_exposing(material.exposed, selection.apart, len(others)):
        selection.keep(Kept(index, int(labels[index]), "exposing"))
    for candidate in others:
        selection.keep(candidate)
    return tuple(selection.kept)


def try_choice(material: Material, wish: Wish) -> list[Trial]:
    """Cross-validate the selection.

    Clusters are not recomputed per fold, so held-out scenarios have influenced them.
    """
    indices = np.arange(len(material.labels))
    folds = []
    parts = list(divide(len(indices)))
    with step(len(parts), "choosing", "sets, to judge the choice") as update_progress:
        for judging in parts:
            rows = np.setdiff1d(indices, judging)
            selected, _ = choose(material.part(rows), wish)
            folds.append(Trial(rows, rows[[scenario.index for scenario in selected]], judging))
            update_progress(len(folds))
    return folds
