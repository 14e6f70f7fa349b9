"""Optimizer that proposes a regular grid, as a baseline for every search."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray, IntArray
from cornercase.optimizers._base import Optimizer
from cornercase.scenario import ParameterSpace

_MAX_POINTS: Final = 1_000_000


class Grid(Optimizer):
    """Full factorial design: all points of a regular grid.

    Each parameter has as many steps as fit into the budget, and at least one. Nothing is random. `start` refuses a grid
    of more than a million points.

    Examples
    --------
    >>> import cornercase as cc
    >>> search = cc.optimizers.Grid()
    >>> str(search)
    'grid'
    >>> study.explore(search, budget=125)  # doctest: +SKIP
    """

    name = "grid"
    multi_objective = True
    requires = frozenset({"budget"})

    def prepare(self, space: ParameterSpace, seed: int, budget: int) -> None:
        """Make the grid that fits into `budget`."""
        self._n_observed = 0
        steps = [1] * space.dimension
        sizes = [parameter.size or budget for parameter in space.parameters]
        while True:
            # Add a step to the parameter with the fewest steps, as long as the grid stays within the budget.
            order = sorted((steps[j], j) for j in range(len(steps)) if steps[j] < sizes[j])
            grown = next((j for count, j in order if math.prod(steps) // count * (count + 1) <= budget), None)
            if grown is None:
                break
            steps[grown] += 1
            if math.prod(steps) > _MAX_POINTS:
                raise InputError(
                    f"`budget` {budget}: its grid has more than {_MAX_POINTS} points, which would"
                    f" take gigabytes of memory;"
                    " give a smaller budget, or use the optimizer sobol."
                )
        grid = space.full_factorial(steps)
        grid = grid[_space_filling_order(steps)]
        self._points = grid[space.is_admissible(grid)]

    def ask(self, n: int) -> FloatArray:
        """Return the next points of the grid, at most `n`, (m, d)."""
        return self._points[self._n_observed : self._n_observed + n].copy()

    def ask_async(self, n: int, pending: FloatArray, *lies: Any) -> FloatArray:
        """Return the next points of the grid after those in `pending`."""
        start = self._n_observed + len(pending)
        return self._points[start : start + n].copy()

    def tell(self, points: FloatArray, scores: FloatArray) -> None:
        """Continue the grid after these points; scores have no effect."""
        self._n_observed += len(points)


def _space_filling_order(steps: list[int]) -> IntArray:
    """Return an order of the cells of a grid in which the first cells always cover the space.

    This is the order in which the points of a Sobol' sequence reach the cells.
    """
    size = int(np.prod(steps))
    # Imported late, since it takes half a second and few searches need it.
    from scipy.stats import qmc

    points = qmc.Sobol(len(steps), scramble=False).random_base2((8 * size - 1).bit_length())
    cells = np.ravel_multi_index(tuple((points * steps).astype(np.int64).T), tuple(steps))
    reached, first = np.unique(cells, return_index=True)
    rest = np.setdiff1d(np.arange(size), reached)
    return np.asarray(np.concatenate([reached[np.argsort(first)], rest]), dtype=np.int64)
