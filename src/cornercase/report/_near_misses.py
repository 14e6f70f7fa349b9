"""Sentences on how near the ego came to others without touching them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class NearMiss:
    """The smallest gap between the boxes of the ego and another entity in a scenario, in m, and when, in s."""

    entity: str
    gap: float
    time: float

    def describe(self) -> str:
        """Describe it, as ``"0.58 m from VRU at 7.1 s"``."""
        return f"{self.gap:.2g} m from {self.entity} at {self.time:.3g} s"


def find_closest_approach(features: Sequence[Mapping[str, float]], others: Sequence[str]) -> NearMiss | None:
    """Find the closest approach among the features with each other entity; None if the ego met none of them."""
    approaches = [
        NearMiss(other, values["nearest"], values["nearest time"])
        for other, values in zip(others, features, strict=True)
        if np.isfinite(values.get("nearest time", np.nan))
    ]
    return min(approaches, key=lambda approach: approach.gap, default=None)


def sort_near_misses(approaches: Mapping[int, NearMiss], colliding: Mapping[int, object]) -> list[tuple[int, NearMiss]]:
    """Return the scenarios without a collision by their closest approach, the nearest first."""
    misses = [(scenario, approach) for scenario, approach in approaches.items() if scenario not in colliding]
    return sorted(misses, key=lambda item: (item[1].gap, item[0]))


def describe_near_misses(misses: Sequence[tuple[int, NearMiss]]) -> Iterator[str]:
    """Yield a line for each of these near misses."""
    for scenario, approach in misses:
        yield f"Near miss in scenario {scenario}: {approach.describe()}."
