"""Units of numbers in logical expressions, and their conversion."""

from __future__ import annotations

from math import pi
from types import MappingProxyType
from typing import Final

from cornercase._common.errors import InputError, suggest_name

_UNITS: Final = MappingProxyType(
    {
        "s": ("s", 1.0),
        "ms": ("s", 1e-3),
        "min": ("s", 60.0),
        "s²": ("s²", 1.0),
        "m": ("m", 1.0),
        "cm": ("m", 1e-2),
        "km": ("m", 1e3),
        "m/s": ("m/s", 1.0),
        "km/h": ("m/s", 1.0 / 3.6),
        "mph": ("m/s", 0.44704),
        "m/s²": ("m/s²", 1.0),
        # Standard gravity (ISO 80000-3).
        "g": ("m/s²", 9.80665),
        "rad": ("rad", 1.0),
        "deg": ("rad", pi / 180.0),
        "°": ("rad", pi / 180.0),
        "1": ("1", 1.0),
        "%": ("1", 1e-2),
    }
)
"""SI unit and conversion factor, by the spelling of a unit."""


def normalize_unit(unit: str) -> str:
    """Return the normalized spelling of a unit: ``²`` replaces ``^2``, and the 2 of ``m/s2`` and ``s2``."""
    plain = unit.replace("^2", "²")
    return plain[:-1] + "²" if plain in ("m/s2", "s2") else plain


def convert_to_unit(number: float, from_unit: str, to_unit: str) -> float:
    """Convert a number to the unit `to_unit`. An empty `from_unit` means that the number has this unit already.

    Raises InputError if `from_unit` is unknown. If it measures another quantity, the error names the units that fit.
    """
    unit, target = normalize_unit(from_unit), normalize_unit(to_unit)
    if unit in ("", target):
        return number
    if unit not in _UNITS:
        raise InputError(f"there is no unit '{from_unit}'; {suggest_name(unit, _UNITS)}")
    si_unit, factor = _UNITS[unit]
    if si_unit != target:
        fitting = [name for name, (si_unit, _) in _UNITS.items() if si_unit == target] or [target]
        raise InputError(f"the unit '{from_unit}' does not fit; give {', '.join(fitting)}.")
    # Division keeps numbers such as 36 km/h exact.
    return number / 3.6 if unit == "km/h" else number * factor


def is_known_unit(text: str) -> bool:
    """Return whether `text` is the name of a known unit."""
    return normalize_unit(text) in _UNITS
