"""Arguments of public functions, checked: each is refused in one sentence that names the parameter."""

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
    """Take a whole number, also one of NumPy's.

    Parameters
    ----------
    name : str
        Parameter that the value was given for.
    value : object
    least, most : int, optional
        Bounds that it may reach.

    Returns
    -------
    int

    Raises
    ------
    InputError
        It is none, or out of bounds.

    Examples
    --------
    >>> whole_number("budget", 200, least=1)
    200
    """
    # True and False count as whole numbers in Python, but nobody means one by them.
    if isinstance(value, Integral) and not isinstance(value, bool):
        number = int(value)
        if number >= least and (most is None or number <= most):
            return number
    bounds = f"of {least} or more" if most is None else f"from {least} to {most}"
    raise InputError(f"`{name}` {shown(value)}: give a whole number {bounds}.")


def number(name: str, value: object, *, above: float | None = None, least: float | None = None) -> float:
    """Take a finite number, also a whole one or one of NumPy's.

    Parameters
    ----------
    name : str
        Parameter that the value was given for.
    value : object
    above, least : float, optional
        Bound that it may not reach, and one that it may.

    Returns
    -------
    float

    Raises
    ------
    InputError
        It is none, not finite, or out of bounds.
    """
    if isinstance(value, Real) and not isinstance(value, bool):
        try:
            found = float(value)
        except OverflowError:
            found = inf
        if isfinite(found) and (above is None or found > above) and (least is None or found >= least):
            return found
    bound = f" above {above:g}" if above is not None else f" of {least:g} or more" if least is not None else ""
    raise InputError(f"`{name}` {shown(value)}: give a number{bound}.")


def flag(name: str, value: object) -> bool:
    """Take True or False.

    Parameters
    ----------
    name : str
        Parameter that the value was given for.
    value : object

    Returns
    -------
    bool

    Raises
    ------
    InputError
        It is neither.
    """
    if isinstance(value, bool):
        return value
    raise InputError(f"`{name}` {shown(value)}: give True or False.")


def text(name: str, value: object, known: Collection[str] = ()) -> str:
    """Take a text.

    Parameters
    ----------
    name : str
        Parameter that the value was given for.
    value : object
    known : collection of str, optional
        Those of which it has to be one.

    Returns
    -------
    str

    Raises
    ------
    InputError
        It is none, is empty, or is not among those that are known.
    """
    if not isinstance(value, str) or not value:
        raise InputError(f"`{name}` {shown(value)}: give a text.")
    if known and value not in known:
        raise InputError(f"`{name}` {value}: {suggestion(value, known)}")
    return value


def texts(name: str, value: object) -> tuple[str, ...]:
    """Take several texts, or one that stands for itself alone.

    Parameters
    ----------
    name : str
        Parameter that the value was given for.
    value : object

    Returns
    -------
    tuple of str

    Raises
    ------
    InputError
        It is no sequence of texts.
    """
    if isinstance(value, str):
        return (text(name, value),)
    if not isinstance(value, Iterable) or isinstance(value, Mapping | bytes):
        raise InputError(f"`{name}` {shown(value)}: give a list of texts.")
    return tuple(text(name, one) for one in value)


def by_name(name: str, value: object) -> dict[str, Any]:
    """Take a mapping with texts as its keys.

    Parameters
    ----------
    name : str
        Parameter that the value was given for.
    value : object

    Returns
    -------
    dict of str to object

    Raises
    ------
    InputError
        It is no mapping, or a key is no text.
    """
    if not isinstance(value, Mapping):
        raise InputError(f"`{name}` {shown(value)}: give a dictionary.")
    return {text(name, key): one for key, one in value.items()}


def numbers_or_texts(name: str, value: object) -> dict[str, float | str]:
    """Take the values of a scenario's parameters.

    Parameters
    ----------
    name : str
        Parameter that they were given for.
    value : object
        None for none.

    Returns
    -------
    dict of str to float or str

    Raises
    ------
    InputError
        It is no mapping, a key is no text, or a value is neither a number nor a text.
    """
    found = {} if value is None else by_name(name, value)
    for key, one in found.items():
        if not isinstance(one, str | Real):
            raise InputError(f"`{name}` {key}={shown(one)}: give a number or a text.")
    return found


def path(name: str, value: object) -> Path:
    """Take the path of a file or folder.

    Parameters
    ----------
    name : str
        Parameter that the value was given for.
    value : object

    Returns
    -------
    Path

    Raises
    ------
    InputError
        It is none.
    """
    if isinstance(value, str | PathLike) and value != "":
        return Path(value)
    raise InputError(f"`{name}` {shown(value)}: give the path of a file or folder.")


def shown(value: object) -> str:
    """Show a value in a message: on one line, and not at length.

    Parameters
    ----------
    value : object

    Returns
    -------
    str
    """
    words = " ".join(repr(value).split())
    return words if len(words) <= _MOST_SHOWN else f"{words[:_MOST_SHOWN]}…"
