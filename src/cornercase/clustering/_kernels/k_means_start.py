"""Compiled choice of initial centres for k-means, far from each other.

Distances of all scenarios to all centres are not needed.
"""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math

import numpy as np

from cornercase._common.numba.kernel import kernel

CELL_SIZE = 16
"""Number of points in a cell."""

N_CELL_AXES = 8
"""Number of first axes in which cells are bounded."""

_MARGIN = 1.0 + 1e-9
"""Factor by which bounds are wider, far more than rounding."""

_BLOCK_SIZE = 128
"""Number of points whose squared distances are summed together."""


@kernel(error_model="numpy")
def choose_centers(points, cells, first, random_numbers):
    """Return the indices of k centres by greedy k-means++; `first` is the first centre.

    `points` have shape (n, p) with p at least `N_CELL_AXES`. `cells`, shape (c, CELL_SIZE), are groups of nearby
    points, padded with -1. `random_numbers`, shape (k - 1, trials), are in [0, 1). Each of them draws a candidate, with
    a probability in proportion to the squared distance to the nearest centre. The candidate that lowers the sum of
    these squared distances most becomes the next centre, the first if tied.
    """
    n, k = len(points), len(random_numbers) + 1
    chosen = np.empty(k, dtype=np.int64)
    chosen[0] = first
    middles, radii = _bounding_balls_of_cells(points, cells)
    squares = np.empty(n)
    for i in range(n):
        squares[i] = _squared_distance(points[i], points[first], np.inf)
    reach = np.empty(len(cells))
    for cell in range(len(cells)):
        reach[cell] = _cell_reach(cells[cell], radii[cell], squares)
    block_sums = np.empty(-(-n // _BLOCK_SIZE))
    for block in range(len(block_sums)):
        block_sums[block] = squares[block * _BLOCK_SIZE : (block + 1) * _BLOCK_SIZE].sum()
    for c in range(1, k):
        total = block_sums.sum()
        best, best_gain = -1, -1.0
        for trial in range(random_numbers.shape[1]):
            candidate = _draw(random_numbers[c - 1, trial] * total, squares, block_sums)
            gain = 0.0
            for cell in range(len(cells)):
                if _squared_distance_to_middle(points[candidate], middles[cell]) <= reach[cell]:
                    for i in cells[cell]:
                        if i >= 0:
                            square = _squared_distance(points[i], points[candidate], squares[i])
                            gain += max(squares[i] - square, 0.0)
            if gain > best_gain:
                best, best_gain = candidate, gain
        chosen[c] = best
        for cell in range(len(cells)):
            if _squared_distance_to_middle(points[best], middles[cell]) > reach[cell]:
                continue
            is_nearer = False
            for i in cells[cell]:
                if i < 0:
                    continue
                square = _squared_distance(points[i], points[best], squares[i])
                if square < squares[i]:
                    squares[i] = square
                    is_nearer = True
                    block_sums[i // _BLOCK_SIZE] = -1.0
            if is_nearer:
                reach[cell] = _cell_reach(cells[cell], radii[cell], squares)
        for block in range(len(block_sums)):
            if block_sums[block] < 0.0:
                block_sums[block] = squares[block * _BLOCK_SIZE : (block + 1) * _BLOCK_SIZE].sum()
    return chosen


@kernel(error_model="numpy", _nrt=False)
def _draw(target, squares, block_sums):
    """Return the first point at which the cumulative sum of squared distances reaches `target`."""
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


@kernel(error_model="numpy")
def _bounding_balls_of_cells(points, cells):
    """Bounding balls of the cells in the first axes: return middles, shape (c, N_CELL_AXES), and radii."""
    middles, radii = np.zeros((len(cells), N_CELL_AXES)), np.zeros(len(cells))
    for cell in range(len(cells)):
        count = 0
        for i in cells[cell]:
            if i >= 0:
                middles[cell] += points[i, :N_CELL_AXES]
                count += 1
        middles[cell] /= count
        for i in cells[cell]:
            if i >= 0:
                square = _squared_distance_to_middle(points[i], middles[cell])
                radii[cell] = max(radii[cell], math.sqrt(square) * _MARGIN)
    return middles, radii


@kernel(error_model="numpy", _nrt=False)
def _cell_reach(members, radius, squares):
    """Return the distance limit for a cell: a centre farther from the middle is nearest to none of its points.

    The limit is a squared distance.
    """
    largest = 0.0
    for i in members:
        if i >= 0:
            largest = max(largest, squares[i])
    return (radius + math.sqrt(largest)) ** 2 * _MARGIN


@kernel(error_model="numpy", _nrt=False)
def _squared_distance_to_middle(point, middle):
    total = 0.0
    for axis in range(N_CELL_AXES):
        difference = point[axis] - middle[axis]
        total += difference * difference
    return total


@kernel(error_model="numpy", _nrt=False)
def _squared_distance(point, other_point, bound):
    """Return the squared distance of two points; if it is at least `bound`, any number of at least `bound`."""
    total = 0.0
    for first in range(0, len(point), N_CELL_AXES):
        for axis in range(first, min(first + N_CELL_AXES, len(point))):
            difference = point[axis] - other_point[axis]
            total += difference * difference
        if total >= bound:
            break
    return total
