"""Compiled distances to the nearest selected scenario, for scenarios with embedding coordinates."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import numpy as np

from cornercase._common.compiling import kernel

_AT_ONCE = 64
"""Block of columns that is searched one by one only if any of them is near enough."""


@kernel(error_model="numpy")
def nearest_chosen(products, row_norms, column_norms, chosen, near, found):
    """Fill `result`, shape (draws, n), with the distance of each row to the nearest column of each choice.

    `inner_products`, shape (n, m), are inner products of the embeddings, and are overwritten by distances; `is_chosen`,
    shape (draws, m), marks the columns of each choice. The `n_nearest` nearest columns of a row are found first, and
    the others are searched only if none of these is in the choice.
    """
    columns = products.shape[1]
    smallest, nearest = np.empty(near), np.empty(near, dtype=np.int64)
    for i in range(len(products)):
        distances = products[i]
        for j in range(columns):
            distances[j] = max(distances[j] * -2.0 + row_norms[i] + column_norms[j], 0.0)
        _find_nearest(distances, smallest, nearest)
        for k in range(len(chosen)):
            nearest_distance = np.inf
            for rank in range(near):
                if chosen[k, nearest[rank]]:
                    nearest_distance = smallest[rank]
                    break
            if nearest_distance == np.inf:
                for j in range(columns):
                    if chosen[k, j] and distances[j] < nearest_distance:
                        nearest_distance = distances[j]
            found[k, i] = nearest_distance


@kernel(error_model="numpy", _nrt=False)
def _find_nearest(away, rising, which):
    """Fill `smallest` with the smallest values in order, and `indices` with their indices."""
    rising[:] = np.inf
    last = len(rising) - 1
    for first in range(0, len(away), _AT_ONCE):
        end = min(first + _AT_ONCE, len(away))
        candidates, bound = 0, rising[last]
        for j in range(first, end):
            candidates += away[j] < bound
        if not candidates:
            continue
        for j in range(first, end):
            if away[j] < rising[last]:
                rank = last
                while rank > 0 and rising[rank - 1] > away[j]:
                    rising[rank], which[rank] = rising[rank - 1], which[rank - 1]
                    rank -= 1
                rising[rank], which[rank] = away[j], j
