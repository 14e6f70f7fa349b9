"""Compiled distances to the nearest selected scenario, for scenarios with embedding coordinates."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import numpy as np

from cornercase._common.numba.kernel import kernel


@kernel(error_model="numpy")
def fill_nearest_distances(rows, columns, nearest_rows, is_chosen, result):
    """Write the squared distance of each column to the nearest row in each choice to `result`, shape (draws, m).

    `rows`, shape (n, p), and `columns`, shape (m, p), are coordinates. `nearest_rows`, shape (m, k), are the nearest
    rows of each column, the nearest first. `is_chosen`, shape (draws, n), marks the rows in each choice. The result is
    infinite if none of the nearest rows is in the choice.
    """
    for draw in range(len(is_chosen)):
        for j in range(len(nearest_rows)):
            result[draw, j] = np.inf
            for i in nearest_rows[j]:
                if is_chosen[draw, i]:
                    total = 0.0
                    for axis in range(rows.shape[1]):
                        difference = rows[i, axis] - columns[j, axis]
                        total += difference * difference
                    result[draw, j] = total
                    break
