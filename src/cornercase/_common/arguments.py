"""Checks of arguments of public functions. The one-sentence error names the parameter."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from math import inf, isfinite
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError, suggestion

_MOST_SHOWN: Final = 60


def whole_number(name: str, value: object, least: int = 0, most: int | None = None) -> int:
    """Return an int, also from a NumPy integer; `InputError` if it is none or out of bounds.

    >>> whole_number("budget", 200, least=1)
    200
    """
    # bool is an Integral in Python, but nobody means a number by it.
    if isinstance(value, Integral) and not isinstance(value, bool):
        number = int(value)
        if number >= least and (most is None or number <= most):
            return number
    bounds = f"of {least} or more" if most is None else f"from {least} to {most}"
    raise InputError(f"`{name}` {shown(value)}: give a whole number {bounds}.")


def number(name: str, value: object, *, above: float | None = None, least: float | None = None) -> float:
    """Return a finite float, also from an int or a NumPy number. `above` is exclusive, `minimum` inclusive."""
    if isinstance(value, Real) and not isinstance(value, bool):
        try:
            result = float(value)
        except OverflowError:
            result = inf
        if isfinite(result) and (above is None or result > above) and (least is None or result >= least):
            return result
    bound = f" above {above:g}" if above is not None else f" of {least:g} or more" if least is not None else ""
    raise InputError(f"`{name}` {shown(value)}: give a number{bound}.")


def flag(name: str, value: object) -> bool:
    """Return True or False; `InputError` for anything else."""
    if isinstance(value, bool):
        return value
    raise InputError(f"`{name}` {shown(value)}: give True or False.")


def text(name: str, value: object, known: Collection[str] = ()) -> str:
    """Return a non-empty string, which has to be one of `choices` if these are given."""
    if not isinstance(value, str) or not value:
        raise InputError(f"`{name}` {shown(value)}: give a text.")
    if known and value not in known:
        raise InputError(f"`{name}` {value}: {suggestion(value, known)}")
    return value


def texts(name: str, value: object) -> tuple[str, ...]:
    """Return a tuple of strings; a single string becomes a tuple of one."""
    if isinstance(value, str):
        return (text(name, value),)
    if not isinstance(value, Iterable) or isinstance(value, Mapping | bytes):
        raise InputError(f"`{name}` {shown(value)}: give a list of texts.")
    return tuple(text(name, item) for item in value)


def by_name(name: str, value: object) -> dict[str, Any]:
    """Return a dict with string keys."""
    if not isinstance(value, Mapping):
        raise InputError(f"`{name}` {shown(value)}: give a dictionary.")
    return {text(name, key): item for key, item in value.items()}


def numbers_or_texts(name: str, value: object) -> dict[str, float | str]:
    """Return values of scenario parameters (numbers or strings) by name; None becomes an empty dict."""
    values = {} if value is None else by_name(name, value)
    for key, item in values.items():
        if not isinstance(item, str | Real):
            raise InputError(f"`{name}` {key}={shown(item)}: give a number or a text.")
    return values


def path(name: str, value: object) -> Path:
    """Return the `Path` of a file or folder."""
    if isinstance(value, str | PathLike) and value != "":
        return Path(value)
    raise InputError(f"`{name}` {shown(value)}: give the path of a file or folder.")


def shown(value: object) -> str:
    """`repr` of a value for a message: on one line, at most 60 characters."""
    line = " ".join(repr(value).split())
    return line if len(line) <= _MOST_SHOWN else f"{line[:_MOST_SHOWN]}…"
