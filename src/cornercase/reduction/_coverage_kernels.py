"""Compiled coverage sums for embedded scenarios, computed by cells (groups) of nearby scenarios.

A coverage sum adds up a cost for each scenario, which grows with the distance to the nearest selected scenario. A newly
selected scenario becomes the nearest selected scenario for few others. Most cells are too far away to contain one of
these few. So if many scenarios are selected, most distances are never computed.
"""

# Compiled functions have no static types.
# mypy: disable-error-code="no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cornercase._common.numba.kernel import kernel
from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering._cells import CELL_SIZE, MARGIN, fill_squares_to_centers, fill_squares_to_members

MAX_KNOWN_TERMS = 192
"""Largest number of stored terms of a scenario's gain; with more terms, the cells are searched again."""


class CoverageCells(NamedTuple):
    """Cells (groups) of nearby scenarios in all clusterings, with the cost of each scenario.

    `coordinates`, (clusterings, n, stages, AXES), are in the order of the scenarios, the axis of largest variance
    first; `members`, (clusterings, c, stages, AXES, CELL), are the same coordinates by cell. `centers`, (clusterings,
    AXES, c), and `radii` are bounding balls of the cells in the first axes. `nearest_squares` are squared distances to
    the nearest selected scenario, and `costs` are computed from them. A scenario can become the nearest selected
    scenario of a cell's member only if its squared distance to the cell's centre is at most `reach`.

    The gain of a scenario is the amount by which its selection lowers the total cost. The gain has a term for each
    scenario that would become cheaper, so terms only disappear as more scenarios are selected. `n_terms`, shape (n,),
    is the number of terms once it is at most `MAX_KNOWN_TERMS`, before that -1. For each term, `term_members`,
    (n, TERMS), is an index into the flattened `costs`, and `term_costs` is the cost after the selection.
    """

    coordinates: FloatArray
    members: FloatArray
    centers: FloatArray
    radii: FloatArray
    weights: FloatArray
    usual_distances: FloatArray
    power: int
    nearest_squares: FloatArray
    reach: FloatArray
    costs: FloatArray
    n_terms: IntArray
    term_members: npt.NDArray[np.int32]
    term_costs: FloatArray


@kernel(error_model="numpy")
def fill_gains(gains, cells):
    """Write to `gains` the amount by which selecting each scenario would lower the coverage sum (total cost)."""
    to_centers, to_members = np.empty(cells.members.shape[1]), np.empty(CELL_SIZE)
    for index in range(len(gains)):
        gains[index] = _gain_of(index, cells, to_centers, to_members)


@kernel(error_model="numpy")
def find_best_candidate(gains, cells):
    """Return the scenario whose selection lowers the coverage sum most, the first if tied; -1 if all gains are -inf.

    `gains` were computed when fewer scenarios were selected. Gains never increase, so the old values are upper bounds,
    and only the largest are computed again.
    """
    to_centers, to_members = np.empty(cells.members.shape[1]), np.empty(CELL_SIZE)
    last = -1
    while True:
        best = int(np.argmax(gains))
        if best == last:
            return best
        if gains[best] == -np.inf:
            return -1
        if cells.n_terms[best] < 0:
            gains[best] = _gain_of(best, cells, to_centers, to_members)
        else:
            gains[best] = _gain_of_known_terms(best, cells)
        last = best


@kernel(error_model="numpy")
def add_to_selection(index, cells):
    """Update `nearest_squares`, `costs` and `reach` of the cells after scenario `index` was selected."""
    to_centers, to_members = np.empty(cells.members.shape[1]), np.empty(CELL_SIZE)
    for k in range(len(cells.members)):
        point = cells.coordinates[k, index]
        fill_squares_to_centers(point, cells.centers[k], to_centers)
        for cell in range(len(to_centers)):
            if to_centers[cell] <= cells.reach[k, cell] and fill_squares_to_members(
                point, cells.members[k, cell], cells.nearest_squares[k, cell], to_members
            ):
                squares, costs = cells.nearest_squares[k, cell], cells.costs[k, cell]
                for i in range(CELL_SIZE):
                    if to_members[i] < squares[i]:
                        squares[i] = to_members[i]
                        costs[i] = _weighted_cost(
                            to_members[i], cells.usual_distances[k], cells.power, cells.weights[k, cell, i]
                        )
                cells.reach[k, cell] = (cells.radii[k, cell] + math.sqrt(squares.max())) ** 2 * MARGIN


@kernel(error_model="numpy", _nrt=False)
def _gain_of(index, cells, to_centers, to_members):
    gain, n_terms = 0.0, 0
    term_members, term_costs = cells.term_members[index], cells.term_costs[index]
    for k in range(len(cells.members)):
        point = cells.coordinates[k, index]
        fill_squares_to_centers(point, cells.centers[k], to_centers)
        for cell in range(len(to_centers)):
            if to_centers[cell] <= cells.reach[k, cell] and fill_squares_to_members(
                point, cells.members[k, cell], cells.nearest_squares[k, cell], to_members
            ):
                squares, costs, weights = cells.nearest_squares[k, cell], cells.costs[k, cell], cells.weights[k, cell]
                for i in range(CELL_SIZE):
                    if to_members[i] < squares[i]:
                        cost = _weighted_cost(to_members[i], cells.usual_distances[k], cells.power, weights[i])
                        gain += costs[i] - cost
                        if n_terms < MAX_KNOWN_TERMS:
                            term_members[n_terms] = (k * len(to_centers) + cell) * CELL_SIZE + i
                            term_costs[n_terms] = cost
                        n_terms += 1
    if n_terms <= MAX_KNOWN_TERMS:
        cells.n_terms[index] = n_terms
    return gain


@kernel(error_model="numpy", _nrt=False)
def _gain_of_known_terms(index, cells):
    gain, n_terms = 0.0, 0
    term_members, term_costs = cells.term_members[index], cells.term_costs[index]
    costs = cells.costs.reshape(-1)
    for term in range(cells.n_terms[index]):
        member, cost = term_members[term], term_costs[term]
        if cost < costs[member]:
            gain += costs[member] - cost
            term_members[n_terms], term_costs[n_terms] = member, cost
            n_terms += 1
    cells.n_terms[index] = n_terms
    return gain


@kernel(error_model="numpy", _nrt=False)
def _weighted_cost(distance, usual_distance, power, weight):
    ratio = distance / usual_distance
    return ratio * ratio * ratio * weight if power == 3 else ratio * ratio * weight
