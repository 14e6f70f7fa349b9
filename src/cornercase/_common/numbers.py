"""Numbers of text files."""

from __future__ import annotations


def number_of(value: object) -> float:
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
    return float(value)  # type: ignore[arg-type]
