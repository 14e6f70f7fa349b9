"""What a batch writes down in every step."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase.typing import BoolArray, FloatArray

# Steps that are kept apart until they are sorted in together, which memory likes better than one by one.
_BLOCK: Final = 16


class History:
    """Rows of state over time, one after the other for each scenario.

    Parameters
    ----------
    shape : tuple of int
        (quantities, entities, scenarios).
    """

    def __init__(self, shape: tuple[int, int, int]) -> None:
        self._block = np.empty((_BLOCK, *shape))
        self._waiting = 0
        self._kept = 0
        self._table = np.empty((shape[2], shape[0], shape[1], 8 * _BLOCK))

    def add(self, row: tuple[FloatArray, ...], valid: BoolArray) -> None:
        """Append the quantities of one instant, each (entities, scenarios); NaN where `valid` is false."""
        for place, quantity in zip(self._block[self._waiting], row, strict=True):
            place[...] = quantity
            place[~valid] = np.nan
        self._waiting += 1
        if self._waiting == _BLOCK:
            self._sort_in()

    def table(self) -> FloatArray:
        """All of it, shape (scenarios, quantities, entities, instants)."""
        self._sort_in()
        return self._table[..., : self._kept]

    def _sort_in(self) -> None:
        end = self._kept + self._waiting
        if end > self._table.shape[3]:
            larger = np.empty((*self._table.shape[:3], 2 * self._table.shape[3]))
            larger[..., : self._kept] = self._table[..., : self._kept]
            self._table = larger
        self._table[..., self._kept : end] = self._block[: self._waiting].transpose(3, 1, 2, 0)
        self._kept, self._waiting = end, 0
