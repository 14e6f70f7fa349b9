"""Coverage sums: the cost of scenarios far from all selected scenarios, and searches that lower this cost most."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.clustering._embedding import Distances, EmbeddedDistances
from cornercase.reduction._cell_greedy_search import CellGreedySearch
from cornercase.reduction._selection_state import SIMILAR_SHARE, Selection

MAX_IN_MEMORY: Final = 2000
"""Largest number of scenarios for which all costs are kept in memory."""
# Number of costs that fit in the CPU cache.
_CACHED_COSTS: Final = 2**15
EXCHANGE_ROUNDS: Final = 3
BLOCK_SIZE: Final = 256
# Largest number of scenarios at which the usual distance of neighbours is sampled, for embedded distances.
_NEIGHBOUR_SAMPLE: Final = 2000
# Largest rank of a neighbour that is searched for in a tree; for higher ranks, comparing all scenarios is faster.
_MAX_SEARCHED: Final = 30


class SetComposition(NamedTuple):
    """Shares and weights that determine which kinds of scenarios a reduced set of a given size contains."""

    archetype_share: float
    """Largest share of archetypes."""
    critical_weight: float
    """Weight of the scenarios of critical clusters, and of these clusters' archetypes."""
    first_weight: float
    """Weight of the first clustering."""
    power: int
    """Exponent of the distances: large gaps weigh more than many small ones."""


