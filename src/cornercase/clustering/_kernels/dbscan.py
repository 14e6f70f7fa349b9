"""Compiled DBSCAN; for some hundred points faster than the input checks and search tree of a library."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import numpy as np

from cornercase._common.numba.kernel import kernel

_NOISE = -1


@kernel(error_model="numpy")
def dbscan_labels(points, eps, min_samples, labels):
    """Write the DBSCAN cluster of each point to `labels`, shape (n,); -1 is noise.

    `points` have shape (n, k). Clusters are numbered in the order of their first dense points. A border point belongs
    to the first cluster that has a dense point in its neighbourhood.
    """
    count = len(points)
    square = eps * eps
    dense = np.empty(count, dtype=np.bool_)
    for i in range(count):
        n_near = 0
        for j in range(count):
            n_near += _squared_distance(points, i, j) <= square
        dense[i] = n_near >= min_samples
    labels[:] = _NOISE
    waiting = np.empty(count, dtype=np.int64)
    number = 0
    for first in range(count):
        if not dense[first] or labels[first] != _NOISE:
            continue
        labels[first], waiting[0], n_waiting = number, first, 1
        while n_waiting > 0:
            n_waiting -= 1
            i = waiting[n_waiting]
            for j in range(count):
                if labels[j] == _NOISE and _squared_distance(points, i, j) <= square:
                    labels[j] = number
                    if dense[j]:
                        waiting[n_waiting] = j
                        n_waiting += 1
        number += 1


@kernel(error_model="numpy")
def _squared_distance(points, i, j):
    total = 0.0
    for k in range(points.shape[1]):
        difference = points[i, k] - points[j, k]
        total += difference * difference
    return total
