"""Compiled distances to the nearest selected scenario, for scenarios with embedding coordinates."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import numpy as np

from cornercase._common.numba.kernel import kernel

_BLOCK_COLUMNS = 64
"""Block of columns that is searched one by one only if any of them is near enough."""


@kernel(error_model="numpy")
def fill_nearest_distances(inner_products, row_norms, column_norms, is_chosen, n_nearest, result):
    """Fill `result`, shape (draws, n), with the distance of each row to the nearest column of each choice.

    `inner_products`, shape (n, m), are inner products of the embeddings, and are overwritten by distances; `is_chosen`,
    shape (draws, m), marks the columns of each choice. The `n_nearest` nearest columns of a row are found first, and
    the others are searched only if none of these is in the choice.
    """
    columns = inner_products.shape[1]
    smallest, nearest = np.empty(n_nearest), np.empty(n_nearest, dtype=np.int64)
    for i in range(len(inner_products)):
        distances = inner_products[i]
        for j in range(columns):
            distances[j] = max(distances[j] * -2.0 + row_norms[i] + column_norms[j], 0.0)
        _find_smallest(distances, smallest, nearest)
        for k in range(len(is_chosen)):
            nearest_distance = np.inf
            for rank in range(n_nearest):
                if is_chosen[k, nearest[rank]]:
                    nearest_distance = smallest[rank]
                    break
            if nearest_distance == np.inf:
                for j in range(columns):
                    if is_chosen[k, j] and distances[j] < nearest_distance:
                        nearest_distance = distances[j]
            result[k, i] = nearest_distance


@kernel(error_model="numpy", _nrt=False)
def _find_smallest(values, smallest, indices):
    """Fill `smallest` with the smallest values in order, and `indices` with their indices."""
    smallest[:] = np.inf
    last = len(smallest) - 1
    for first in range(0, len(values), _BLOCK_COLUMNS):
        end = min(first + _BLOCK_COLUMNS, len(values))
        candidates, bound = 0, smallest[last]
        for j in range(first, end):
            candidates += values[j] < bound
        if not candidates:
            continue
        for j in range(first, end):
            if values[j] < smallest[last]:
                rank = last
                while rank > 0 and smallest[rank - 1] > values[j]:
                    smallest[rank], indices[rank] = smallest[rank - 1], indices[rank - 1]
                    rank -= 1
                smallest[rank], indices[rank] = values[j], j
