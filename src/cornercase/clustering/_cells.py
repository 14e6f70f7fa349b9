"""Cells of nearby points, by which distances to points that are too far away are never computed."""

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
"""Factor by which bounds are wider, far more than rounding."""


class Cells(NamedTuple):
    """Cells of points, with their coordinates side by side in memory.

    `indices`, shape (c, CELL), are those of the points, -1 for padding, whose coordinates are those of the last point.
    `members`, shape (c, stages, AXES, CELL), are the coordinates. `centers`, shape (AXES, c), and `radii`, shape (c,),
    are bounding balls of the cells in the first axes.
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
    """Group points into cells; their number of axes is a multiple of `AXES_PER_STAGE`."""
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
    """Write the squared distances of a point, shape (stages, AXES), to the centres of all cells to `result`."""
    result[:] = 0.0
    for axis in range(AXES_PER_STAGE):
        for cell in range(len(result)):
            difference = point[0, axis] - centers[axis, cell]
            result[cell] += difference * difference


@kernel(error_model="numpy", _nrt=False)
def measure_cell_or_give_up(point, cell, bounds, result):
    """Write the squared distances of a point to the members of a cell to `result`.

    Returns False as soon as no distance can be less than in `bounds`.
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
