"""Compiled search for nearest points with many axes; fast if points differ most in the first axes."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math

import numpy as np

from cornercase._common.numba.kernel import kernel
from cornercase.clustering._cells import CELL_SIZE, MARGIN, fill_squares_to_centers, fill_squares_to_members


@kernel(error_model="numpy")
def fill_nearest_rows(columns, cells, result):
    """Find the k points of one set that are nearest to each point of another set.

    The points to find are those of `cells`, made by `make_cells`, at least k points; they are the rows of a distance
    matrix. The others are its columns: `columns`, shape (m, stages, AXES_PER_STAGE), has the coordinates of m points in
    groups of `AXES_PER_STAGE` axes. The indices of the nearest rows, the nearest first, are written to `result`, shape
    (m, k).
    """
    n_nearest, n_cells = result.shape[1], len(cells.indices)
    to_centers, to_members, bounds = np.empty(n_cells), np.empty(CELL_SIZE), np.empty(CELL_SIZE)
    nearest, nearest_squares = np.empty(n_nearest, dtype=np.int64), np.empty(n_nearest)
    for j in range(len(columns)):
        fill_squares_to_centers(columns[j], cells.centers, to_centers)
        # A column that is not finite is near to none, and gets row 0.
        nearest[:], nearest_squares[:] = 0, np.inf
        start = to_centers.argmin()
        # Neighbours in the order of cells are mostly near, too, so that nearly all others are skipped.
        for step in range(n_cells):
            cell = (start + (step + 1) // 2 * (1 - 2 * (step % 2))) % n_cells
            farthest = nearest_squares[n_nearest - 1]
            if to_centers[cell] > (cells.radii[cell] + math.sqrt(farthest)) ** 2 * MARGIN:
                continue
            bounds[:] = farthest
            if not fill_squares_to_members(columns[j], cells.members[cell], bounds, to_members):
                continue
            for i in range(CELL_SIZE):
                if cells.indices[cell, i] >= 0 and to_members[i] < nearest_squares[n_nearest - 1]:
                    k = n_nearest - 1
                    while k > 0 and nearest_squares[k - 1] > to_members[i]:
                        nearest_squares[k], nearest[k] = nearest_squares[k - 1], nearest[k - 1]
                        k -= 1
                    nearest_squares[k], nearest[k] = to_members[i], cells.indices[cell, i]
        result[j] = nearest
