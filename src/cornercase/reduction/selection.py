"""The few scenarios that stand for all: what is kept of each cluster, and what the clusters leave out."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Final, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.reduction.archetypal_analysis import MOST_ARCHETYPES
from cornercase.reduction.cluster_shapes import ClusterShape, shapes, shared
from cornercase.reduction.coverage import medoids, random_gaps
from cornercase.reduction.hulls import prototype

# Of all scenarios about a tenth is kept, in the paper and here.
KEPT_SHARE: Final = 10
_BETTER: Final = 0.95
_ALIKE: Final = 1e-3
_ROUNDS: Final = 3
_MOST_EXCHANGED: Final = 2000
_BLOCK: Final = 256


class _Composition(NamedTuple):
    """What a set of a given size is made of."""

    archetypes: float
    """Share that archetypes take at most."""
    critical: float
    """Weight of the scenarios of critical clusters, and of these clusters' archetypes."""
    first: float
    """Weight of the first clustering."""
    power: int
    """Of the distances: large gaps weigh more than many small ones."""


# Each is best for some studies; the first is taken that leaves less than random choices do.
_COMPOSITIONS: Final = (
    _Composition(0.2, 4.0, 2.0, 3),
    _Composition(0.1, 6.0, 1.0, 3),
    _Composition(0.1, 6.0, 4.0, 3),
    _Composition(0.1, 6.0, 4.0, 2),
)


@dataclass(frozen=True)
class Kept:
    """A scenario of the reduced set.

    Attributes
    ----------
    index : int
        Which scenario.
    cluster : int
        Which cluster it stands for; -1 for noise.
    role : {"archetype", "prototype", "gap"}
        Why it is kept; a gap is a scenario that was unlike what was kept before it.
    """

    index: int
    cluster: int
    role: Literal["archetype", "prototype", "gap"]


