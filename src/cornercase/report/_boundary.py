"""Pairs of neighbouring scenarios of a study that end differently."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cornercase.evidence._boundary_pairs import find_boundary_pairs
from cornercase.report._report_data import ReportData


@dataclass(frozen=True)
class BoundaryPair:
    """Rows of two scenarios that are near each other; the ego collides in one of them."""

    without_collision: int
    with_collision: int


def find_collision_boundary(data: ReportData, count: int) -> list[BoundaryPair]:
    """Find the nearest pairs with and without a collision; empty if all end alike, or the space was not explored.

    All parameters count alike: what hardly changes the score may still decide whether there is a collision.
    """
    if not data.summary.represents_space:
        return []
    collides = data.collides.tolist()
    points = np.array([row.point for row in data.rows])
    pairs = find_boundary_pairs(points, ["collides" if hit else "does not" for hit in collides], None, count)
    return [
        BoundaryPair(second, first) if collides[first] else BoundaryPair(first, second) for first, second, _ in pairs
    ]
