"""The few scenarios that represent all: those that represent the clusters, and those that these leave out."""

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

# Each is best for some studies; the first one that leaves less than random choices do is taken.
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
    """Choose scenarios that represent the clusters, and then the scenarios that these leave out.

    A set of a given size begins with the prototype of each cluster, those of critical clusters first. Then come
    archetypes, up to a fifth of the set. Each cluster has a part of them in proportion to the root of its size, four
    times as large where it is critical. All others are chosen for what these leave out in all clusterings together:
    they minimise the sum over all scenarios of the cube of the distance to the nearest kept one. The unit of the
    distance is what is usual in that clustering between neighbours in a set of this size. The cube lets large gaps
    weigh more than many small ones. Scenarios of critical clusters count four times, the first clustering twice. Each
    scenario that is added is the one that lowers the sum most [1]_; then, with up to 2,000 scenarios, each is exchanged
    for another one where that lowers the sum.

    The set is compared with 100 random choices in each clustering, by the largest and the mean distance to the nearest
    kept scenario, and in the critical clusters with k-medoids of the first clustering. Where it is not better than 95
    of the random choices, or worse than k-medoids, other shares and weights are tried, four in all, and the set that
    falls least short is taken; up to 2,000 scenarios. `measure_coverage` grades a set by random choices of its own.

    No scenario is kept that is like a kept one: with a distance of at most 0.001 of the largest, in each clustering.

    Parameters
    ----------
    points : ndarray of float64, shape (n, d)
        Parameters in the unit cube.
    distances : sequence of ndarray of float64, each of shape (n, n), or of PlacedDistances
        Of all clusterings; the first is that of `labels`.
    labels : ndarray of int64, shape (n,)
        -1 is noise.
    critical : sequence of int
        Clusters that are critical.
    size : int, optional
        Number of scenarios to keep, at least one; fewer are kept only where no others differ.
    cover : float, optional
        Instead of `size`: keep as few as leave no scenario farther from a kept one than this share of the largest
        distance, in each clustering; above 0 and up to 1. After the prototypes, the scenario that is least like all
        kept ones is added again and again (farthest-first traversal [2]_).
    shaped : sequence of ShapedCluster, optional
        How archetypes are found for each cluster, as in `cornercase.reduction.cluster_shapes.find_shapes`; by its
        convexity by default.

    Returns
    -------
    tuple of Kept
        In the order in which they were chosen.

    Raises
    ------
    InputError
        Neither or both of `size` and `cover` are given, or one is out of range.

    References
    ----------
    .. [1] G. L. Nemhauser, L. A. Wolsey, M. L. Fisher, "An analysis of approximations for maximizing submodular set
       functions", 1978.
    .. [2] T. F. Gonzalez, "Clustering to minimize the maximum intercluster distance", 1985.
    """
    if (size is None) == (cover is None):
        raise InputError("`size`, `cover`: give one of them.")
    if size is not None and size < 1:
        raise InputError(f"`size` {size}: keeps nothing; give 1 or more.")
    if cover is not None and not 0.0 < cover <= 1.0:
        raise InputError(f"`cover` {cover:g}: give a number above 0 and up to 1.")
    clusters = [int(label) for label in np.unique(labels) if label >= 0]
    clusters.sort(key=lambda label: (label not in critical, label))
    start = Selection(distances, size)
    for label in clusters:
        start.keep(Kept(find_prototype(distances[0], np.flatnonzero(labels == label)), label, "prototype"))
    if not clusters:
        middle = find_prototype(distances[0], np.arange(len(labels)))
        start.keep(Kept(middle, int(labels[middle]), "gap"))
    if size is None:
        assert cover is not None
        # A coverage is reached with as few as possible, so without archetypes that add nothing to it.
        while start.gap.max() > cover:
            worst = int(start.gap.argmax())
            start.keep(Kept(worst, int(labels[worst]), "gap"))
        return tuple(start.kept)
    known = {one.shape.cluster: one for one in (find_shapes(points, labels) if shaped is None else shaped)}
    task = _Task(points, distances, labels, critical, clusters, known, size)
    rivals = Rivals(distances, labels, critical, size) if len(labels) <= _MOST_EXCHANGED else None
    best, least = start.kept, np.inf
    for composition in _COMPOSITIONS:
        chosen = task.completed(start, composition)
        short = rivals.shortfall(chosen.indices) if rivals else 0.0
        if short < least:
            best, least = chosen.kept, short
        if short == 0.0:
            break
    return tuple(best)


@dataclass(frozen=True, eq=False)
class _Task:
    """Scenarios of which some are to be kept, and how many."""

    points: FloatArray
    distances: Sequence[Distances]
    labels: IntArray
    critical: Sequence[int]
    clusters: Sequence[int]
    known: Mapping[int, ShapedCluster]
    size: int

    def completed(self, start: Selection, composition: Composition) -> Selection:
        """Return a selection with archetypes, and what these leave out, added."""
        chosen = start.copy()
        labels = self.labels
        heavy = [composition.critical if label in self.critical else 1.0 for label in self.clusters]
        weights = [each * np.sqrt((labels == label).sum()) for each, label in zip(heavy, self.clusters, strict=True)]
        numbers = divide_fairly(int(composition.archetypes * self.size), weights)
        for label, number in zip(self.clusters, numbers, strict=True):
            extremes = self.known[label].archetypes(self.points, self.distances[0], number).tolist() if number else ()
            for index in extremes:
                chosen.keep(Kept(index, label, "archetype"))
        self._fill(chosen, composition)
        return chosen

    def _fill(self, chosen: Selection, composition: Composition) -> None:
        """Keep as many more as are wanted, where they leave least."""
        fixed = len(chosen.kept)
        sums = GapSums(self.distances, np.isin(self.labels, self.critical), composition, self.size)
        for index in sums.added(chosen.indices, self.size, chosen):
            chosen.keep(Kept(index, int(self.labels[index]), "gap"))
        if len(self.labels) <= _MOST_EXCHANGED:
            indices = sums.exchanged(chosen.indices, fixed, chosen)
            chosen.kept[fixed:] = [Kept(index, int(self.labels[index]), "gap") for index in indices[fixed:]]
