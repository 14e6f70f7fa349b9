"""Values of the types that a scenario file declares for its parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, Protocol

import numpy as np

from cornercase._common.numbers import number_of
from cornercase._common.typing import FloatArray
from cornercase.scenario.parameter import Value

INTEGERS: Final = frozenset({"integer", "int", "unsignedInt", "unsignedShort"})
"""Types of whole numbers."""

NUMERIC: Final = INTEGERS | {"double"}
"""Types of parameters that are numbers."""

# A number that differs from a whole one by less is that one.
_WHOLE: Final = 1e-6

_TRUTHS: Final = {"true": "true", "1": "true", "1.0": "true", "false": "false", "0": "false", "0.0": "false"}

_NUMBERS: Final = {float, int, np.float64}

_MOST: Final = {"unsignedInt": 2**32 - 1, "unsignedShort": 2**16 - 1}


def typed_value(value: Value, kind: str) -> Value:
    """Give a value the type that its parameter is declared with.

    Parameters
    ----------
    value : float or str
    kind : str
        ``"double"``, ``"integer"``, ``"boolean"``, ``"string"`` or another one of OpenSCENARIO.

    Returns
    -------
    float, int or str
        Booleans as ``"true"`` or ``"false"``.

    Raises
    ------
    ValueError
        It is no value of that type; the message goes on from "is '12.5'".
    """
    if kind in NUMERIC:
        try:
            number = number_of(value)
        except ValueError:
            raise ValueError("which is not a number") from None
        if not math.isfinite(number):
            raise ValueError("which is not a finite number")
        return number if kind == "double" else _whole(number, kind)
    if kind == "boolean":
        truth = _TRUTHS.get(str(value).lower())
        if truth is None:
            raise ValueError("not true or false")
        return truth
    return value if isinstance(value, str) else value_text(value)


def typed_numbers(values: Sequence[object], kind: str) -> FloatArray | None:
    """Give many numbers the type that their parameter is declared with.

    Parameters
    ----------
    values : sequence
    kind : str
        As in `typed_value`.

    Returns
    -------
    ndarray of float64, or None
        None where it takes a look at each of them: one may be no number, or no value of that type.
    """
    if kind not in NUMERIC or not set(map(type, values)) <= _NUMBERS:
        return None
    numbers: FloatArray = np.array(values, dtype=np.float64)
    if not np.isfinite(numbers).all():
        return None
    if kind == "double":
        return numbers
    whole: FloatArray = np.round(numbers) + 0.0
    if (np.abs(numbers - whole) > _WHOLE).any() or not ((whole >= 0) & (whole <= _MOST.get(kind, np.inf))).all():
        return None
    return whole


class _Declared(Protocol):
    @property
    def name(self) -> str: ...

    @property
    def kind(self) -> str: ...


def unusable_values(declarations: Sequence[_Declared], values: Sequence[Mapping[str, Value]]) -> dict[int, str]:
    """Tell which concrete scenarios have a value that cannot be that of its parameter, and why.

    Parameters
    ----------
    declarations : sequence of Declaration
    values : sequence of mapping of str to float or str
        Those of each concrete scenario.

    Returns
    -------
    dict of int to str
        By place among the values, a sentence without its full stop; not of scenarios whose values are all of the
        declared types, or are expressions.
    """
    names = set().union(*values)
    given = [one for one in declarations if one.name in names]
    # Numbers, of which most values are, are looked at all at once.
    asked = [one for one in given if typed_numbers([each.get(one.name) for each in values], one.kind) is None]
    found = ((i, _unusable_value(asked, each)) for i, each in enumerate(values)) if asked else ()
    return {i: words for i, words in found if words is not None}


def _unusable_value(declarations: Sequence[_Declared], values: Mapping[str, Value]) -> str | None:
    for declaration in declarations:
        value = values.get(declaration.name)
        if value is None or (isinstance(value, str) and value.lstrip().startswith("$")):
            continue
        try:
            typed_value(value, declaration.kind)
        except ValueError as why:
            return f"the parameter {declaration.name} is '{value}', {why}"
    return None


def _whole(number: float, kind: str) -> int:
    if abs(number - round(number)) > _WHOLE:
        raise ValueError(f"which is not a whole number, as a parameter of type {kind} needs")
    if kind in _MOST and not 0 <= round(number) <= _MOST[kind]:
        raise ValueError(f"which is not from 0 to {_MOST[kind]}, as a parameter of type {kind} needs")
    return round(number)


def value_text(value: Value) -> str:
    """Write a value so that reading gives the same; a whole number has no decimals.

    Parameters
    ----------
    value : float or str

    Returns
    -------
    str
    """
    if isinstance(value, str):
        return value
    if isinstance(value, bool | np.bool_):
        return str(value).lower()
    number = float(value)
    return str(int(number)) if number.is_integer() and abs(number) < 1e15 else repr(number)
