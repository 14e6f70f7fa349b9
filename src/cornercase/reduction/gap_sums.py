"""Coverage sums: what the selected scenarios leave uncovered, and the scenarios that reduce it most."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.clustering import Distances, PlacedDistances
from cornercase.reduction.gap_cells import CellSums
from cornercase.reduction.kept import ALIKE, Selection

# Largest number of scenarios for which all costs are kept in memory.
_MOST_WHOLE: Final = 2000
# Number of costs that fit in the CPU cache.
_AT_ONCE: Final = 2**15
ROUNDS: Final = 3
BLOCK: Final = 256
# Largest number of scenarios at which the usual distance of neighbours is sampled, for embedded distances.
_USUAL_OF: Final = 2000


class Composition(NamedTuple):
    """Shares and weights with which a set of a given size is composed."""

    archetypes: float
    """Largest share of archetypes."""
    critical: float
    """Weight of the scenarios of critical clusters, and of these clusters' archetypes."""
    first: float
    """Weight of the first clustering."""
    power: int
    """Exponent of the distances: large gaps weigh more than many small ones."""


class GapSums:
    """Weighted sums of powers of the distances to the nearest selected scenario, over all clusterings.

    `is_critical`, shape (n,), marks scenarios of critical clusters; `size` is the number of scenarios to select.
    """

    def __init__(
        self, distances: Sequence[Distances], critical: BoolArray, composition: Composition, size: int
    ) -> None:
        n_neighbours = min(-(-len(critical) // size), len(critical) - 1)
        self._weights = np.where(critical, composition.critical, 1.0)
        self._power = composition.power
        self._distances = distances
        self._usual = [_usual(matrix, n_neighbours) for matrix in distances]
        self._heavy = [composition.first if k == 0 else 1.0 for k in range(len(distances))]
        self._placed = isinstance(distances[0], PlacedDistances)
        # All costs take as much memory as all distances.
        self._whole = (
            [self._costs(k, np.arange(len(critical))) for k in range(len(distances))]
            if len(critical) <= _MOST_WHOLE
            else None
        )

    def _costs(self, k: int, candidates: IntArray) -> FloatArray:
        """Weighted costs of some candidates in a clustering: one row per candidate, one column per scenario."""
        costs: FloatArray = self._distances[k][candidates] / self._usual[k]
        # Products are many times as fast as a general power, and may differ in the last digit.
        use_products = self._placed and self._power == 3
        costs = costs * costs * costs if use_products else costs**self._power
        costs *= self._weights * self._heavy[k]
        return costs

    def _rows(self, candidates: IntArray) -> list[FloatArray]:
        if self._whole is not None:
            return [costs[candidates] for costs in self._whole]
        return [self._costs(k, candidates) for k in range(len(self._distances))]

    def left(self, kept: Sequence[int]) -> list[FloatArray]:
        """Return what each scenario adds to the sum for the selected ones, shape (n,) by clustering."""
        left_costs = [np.full(len(self._weights), np.inf) for _ in self._distances]
        for first in range(0, len(kept), BLOCK):
            batch = np.asarray(kept[first : first + BLOCK], dtype=np.int64)
            for lowest, costs in zip(left_costs, self._rows(batch), strict=True):
                np.minimum(lowest, costs.min(axis=0), out=lowest)
        return left_costs

    def gains(self, left: Sequence[FloatArray], candidates: IntArray) -> FloatArray:
        """Return by how much each candidate would lower the sum, given the uncovered costs."""
        gains = np.zeros(len(candidates))
        block = max(1, _AT_ONCE // len(self._weights))
        for first in range(0, len(candidates), block):
            for now, costs in zip(left, self._rows(candidates[first : first + block]), strict=True):
                # The rows are copies, so they may be overwritten.
                np.maximum(np.subtract(now, costs, out=costs), 0.0, out=costs)
                gains[first : first + block] += costs.sum(axis=1)
        return gains

    def added(self, kept: list[int], size: int, selection: Selection) -> list[int]:
        """Add scenarios greedily until there are `size`; return the indices of those added.

        Scenarios similar to a selected one, by `selection`, are skipped.
        """
        new: list[int] = []
        sums = self._cells(kept) if self._placed and self._whole is None else _Rows(self, kept)
        gap = selection.gap.copy()
        while len(kept) + len(new) < size and (best := sums.best(gap, ALIKE)) is not None:
            new.append(best)
            sums.keep(best)
            gap = np.minimum(gap, selection.apart([best])[0])
        return new

    def _cells(self, kept: Sequence[int]) -> CellSums:
        heavy = [self._weights * weight for weight in self._heavy]
        embeddings = [embedding.places for embedding in self._distances if isinstance(embedding, PlacedDistances)]
        return CellSums(embeddings, self._usual, heavy, self._power, kept)

    def exchanged(self, kept: list[int], fixed: int, selection: Selection) -> list[int]:
        """Exchange each scenario after the first `n_fixed` ones for another one if that lowers the sum; return all."""
        kept = kept[:]
        everyone = np.arange(len(selection.gap))
        pair_distances = selection.apart(everyone)
        for _ in range(ROUNDS):
            previous = kept[:]
            for j in range(fixed, len(kept)):
                others = kept[:j] + kept[j + 1 :]
                if not others:
                    continue
                gains = self.gains(self.left(others), everyone)
                gains[pair_distances[others].min(axis=0) <= ALIKE] = -1.0
                best = int(gains.argmax())
                if gains[best] > gains[kept[j]] * (1.0 + 1e-9):
                    kept[j] = best
            if kept == previous:
                break
        return kept


class _Rows:
    """Lazy greedy search by rows of costs, with the methods of `CellCoverageSums`."""

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
            entry = (-float(self._sums.gains(self._left, np.array([best]))[0]), best)
            if not self._queue or entry <= self._queue[0]:
                return best
            heapq.heappush(self._queue, entry)
        return None

    def keep(self, index: int) -> None:
        self._left = [np.minimum(now, new) for now, new in zip(self._left, self._sums.left([index]), strict=True)]


def _usual(distances: Distances, near: int) -> float:
    """Mean distance of each scenario to its `n_neighbours`-th neighbour, 1 if that is 0."""
    n = len(distances)
    # A slice of a matrix is not a copy.
    blocks: list[slice | IntArray] = [slice(first, first + BLOCK) for first in range(0, n, BLOCK)]
    if isinstance(distances, PlacedDistances) and n > _USUAL_OF:
        sample = np.linspace(0, n - 1, _USUAL_OF).astype(np.int64)
        blocks = [sample[first : first + BLOCK] for first in range(0, _USUAL_OF, BLOCK)]
    neighbour_distances = [np.partition(distances[block], near, axis=1)[:, near] for block in blocks]
    return float(np.concatenate(neighbour_distances).mean()) or 1.0
