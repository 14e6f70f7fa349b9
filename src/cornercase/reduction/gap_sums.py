"""Sums of what the kept scenarios leave out, and the scenarios that make them small."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.reduction.kept import ALIKE, Selection

ROUNDS: Final = 3
BLOCK: Final = 256


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
    distances : sequence of ndarray of float64, each (n, n)
        Between all scenarios, in any unit.
    critical : ndarray of bool, shape (n,)
        Scenarios of critical clusters.
    composition : Composition
        Shares and weights of the set.
    size : int
        Number of scenarios to keep.
    """

    def __init__(
        self, distances: Sequence[FloatArray], critical: BoolArray, composition: Composition, size: int
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
        return [costs[list(kept)].min(axis=0) for costs in self._costs]

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
        for first in range(0, len(candidates), BLOCK):
            some = candidates[first : first + BLOCK]
            for now, costs in zip(left, self._costs, strict=True):
                gains[first : first + BLOCK] += np.maximum(now - costs[some], 0.0).sum(axis=1)
        return gains

    def added(self, kept: list[int], size: int, selection: Selection) -> list[int]:
        """Return scenarios that lower the sum most, one after the other.

        What a scenario gains can only fall as others are added, so it need be computed again only for those that had
        the largest gain before.

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
        left = self.left(kept)
        gap = selection.apart[kept].min(axis=0)
        queue = [(-gain, k) for k, gain in enumerate(self.gains(left, np.arange(len(gap))).tolist())]
        heapq.heapify(queue)
        while queue and len(kept) + len(found) < size:
            _, best = heapq.heappop(queue)
            if gap[best] <= ALIKE:
                continue
            gain = float(self.gains(left, np.array([best]))[0])
            if queue and (-gain, best) > queue[0]:
                heapq.heappush(queue, (-gain, best))
                continue
            found.append(best)
            left = [np.minimum(now, costs[best]) for now, costs in zip(left, self._costs, strict=True)]
            gap = np.minimum(gap, selection.apart[best])
        return found

    def exchanged(self, kept: list[int], fixed: int, apart: FloatArray) -> list[int]:
        """Return as many scenarios, each but the first ones exchanged for another one where that lowers the sum.

        Parameters
        ----------
        kept : list of int
            Indices.
        fixed : int
            Number of the first ones that stay.
        apart : ndarray of float64, shape (n, n)
            As in `Selection`.

        Returns
        -------
        list of int
            Indices, the fixed ones first.
        """
        kept = kept[:]
        everyone = np.arange(len(apart))
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
