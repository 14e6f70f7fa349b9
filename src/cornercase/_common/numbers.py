"""Numbers of text files."""

from __future__ import annotations

import math


def number_of(value: str | float) -> float:
    """Read a number as XML writes it: without the underscores and the digits of other scripts that Python takes.

    Parameters
    ----------
    value : str or number

    Returns
    -------
    float
        Possibly not finite.

    Raises
    ------
    ValueError
        It is no number.
    """
    if isinstance(value, str) and ("_" in value or not value.isascii()):
        raise ValueError(f"'{value}' is not a number")
    return float(value)


def finite_number(text: str) -> float | None:
    """Finite number that a text is; None for any other text."""
    try:
        number = number_of(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None
