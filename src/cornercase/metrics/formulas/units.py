"""Units that a number in a formula may have."""

from __future__ import annotations

from math import pi
from types import MappingProxyType
from typing import Final

from cornercase._common.errors import InputError, suggestion

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
"""Unit in SI, and how much of it one is, by the unit as it is written."""


def spelt(unit: str) -> str:
    """Spell a unit as the units of metrics are.

    Parameters
    ----------
    unit : str

    Returns
    -------
    str
        With ``²`` for ``^2`` and for a 2 at the end.
    """
    plain = unit.replace("^2", "²")
    return plain[:-1] + "²" if plain in ("m/s2", "s2") else plain


def in_si(number: float, given: str, wanted: str) -> float:
    """Convert a number to the unit of the signal that it is compared with.

    Parameters
    ----------
    number : float
    given : str
        Its unit; ``""`` for that of the signal.
    wanted : str
        Unit of the signal.

    Returns
    -------
    float

    Raises
    ------
    InputError
        There is no such unit, or it is one of something else; the message says which fit.

    Examples
    --------
    >>> in_si(50.0, "km/h", "m/s")
    13.88888888888889
    """
    unit, target = spelt(given), spelt(wanted)
    if unit in ("", target):
        return number
    if unit not in _UNITS:
        raise InputError(f"there is no unit '{given}'; {suggestion(unit, _UNITS)}")
    quantity, size = _UNITS[unit]
    if quantity != target:
        fitting = [name for name, (of, _) in _UNITS.items() if of == target] or [target]
        raise InputError(f"the unit '{given}' does not fit; give {', '.join(fitting)}.")
    # A quotient keeps numbers such as 36 km/h exact.
    return number / 3.6 if unit == "km/h" else number * size


def is_unit(text: str) -> bool:
    """Whether there is such a unit.

    Parameters
    ----------
    text : str

    Returns
    -------
    bool
    """
    return spelt(text) in _UNITS
