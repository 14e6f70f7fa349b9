"""Pairs of neighbouring scenarios of a study that end differently."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cornercase._common.typing import FloatArray
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
    others = data.summary.meta.others
    collides = [not data.entities_hit[row.id].isdisjoint(others) for row in data.rows]
    points = np.array([row.point for row in data.rows])
    pairs = find_boundary_pairs(points, ["collides" if hit else "does not" for hit in collides], None, count)
    return [
        BoundaryPair(second, first) if collides[first] else BoundaryPair(first, second) for first, second, _ in pairs
    ]


def boundary_weights(data: ReportData) -> FloatArray | None:
    """Return the share of each parameter in the score's variance, shape (d,); None if it is unknown."""
    sensitivity = data.summary.estimates.sensitivity
    if sensitivity is None or not sensitivity.is_meaningful:
        return None
    total = dict(zip(sensitivity.names, sensitivity.total, strict=True))
    # Parameters with a single value have no index.
    return np.array([total.get(parameter.name, 0.0) for parameter in data.parameters])
