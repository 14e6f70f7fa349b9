"""Compiled choice of initial centres for k-means, far from each other.

Distances to centres that are certainly too far away are not computed.
"""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math

import numpy as np

from cornercase._common.numba.kernel import kernel
from cornercase.clustering._cells import CELL_SIZE, MARGIN, fill_squares_to_centers, fill_squares_to_members

_BLOCK_SIZE = 128
"""Number of points whose squared distances are summed together."""


@kernel(error_model="numpy")
def choose_centers(points, cells, first, random_numbers):
    """Choose k points as initial centres by greedy k-means++, and return their indices; the first index is `first`.

    `points`, shape (n, stages, AXES_PER_STAGE), have their coordinates in groups of `AXES_PER_STAGE` axes. `cells` are
    the cells that `make_cells` makes of these points. `random_numbers`, shape (k - 1, trials), are in [0, 1): each row
    chooses one more centre, so k is one more than the number of rows. Each number in the row draws a candidate; the
    probability of a point is proportional to its squared distance to the nearest centre. The candidate that lowers the
    sum of these squared distances most becomes the centre. If candidates are tied, the first of them is chosen.
    """
    n, k = len(points), len(random_numbers) + 1
    n_blocks = -(-n // _BLOCK_SIZE)
    chosen = np.empty(k, dtype=np.int64)
    chosen[0] = first
    # Squared distances of the cells' members to their nearest centres; 0 for padding, so that no centre is nearer.
    squares = np.zeros((len(cells.indices), CELL_SIZE))
    squares_by_point, block_sums, reach = np.empty(n), np.empty(n_blocks), np.empty(len(cells.indices))
    to_centers, to_members = np.empty(len(cells.indices)), np.empty(CELL_SIZE)
    no_bound = np.full(CELL_SIZE, np.inf)
    for cell in range(len(reach)):
        fill_squares_to_members(points[first], cells.members[cell], no_bound, to_members)
        for i in range(CELL_SIZE):
            if cells.indices[cell, i] >= 0:
                squares[cell, i] = squares_by_point[cells.indices[cell, i]] = to_members[i]
        reach[cell] = (cells.radii[cell] + math.sqrt(squares[cell].max())) ** 2 * MARGIN
    for block in range(n_blocks):
        block_sums[block] = squares_by_point[block * _BLOCK_SIZE : (block + 1) * _BLOCK_SIZE].sum()
    for c in range(1, k):
        total = block_sums.sum()
        best, best_gain = -1, -1.0
        for trial in range(random_numbers.shape[1]):
            candidate = _find_index_at_cumulative_sum(
                random_numbers[c - 1, trial] * total, squares_by_point, block_sums
            )
            gain = 0.0
            fill_squares_to_centers(points[candidate], cells.centers, to_centers)
            for cell in range(len(reach)):
                if to_centers[cell] <= reach[cell] and fill_squares_to_members(
                    points[candidate], cells.members[cell], squares[cell], to_members
                ):
                    for i in range(CELL_SIZE):
                        gain += max(squares[cell, i] - to_members[i], 0.0)
            if gain > best_gain:
                best, best_gain = candidate, gain
        chosen[c] = best
        fill_squares_to_centers(points[best], cells.centers, to_centers)
        for cell in range(len(reach)):
            if to_centers[cell] <= reach[cell] and fill_squares_to_members(
                points[best], cells.members[cell], squares[cell], to_members
            ):
                for i in range(CELL_SIZE):
                    if to_members[i] < squares[cell, i]:
                        index = cells.indices[cell, i]
                        squares[cell, i] = squares_by_point[index] = to_members[i]
                        block_sums[index // _BLOCK_SIZE] = -1.0
                reach[cell] = (cells.radii[cell] + math.sqrt(squares[cell].max())) ** 2 * MARGIN
        for block in range(n_blocks):
            if block_sums[block] < 0.0:
                block_sums[block] = squares_by_point[block * _BLOCK_SIZE : (block + 1) * _BLOCK_SIZE].sum()
    return chosen


@kernel(error_model="numpy", _nrt=False)
def _find_index_at_cumulative_sum(target, squares, block_sums):
    """Return the index of the first point at which the cumulative sum of squared distances reaches `target`."""
    last, total = len(squares) - 1, 0.0
    for block in range(len(block_sums)):
        if total + block_sums[block] < target:
            total += block_sums[block]
            continue
        for i in range(block * _BLOCK_SIZE, min((block + 1) * _BLOCK_SIZE, len(squares))):
            total += squares[i]
            if total >= target:
                return i
    return last
