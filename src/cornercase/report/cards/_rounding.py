"""Round the parameters of a scenario to steps that can be set, within their ranges."""

from __future__ import annotations

import itertools
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
    """Yield the roundings of a scenario, up or down in each parameter, the nearest first; at most 64.

    Each value is within the range of its parameter. A parameter whose range has no step keeps its value.
    """
    names: list[str] = []
    neighbours: list[list[tuple[float, float]]] = []
    for parameter, quantity in zip(parameters, quantities, strict=True):
        if quantity.step is not None:
            names.append(parameter.name)
            neighbours.append(_neighbours(float(values[parameter.name]), quantity.step, parameter.low, parameter.high))
    # Of many parameters only those that are farthest from a step are rounded either way.
    while math.prod(map(len, neighbours)) > _MAX_ROUNDINGS:
        k = max(
            (k for k, pair in enumerate(neighbours) if len(pair) > 1),
            key=lambda k: neighbours[k][1][1] - neighbours[k][0][1],
        )
        neighbours[k] = neighbours[k][:1]
    roundings = [
        Rounding(
            {**values, **{name: value for name, (value, _) in zip(names, choice, strict=True)}},
            math.hypot(*(distance for _, distance in choice)),
        )
        for choice in itertools.product(*neighbours)
    ]
    # Sorting is stable, so equal distances keep their order.
    yield from sorted(roundings, key=lambda rounding: rounding.distance)


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
