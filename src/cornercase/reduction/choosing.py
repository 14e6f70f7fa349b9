"""The choice of a reduced set, made the same way of all scenarios or of a part of them."""

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
    """How many scenarios are to be kept, and of what kind; one of the first three is given.

    Attributes
    ----------
    size : int or None
        Number of scenarios.
    cover : float or None
        Largest distance that is left, as a share of the largest one.
    archetypes : int, "auto" or None
        Archetypes of each cluster, beside its prototype.
    archetypes_by : {"auto", "hull", "pcha", "parts", "kernel"}
        How they are found.
    """

    size: int | None
    cover: float | None
    archetypes: int | Literal["auto"] | None
    archetypes_by: ArchetypeMethod


@dataclass(frozen=True, eq=False)
class Material:
    """Scenarios to choose from.

    Attributes
    ----------
    points : ndarray of float64, shape (n, d)
        Parameters in the unit cube.
    distances : sequence of ndarray of float64, each (n, n), or of PlacedDistances
        Of all clusterings; the first is that of `labels`.
    labels : ndarray of int64, shape (n,)
        -1 is noise.
    embedding : ndarray of float64, shape (n, e)
        Kernel space of the clustering.
    critical : sequence of int
        Critical clusters.
    exposed : ndarray of bool, shape (n, m), optional
        Which of them expose which mutants of the driver, for these to choose first.
    """

    points: FloatArray
    distances: Sequence[Distances]
    labels: IntArray
    embedding: FloatArray
    critical: Sequence[int]
    exposed: BoolArray | None = None

    def part(self, rows: IntArray) -> Material:
        """Return a part of the scenarios.

        Parameters
        ----------
        rows : ndarray of int64, shape (m,)
            Indices.

        Returns
        -------
        Material
            The clusters are those of all.
        """
        return Material(
            self.points[rows],
            [part_of(one, rows, rows) for one in self.distances],
            self.labels[rows],
            self.embedding[rows],
            self.critical,
            None if self.exposed is None else self.exposed[rows],
        )


def choose(material: Material, wish: Wish) -> tuple[tuple[Kept, ...], tuple[ShapedCluster, ...]]:
    """Choose scenarios.

    Parameters
    ----------
    material : Material
        The scenarios.
    wish : Wish
        How many, and of what kind.

    Returns
    -------
    kept : tuple of Kept
        In the order in which they were chosen.
    shaped : tuple of ShapedCluster
        How archetypes were found for each cluster.
    """
    points, labels = material.points, material.labels
    shaped = find_shapes(points, labels, material.embedding, wish.archetypes_by)
    if wish.archetypes is not None:
        kept = choose_by_cluster(points, material.distances[0], labels, archetypes=wish.archetypes, shaped=shaped)
    else:
        kept = choose_scenarios(
            points, material.distances, labels, material.critical, size=wish.size, cover=wish.cover, shaped=shaped
        )
    if material.exposed is not None:
        kept = _exposing_first(material, kept)
    return kept, shaped


def _exposing_first(material: Material, others: Sequence[Kept]) -> tuple[Kept, ...]:
    """Choose as many scenarios, first those that expose mutants, then the first of the others."""
    assert material.exposed is not None
    distances, labels = material.distances, material.labels
    found = Selection(distances, len(others))
    for index in choose_exposing(material.exposed, found.apart, len(others)):
        found.keep(Kept(index, int(labels[index]), "exposing"))
    for one in others:
        found.keep(one)
    return tuple(found.kept)


def try_choice(material: Material, wish: Wish) -> list[Trial]:
    """Choose in the same way from parts of the scenarios, for the others to judge.

    The clusters stay those of all scenarios: that the others had a part in finding them is not left out.

    Parameters
    ----------
    material : Material
        The scenarios.
    wish : Wish
        How many, and of what kind.

    Returns
    -------
    list of Trial
        By index; as many as `cornercase.reduction.held_out.divide` gives parts.
    """
    everyone = np.arange(len(material.labels))
    trials = []
    parts = list(divide(len(everyone)))
    with step(len(parts), "choosing", "sets, to judge the choice") as tell:
        for judging in parts:
            rows = np.setdiff1d(everyone, judging)
            kept, _ = choose(material.part(rows), wish)
            trials.append(Trial(rows, rows[[one.index for one in kept]], judging))
            tell(len(trials))
    return trials
