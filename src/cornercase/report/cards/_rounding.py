"""Round the parameters of a scenario to steps that can be set, within their ranges."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from cornercase.report.cards._quantity import SettableQuantity
from cornercase.scenario import Parameter, Value

# Values that are this close to a step, in steps, are on it.
_TOLERANCE: Final = 1e-6
# Scenarios that are run to find a rounding that keeps the outcome.
_MAX_ROUNDINGS: Final = 64


@dataclass(frozen=True)
class Rounding:
    """Values of a scenario on steps, by parameter, and how far they are from the original ones in steps."""

    values: Mapping[str, Value]
    distance: float


def iter_roundings(
    parameters: Sequence[Parameter], quantities: Sequence[SettableQuantity], values: Mapping[str, Value]
) -> Iterator[Rounding]:
    """Yield the roundings of a scenario, up or down in each parameter, the nearest first; at most the nearest 64.

    Each value is within the range of its parameter. A parameter whose range has no step keeps its value.
    """
    # Whatever the values of the parameters that follow, only the nearest so far can be among the nearest in the end.
    # Sorting is stable, so equal distances keep their order.
    nearest: list[Rounding] = [Rounding(values, 0.0)]
    for name, pairs in _list_neighbours(parameters, quantities, values).items():
        longer = [
            Rounding({**rounding.values, name: value}, math.hypot(rounding.distance, distance))
            for rounding in nearest
            for value, distance in pairs
        ]
        nearest = sorted(longer, key=lambda rounding: rounding.distance)[:_MAX_ROUNDINGS]
    yield from nearest


def count_roundings(
    parameters: Sequence[Parameter], quantities: Sequence[SettableQuantity], values: Mapping[str, Value]
) -> int:
    """Return how many roundings of a scenario there are, up or down in each parameter; they may be more than 64."""
    return math.prod(map(len, _list_neighbours(parameters, quantities, values).values()))


def _list_neighbours(
    parameters: Sequence[Parameter], quantities: Sequence[SettableQuantity], values: Mapping[str, Value]
) -> dict[str, list[tuple[float, float]]]:
    """Return the steps next to each value that is rounded, by parameter, with their distances in steps."""
    return {
        parameter.name: _neighbours(float(values[parameter.name]), quantity.step, parameter.low, parameter.high)
        for parameter, quantity in zip(parameters, quantities, strict=True)
        if quantity.step is not None
    }


def _neighbours(value: float, step: float, low: float, high: float) -> list[tuple[float, float]]:
    """Return the steps below and above a value within a range, the nearer first, with their distances in steps."""
    position = value / step
    if abs(position - round(position)) <= _TOLERANCE:
        return [(_on_step(round(position), step), 0.0)]
    margin = _TOLERANCE * step
    pairs = [(_on_step(k, step), abs(position - k)) for k in (math.floor(position), math.ceil(position))]
    inside = [pair for pair in pairs if low - margin <= pair[0] <= high + margin]
    return sorted(inside, key=lambda pair: pair[1]) or [(value, 0.0)]


def _on_step(k: int, step: float) -> float:
    # Without the last digits that a product has, so that files and cards show what is set.
    return float(f"{k * step:.12g}")
