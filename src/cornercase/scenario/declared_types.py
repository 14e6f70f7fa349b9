"""Parameter types of OpenSCENARIO: conversion of values and of varied ranges."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final, Protocol

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.numbers import number_of
from cornercase._common.typing import FloatArray
from cornercase.scenario.parameter import Parameter, Value

INTEGERS: Final = frozenset({"integer", "int", "unsignedInt", "unsignedShort"})
"""Integer types."""

NUMERIC: Final = INTEGERS | {"double"}
"""Types of numbers."""

# Tolerance for integers.
_WHOLE: Final = 1e-6

_TRUTHS: Final = {"true": "true", "1": "true", "1.0": "true", "false": "false", "0": "false", "0.0": "false"}

_NUMBERS: Final = {float, int, np.float64}

# Limits for ranges of parameters that are not numbers, and for integers with a distribution.
_MOST_CHOICES: Final = 1000
_MOST_LIKELY: Final = 100_000

_MOST: Final = {"unsignedInt": 2**32 - 1, "unsignedShort": 2**16 - 1}


def typed_value(value: Value, kind: str) -> Value:
    """Convert a value to a declared type; booleans become ``"true"`` or ``"false"``.

    Raises `ValueError` if that is not possible; the message continues "is '12.5'".
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
    """Convert many numbers at once, shape (n,); None if they have to be converted one by one."""
    if kind not in NUMERIC or not set(map(type, values)) <= _NUMBERS:
        return None
    numbers: FloatArray = np.array(values, dtype=np.float64)
    if not np.isfinite(numbers).all():
        return None
    if kind == "double":
        return numbers
    integers: FloatArray = np.round(numbers) + 0.0
    if (np.abs(numbers - integers) > _WHOLE).any() or not (
        (integers >= 0) & (integers <= _MOST.get(kind, np.inf))
    ).all():
        return None
    return integers


class _Declared(Protocol):
    @property
    def name(self) -> str: ...

    @property
    def kind(self) -> str: ...


def unusable_values(declarations: Sequence[_Declared], values: Sequence[Mapping[str, Value]]) -> dict[int, str]:
    """Return why scenarios have a value that does not fit its declared type, by index, as sentences without full stop.

    Expressions are not looked at.
    """
    names = set().union(*values)
    varied = [declaration for declaration in declarations if declaration.name in names]
    # Most values are numbers: check them all at once.
    unclear = [
        declaration
        for declaration in varied
        if typed_numbers([scenario.get(declaration.name) for scenario in values], declaration.kind) is None
    ]
    problems = ((i, _unusable_value(unclear, scenario)) for i, scenario in enumerate(values)) if unclear else ()
    return {i: problem for i, problem in problems if problem is not None}


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
    """Format a value so that it reads back the same; whole numbers have no decimals."""
    if isinstance(value, str):
        return value
    if isinstance(value, bool | np.bool_):
        return str(value).lower()
    number = float(value)
    return str(int(number)) if number.is_integer() and abs(number) < 1e15 else repr(number)


def typed_parameter(parameter: Parameter, kind: str, source: str) -> Parameter:
    """Convert a varied parameter to its declared type; raises `InputError` if its range does not fit."""
    if parameter.choices or kind == "double":
        return parameter
    where = f"{source}: the parameter {parameter.name} is declared as {kind}"
    if kind in INTEGERS:
        return _typed_range(parameter, kind, where)
    if kind == "boolean":
        if (parameter.low, parameter.high) != (0.0, 1.0) or parameter.step not in (None, 1.0):
            raise InputError(f"{where}, and its range is {parameter.values_text}; vary it as {parameter.name}=0:1.")
        return _chosen(parameter, ("false", "true"))
    if parameter.size is None:
        raise InputError(
            f"{where}, and its range is {parameter.values_text}; give a step, as {parameter.name}=LOW:HIGH:STEP, or a"
            " `space` file with a <DistributionSet>."
        )
    if parameter.size > _MOST_CHOICES:
        raise InputError(f"{where}, and its range has {parameter.size} values; it may have {_MOST_CHOICES}.")
    values = [parameter.low + k * float(parameter.step or 1.0) for k in range(parameter.size)]
    return _chosen(parameter, tuple(value_text(float(f"{value:.12g}")) for value in values))


def _typed_range(parameter: Parameter, kind: str, where: str) -> Parameter:
    step = 1.0 if parameter.step is None else parameter.step
    low, high = float(math.ceil(parameter.low - 1e-9)), float(math.floor(parameter.high + 1e-9))
    if step != round(step) or (parameter.step is not None and low != parameter.low) or low > high:
        raise InputError(
            f"{where}, and its range is {parameter.values_text}; give whole numbers as bounds, and as step."
        )
    for bound in (low, high):
        try:
            typed_value(bound, kind)
        except ValueError as why:
            raise InputError(f"{where}, and its range ends at {bound:g}, {why}.") from None
    typed = replace(parameter, low=low, high=high, step=step, whole=True)
    if typed.distribution is not None and (typed.size or 0) > _MOST_LIKELY:
        raise InputError(f"{where}, and its distribution has {typed.size} values; it may have {_MOST_LIKELY}.")
    return typed


def _chosen(parameter: Parameter, choices: tuple[str, ...]) -> Parameter:
    if parameter.distribution is not None:
        raise InputError(f"The parameter {parameter.name} is not a number, and cannot have a distribution of numbers.")
    return Parameter(parameter.name, 0.0, len(choices) - 1.0, None, choices, unit=parameter.unit)