def reduce_clusters(
    points: npt.ArrayLike,
    distances: npt.ArrayLike,
    labels: npt.ArrayLike,
    *,
    archetypes: int | Literal["auto"] = "auto",
    shaped: Sequence[ClusterShape] | None = None,
) -> tuple[Kept, ...]:
    """Choose the scenarios that stand for the clusters, as the paper does.

    Parameters
    ----------
    points : array_like, shape (n, d)
        Parameters of the scenarios in the unit cube.
    distances : array_like, shape (n, n)
        Distances by which the scenarios were clustered.
    labels : array_like of int, shape (n,)
        Cluster of each scenario; -1 is noise, of which none is kept.
    archetypes : int or "auto"
        How many for each cluster at most. ``"auto"`` keeps about a tenth of all scenarios, prototypes
        included, so ``n // (10 * clusters) - 1``, but at least d + 1, without which a hull is flat, and at
        most 15, as the paper.
    shaped : sequence of ClusterShape, optional
        How archetypes are found for each cluster, as of `cornercase.reduction.cluster_shapes.shapes`; by the paper's
        hulls by default.

    Returns
    -------
    tuple of Kept
        By cluster, the prototype first, then the archetypes by index. No scenario is there twice: a prototype
        that is also an archetype stands as the prototype, and the hull of the others gives the archetypes.

    Raises
    ------
    InputError
        The numbers of scenarios differ, or `archetypes` is not positive.
    """
    points = np.asarray(points, dtype=np.float64)
    distances = np.asarray(distances, dtype=np.float64)
    names = np.asarray(labels, dtype=np.int64)
    n = len(names)
    if points.ndim != 2 or len(points) != n or distances.shape != (n, n):
        raise InputError(
            f"There are {n} labels, points of shape {points.shape} and distances of shape {distances.shape}; "
            "give all for the same scenarios."
        )
    found = shapes(points, names, method="hull") if shaped is None else shaped
    if archetypes == "auto":
        lowest = min(points.shape[1] + 1, MOST_ARCHETYPES)
        most = int(np.clip(n // (KEPT_SHARE * max(1, len(found))) - 1, lowest, MOST_ARCHETYPES))
    elif isinstance(archetypes, (int, np.integer)) and archetypes >= 1:
        most = int(archetypes)
    else:
        raise InputError(f"archetypes is {archetypes!r}; give a whole number of at least 1, or 'auto'.")

    kept: list[Kept] = []
    for shape in found:
        middle = prototype(distances, np.flatnonzero(names == shape.cluster))
        kept.append(Kept(middle, shape.cluster, "prototype"))
        # A scenario with the same parameters as the prototype would add nothing to it.
        others = [part[(points[part] != points[middle]).any(axis=1)] for part in shape.parts]
        rest = replace(shape, parts=tuple(part for part in others if len(part)))
        if rest.parts:
            corners = rest.archetypes(points, distances, most)
            kept.extend(Kept(index, shape.cluster, "archetype") for index in corners.tolist())
    return tuple(kept)


def choose(
    points: FloatArray,
    distances: Sequence[FloatArray],
    labels: IntArray,
    critical: Sequence[int] = (),
    *,
    size: int | None = None,
    cover: float | None = None,
    shaped: Sequence[ClusterShape] | None = None,
) -> tuple[Kept, ...]:
    """Choose scenarios for the clusters, and then for whatever they leave out.

    First the prototype of each cluster, critical ones first; then archetypes, up to a fifth of the set, each cluster
    with a part that grows with the root of its size and is four times as large where it is critical. The rest are those
    that leave least, in all clusterings together: they minimise the sum over all scenarios of the cube of the distance
    to the nearest kept one, in units of what is usual in that clustering between scenarios that are nearest in sets of
    this size. The cube lets large gaps weigh more than many small ones. Scenarios of critical clusters count four
    times, the first clustering twice. The sum falls as fast as it can with each scenario that is added (G. L.
    Nemhauser, L. A. Wolsey, M. L. Fisher, "An analysis of approximations for maximizing submodular set functions",
    1978); then, with up to 2,000 scenarios, each is exchanged for another one where that lowers it.

    What comes out is held against 100 random choices in each clustering, by the largest and the mean distance to the
    nearest kept one, and in the critical clusters against k-medoids of the first clustering. Where it is not better
    than 95 of the random ones, or worse than k-medoids, other shares and weights are tried, four in all, and those
    taken that fall least short; up to 2,000 scenarios.

    Nothing is kept that is like something kept: whose distance to it is within 0.001 of the largest, in each
    clustering.

    Parameters
    ----------
    points : ndarray of float64, shape (n, d)
        Parameters in the unit cube.
    distances : sequence of ndarray of float64, each (n, n)
        Of all clusterings; the first is that of `labels`.
    labels : ndarray of int64, shape (n,)
        -1 is noise.
    critical : sequence of int
        Clusters that are critical.
    size : int, optional
        How many to keep, at least one; fewer only where no others differ.
    cover : float, optional
        Instead: as few as leave nothing more unlike than this, as a share of the largest distance in any clustering,
        above 0 and up to 1. After the prototypes always the scenario that is least like all that are kept is added
        (farthest-first traversal, Gonzalez 1985).
    shaped : sequence of ClusterShape, optional
        How archetypes are found for each cluster, as of `cornercase.reduction.cluster_shapes.shapes`; by its convexity
        by default.

    Returns
    -------
    tuple of Kept
        In the order in which they were chosen.

    Raises
    ------
    InputError
        Neither or both of `size` and `cover` are given, or one is out of range.
    """
    if (size is None) == (cover is None):
        raise InputError("Give either a size or a coverage of the reduced set.")
    if size is not None and size < 1:
        raise InputError(f"A size of {size} keeps nothing; give 1 or more.")
    if cover is not None and not 0.0 < cover <= 1.0:
        raise InputError(f"A coverage of {cover:g} cannot be reached; give a number above 0 and up to 1.")
    clusters = [int(label) for label in np.unique(labels) if label >= 0]
    clusters.sort(key=lambda label: (label not in critical, label))
    start = _Chosen(distances, size)
    for label in clusters:
        start.keep(Kept(prototype(distances[0], np.flatnonzero(labels == label)), label, "prototype"))
    if not clusters:
        middle = prototype(distances[0], np.arange(len(labels)))
        start.keep(Kept(middle, int(labels[middle]), "gap"))
    if cover is not None:
        # A coverage is reached with as few as possible, so without archetypes that add nothing to it.
        while start.gap.max() > cover:
            worst = int(start.gap.argmax())
            start.keep(Kept(worst, int(labels[worst]), "gap"))
        return tuple(start.kept)
    assert size is not None
    known = {shape.cluster: shape for shape in (shapes(points, labels) if shaped is None else shaped)}
    rival = _Rival(distances, labels, critical, size) if len(labels) <= _MOST_EXCHANGED else None
    best, least = start.kept, np.inf
    for composition in _COMPOSITIONS:
        chosen = start.copy()
        heavy = [composition.critical if label in critical else 1.0 for label in clusters]
        weights = [weight * np.sqrt((labels == label).sum()) for weight, label in zip(heavy, clusters, strict=True)]
        for label, number in zip(clusters, shared(int(composition.archetypes * size), weights), strict=True):
            for index in known[label].archetypes(points, distances[0], number).tolist() if number else ():
                chosen.keep(Kept(index, label, "archetype"))
        _fill(chosen, distances, labels, critical, composition, size)
        short = rival.shortfall([one.index for one in chosen.kept]) if rival else 0.0
        if short < least:
            best, least = chosen.kept, short
        if short == 0.0:
            break
    return tuple(best)


def _fill(
    chosen: _Chosen,
    distances: Sequence[FloatArray],
    labels: IntArray,
    critical: Sequence[int],
    composition: _Composition,
    size: int,
) -> None:
    """Keep as many more as are wanted, where they leave least."""
    fixed = len(chosen.kept)
    sums = _Sums(distances, np.isin(labels, critical), composition, size)
    for index in sums.added([one.index for one in chosen.kept], size, chosen):
        chosen.keep(Kept(index, int(labels[index]), "gap"))
    if len(labels) <= _MOST_EXCHANGED:
        indices = sums.exchanged([one.index for one in chosen.kept], fixed, chosen.apart)
        chosen.kept[fixed:] = [Kept(index, int(labels[index]), "gap") for index in indices[fixed:]]


class _Chosen:
    """What is kept, with what is like something kept left out."""

    def __init__(self, distances: Sequence[FloatArray], size: int | None) -> None:
        self.apart = np.max([matrix / max(matrix.max(), 1e-300) for matrix in distances], axis=0)
        self.gap = np.full(len(self.apart), np.inf)
        self.kept: list[Kept] = []
        self._size = size

    def copy(self) -> _Chosen:
        """The same so far, to go on with in another way."""
        other = copy(self)
        other.gap, other.kept = self.gap.copy(), self.kept[:]
        return other

    def keep(self, one: Kept) -> None:
        if self.gap[one.index] > _ALIKE and (self._size is None or len(self.kept) < self._size):
            self.kept.append(one)
            np.minimum(self.gap, self.apart[one.index], out=self.gap)


class _Sums:
    """Weighted sums of powers of distances to the nearest kept scenario, over all clusterings."""

    def __init__(
        self, distances: Sequence[FloatArray], critical: BoolArray, composition: _Composition, size: int
    ) -> None:
        n = len(critical)
        near = min(-(-n // size), n - 1)
        weights = np.where(critical, composition.critical, 1.0)
        # A row for each candidate, a column for each scenario, with the scenario's weight.
        self._costs = []
        for k, matrix in enumerate(distances):
            usual = float(np.partition(matrix, near, axis=1)[:, near].mean()) or 1.0
            heavy = composition.first if k == 0 else 1.0
            self._costs.append((matrix / usual) ** composition.power * (weights * heavy))

    def left(self, kept: Sequence[int]) -> list[FloatArray]:
        """What each scenario adds to the sum, in each clustering."""
        return [costs[list(kept)].min(axis=0) for costs in self._costs]

    def gains(self, left: Sequence[FloatArray], candidates: IntArray) -> FloatArray:
        """By how much each candidate would lower the sum."""
        gains = np.zeros(len(candidates))
        for first in range(0, len(candidates), _BLOCK):
            some = candidates[first : first + _BLOCK]
            for now, costs in zip(left, self._costs, strict=True):
                gains[first : first + _BLOCK] += np.maximum(now - costs[some], 0.0).sum(axis=1)
        return gains

    def added(self, kept: list[int], size: int, chosen: _Chosen) -> list[int]:
        """Scenarios that lower the sum most, one after the other.

        What a scenario would gain only falls as others are added, so most need not be asked again.
        """
        found: list[int] = []
        left = self.left(kept)
        gap = chosen.apart[kept].min(axis=0)
        queue = [(-gain, k) for k, gain in enumerate(self.gains(left, np.arange(len(gap))).tolist())]
        heapq.heapify(queue)
        while queue and len(kept) + len(found) < size:
            _, best = heapq.heappop(queue)
            if gap[best] <= _ALIKE:
                continue
            gain = float(self.gains(left, np.array([best]))[0])
            if queue and (-gain, best) > queue[0]:
                heapq.heappush(queue, (-gain, best))
                continue
            found.append(best)
            left = [np.minimum(now, costs[best]) for now, costs in zip(left, self._costs, strict=True)]
            gap = np.minimum(gap, chosen.apart[best])
        return found

    def exchanged(self, kept: list[int], fixed: int, apart: FloatArray) -> list[int]:
        """The same number of scenarios, of which all but the first `fixed` were exchanged where that lowers the sum."""
        kept = kept[:]
        everyone = np.arange(len(apart))
        for _ in range(_ROUNDS):
            before = kept[:]
            for j in range(fixed, len(kept)):
                rest = kept[:j] + kept[j + 1 :]
                if not rest:
                    continue
                gains = self.gains(self.left(rest), everyone)
                gains[apart[rest].min(axis=0) <= _ALIKE] = -1.0
                best = int(gains.argmax())
                if gains[best] > gains[kept[j]] * (1.0 + 1e-9):
                    kept[j] = best
            if kept == before:
                break
        return kept


class _Rival:
    """Random choices in each clustering, and k-medoids in the critical clusters of the first."""

    def __init__(self, distances: Sequence[FloatArray], labels: IntArray, critical: Sequence[int], size: int) -> None:
        self._distances = distances
        self._size = min(size, len(labels))
        self._random = []
        for matrix in distances:
            gaps = random_gaps(matrix, self._size)
            self._random.append((gaps.max(axis=1), gaps.mean(axis=1)))
        # Where every cluster is critical there is nothing that would count more than the rest.
        members = np.isin(labels, critical)
        self._members = members if members.any() and (labels[~members] >= 0).any() else None
        if self._members is not None:
            middle = distances[0][self._members][:, medoids(distances[0], self._size)].min(axis=1)
            self._middle = float(middle.max()), float(middle.mean())

    def shortfall(self, kept: list[int]) -> float:
        """How far a choice falls short of all that it should be better than; 0 where it does not."""
        short = 0.0
        for matrix, random in zip(self._distances, self._random, strict=True):
            gap = matrix[:, kept].min(axis=1)
            for mine, theirs in zip((gap.max(), gap.mean()), random, strict=True):
                short += max(0.0, _BETTER - float(np.mean(theirs > mine)))
        if self._members is not None:
            gap = self._distances[0][self._members][:, kept].min(axis=1)
            for mine, other in zip((gap.max(), gap.mean()), self._middle, strict=True):
                short += max(0.0, float(mine) / max(other, 1e-300) - 1.0) if mine > other else 0.0
        return short
