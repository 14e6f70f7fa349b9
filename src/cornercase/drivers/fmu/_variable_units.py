"""Units of FMU variables, with the factors and offsets that convert numbers to SI units."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True)
class Unit:
    """Unit of measurement: ``SI value = factor * value + offset``; `exponents` are the exponents of m, s and rad."""

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
"""SI units of the quantities that an FMU is given and of its decisions, by symbol."""
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
"""Known units by symbol, for maps, and for FMUs that name a unit without defining it."""


def has_same_dimension(unit: Unit, symbol: str) -> bool:
    """Return whether a unit has the same dimension as the SI unit `symbol`; radians count as dimensionless."""
    (*length_time, _), (*expected, _) = unit.exponents, SI[symbol].exponents
    return length_time == expected
