"""Compiled coverage sums for embedded scenarios, by cells of nearby scenarios.

An added scenario becomes the nearest one for few others, and most cells are too far away to contain one of these. So if
many are selected, most distances are never computed.
"""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cornercase._common.compiling import kernel
from cornercase._common.typing import FloatArray

CELL = 16
"""Number of scenarios in a cell."""

AXES = 8
"""Number of axes by which cells are formed, and after which the distance computation may stop early."""

_MARGIN = 1.0 + 1e-9
"""Factor by which bounds are wider, far more than rounding."""


class Cells(NamedTuple):
    """Cells of all clusterings, and the uncovered costs in them.

    `coordinates`, (clusterings, n, stages, AXES), are in the order of the scenarios and `members`, (clusterings, c,
    stages, AXES, CELL), in the order of the cells, the axis of largest variance first. `centres`, (clusterings, AXES,
    c), and `radii` are bounding balls of the cells in the first axes. `nearest_squares` are squared distances to the
    nearest selected scenario and `costs` follow from them; a scenario farther from a centre than the root of `reach` is
    nearest to none of the cell.
    """

    coordinates: FloatArray
    members: FloatArray
    centres: FloatArray
    radii: FloatArray
    weights: FloatArray
    usual_distances: FloatArray
    power: int
    nearest_squares: FloatArray
    reach: FloatArray
    costs: FloatArray


@kernel(error_model="numpy")
def find_gains(gains, of):
    """Fill `gains` with the amount by which each scenario would lower the sum."""
    to_centres, to_members = np.empty(of.members.shape[1]), np.empty(CELL)
    for index in range(len(gains)):
        gains[index] = _gain(index, of, to_centres, to_members)


@kernel(error_model="numpy")
def find_best(gains, gap, alike, of):
    """Return the scenario with a gap that would lower the sum most, the first of equals; -1 if there is none.

    `gains` are upper bounds from when fewer were selected, and are updated as needed.
    """
    to_centres, to_members = np.empty(of.members.shape[1]), np.empty(CELL)
    last = -1
    while True:
        best = int(np.argmax(gains))
        if best == last:
            return best
        if gains[best] == -np.inf:
            return -1
        if gap[best] <= alike:
            gains[best] = -np.inf
        else:
            gains[best] = _gain(best, of, to_centres, to_members)
            last = best


@kernel(error_model="numpy")
def keep(index, of):
    """Update distances, costs and reaches for a newly selected scenario."""
    to_centres, to_members = np.empty(of.members.shape[1]), np.empty(CELL)
    for k in range(len(of.members)):
        point = of.coordinates[k, index]
        _measure_away(point, of.centres[k], to_centres)
        for cell in range(len(to_centres)):
            if to_centres[cell] <= of.reach[k, cell] and _come_near(
                point, of.members[k, cell], of.nearest_squares[k, cell], to_members
            ):
                squares, costs = of.nearest_squares[k, cell], of.costs[k, cell]
                for i in range(CELL):
                    if to_members[i] < squares[i]:
                        squares[i] = to_members[i]
                        costs[i] = _cost(to_members[i], of.usual_distances[k], of.power, of.weights[k, cell, i])
                of.reach[k, cell] = (of.radii[k, cell] + math.sqrt(squares.max())) ** 2 * _MARGIN


@kernel(error_model="numpy", _nrt=False)
def _gain(index, of, away, apart):
    gain = 0.0
    for k in range(len(of.members)):
        point = of.coordinates[k, index]
        _measure_away(point, of.centres[k], away)
        for cell in range(len(away)):
            if away[cell] <= of.reach[k, cell] and _come_near(
                point, of.members[k, cell], of.nearest_squares[k, cell], apart
            ):
                squares, costs, weights = of.nearest_squares[k, cell], of.costs[k, cell], of.weights[k, cell]
                for i in range(CELL):
                    if apart[i] < squares[i]:
                        gain += costs[i] - _cost(apart[i], of.usual_distances[k], of.power, weights[i])
    return gain


@kernel(error_model="numpy", _nrt=False)
def _measure_away(place, centres, away):
    away[:] = 0.0
    for axis in range(AXES):
        for cell in range(len(away)):
            difference = place[0, axis] - centres[axis, cell]
            away[cell] += difference * difference


@kernel(error_model="numpy", _nrt=False)
def _come_near(place, cell, near, apart):
    """Fill `result` with squared distances to a cell; False as soon as none can be nearer than `nearest_squares`."""
    apart[:] = 0.0
    for stage in range(len(place)):
        n_nearer = 0
        for i in range(CELL):
            total = apart[i]
            for axis in range(AXES):
                difference = place[stage, axis] - cell[stage, axis, i]
                total += difference * difference
            apart[i] = total
            n_nearer += total < near[i]
        if not n_nearer:
            return False
    return True


@kernel(error_model="numpy", _nrt=False)
def _cost(distance, usual, power, heavy):
    ratio = distance / usual
    return ratio * ratio * ratio * heavy if power == 3 else ratio * ratio * heavy
