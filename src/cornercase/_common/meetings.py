"""Which steps of one way meet which of another, as runs: a table of all pairs grows with the square of the steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from cornercase._common.typing import BoolArray, IntArray


@dataclass(frozen=True, eq=False)
class Meetings:
    """Which of n steps meet which of m others.

    Attributes
    ----------
    runs : ndarray of int64, shape (k, 3)
        A step, and the first and last one of others next to each other that it meets; in their order.
    shape : tuple of (int, int)
        n and m.
    """

    runs: IntArray
    shape: tuple[int, int]

    def steps(self) -> IntArray:
        """List the steps that meet any other.

        Returns
        -------
        ndarray of int64
            In order.
        """
        steps: IntArray = np.unique(self.runs[:, 0])
        return steps

    def others(self) -> IntArray:
        """List the others that any step meets.

        Returns
        -------
        ndarray of int64
            In order.
        """
        ends = np.zeros(self.shape[1] + 1, dtype=np.int64)
        np.add.at(ends, self.runs[:, 1], 1)
        np.add.at(ends, self.runs[:, 2] + 1, -1)
        return np.flatnonzero(np.cumsum(ends[:-1]) > 0)

    def met_by(self, step: int) -> BoolArray:
        """Say which others a step meets.

        Parameters
        ----------
        step : int
            From 0 on.

        Returns
        -------
        ndarray of bool, shape (m,)
        """
        found = np.zeros(self.shape[1], dtype=np.bool_)
        for first, last in self.runs[self.runs[:, 0] == step, 1:].tolist():
            found[first : last + 1] = True
        return found

    def meeting(self, other: int) -> BoolArray:
        """Say which steps meet one of the others.

        Parameters
        ----------
        other : int
            From 0 on.

        Returns
        -------
        ndarray of bool, shape (n,)
        """
        found = np.zeros(self.shape[0], dtype=np.bool_)
        found[self.runs[(self.runs[:, 1] <= other) & (other <= self.runs[:, 2]), 0]] = True
        return found

    def places(self) -> list[Meetings]:
        """Split them into connected groups, in which each pair is connected with the eight pairs around it.

        Returns
        -------
        list of Meetings
            In the order of their first steps.
        """
        if not len(self.runs):
            return []
        step, first, last = self.runs.T
        # Each row has a number for each place in it and one beyond either end.
        row = (step + 1) * (self.shape[1] + 2)
        before = row - (self.shape[1] + 2)
        begins = np.searchsorted(row + last, before + first - 1)
        ends = np.searchsorted(row + first, before + last + 1, side="right")
        counts = np.maximum(ends - begins, 0)
        if (counts[1:] == 1).all() and (np.diff(step) == 1).all():
            return [self]
        mine = np.repeat(np.arange(len(step)), counts)
        theirs = np.arange(len(mine)) - np.repeat(counts.cumsum() - counts, counts) + np.repeat(begins, counts)
        touching = coo_matrix((np.ones(len(mine), dtype=np.int8), (mine, theirs)), shape=(len(step), len(step)))
        count, place = connected_components(touching, directed=False)
        return [Meetings(self.runs[place == k], self.shape) for k in range(count)]
