"""Sums of what kept scenarios with places leave out, by cells of scenarios that are near each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from cornercase._common.typing import FloatArray, IntArray
from cornercase.reduction import gap_kernels
from cornercase.reduction.gap_kernels import AXES, CELL, Cells


class CellSums:
    """Weighted sums of powers of the distances to the nearest kept scenario, over all clusterings.

    Parameters
    ----------
    places : sequence of ndarray of float64, each (n, p)
        Of all scenarios, by clustering; distances are squared Euclidean ones.
    usual : sequence of float
        Unit of the distances, by clustering.
    heavy : sequence of ndarray of float64, each (n,)
        Weights of the scenarios, by clustering.
    power : int
        2 or 3.
    kept : sequence of int
        Indices of those that are kept already, at least one.

    Attributes
    ----------
    gains : ndarray of float64, shape (n,)
        By how much each scenario lowered the sum when that was last computed; it can only have fallen since.
    """

    def __init__(
        self,
        places: Sequence[FloatArray],
        usual: Sequence[float],
        heavy: Sequence[FloatArray],
        power: int,
        kept: Sequence[int],
    ) -> None:
        axes = -(-max(one.shape[1] for one in places) // AXES) * AXES
        along = np.stack([np.pad(one, ((0, 0), (0, axes - one.shape[1]))) for one in places])
        orders = [_order(one) for one in along]
        cells = np.stack([one[order] for one, order in zip(along, orders, strict=True)])
        first = cells[..., :AXES]
        centres = first.mean(axis=2)
        radii = np.sqrt(((first - centres[:, :, None]) ** 2).sum(axis=3).max(axis=2))
        near = np.full(cells.shape[:3], np.inf)
        # What fills up the last cell is as near as can be, so that it never counts.
        near.reshape(len(places), -1)[:, len(places[0]) :] = 0.0
        self._cells = Cells(
            along.reshape(len(places), -1, axes // AXES, AXES),
            np.ascontiguousarray(cells.transpose(0, 1, 3, 2)).reshape(*cells.shape[:2], axes // AXES, AXES, CELL),
            np.ascontiguousarray(centres.transpose(0, 2, 1)),
            radii * (1.0 + 1e-9),
            np.stack([one[order] for one, order in zip(heavy, orders, strict=True)]),
            np.array(usual),
            power,
            near,
            np.full(radii.shape, np.inf),
            near.copy(),
        )
        for index in kept:
            self.keep(index)
        self.gains = np.empty(len(places[0]))
        gap_kernels.find_gains(self.gains, self._cells)

    def best(self, gap: FloatArray, alike: float) -> int | None:
        """Return the scenario that lowers the sum most.

        What a scenario lowers it by is computed again only for those that lowered it most before.

        Parameters
        ----------
        gap : ndarray of float64, shape (n,)
            Of each scenario; smaller than that of an earlier call.
        alike : float
            Gap up to which a scenario is like a kept one.

        Returns
        -------
        int or None
            Index; of those that lower it by as much, the first one. None where all are like kept ones.
        """
        index = int(gap_kernels.find_best(self.gains, gap, alike, self._cells))
        return None if index < 0 else index

    def keep(self, index: int) -> None:
        """Keep one more.

        Parameters
        ----------
        index : int
            Of a scenario.
        """
        gap_kernels.keep(index, self._cells)


def _order(places: FloatArray) -> IntArray:
    """Scenarios by cell, shape (cells, CELL); the last cell is filled up with the last scenario."""
    order = cKDTree(places[:, :AXES], leafsize=CELL).indices
    count = -(-len(order) // CELL)
    return np.append(order, np.full(count * CELL - len(order), order[-1])).reshape(count, CELL)
