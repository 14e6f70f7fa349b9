"""Closest approaches of the ego to other entities, and sentences about near misses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ClosestApproach:
    """Smallest gap in m between the bounding boxes of the ego and another entity, and the time in s of this gap."""

    entity: str
    gap: float
    time: float

    def describe(self) -> str:
        """Return gap, entity and time as text, such as ``"0.58 m from VRU at 7.1 s"``."""
        return f"{self.gap:.2g} m from {self.entity} at {self.time:.3g} s"


def find_closest_approach(
    features: Sequence[Mapping[str, float]], others: Sequence[str], begin: float
) -> ClosestApproach | None:
    """Find the closest approach of the ego to one of the other entities; None if the ego approached no entity.

    `features` are the features of a recording, one mapping per other entity. An entity that is nearest at the start of
    the scenario (time `begin`, in s) is left out, since this gap results from the start positions, not from driving.
    """
    approaches = [
        ClosestApproach(other, values["nearest"], values["nearest time"])
        for other, values in zip(others, features, strict=True)
        if values.get("nearest time", np.nan) > begin
    ]
    return min(approaches, key=lambda approach: approach.gap, default=None)


def sort_near_misses(
    approaches: Mapping[int, ClosestApproach], colliding: Mapping[int, object]
) -> list[tuple[int, ClosestApproach]]:
    """Return id and closest approach of each scenario that is not in `colliding`, the smallest gap first."""
    misses = [(scenario, approach) for scenario, approach in approaches.items() if scenario not in colliding]
    return sorted(misses, key=lambda item: (item[1].gap, item[0]))


def describe_near_misses(misses: Sequence[tuple[int, ClosestApproach]]) -> Iterator[str]:
    """Yield a sentence for each near miss, given as id of the scenario and closest approach."""
    for scenario, approach in misses:
        yield f"Near miss in scenario {scenario}: {approach.describe()}."
