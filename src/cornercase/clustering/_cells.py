"""Cells, groups of nearby points: a search skips a whole cell if it is too far away."""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from cornercase._common.numba.kernel import kernel
from cornercase._common.typing import FloatArray, IntArray

CELL_SIZE = 16
"""Number of points in a cell."""

AXES_PER_STAGE = 8
"""Number of axes by which cells are formed, and after which the distance computation may stop early."""

MARGIN = 1.0 + 1e-9
"""Factor that widens bounds by far more than rounding errors."""


class Cells(NamedTuple):
    """All cells: groups of `CELL_SIZE` nearby points, whose coordinates are next to each other in memory.

    `indices`, shape (c, CELL_SIZE), are the indices of the points in the c cells. The last cell is filled up with
    copies of the last point, which have the index -1. `members`, shape (c, stages, AXES_PER_STAGE, CELL_SIZE), are the
    coordinates; a stage is a group of axes. `centers`, shape (AXES_PER_STAGE, c), and `radii`, shape (c,), describe a
    ball around the points of each cell, in the axes of the first stage only.
    """

    indices: IntArray
    members: FloatArray
    centers: FloatArray
    radii: FloatArray


def pad_axes(points: FloatArray) -> FloatArray:
    """Add axes of zeros until their number is a multiple of `AXES_PER_STAGE`."""
    n_axes = -(-points.shape[1] // AXES_PER_STAGE) * AXES_PER_STAGE
    return np.pad(points, ((0, 0), (0, n_axes - points.shape[1])))


def make_cells(points: FloatArray) -> Cells:
    """Group points, shape (n, p), into cells of nearby points; p is a multiple of `AXES_PER_STAGE`."""
    order = cKDTree(points[:, :AXES_PER_STAGE], leafsize=CELL_SIZE).indices
    count = -(-len(order) // CELL_SIZE)
    n_padding = count * CELL_SIZE - len(order)
    members = points[np.append(order, np.full(n_padding, order[-1]))].reshape(count, CELL_SIZE, -1)
    first = members[..., :AXES_PER_STAGE]
    centers = first.mean(axis=1)
    radii = np.sqrt(((first - centers[:, None]) ** 2).sum(axis=2).max(axis=1))
    return Cells(
        np.append(order, np.full(n_padding, -1)).reshape(count, CELL_SIZE),
        np.ascontiguousarray(members.transpose(0, 2, 1)).reshape(count, -1, AXES_PER_STAGE, CELL_SIZE),
        np.ascontiguousarray(centers.T),
        radii * MARGIN,
    )


@kernel(error_model="numpy", _nrt=False)
def fill_squares_to_centers(point, centers, result):
    """Write the squared distances of a point to the centres of all cells to `result`, shape (c,).

    Only the axes of the first stage count. The point has the shape (stages, AXES_PER_STAGE).
    """
    result[:] = 0.0
    for axis in range(AXES_PER_STAGE):
        for cell in range(len(result)):
            difference = point[0, axis] - centers[axis, cell]
            result[cell] += difference * difference


@kernel(error_model="numpy", _nrt=False)
def fill_squares_to_members(point, cell, bounds, result):
    """Write the squared distances of a point to the members of a cell to `result`, shape (CELL_SIZE,).

    Stops early and returns False as soon as each distance is at least as large as its bound in `bounds`.
    """
    result[:] = 0.0
    for stage in range(len(point)):
        n_nearer = 0
        for i in range(CELL_SIZE):
            total = result[i]
            for axis in range(AXES_PER_STAGE):
                difference = point[stage, axis] - cell[stage, axis, i]
                total += difference * difference
            result[i] = total
            n_nearer += total < bounds[i]
        if not n_nearer:
            return False
    return True
