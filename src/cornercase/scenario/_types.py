"""Parameter types of OpenSCENARIO: conversion of values and of varied ranges."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final, Protocol

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.text.parse_number import parse_number
from cornercase._common.typing import FloatArray
from cornercase.scenario._parameter import Parameter, Value

INTEGER_TYPES: Final = frozenset({"integer", "int", "unsignedInt", "unsignedShort"})
"""Integer types."""

NUMERIC_TYPES: Final = INTEGER_TYPES | {"double"}
"""Types of numbers."""

# Tolerance for integers.
_INTEGER_TOLERANCE: Final = 1e-6

_BOOLEAN_SPELLINGS: Final = {"true": "true", "1": "true", "1.0": "true", "false": "false", "0": "false", "0.0": "false"}

_PYTHON_NUMBER_TYPES: Final = {float, int, np.float64}

# Limits for ranges of parameters that are not numbers, and for integers with a distribution.
_MAX_CHOICES: Final = 1000
_MAX_WEIGHTED_VALUES: Final = 100_000

_MAX_UNSIGNED: Final = {"unsignedInt": 2**32 - 1, "unsignedShort": 2**16 - 1}


def convert_to_type(value: Value, type_name: str) -> Value:
    """Convert a value to a declared type; booleans become ``"true"`` or ``"false"``.

    Raises `ValueError` if the value cannot be converted. Its message completes a sentence such as "gap is '12.5', …".
    """
    if type_name in NUMERIC_TYPES:
        try:
            number = parse_number(value)
        except ValueError:
            raise ValueError("which is not a number") from None
        if not math.isfinite(number):
            raise ValueError("which is not a finite number")
        return number if type_name == "double" else _convert_to_integer(number, type_name)
    if type_name == "boolean":
        truth = _BOOLEAN_SPELLINGS.get(str(value).lower())
        if truth is None:
            raise ValueError("not true or false")
        return truth
    return value if isinstance(value, str) else format_value(value)


def convert_numbers_to_type(values: Sequence[object], type_name: str) -> FloatArray | None:
    """Convert many numbers at once, shape (n,); None if they must be converted one by one with `convert_to_type`."""
    if type_name not in NUMERIC_TYPES or not set(map(type, values)) <= _PYTHON_NUMBER_TYPES:
        return None
    numbers: FloatArray = np.array(values, dtype=np.float64)
    if not np.isfinite(numbers).all():
        return None
    if type_name == "double":
        return numbers
    integers: FloatArray = np.round(numbers) + 0.0
    if (np.abs(numbers - integers) > _INTEGER_TOLERANCE).any() or not (
        (integers >= 0) & (integers <= _MAX_UNSIGNED.get(type_name, np.inf))
    ).all():
        return None
    return integers


class _TypedDeclaration(Protocol):
    @property
    def name(self) -> str: ...

    @property
    def type_name(self) -> str: ...


def find_type_errors(
    declarations: Sequence[_TypedDeclaration], scenario_values: Sequence[Mapping[str, Value]]
) -> dict[int, str]:
    """Describe the first value of a wrong type in each scenario that has one; by index of the scenario.

    Each description is a sentence without full stop. Values that are expressions are not checked.
    """
    names = set().union(*scenario_values)
    varied = [declaration for declaration in declarations if declaration.name in names]
    # Most values are numbers: check them all at once.
    unclear = [
        declaration
        for declaration in varied
        if convert_numbers_to_type(
            [scenario.get(declaration.name) for scenario in scenario_values], declaration.type_name
        )
        is None
    ]
    problems = (
        ((i, _first_type_error(unclear, scenario)) for i, scenario in enumerate(scenario_values)) if unclear else ()
    )
    return {i: problem for i, problem in problems if problem is not None}


def _first_type_error(declarations: Sequence[_TypedDeclaration], values: Mapping[str, Value]) -> str | None:
    for declaration in declarations:
        value = values.get(declaration.name)
        if value is None or (isinstance(value, str) and value.lstrip().startswith("$")):
            continue
        try:
            convert_to_type(value, declaration.type_name)
        except ValueError as why:
            return f"the parameter {declaration.name} is '{value}', {why}"
    return None


def _convert_to_integer(number: float, type_name: str) -> int:
    if abs(number - round(number)) > _INTEGER_TOLERANCE:
        raise ValueError(f"which is not a whole number, as a parameter of type {type_name} needs")
    if type_name in _MAX_UNSIGNED and not 0 <= round(number) <= _MAX_UNSIGNED[type_name]:
        raise ValueError(f"which is not from 0 to {_MAX_UNSIGNED[type_name]}, as a parameter of type {type_name} needs")
    return round(number)


def format_value(value: Value) -> str:
    """Format a value so that reading the text gives exactly the same value; whole numbers get no decimals."""
    if isinstance(value, str):
        return value
    if isinstance(value, bool | np.bool_):
        return str(value).lower()
    number = float(value)
    return str(int(number)) if number.is_integer() and abs(number) < 1e15 else repr(number)


def convert_parameter_to_type(parameter: Parameter, type_name: str, file_name: str) -> Parameter:
    """Convert a varied parameter to its declared type; raises `InputError` if its range does not fit the type."""
    if parameter.choices or type_name == "double":
        return parameter
    where = f"{file_name}: the parameter {parameter.name} is declared as {type_name}"
    if type_name in INTEGER_TYPES:
        return _convert_range_to_integer(parameter, type_name, where)
    if type_name == "boolean":
        if (parameter.low, parameter.high) != (0.0, 1.0) or parameter.step not in (None, 1.0):
            raise InputError(f"{where}, and its range is {parameter.values_text}; vary it as {parameter.name}=0:1.")
        return _parameter_with_choices(parameter, ("false", "true"))
    if parameter.size is None:
        raise InputError(
            f"{where}, so its range {parameter.values_text} needs a step; give it as {parameter.name}=LOW:HIGH:STEP, or"
            " give a `space` file with a <DistributionSet>."
        )
    if parameter.size > _MAX_CHOICES:
        raise InputError(f"{where}, and its range has {parameter.size} values; at most {_MAX_CHOICES} are possible.")
    values = [parameter.low + k * float(parameter.step or 1.0) for k in range(parameter.size)]
    return _parameter_with_choices(parameter, tuple(format_value(float(f"{value:.12g}")) for value in values))


def _convert_range_to_integer(parameter: Parameter, type_name: str, location: str) -> Parameter:
    step = 1.0 if parameter.step is None else parameter.step
    low, high = float(math.ceil(parameter.low - 1e-9)), float(math.floor(parameter.high + 1e-9))
    if step != round(step) or (parameter.step is not None and low != parameter.low) or low > high:
        raise InputError(
            f"{location}, and its range is {parameter.values_text}; give whole numbers as bounds, and as step."
        )
    for bound in (low, high):
        try:
            convert_to_type(bound, type_name)
        except ValueError as why:
            raise InputError(f"{location}, and its range ends at {bound:g}, {why}.") from None
    typed = replace(parameter, low=low, high=high, step=step, is_integer=True)
    if typed.distribution is not None and (typed.size or 0) > _MAX_WEIGHTED_VALUES:
        raise InputError(
            f"{location}, and its distribution has {typed.size} values; at most {_MAX_WEIGHTED_VALUES} are possible."
        )
    return typed


def _parameter_with_choices(parameter: Parameter, choices: tuple[str, ...]) -> Parameter:
    if parameter.distribution is not None:
        raise InputError(f"The parameter {parameter.name} is not a number, and cannot have a distribution of numbers.")
    return Parameter(parameter.name, 0.0, len(choices) - 1.0, None, choices, unit=parameter.unit)
