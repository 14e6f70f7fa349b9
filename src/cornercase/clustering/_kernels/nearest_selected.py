"""Compiled distances to the nearest selected scenario, for scenarios with embedding coordinates."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import numpy as np

from cornercase._common.numba.kernel import kernel


@kernel(error_model="numpy")
def fill_nearest_distances(rows, columns, nearest_rows, choices, result):
    """For several selections of points, compute the squared distance of other points to the nearest selected point.

    `rows`, shape (n, p), are the coordinates of the points that can be selected; `columns`, shape (m, p), those of the
    other points. Each of the c rows of `choices` is one selection: indices into `rows`. The result for each selection
    is written to a row of `result`, shape (c, m). `nearest_rows`, shape (m, k), has for each point in `columns` the
    indices of the k nearest points in `rows`, the nearest first.
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
