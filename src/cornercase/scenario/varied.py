"""Read varied parameters from ``NAME=LOW:HIGH[:STEP]`` texts."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.numbers import number_of
from cornercase.scenario.parameter import Parameter

# Limits of what doubles can resolve.
_LARGEST = 1e15
_MOST_STEPS = 1e9
_RANGE = re.compile(r"(?P<name>[^=]+)=(?P<low>[^:]+):(?P<high>[^:]+)(?::(?P<step>[^:]+))?")


def read_ranges(texts: Sequence[str], given: str = "ranges") -> list[Parameter]:
    """Read ``NAME=LOW:HIGH[:STEP]`` texts; `option` is the option that they were given for."""
    parameters = [_read_range(text, f"`{given}` {text}") for text in texts]
    require_names([parameter.name for parameter in parameters], f"`{given}`")
    return parameters


def _read_range(text: str, where: str) -> Parameter:
    match = _RANGE.fullmatch(text.strip())
    if match is None:
        raise InputError(f"{where}: write it as NAME=LOW:HIGH or NAME=LOW:HIGH:STEP.")
    numbers = {}
    for key in ("low", "high", "step"):
        if match[key] is not None:
            try:
                numbers[key] = number_of(match[key])
            except ValueError:
                raise InputError(f"{where}: '{match[key]}' is not a number.") from None
    return ranged(match["name"].strip(), numbers["low"], numbers["high"], numbers.get("step"), where)


def ranged(name: str, low: float, high: float, step: float | None, where: str) -> Parameter:
    """Create a parameter with a range; raises `InputError` if the range is not valid."""
    if not (np.isfinite(low) and np.isfinite(high)):
        raise InputError(f"{where}: the bounds of {name} must be finite.")
    if max(abs(low), abs(high)) > _LARGEST:
        raise InputError(f"{where}: the bounds of {name} are {low:g} and {high:g}; the largest value is {_LARGEST:g}.")
    if low >= high:
        raise InputError(
            f"{where}: the range of {name} is {low:g} to {high:g}; the lower bound must be below the upper."
        )
    if step is not None and not 0 < step <= high - low:
        raise InputError(f"{where}: the step of {name} must be above 0 and at most {high - low:g}.")
    if step is not None and (high - low) / step > _MOST_STEPS:
        raise InputError(
            f"{where}: the range of {name} has {(high - low) / step:.3g} steps; use at most {_MOST_STEPS:g}, or no"
            " step."
        )
    return Parameter(name, low, high, step)


def require_names(names: Sequence[str], where: str) -> None:
    """Raise `InputError` if a name is empty or occurs twice."""
    for name in names:
        if not name:
            raise InputError(f"{where}: a varied parameter has no name.")
        if names.count(name) > 1:
            raise InputError(f"{where}: the parameter {name} is varied twice; keep one of them.")
