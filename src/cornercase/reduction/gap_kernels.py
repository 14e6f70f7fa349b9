"""Compiled sums of what scenarios with places leave out, by cells: some scenarios that are near each other.

A scenario that is added is nearer than what is kept to few, and most cells are too far away to hold one of these. So
where many are kept, most distances are never made.
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
"""Scenarios of a cell."""

AXES = 8
"""Axes that cells are found by, and after which is looked whether a scenario of a cell is still near enough."""

_MARGIN = 1.0 + 1e-9
"""Bounds are wider by this factor, far more than rounding."""


class Cells(NamedTuple):
    """Cells of all clusterings, and what is left in them.

    `places`, (clusterings, n, stages, AXES), are in the order of the scenarios and `cells`, (clusterings, c, stages,
    AXES, CELL), in that of the cells, the axis along which scenarios differ most first. `centres`, (clusterings, AXES,
    c), and `radii` are of balls around the cells by the first axes. `near` are squared distances to the nearest kept
    scenario, and `left` what these cost; who is farther from a centre than the root of `reach` is near to none of the
    cell.
    """

    places: FloatArray
    cells: FloatArray
    centres: FloatArray
    radii: FloatArray
    heavy: FloatArray
    usual: FloatArray
    power: int
    near: FloatArray
    reach: FloatArray
    left: FloatArray


@kernel(error_model="numpy")
def find_gains(gains, of):
    """By how much each scenario would lower the sum of what is left."""
    away, apart = np.empty(of.cells.shape[1]), np.empty(CELL)
    for index in range(len(gains)):
        gains[index] = _gain(index, of, away, apart)


@kernel(error_model="numpy")
def find_best(gains, gap, alike, of):
    """Scenario that would lower the sum most, of those that have a gap, the first one of equals; -1 where none has.

    `gains` are what they were when fewer were kept, so none has become larger, and are brought up to date as needed.
    """
    away, apart = np.empty(of.cells.shape[1]), np.empty(CELL)
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
            gains[best] = _gain(best, of, away, apart)
            last = best


@kernel(error_model="numpy")
def keep(index, of):
    """Note in `near`, `left` and `reach` that a scenario is kept."""
    away, apart = np.empty(of.cells.shape[1]), np.empty(CELL)
    for k in range(len(of.cells)):
        place = of.places[k, index]
        _measure_away(place, of.centres[k], away)
        for cell in range(len(away)):
            if away[cell] <= of.reach[k, cell] and _come_near(place, of.cells[k, cell], of.near[k, cell], apart):
                near, left = of.near[k, cell], of.left[k, cell]
                for i in range(CELL):
                    if apart[i] < near[i]:
                        near[i] = apart[i]
                        left[i] = _cost(apart[i], of.usual[k], of.power, of.heavy[k, cell, i])
                of.reach[k, cell] = (of.radii[k, cell] + math.sqrt(near.max())) ** 2 * _MARGIN


@kernel(error_model="numpy", _nrt=False)
def _gain(index, of, away, apart):
    gain = 0.0
    for k in range(len(of.cells)):
        place = of.places[k, index]
        _measure_away(place, of.centres[k], away)
        for cell in range(len(away)):
            if away[cell] <= of.reach[k, cell] and _come_near(place, of.cells[k, cell], of.near[k, cell], apart):
                near, left, heavy = of.near[k, cell], of.left[k, cell], of.heavy[k, cell]
                for i in range(CELL):
                    if apart[i] < near[i]:
                        gain += left[i] - _cost(apart[i], of.usual[k], of.power, heavy[i])
    return gain


@kernel(error_model="numpy", _nrt=False)
def _measure_away(place, centres, away):
    away[:] = 0.0
    for axis in range(AXES):
        for cell in range(len(away)):
            step = place[0, axis] - centres[axis, cell]
            away[cell] += step * step


@kernel(error_model="numpy", _nrt=False)
def _come_near(place, cell, near, apart):
    """Whether any scenario of a cell is nearer than `near`; then `apart` is how far they are."""
    apart[:] = 0.0
    for stage in range(len(place)):
        nearer = 0
        for i in range(CELL):
            total = apart[i]
            for axis in range(AXES):
                step = place[stage, axis] - cell[stage, axis, i]
                total += step * step
            apart[i] = total
            nearer += total < near[i]
        if not nearer:
            return False
    return True


@kernel(error_model="numpy", _nrt=False)
def _cost(distance, usual, power, heavy):
    cost = distance / usual
    return cost * cost * cost * heavy if power == 3 else cost * cost * heavy
