"""Overlaps between the steps of two paths, stored as runs of steps because a full table would grow quadratically."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from cornercase._common.typing import BoolArray, IntArray


@dataclass(frozen=True, eq=False)
class OverlapRuns:
    """Overlaps between the n steps of one path and the m steps of another path.

    Each row of `runs`, shape (k, 3), is a run of overlaps: a step of the first path, and the first and last of the
    consecutive steps of the second path that overlap this step. The rows are sorted. `shape` is (n, m).
    """

    runs: IntArray
    shape: tuple[int, int]

    def steps_of_first_path(self) -> IntArray:
        """Return sorted indices of the steps of the first path that overlap at least one step of the second path."""
        steps: IntArray = np.unique(self.runs[:, 0])
        return steps

    def steps_of_second_path(self) -> IntArray:
        """Return sorted indices of the steps of the second path that overlap at least one step of the first path."""
        ends = np.zeros(self.shape[1] + 1, dtype=np.int64)
        np.add.at(ends, self.runs[:, 1], 1)
        np.add.at(ends, self.runs[:, 2] + 1, -1)
        return np.flatnonzero(np.cumsum(ends[:-1]) > 0)

    def overlaps_of_step(self, step: int) -> BoolArray:
        """Return a mask, shape (m,), of the steps of the second path that overlap step `step` of the first path."""
        mask = np.zeros(self.shape[1], dtype=np.bool_)
        for first, last in self.runs[self.runs[:, 0] == step, 1:].tolist():
            mask[first : last + 1] = True
        return mask

    def overlaps_of_other_step(self, other_step: int) -> BoolArray:
        """Return a mask, shape (n,), of the steps of the first path that overlap `other_step` of the second path."""
        mask = np.zeros(self.shape[0], dtype=np.bool_)
        mask[self.runs[(self.runs[:, 1] <= other_step) & (other_step <= self.runs[:, 2]), 0]] = True
        return mask

    def connected_components(self) -> list[OverlapRuns]:
        """Split the overlaps into connected components, sorted by first step.

        Pairs of overlapping steps are neighbours if both of their indices differ by at most 1.
        """
        if not len(self.runs):
            return []
        step, first, last = self.runs.T
        # Number the pairs of steps row by row, with an additional column at either end of each row.
        row = (step + 1) * (self.shape[1] + 2)
        before = row - (self.shape[1] + 2)
        begins = np.searchsorted(row + last, before + first - 1)
        ends = np.searchsorted(row + first, before + last + 1, side="right")
        counts = np.maximum(ends - begins, 0)
        if (counts[1:] == 1).all() and (np.diff(step) == 1).all():
            return [self]
        left = np.repeat(np.arange(len(step)), counts)
        right = np.arange(len(left)) - np.repeat(counts.cumsum() - counts, counts) + np.repeat(begins, counts)
        touching = coo_matrix((np.ones(len(left), dtype=np.int8), (left, right)), shape=(len(step), len(step)))
        count, component = connected_components(touching, directed=False)
        return [OverlapRuns(self.runs[component == k], self.shape) for k in range(count)]