class CoverageSums:
    """Coverage sum: weighted sum of powers of the distances to the nearest selected scenario, over all clusterings.

    `is_critical`, shape (n,), marks scenarios of critical clusters. `size` is the number of scenarios to select. With
    up to `max_in_memory` scenarios, the costs for all pairs of scenarios are kept in memory.
    """

    def __init__(
        self,
        distances: Sequence[Distances],
        is_critical: BoolArray,
        composition: SetComposition,
        size: int,
        max_in_memory: int = MAX_IN_MEMORY,
    ) -> None:
        n_neighbours = min(-(-len(is_critical) // size), len(is_critical) - 1)
        self._weights = np.where(is_critical, composition.critical_weight, 1.0)
        self._power = composition.power
        self._distances = distances
        self._usual_distances = [_mean_neighbour_distance(matrix, n_neighbours) for matrix in distances]
        self._clustering_weights = [composition.first_weight if k == 0 else 1.0 for k in range(len(distances))]
        self._is_embedded = isinstance(distances[0], EmbeddedDistances)
        # All costs take as much memory as all distances.
        self._all_costs = (
            [self._compute_costs(k, np.arange(len(is_critical))) for k in range(len(distances))]
            if len(is_critical) <= max_in_memory
            else None
        )

    def _compute_costs(self, clustering: int, candidates: IntArray) -> FloatArray:
        """Compute, in one clustering, the weighted cost of each scenario if only a single candidate were selected.

        The result has a row per candidate and a column per scenario.
        """
        costs: FloatArray = self._distances[clustering][candidates] / self._usual_distances[clustering]
        # Products are many times as fast as a general power, and may differ in the last digit.
        use_products = self._is_embedded and self._power == 3
        costs = costs * costs * costs if use_products else costs**self._power
        costs *= self._weights * self._clustering_weights[clustering]
        return costs

    def _cost_rows(self, candidates: IntArray) -> list[FloatArray]:
        if self._all_costs is not None:
            return [costs[candidates] for costs in self._all_costs]
        return [self._compute_costs(k, candidates) for k in range(len(self._distances))]

    def uncovered_costs(self, selected: Sequence[int]) -> list[FloatArray]:
        """Return, for each clustering, the costs of all scenarios if `selected` are selected, shape (n,)."""
        left_costs = [np.full(len(self._weights), np.inf) for _ in self._distances]
        for first in range(0, len(selected), BLOCK_SIZE):
            batch = np.asarray(selected[first : first + BLOCK_SIZE], dtype=np.int64)
            for lowest, costs in zip(left_costs, self._cost_rows(batch), strict=True):
                np.minimum(lowest, costs.min(axis=0), out=lowest)
        return left_costs

    def compute_gains(self, uncovered: Sequence[FloatArray], candidates: IntArray) -> FloatArray:
        """Return the amount by which each candidate would lower the coverage sum.

        `uncovered` has the present costs of all scenarios, shape (n,), for each clustering.
        """
        gains = np.zeros(len(candidates))
        block = max(1, _CACHED_COSTS // len(self._weights))
        for first in range(0, len(candidates), block):
            for now, costs in zip(uncovered, self._cost_rows(candidates[first : first + block]), strict=True):
                # The rows are copies, so they may be overwritten.
                np.maximum(np.subtract(now, costs, out=costs), 0.0, out=costs)
                gains[first : first + block] += costs.sum(axis=1)
        return gains

    def start_greedy_search(self, selected: Sequence[int]) -> CellGreedySearch | RowGreedySearch:
        """Return a search that finds, one after the other, the scenarios whose selection lowers the coverage sum most.

        `selected` are the indices of the scenarios selected so far.
        """
        if self._is_embedded and self._all_costs is None:
            return self._make_cell_sums(selected)
        return RowGreedySearch(self, selected)

    def _make_cell_sums(self, selected: Sequence[int]) -> CellGreedySearch:
        heavy = [self._weights * weight for weight in self._clustering_weights]
        embeddings = [
            embedding.coordinates for embedding in self._distances if isinstance(embedding, EmbeddedDistances)
        ]
        return CellGreedySearch(embeddings, self._usual_distances, heavy, self._power, selected)

    def exchange_selected(self, selected: list[int], n_fixed: int, selection: Selection) -> list[int]:
        """Exchange selected scenarios for others if this lowers the coverage sum; return all selected scenarios.

        The first `n_fixed` scenarios stay.
        """
        selected = selected[:]
        everyone = np.arange(len(self._weights))
        pair_distances = selection.distances_to(everyone)
        for _ in range(EXCHANGE_ROUNDS):
            previous = selected[:]
            for j in range(n_fixed, len(selected)):
                others = selected[:j] + selected[j + 1 :]
                if not others:
                    continue
                gains = self.compute_gains(self.uncovered_costs(others), everyone)
                gains[pair_distances[others].min(axis=0) <= SIMILAR_SHARE] = -1.0
                best = int(gains.argmax())
                if gains[best] > gains[selected[j]] * (1.0 + 1e-9):
                    selected[j] = best
            if selected == previous:
                break
        return selected


class RowGreedySearch:
    """Greedy search that computes gains only when needed, from rows of costs; same interface as `CellGreedySearch`."""

    def __init__(self, sums: CoverageSums, selected: Sequence[int]) -> None:
        self._sums = sums
        self._uncovered = sums.uncovered_costs(selected)
        gains = sums.compute_gains(self._uncovered, np.arange(len(self._uncovered[0])))
        self._queue = [(-gain, k) for k, gain in enumerate(gains.tolist())]
        heapq.heapify(self._queue)

    def pop_best_candidate(self) -> int | None:
        while self._queue:
            _, best = heapq.heappop(self._queue)
            entry = (-float(self._sums.compute_gains(self._uncovered, np.array([best]))[0]), best)
            if not self._queue or entry <= self._queue[0]:
                return best
            heapq.heappush(self._queue, entry)
        return None

    def add(self, index: int) -> None:
        self._uncovered = [
            np.minimum(now, new) for now, new in zip(self._uncovered, self._sums.uncovered_costs([index]), strict=True)
        ]


def _mean_neighbour_distance(distances: Distances, n_neighbours: int) -> float:
    """Return the mean distance of scenarios to their `n_neighbours`-th neighbour, by which distances are divided.

    If this mean is 0, the result is 1, so that the division is possible.
    """
    n = len(distances)
    # A slice of a matrix is not a copy.
    blocks: list[slice | IntArray] = [slice(first, first + BLOCK_SIZE) for first in range(0, n, BLOCK_SIZE)]
    if isinstance(distances, EmbeddedDistances) and n > _NEIGHBOUR_SAMPLE:
        sample = np.linspace(0, n - 1, _NEIGHBOUR_SAMPLE).astype(np.int64)
        if n_neighbours <= _MAX_SEARCHED:
            return float(distances.distances_to_nth_neighbour(sample, n_neighbours).mean()) or 1.0
        blocks = [sample[first : first + BLOCK_SIZE] for first in range(0, _NEIGHBOUR_SAMPLE, BLOCK_SIZE)]
    neighbour_distances = [np.partition(distances[block], n_neighbours, axis=1)[:, n_neighbours] for block in blocks]
    return float(np.concatenate(neighbour_distances).mean()) or 1.0
