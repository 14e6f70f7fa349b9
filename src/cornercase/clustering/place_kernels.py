"""Compiled distances to the nearest of some choices, for scenarios with places."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import numpy as np

from cornercase._common.compiling import kernel

_AT_ONCE = 64
"""Columns that are looked at one by one only where any of them is near enough."""


@kernel(error_model="numpy")
def nearest_chosen(products, row_norms, column_norms, chosen, near, found):
    """How far each row is from the nearest of each choice of columns.

    `products`, (n, m), are those of the places of rows and columns, and become their distances; `chosen`, (draws, m),
    says which columns are in a choice, and `found`, (draws, n), is filled. Of each row the `near` nearest columns are
    found first, and all others are looked at only where none of these is in a choice.
    """
    columns = products.shape[1]
    rising, which = np.empty(near), np.empty(near, dtype=np.int64)
    for i in range(len(products)):
        away = products[i]
        for j in range(columns):
            away[j] = max(away[j] * -2.0 + row_norms[i] + column_norms[j], 0.0)
        _find_nearest(away, rising, which)
        for k in range(len(chosen)):
            least = np.inf
            for place in range(near):
                if chosen[k, which[place]]:
                    least = rising[place]
                    break
            if least == np.inf:
                for j in range(columns):
                    if chosen[k, j] and away[j] < least:
                        least = away[j]
            found[k, i] = least


@kernel(error_model="numpy", _nrt=False)
def _find_nearest(away, rising, which):
    """Fill `rising` with the least numbers in their order, and `which` with where they are."""
    rising[:] = np.inf
    last = len(rising) - 1
    for first in range(0, len(away), _AT_ONCE):
        end = min(first + _AT_ONCE, len(away))
        nearer, bound = 0, rising[last]
        for j in range(first, end):
            nearer += away[j] < bound
        if not nearer:
            continue
        for j in range(first, end):
            if away[j] < rising[last]:
                place = last
                while place > 0 and rising[place - 1] > away[j]:
                    rising[place], which[place] = rising[place - 1], which[place - 1]
                    place -= 1
                rising[place], which[place] = away[j], j
