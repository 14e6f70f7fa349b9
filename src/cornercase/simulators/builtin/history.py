"""Motion of all entities over time, as a batch records it."""

from __future__ import annotations

from typing import Final

import numpy as np

from cornercase._common.typing import BoolArray, FloatArray

# Steps are collected in blocks of this many: copying a block at once is faster than copying step by step.
_BLOCK: Final = 32


class History:
    """Rows of state over time, one after the other for each scenario.

    Each block is stored as a table of its own. Growing one table would copy everything again.

    Parameters
    ----------
    shape : tuple of int
        (quantities, entities, scenarios).
    """

    def __init__(self, shape: tuple[int, int, int]) -> None:
        self._block = np.empty((_BLOCK, *shape))
        self._waiting = 0
        self._tables: list[FloatArray] = []

    def add(self, row: tuple[FloatArray, ...], valid: BoolArray) -> None:
        """Append the quantities of one instant, each (entities, scenarios); NaN where `valid` is false."""
        for place, quantity in zip(self._block[self._waiting], row, strict=True):
            place[...] = quantity
            place[~valid] = np.nan
        self._waiting += 1
        if self._waiting == _BLOCK:
            self._sort_in()

    def of(self, scenario: int, instants: int) -> FloatArray:
        """First instants of one scenario, shape (quantities, entities, instants)."""
        if self._waiting:
            self._sort_in()
        motion: FloatArray = np.concatenate([table[scenario] for table in self._tables], axis=-1)
        return motion[..., :instants]

    def _sort_in(self) -> None:
        self._tables.append(np.ascontiguousarray(self._block[: self._waiting].transpose(3, 1, 2, 0)))
        self._waiting = 0
