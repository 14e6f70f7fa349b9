"""Pairs of neighbouring scenarios of a study: the ego collides in one of the two, and not in the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cornercase.evidence._boundary_pairs import find_boundary_pairs
from cornercase.report._report_data import ReportData


@dataclass(frozen=True)
class BoundaryPair:
    """Row indices of two neighbouring scenarios: the ego collides in one of the two, and not in the other."""

    without_collision: int
    with_collision: int


def find_collision_boundary(data: ReportData, count: int) -> list[BoundaryPair]:
    """Find up to `count` pairs of a scenario and the nearest one with the other outcome: collision or none.

    Distances are those in the unit cube, and the nearest pairs come first. Only the nearest scenario is considered, and
    no scenario is in two pairs, so there may be fewer than `count`. The result is empty if all scenarios have a
    collision, if no scenario has one, or if the space was not explored. All parameters have the same weight, since a
    parameter that hardly changes the score may still decide about a collision.
    """
    if not data.summary.represents_space:
        return []
    collides = data.collides.tolist()
    points = np.array([row.point for row in data.rows])
    pairs = find_boundary_pairs(points, ["collides" if hit else "does not" for hit in collides], None, count)
    return [
        BoundaryPair(second, first) if collides[first] else BoundaryPair(first, second) for first, second, _ in pairs
    ]
