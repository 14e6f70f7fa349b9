"""Checks of arguments of public functions. The one-sentence error names the parameter."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from math import inf, isfinite
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError, suggest_name

_MAX_REPR_LENGTH: Final = 60


def check_int(name: str, value: object, minimum: int = 0, maximum: int | None = None) -> int:
    """Return an argument as int; `InputError` if it is not a whole number, or out of bounds. NumPy integers are valid.

    >>> check_int("budget", 200, minimum=1)
    200
    """
    # bool is an Integral in Python, but nobody means a number by it.
    if isinstance(value, Integral) and not isinstance(value, bool):
        number = int(value)
        if number >= minimum and (maximum is None or number <= maximum):
            return number
    bounds = f"of {minimum} or more" if maximum is None else f"from {minimum} to {maximum}"
    raise InputError(f"`{name}` {repr_short(value)}: give a whole number {bounds}.")


def check_float(
    name: str, value: object, *, above: float | None = None, minimum: float | None = None, maximum: float = inf
) -> float:
    """Return an argument as a finite float; ints and NumPy numbers are valid.

    `above` is exclusive, `minimum` and `maximum` are inclusive.
    """
    if isinstance(value, Real) and not isinstance(value, bool):
        try:
            result = float(value)
        except OverflowError:
            result = inf
        is_high_enough = (above is None or result > above) and (minimum is None or result >= minimum)
        if isfinite(result) and is_high_enough and result <= maximum:
            return result
    if above is not None:
        bound = f"number above {above:g}"
    elif minimum is None:
        bound = "finite number"
    else:
        bound = f"number of {minimum:g} or more" if maximum == inf else f"number from {minimum:g} to {maximum:g}"
    raise InputError(f"`{name}` {repr_short(value)}: give a {bound}.")


def check_bool(name: str, value: object) -> bool:
    """Return an argument that is True or False; `InputError` for anything else."""
    if isinstance(value, bool):
        return value
    raise InputError(f"`{name}` {repr_short(value)}: give True or False.")


def check_str(name: str, value: object, choices: Collection[str] = ()) -> str:
    """Return an argument that is a non-empty string; if `choices` are given, it must be one of them."""
    if not isinstance(value, str) or not value:
        raise InputError(f"`{name}` {repr_short(value)}: give a text.")
    if choices and value not in choices:
        raise InputError(f"`{name}` {value}: {suggest_name(value, choices)}")
    return value


def check_str_sequence(name: str, value: object) -> tuple[str, ...]:
    """Return an argument as tuple of strings; a single string becomes a tuple of one."""
    if isinstance(value, str):
        return (check_str(name, value),)
    if not isinstance(value, Iterable) or isinstance(value, Mapping | bytes):
        raise InputError(f"`{name}` {repr_short(value)}: give a list of texts.")
    return tuple(check_str(name, item) for item in value)


def check_mapping(name: str, value: object) -> dict[str, Any]:
    """Return an argument as dict with string keys."""
    if not isinstance(value, Mapping):
        raise InputError(f"`{name}` {repr_short(value)}: give a dictionary.")
    return {check_str(name, key): item for key, item in value.items()}


def check_parameter_values(name: str, value: object) -> dict[str, float | str]:
    """Return values of scenario parameters (numbers or strings) by name; None becomes an empty dict."""
    values = {} if value is None else check_mapping(name, value)
    for key, item in values.items():
        if not isinstance(item, str | Real):
            raise InputError(f"`{name}` {key}={repr_short(item)}: give a number or a text.")
    return values


def check_path(name: str, value: object) -> Path:
    """Return an argument as `Path` of a file or folder."""
    if isinstance(value, str | PathLike) and value != "":
        return Path(value)
    raise InputError(f"`{name}` {repr_short(value)}: give the path of a file or folder.")


def not_an_object_error(name: str, value: object, hint: str = "give an object or its name") -> InputError:
    """Return the `InputError` for an argument that has to be an object; for a class, advise to make an object."""
    if isinstance(value, type):
        return InputError(f"`{name}`: {value.__name__} is a class; give an object of it, as in {value.__name__}().")
    return InputError(f"`{name}` {repr_short(value)}: {hint}.")


def repr_short(value: object) -> str:
    """Return the `repr` of a value for a message, on one line and cut after 60 characters."""
    line = " ".join(repr(value).split())
    return line if len(line) <= _MAX_REPR_LENGTH else f"{line[:_MAX_REPR_LENGTH]}…"
