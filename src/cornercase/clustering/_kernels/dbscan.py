"""Compiled DBSCAN, which for some hundred points is faster than a library with input checks and a search tree."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import numpy as np

from cornercase._common.numba.kernel import kernel

_NOISE = -1


@kernel(error_model="numpy")
def dbscan_labels(points, eps, min_samples, labels):
    """Write the DBSCAN cluster of each point to `labels`, shape (n,); -1 is noise.

    `points` have shape (n, k). Clusters are numbered in the order of their first dense points. A border point (not
    dense, but within `eps` of a dense point) belongs to the first cluster with a dense point so near.
    """
    count, dimensions = points.shape
    square = eps * eps
    columns = np.ascontiguousarray(points.T)
    near, dense = np.empty((count, count), dtype=np.bool_), np.empty(count, dtype=np.bool_)
    squares = np.empty(count)
    for i in range(count):
        squares[:] = 0.0
        for k in range(dimensions):
            column, value = columns[k], columns[k, i]
            for j in range(count):
                difference = value - column[j]
                squares[j] += difference * difference
        n_near = 0
        for j in range(count):
            near[i, j] = squares[j] <= square
            n_near += near[i, j]
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
                if near[i, j] and labels[j] == _NOISE:
                    labels[j] = number
                    if dense[j]:
                        waiting[n_waiting] = j
                        n_waiting += 1
        number += 1
