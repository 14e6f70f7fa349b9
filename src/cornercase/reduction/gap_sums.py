"""Sums of what the kept scenarios leave out, and the scenarios that make them small."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.clustering import Distances, PlacedDistances
from cornercase.reduction.gap_cells import CellSums
from cornercase.reduction.kept import ALIKE, Selection

# Most scenarios for which all costs are in memory.
_MOST_WHOLE: Final = 2000
# Costs that the processor's cache holds.
_AT_ONCE: Final = 2**15
ROUNDS: Final = 3
BLOCK: Final = 256
# Scenarios by which what is usual between neighbours is measured, at most, where distances are made of places.
_USUAL_OF: Final = 2000


class Composition(NamedTuple):
    """Shares and weights by which a set of a given size is put together."""

    archetypes: float
    """Largest share of archetypes."""
    critical: float
    """Weight of the scenarios of critical clusters, and of these clusters' archetypes."""
    first: float
    """Weight of the first clustering."""
    power: int
    """Of the distances: large gaps weigh more than many small ones."""


class GapSums:
    """Weighted sums of powers of the distances to the nearest kept scenario, over all clusterings.

    Parameters
    ----------
    distances : sequence of ndarray of float64, each (n, n), or of PlacedDistances
        Between all scenarios, in any unit.
    critical : ndarray of bool, shape (n,)
        Scenarios of critical clusters.
    composition : Composition
        Shares and weights of the set.
    size : int
        Number of scenarios to keep.
    """

    def __init__(
        self, distances: Sequence[Distances], critical: BoolArray, composition: Composition, size: int
    ) -> None:
        near = min(-(-len(critical) // size), len(critical) - 1)
        self._weights = np.where(critical, composition.critical, 1.0)
        self._power = composition.power
        self._distances = distances
        self._usual = [_usual(matrix, near) for matrix in distances]
        self._heavy = [composition.first if k == 0 else 1.0 for k in range(len(distances))]
        self._placed = isinstance(distances[0], PlacedDistances)
        # All costs at once are as large as all distances.
        self._whole = (
            [self._costs(k, np.arange(len(critical))) for k in range(len(distances))]
            if len(critical) <= _MOST_WHOLE
            else None
        )

    def _costs(self, k: int, candidates: IntArray) -> FloatArray:
        """Costs of some candidates in a clustering: a row for each, a column for each scenario, with its weight."""
        costs: FloatArray = self._distances[k][candidates] / self._usual[k]
        # Products are many times as fast as a general power, and may have another last digit.
        quick = self._placed and self._power == 3
        costs = costs * costs * costs if quick else costs**self._power
        costs *= self._weights * self._heavy[k]
        return costs

    def _rows(self, candidates: IntArray) -> list[FloatArray]:
        if self._whole is not None:
            return [costs[candidates] for costs in self._whole]
        return [self._costs(k, candidates) for k in range(len(self._distances))]

    def left(self, kept: Sequence[int]) -> list[FloatArray]:
        """Return what each scenario adds to the sum.

        Parameters
        ----------
        kept : sequence of int
            Indices.

        Returns
        -------
        list of ndarray of float64, each (n,)
            By clustering.
        """
        found = [np.full(len(self._weights), np.inf) for _ in self._distances]
        for first in range(0, len(kept), BLOCK):
            some = np.asarray(kept[first : first + BLOCK], dtype=np.int64)
            for least, costs in zip(found, self._rows(some), strict=True):
                np.minimum(least, costs.min(axis=0), out=least)
        return found

    def gains(self, left: Sequence[FloatArray], candidates: IntArray) -> FloatArray:
        """Return by how much each candidate would lower the sum.

        Parameters
        ----------
        left : sequence of ndarray of float64, each (n,)
            As in `left`.
        candidates : ndarray of int64, shape (m,)
            Indices.

        Returns
        -------
        ndarray of float64, shape (m,)
            By candidate.
        """
        gains = np.zeros(len(candidates))
        block = max(1, _AT_ONCE // len(self._weights))
        for first in range(0, len(candidates), block):
            for now, costs in zip(left, self._rows(candidates[first : first + block]), strict=True):
                # The rows are copies, which need not be kept.
                np.maximum(np.subtract(now, costs, out=costs), 0.0, out=costs)
                gains[first : first + block] += costs.sum(axis=1)
        return gains

    def added(self, kept: list[int], size: int, selection: Selection) -> list[int]:
        """Return scenarios that lower the sum most, one after the other.

        Parameters
        ----------
        kept : list of int
            Indices of those that are kept already.
        size : int
            Number to keep in all.
        selection : Selection
            Says what is alike.

        Returns
        -------
        list of int
            Indices of those that are added.
        """
        found: list[int] = []
        sums = self._cells(kept) if self._placed and self._whole is None else _Rows(self, kept)
        gap = selection.gap.copy()
        while len(kept) + len(found) < size and (best := sums.best(gap, ALIKE)) is not None:
            found.append(best)
            sums.keep(best)
            gap = np.minimum(gap, selection.apart([best])[0])
        return found

    def _cells(self, kept: Sequence[int]) -> CellSums:
        heavy = [self._weights * each for each in self._heavy]
        places = [one.places for one in self._distances if isinstance(one, PlacedDistances)]
        return CellSums(places, self._usual, heavy, self._power, kept)

    def exchanged(self, kept: list[int], fixed: int, selection: Selection) -> list[int]:
        """Return as many scenarios, each but the first ones exchanged for another one where that lowers the sum.

        Parameters
        ----------
        kept : list of int
            Indices.
        fixed : int
            Number of the first ones that stay.
        selection : Selection
            Says what is alike.

        Returns
        -------
        list of int
            Indices, the fixed ones first.
        """
        kept = kept[:]
        everyone = np.arange(len(selection.gap))
        apart = selection.apart(everyone)
        for _ in range(ROUNDS):
            before = kept[:]
            for j in range(fixed, len(kept)):
                rest = kept[:j] + kept[j + 1 :]
                if not rest:
                    continue
                gains = self.gains(self.left(rest), everyone)
                gains[apart[rest].min(axis=0) <= ALIKE] = -1.0
                best = int(gains.argmax())
                if gains[best] > gains[kept[j]] * (1.0 + 1e-9):
                    kept[j] = best
            if kept == before:
                break
        return kept


class _Rows:
    """What is left by rows of costs, as `CellSums` by cells."""

    def __init__(self, sums: GapSums, kept: Sequence[int]) -> None:
        self._sums = sums
        self._left = sums.left(kept)
        gains = sums.gains(self._left, np.arange(len(self._left[0])))
        self._queue = [(-gain, k) for k, gain in enumerate(gains.tolist())]
        heapq.heapify(self._queue)

    def best(self, gap: FloatArray, alike: float) -> int | None:
        while self._queue:
            _, best = heapq.heappop(self._queue)
            if gap[best] <= alike:
                continue
            again = (-float(self._sums.gains(self._left, np.array([best]))[0]), best)
            if not self._queue or again <= self._queue[0]:
                return best
            heapq.heappush(self._queue, again)
        return None

    def keep(self, index: int) -> None:
        self._left = [np.minimum(now, new) for now, new in zip(self._left, self._sums.left([index]), strict=True)]


def _usual(distances: Distances, near: int) -> float:
    """Mean distance of each scenario to its `near`-th neighbour, 1 where that is 0."""
    n = len(distances)
    # A slice of a matrix is no copy.
    blocks: list[slice | IntArray] = [slice(first, first + BLOCK) for first in range(0, n, BLOCK)]
    if isinstance(distances, PlacedDistances) and n > _USUAL_OF:
        some = np.linspace(0, n - 1, _USUAL_OF).astype(np.int64)
        blocks = [some[first : first + BLOCK] for first in range(0, _USUAL_OF, BLOCK)]
    near_by = [np.partition(distances[one], near, axis=1)[:, near] for one in blocks]
    return float(np.concatenate(near_by).mean()) or 1.0
