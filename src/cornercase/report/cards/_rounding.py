"""Roundings of parameter values to steps that a proving ground can set, within the ranges of the parameters."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from cornercase.report.cards._settable_quantity import SettableQuantity
from cornercase.scenario import Parameter, Value

# Values this close to a multiple of the step, as a share of the step, count as equal to the multiple.
_TOLERANCE: Final = 1e-6
# Most scenarios that are run to find a rounding that keeps the outcome.
_MAX_ROUNDINGS: Final = 64


@dataclass(frozen=True)
class Rounding:
    """Rounded values of a scenario by parameter, and their Euclidean distance from the original values in steps."""

    values: Mapping[str, Value]
    distance: float


def iter_roundings(
    parameters: Sequence[Parameter], quantities: Sequence[SettableQuantity], values: Mapping[str, Value]
) -> Iterator[Rounding]:
    """Yield at most 64 roundings of a scenario, up or down in each parameter, the nearest first.

    Each value is within the range of its parameter. A parameter that is not rounded, or whose range contains no
    multiple of the step, keeps its value.
    """
    # Further parameters only add to distances, so roundings that are not among the nearest so far can be dropped.
    # Sorting is stable, so equal distances keep their order.
    nearest: list[Rounding] = [Rounding(values, 0.0)]
    for name, pairs in _list_steps_by_parameter(parameters, quantities, values).items():
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
    """Return the number of all roundings of a scenario, up or down in each parameter; it may be greater than 64."""
    return math.prod(map(len, _list_steps_by_parameter(parameters, quantities, values).values()))


def _list_steps_by_parameter(
    parameters: Sequence[Parameter], quantities: Sequence[SettableQuantity], values: Mapping[str, Value]
) -> dict[str, list[tuple[float, float]]]:
    """Return, for each parameter that is rounded, its possible rounded values with their distances in steps."""
    return {
        parameter.name: _list_steps_next_to(float(values[parameter.name]), quantity.step, parameter.low, parameter.high)
        for parameter, quantity in zip(parameters, quantities, strict=True)
        if quantity.step is not None
    }


def _list_steps_next_to(value: float, step: float, low: float, high: float) -> list[tuple[float, float]]:
    """Return the multiples of `step` below and above a value, nearest first, each with its distance in steps.

    A value that is itself a multiple is returned alone. Otherwise multiples outside the range are left out. If the
    range contains neither multiple, the value itself is returned.
    """
    position = value / step
    if abs(position - round(position)) <= _TOLERANCE:
        return [(_multiple_of_step(round(position), step), 0.0)]
    margin = _TOLERANCE * step
    pairs = [(_multiple_of_step(k, step), abs(position - k)) for k in (math.floor(position), math.ceil(position))]
    inside = [pair for pair in pairs if low - margin <= pair[0] <= high + margin]
    return sorted(inside, key=lambda pair: pair[1]) or [(value, 0.0)]


def _multiple_of_step(k: int, step: float) -> float:
    # Without the rounding error of the product, so that files and cards show the value that is set.
    return float(f"{k * step:.12g}")
