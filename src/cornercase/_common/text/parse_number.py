"""Parse numbers in text files."""

from __future__ import annotations

import math


def parse_number(value: str | float) -> float:
    """Parse a number as XML writes it, such as ``1e3`` or ``INF``.

    Unlike Python's `float`, it refuses underscores and non-ASCII digits.
    """
    if isinstance(value, str) and ("_" in value or not value.isascii()):
        raise ValueError(f"'{value}' is not a number")
    return float(value)


def parse_finite_number(text: str) -> float | None:
    """Parse a finite number; return None if the text is not a finite number."""
    try:
        number = parse_number(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None
