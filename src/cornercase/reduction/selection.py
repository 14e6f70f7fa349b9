"""Greedy selection: scenarios that represent the clusters, then those that these leave uncovered."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering import Distances
from cornercase.reduction.cluster_shapes import ShapedCluster, divide_fairly, find_shapes
from cornercase.reduction.gap_sums import Composition, GapSums
from cornercase.reduction.kept import Kept, Selection
from cornercase.reduction.medoids import find_prototype
from cornercase.reduction.rivals import Rivals

_MOST_EXCHANGED: Final = 2000

# Each is best for some studies; the first one that beats the baselines is taken.
_COMPOSITIONS: Final = (
    Composition(0.2, 4.0, 2.0, 3),
    Composition(0.1, 6.0, 1.0, 3),
    Composition(0.1, 6.0, 4.0, 3),
    Composition(0.1, 6.0, 4.0, 2),
)


def choose_scenarios(
    points: FloatArray,
    distances: Sequence[Distances],
    labels: IntArray,
    critical: Sequence[int] = (),
    *,
    size: int | None = None,
    cover: float | None = None,
    shaped: Sequence[ShapedCluster] | None = None,
) -> tuple[Kept, ...]:
    """Select scenarios that represent the clusters, then scenarios that these leave uncovered.

    A set of a given size begins with the prototype of each cluster, critical clusters first. Then come archetypes, up
    to a fifth of the set, divided among clusters in proportion to the root of their size, four times as many if
    critical. All others minimise the sum over all scenarios of the cubed distance to the nearest selected one, over all
    clusterings, in units of the usual distance between neighbours in a set of this size. The cube gives large gaps more
    weight than many small ones. Scenarios of critical clusters count four times, the first clustering twice. Scenarios
    are added greedily (G. L. Nemhauser, L. A. Wolsey, M. L. Fisher, "An analysis of approximations for maximizing
    submodular set functions", 1978); then, with up to 2,000 scenarios, each is exchanged for another one if that lowers
    the sum.

    The set is compared with 100 random selections in each clustering, by the largest and the mean distance to the
    nearest selected scenario, and in the critical clusters with k-medoids of the first clustering. If it is not better
    than 95 of the random selections, or is worse than k-medoids, other shares and weights are tried, four in all, and
    the set with the smallest shortfall is taken; with up to 2,000 scenarios.

    With `cover` instead of `size`, the scenario least similar to all selected ones is added until none is farther than
    this share of the largest distance, in each clustering (farthest-first traversal: T. F. Gonzalez, "Clustering to
    minimize the maximum intercluster distance", 1985).

    No scenario is selected that is similar to a selected one: at most 0.001 of the largest distance away in each
    clustering. `points`, shape (n, d), are in the unit cube; `distances` are those of all clusterings, `labels` those
    of the first; `shaped_clusters` defaults to `classify_cluster_shapes`.
    """
    if (size is None) == (cover is None):
        raise InputError("`size`, `cover`: give one of them.")
    if size is not None and size < 1:
        raise InputError(f"`size` {size}: selects nothing; give 1 or more.")
    if cover is not None and not 0.0 < cover <= 1.0:
        raise InputError(f"`cover` {cover:g}: give a number above 0 and up to 1.")
    clusters = [int(label) for label in np.unique(labels) if label >= 0]
    clusters.sort(key=lambda label: (label not in critical, label))
    base = Selection(distances, size)
    for label in clusters:
        base.keep(Kept(find_prototype(distances[0], np.flatnonzero(labels == label)), label, "prototype"))
    if not clusters:
        medoid = find_prototype(distances[0], np.arange(len(labels)))
        base.keep(Kept(medoid, int(labels[medoid]), "gap"))
    if size is None:
        assert cover is not None
        # Archetypes are left out, since a coverage is to be reached with as few scenarios as possible.
        while base.gap.max() > cover:
            farthest = int(base.gap.argmax())
            base.keep(Kept(farthest, int(labels[farthest]), "gap"))
        return tuple(base.kept)
    shapes = {cluster.shape.cluster: cluster for cluster in (find_shapes(points, labels) if shaped is None else shaped)}
    task = _Task(points, distances, labels, critical, clusters, shapes, size)
    baselines = Rivals(distances, labels, critical, size) if len(labels) <= _MOST_EXCHANGED else None
    best, smallest_shortfall = base.kept, np.inf
    for composition in _COMPOSITIONS:
        completed = task.completed(base, composition)
        shortfall = baselines.shortfall(completed.indices) if baselines else 0.0
        if shortfall < smallest_shortfall:
            best, smallest_shortfall = completed.kept, shortfall
        if shortfall == 0.0:
            break
    return tuple(best)


@dataclass(frozen=True, eq=False)
class _Task:
    """The scenarios to select from, and the number to select."""

    points: FloatArray
    distances: Sequence[Distances]
    labels: IntArray
    critical: Sequence[int]
    clusters: Sequence[int]
    known: Mapping[int, ShapedCluster]
    size: int

    def completed(self, start: Selection, composition: Composition) -> Selection:
        """Return a copy of a selection, completed by archetypes and by what these leave uncovered."""
        selection = start.copy()
        labels = self.labels
        factors = [composition.critical if label in self.critical else 1.0 for label in self.clusters]
        weights = [
            factor * np.sqrt((labels == label).sum()) for factor, label in zip(factors, self.clusters, strict=True)
        ]
        numbers = divide_fairly(int(composition.archetypes * self.size), weights)
        for label, number in zip(self.clusters, numbers, strict=True):
            extremes = self.known[label].archetypes(self.points, self.distances[0], number).tolist() if number else ()
            for index in extremes:
                selection.keep(Kept(index, label, "archetype"))
        self._fill(selection, composition)
        return selection

    def _fill(self, chosen: Selection, composition: Composition) -> None:
        """Add scenarios that minimise the sum until there are enough."""
        n_fixed = len(chosen.kept)
        sums = GapSums(self.distances, np.isin(self.labels, self.critical), composition, self.size)
        for index in sums.added(chosen.indices, self.size, chosen):
            chosen.keep(Kept(index, int(self.labels[index]), "gap"))
        if len(self.labels) <= _MOST_EXCHANGED:
            indices = sums.exchanged(chosen.indices, n_fixed, chosen)
            chosen.kept[n_fixed:] = [Kept(index, int(self.labels[index]), "gap") for index in indices[n_fixed:]]
