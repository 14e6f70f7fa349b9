"""Greedy selection: scenarios that represent the clusters, then scenarios far from all scenarios selected before."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.clustering._embedding import Distances
from cornercase.reduction._baselines import Baselines
from cornercase.reduction._cluster_shapes import ShapedCluster, classify_cluster_shapes, divide_in_proportion
from cornercase.reduction._coverage_sums import MAX_IN_MEMORY, CoverageSums, SetComposition
from cornercase.reduction._medoids import find_prototype
from cornercase.reduction._random_selections import submatrix
from cornercase.reduction._selection_state import SIMILAR_SHARE, Selected, Selection

_MAX_EXCHANGED: Final = 2000
# While few scenarios are selected, each candidate is the nearest one for very many others, which takes most of the
# time. So with more scenarios than this, only every fourth is a candidate until this share of all is selected.
_SAMPLED_FROM: Final = 16_000
_SAMPLED_PART: Final = 4
_FIRST_SHARE: Final = 1.0 / 32.0

# Each composition is best for some studies; the first composition that beats the baselines is taken.
_COMPOSITIONS: Final = (
    SetComposition(0.2, 4.0, 2.0, 3),
    SetComposition(0.1, 6.0, 1.0, 3),
    SetComposition(0.1, 6.0, 4.0, 3),
    SetComposition(0.1, 6.0, 4.0, 2),
)


def select_scenarios(
    points: FloatArray,
    distances: Sequence[Distances],
    labels: IntArray,
    critical_clusters: Sequence[int] = (),
    is_critical: BoolArray | None = None,
    *,
    size: int | None = None,
    cover: float | None = None,
    shaped_clusters: Sequence[ShapedCluster] | None = None,
    sampled_from: int = _SAMPLED_FROM,
    max_in_memory: int = MAX_IN_MEMORY,
) -> tuple[Selected, ...]:
    """Select scenarios that represent the clusters, then scenarios that are far from these.

    First, each cluster with critical scenarios contributes one of them: its prototype (most central scenario), or the
    medoid of its critical scenarios if the prototype is not critical. Critical clusters come first, then clusters with
    the most critical scenarios. Second, all other prototypes follow, first those of clusters without a critical
    scenario. Third, archetypes (extreme scenarios) fill up to a fifth of the set. Each cluster contributes archetypes
    in proportion to the square root of its size; critical clusters have four times the weight.

    Last, scenarios are added that minimise a sum over all scenarios and all clusterings. The terms are cubed distances
    to the nearest selected scenario, divided by the usual distance between neighbours in a set of this size. Due to the
    cube, one large gap counts more than many small ones. Scenarios of critical clusters count four times, the first
    clustering twice. Scenarios are added greedily (G. L. Nemhauser, L. A. Wolsey, M. L. Fisher, "An analysis of
    approximations for maximizing submodular set functions", 1978). If there are more than `sampled_from` scenarios,
    only every fourth is a candidate until a 32nd of all scenarios is selected. If there are at most 2,000 scenarios,
    each scenario added in this step is then exchanged for another one if the exchange lowers the sum.

    If there are at most 2,000 scenarios, the set is also compared with two baselines by the largest and the mean
    distance to the nearest selected scenario. In each clustering, it should be better than 95 of 100 random selections.
    In the critical clusters of the first clustering, it should not be worse than k-medoids. If it fails, up to three
    other combinations of the shares and weights above are tried. The set that falls least short is returned.

    With `cover` instead of `size`, scenarios are added to the prototypes until every scenario is near a selected one:
    at most `cover` times the largest distance away, in each clustering. Each time, the scenario least similar to all
    selected ones is added (farthest-first traversal: T. F. Gonzalez, "Clustering to minimize the maximum intercluster
    distance", 1985).

    A scenario is never selected if it is similar to a selected one, which means at most 0.001 of the largest distance
    away in each clustering. `points`, shape (n, d), are in the unit cube. `distances` belong to all clusterings,
    `labels` to the first clustering. By default, `shaped_clusters` are computed by `classify_cluster_shapes`. For
    `max_in_memory` see `CoverageSums`.
    """
    if (size is None) == (cover is None):
        raise InputError("`size`, `cover`: give exactly one of them.")
    if size is not None and size < 1:
        raise InputError(f"`size` {size}: selects nothing; give 1 or more.")
    if cover is not None and not 0.0 < cover <= 1.0:
        raise InputError(f"`cover` {cover:g}: give a number above 0 and up to 1.")
    clusters = [int(label) for label in np.unique(labels) if label >= 0]
    clusters.sort(key=lambda label: (label not in critical_clusters, label))
    base = Selection(distances, size)
    for scenario in _find_prototypes(distances[0], labels, clusters, critical_clusters, is_critical):
        base.add(scenario)
    if not clusters:
        medoid = find_prototype(distances[0], np.arange(len(labels)))
        base.add(Selected(medoid, int(labels[medoid]), "gap"))
    if size is None:
        assert cover is not None
        # Archetypes are left out, since a coverage is to be reached with few scenarios.
        nearest = base.distances_to(base.indices).min(axis=0)
        # Nearer ones are similar, so they are never selected.
        while nearest.max() > max(cover, SIMILAR_SHARE):
            farthest = int(nearest.argmax())
            base.add(Selected(farthest, int(labels[farthest]), "gap"))
            np.minimum(nearest, base.distances_to([farthest])[0], out=nearest)
        return tuple(base.selected)
    shapes = {
        cluster.shape.cluster: cluster
        for cluster in (classify_cluster_shapes(points, labels) if shaped_clusters is None else shaped_clusters)
    }
    task = _SelectionTask(
        points, distances, labels, critical_clusters, clusters, shapes, size, sampled_from, max_in_memory
    )
    baselines = Baselines(distances, labels, critical_clusters, size) if len(labels) <= _MAX_EXCHANGED else None
    best, smallest_shortfall = base.selected, np.inf
    for composition in _COMPOSITIONS:
        completed = task.complete_selection(base, composition)
        shortfall = baselines.measure_shortfall(completed.indices) if baselines else 0.0
        if shortfall < smallest_shortfall:
            best, smallest_shortfall = completed.selected, shortfall
        if shortfall == 0.0:
            break
    return tuple(best)


def _find_prototypes(
    distances: Distances,
    labels: IntArray,
    clusters: Sequence[int],
    critical_clusters: Sequence[int],
    is_critical: BoolArray | None,
) -> list[Selected]:
    """Return the prototypes (most central scenarios) of clusters, those that represent critical scenarios first.

    If the prototype of a cluster is not critical, the medoid of the cluster's critical scenarios is a second prototype.
    Critical scenarios that are noise have a prototype only if no cluster has a critical scenario.
    """
    prototypes = [Selected(find_prototype(distances, np.flatnonzero(labels == k)), k, "prototype") for k in clusters]
    if is_critical is None or not is_critical.any():
        return prototypes
    n_critical = {k: int(is_critical[labels == k].sum()) for k in clusters}
    dangerous = sorted(filter(n_critical.get, clusters), key=lambda k: (k not in critical_clusters, -n_critical[k]))
    critical = []
    for k in dangerous or [-1]:
        prototype = next((entry for entry in prototypes if entry.cluster == k and is_critical[entry.index]), None)
        medoid = find_prototype(distances, np.flatnonzero(is_critical & (labels == k)))
        critical.append(prototype or Selected(medoid, k, "critical prototype"))
    others = [entry for entry in prototypes if entry not in critical]
    return critical + sorted(others, key=lambda entry: n_critical[entry.cluster] > 0)


@dataclass(frozen=True, eq=False)
class _SelectionTask:
    """Input of a selection: the scenarios to select from, their clusters, and the number to select."""

    points: FloatArray
    distances: Sequence[Distances]
    labels: IntArray
    critical_clusters: Sequence[int]
    clusters: Sequence[int]
    shaped_by_cluster: Mapping[int, ShapedCluster]
    size: int
    sampled_from: int
    max_in_memory: int

    def complete_selection(self, base: Selection, composition: SetComposition) -> Selection:
        """Copy the selection `base`, and add archetypes, then scenarios that are far from all selected ones."""
        selection = base.copy()
        labels = self.labels
        factors = [composition.critical_weight if label in self.critical_clusters else 1.0 for label in self.clusters]
        weights = [
            factor * np.sqrt((labels == label).sum()) for factor, label in zip(factors, self.clusters, strict=True)
        ]
        numbers = divide_in_proportion(int(composition.archetype_share * self.size), weights)
        for label, number in zip(self.clusters, numbers, strict=True):
            extremes = (
                self.shaped_by_cluster[label].find_archetypes(self.points, self.distances[0], number).tolist()
                if number
                else ()
            )
            for index in extremes:
                selection.add(Selected(index, label, "archetype"))
        self._add_uncovered(selection, composition)
        return selection

    def _add_uncovered(self, selection: Selection, composition: SetComposition) -> None:
        """Complete the selection with scenarios that minimise the coverage sum (see `CoverageSums`)."""
        n_fixed = len(selection.selected)
        n_first = min(self.size, int(_FIRST_SHARE * len(self.labels)))
        if len(self.labels) > self.sampled_from and n_fixed < n_first:
            self._add_from_sample(selection, composition, n_first)
        is_critical = np.isin(self.labels, self.critical_clusters)
        sums = CoverageSums(self.distances, is_critical, composition, self.size, self.max_in_memory)
        search = sums.start_greedy_search(selection.indices)
        while not selection.is_complete and (best := search.pop_best_candidate()) is not None:
            if selection.add(Selected(best, int(self.labels[best]), "gap")):
                search.add(best)
        if len(self.labels) <= _MAX_EXCHANGED:
            indices = sums.exchange_selected(selection.indices, n_fixed, selection)
            selection.selected[n_fixed:] = [
                Selected(index, int(self.labels[index]), "gap") for index in indices[n_fixed:]
            ]

    def _add_from_sample(self, selection: Selection, composition: SetComposition, size: int) -> None:
        """Add scenarios until `size` scenarios are selected; the candidates are every fourth of all scenarios.

        The added scenarios minimise the coverage sum (see `CoverageSums`) over the candidates.
        """
        rows = np.union1d(np.arange(0, len(self.labels), _SAMPLED_PART), selection.indices)
        sums = CoverageSums(
            [submatrix(matrix, rows, rows) for matrix in self.distances],
            np.isin(self.labels[rows], self.critical_clusters),
            composition,
            size,
            self.max_in_memory,
        )
        search = sums.start_greedy_search(np.searchsorted(rows, selection.indices).tolist())
        while len(selection.selected) < size and (best := search.pop_best_candidate()) is not None:
            index = int(rows[best])
            if selection.add(Selected(index, int(self.labels[index]), "gap")):
                search.add(best)
