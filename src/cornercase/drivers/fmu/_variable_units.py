"""Units of FMU variables: how a number in them becomes one in SI units."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True)
class Unit:
    """A unit: ``SI value = factor * value + offset``; `exponents` are those of m, s and rad."""

    factor: float
    exponents: tuple[int, int, int]
    offset: float = 0.0


SI: Final[Mapping[str, Unit]] = {
    "m": Unit(1.0, (1, 0, 0)),
    "s": Unit(1.0, (0, 1, 0)),
    "m/s": Unit(1.0, (1, -1, 0)),
    "m/s²": Unit(1.0, (1, -2, 0)),
    "rad": Unit(1.0, (0, 0, 1)),
    "1/m": Unit(1.0, (-1, 0, 0)),
    "1": Unit(1.0, (0, 0, 0)),
}
"""Units of the quantities, by symbol."""
KNOWN_UNITS: Final[Mapping[str, Unit]] = {
    **SI,
    "km": Unit(1000.0, (1, 0, 0)),
    "cm": Unit(0.01, (1, 0, 0)),
    "mm": Unit(0.001, (1, 0, 0)),
    "ft": Unit(0.3048, (1, 0, 0)),
    "ms": Unit(0.001, (0, 1, 0)),
    "km/h": Unit(1.0 / 3.6, (1, -1, 0)),
    "kph": Unit(1.0 / 3.6, (1, -1, 0)),
    "mph": Unit(0.44704, (1, -1, 0)),
    "m/s2": Unit(1.0, (1, -2, 0)),
    "m/s^2": Unit(1.0, (1, -2, 0)),
    "m.s-1": Unit(1.0, (1, -1, 0)),
    "m.s-2": Unit(1.0, (1, -2, 0)),
    "m-1": Unit(1.0, (-1, 0, 0)),
    "m^-1": Unit(1.0, (-1, 0, 0)),
    "rad/m": Unit(1.0, (-1, 0, 1)),
    "deg": Unit(math.pi / 180.0, (0, 0, 1)),
    "°": Unit(math.pi / 180.0, (0, 0, 1)),
    "%": Unit(0.01, (0, 0, 0)),
    "-": Unit(1.0, (0, 0, 0)),
}
"""Units that are known by their symbol alone, for FMUs that do not define them."""


def fits(unit: Unit, symbol: str) -> bool:
    """Return whether a unit measures what an SI unit of the table measures; radians count as numbers."""
    (*length_time, _), (*expected, _) = unit.exponents, SI[symbol].exponents
    return length_time == expected
