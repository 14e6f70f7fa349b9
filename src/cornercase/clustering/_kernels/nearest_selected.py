"""Compiled distances to the nearest selected scenario, for scenarios with embedding coordinates."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import numpy as np

from cornercase._common.numba.kernel import kernel


@kernel(error_model="numpy")
def fill_nearest_distances(rows, columns, nearest_rows, choices, result):
    """Write to `result`, shape (choices, m), the squared distance of each column to the nearest chosen row.

    Rows and columns are points: `rows`, shape (n, p), and `columns`, shape (m, p), are their coordinates. `choices` has
    several alternative choices, one per line, as indices of `rows`. `nearest_rows`, shape (m, k), are the indices of
    the k rows nearest to each column, the nearest first.
    """
    is_chosen = np.zeros(len(rows), dtype=np.bool_)
    for draw in range(len(choices)):
        for i in choices[draw]:
            is_chosen[i] = True
        for j in range(len(columns)):
            nearest = -1
            for i in nearest_rows[j]:
                if is_chosen[i]:
                    nearest = i
                    break
            if nearest >= 0:
                result[draw, j] = _squared_distance(rows[nearest], columns[j], np.inf)
                continue
            # None of the nearest rows is in the choice.
            smallest = np.inf
            for i in choices[draw]:
                smallest = min(smallest, _squared_distance(rows[i], columns[j], smallest))
            result[draw, j] = smallest
        for i in choices[draw]:
            is_chosen[i] = False


@kernel(error_model="numpy", _nrt=False)
def _squared_distance(row, column, bound):
    """Return the squared distance of two points.

    If the distance is at least `bound`, the result is any number of at least `bound`.
    """
    total = 0.0
    for axis in range(len(row)):
        difference = row[axis] - column[axis]
        total += difference * difference
        if total >= bound:
            break
    return total
