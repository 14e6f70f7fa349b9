"""Scenarios that are kept, while they are chosen."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering import Distances

# Scenarios are alike within this share of the largest distance.
ALIKE: Final = 1e-3

Role = Literal["archetype", "prototype", "gap", "exposing"]


@dataclass(frozen=True)
class Kept:
    """A scenario that is kept.

    Attributes
    ----------
    index : int
        Which scenario.
    cluster : int
        Cluster that it represents; -1 for noise.
    role : {"archetype", "prototype", "gap", "exposing"}
        Why it is kept. A gap is a scenario that was unlike those that were kept before it; one that is exposing
        exposes mutants of the driver.
    """

    index: int
    cluster: int
    role: Role


class Selection:
    """Scenarios kept so far; one that is like a kept one is not taken.

    Parameters
    ----------
    distances : sequence of ndarray of float64, each (n, n), or of PlacedDistances
        Of all clusterings.
    size : int, optional
        Most to keep.

    Attributes
    ----------
    gap : ndarray of float64, shape (n,)
        By the measure of `apart`, from each scenario to the nearest kept one; infinite while none is kept.
    kept : list of Kept
        In the order in which they were chosen.
    """

    def __init__(self, distances: Sequence[Distances], size: int | None) -> None:
        self._distances = distances
        self._extents = [max(float(matrix.max()), 1e-300) for matrix in distances]
        self.gap = np.full(len(distances[0]), np.inf)
        self.kept: list[Kept] = []
        self._size = size

    @property
    def indices(self) -> list[int]:
        """Indices of the kept scenarios."""
        return [one.index for one in self.kept]

    def apart(self, indices: Sequence[int] | IntArray) -> FloatArray:
        """Return how far apart some scenarios are from all others.

        Rows are made as they are asked for: a matrix of all of them would be as large as that of a clustering.

        Parameters
        ----------
        indices : sequence of int or ndarray of int64, length m
            Which scenarios.

        Returns
        -------
        ndarray of float64, shape (m, n)
            Largest distance in any clustering, as a share of that clustering's largest distance.
        """
        rows = list(indices)
        scaled = [matrix[rows] / extent for matrix, extent in zip(self._distances, self._extents, strict=True)]
        return np.asarray(np.max(scaled, axis=0))

    def copy(self) -> Selection:
        """Copy the selection, to go on with both in different ways.

        Returns
        -------
        Selection
            With the same scenarios.
        """
        other = copy(self)
        other.gap, other.kept = self.gap.copy(), self.kept[:]
        return other

    def keep(self, one: Kept) -> None:
        """Keep a scenario, unless it is like a kept one or there are enough.

        Parameters
        ----------
        one : Kept
            The scenario.
        """
        if self.gap[one.index] > ALIKE and (self._size is None or len(self.kept) < self._size):
            self.kept.append(one)
            np.minimum(self.gap, self.apart([one.index])[0], out=self.gap)
