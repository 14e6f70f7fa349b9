"""Read varied parameters from ``NAME=LOW:HIGH[:STEP]`` texts."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.text.parse_number import parse_number
from cornercase._common.validation import check_float, check_mapping, check_str_sequence, repr_short
from cornercase.scenario._parameter import Parameter

# Limits of what doubles can resolve.
_MAX_BOUND = 1e15
_MAX_STEPS = 1e9
_RANGE_PATTERN = re.compile(r"(?P<name>[^=]+)=(?P<low>[^:]+):(?P<high>[^:]+)(?::(?P<step>[^:]+))?")


def format_ranges(ranges: object) -> tuple[str, ...]:
    """Return ranges as texts ``NAME=LOW:HIGH[:STEP]``.

    `ranges` are such texts, or a mapping of parameter names to bounds, ``(LOW, HIGH)`` or ``(LOW, HIGH, STEP)``.
    """
    if not isinstance(ranges, Mapping):
        return check_str_sequence("ranges", ranges)
    texts = []
    for name, bounds in check_mapping("ranges", ranges).items():
        if isinstance(bounds, str) or not isinstance(bounds, Sequence) or len(bounds) not in (2, 3):
            raise InputError(f"`ranges` {name}={repr_short(bounds)}: give two bounds, as in {{{name!r}: (20, 80)}}.")
        texts.append(f"{name}={':'.join(repr(check_float('ranges', bound)) for bound in bounds)}")
    return tuple(texts)


def parse_ranges(texts: Sequence[str], option: str = "ranges") -> list[Parameter]:
    """Read ``NAME=LOW:HIGH[:STEP]`` texts; messages say that they come from the argument or option `option`."""
    parameters = [_parse_range(text, f"`{option}` {text}") for text in texts]
    require_unique_names([parameter.name for parameter in parameters], f"`{option}`")
    return parameters


def _parse_range(text: str, location: str) -> Parameter:
    match = _RANGE_PATTERN.fullmatch(text.strip())
    if match is None:
        raise InputError(f"{location}: is not a range; write NAME=LOW:HIGH or NAME=LOW:HIGH:STEP.")
    numbers = {}
    for key in ("low", "high", "step"):
        if match[key] is not None:
            try:
                numbers[key] = parse_number(match[key])
            except ValueError:
                raise InputError(f"{location}: '{match[key]}' is not a number.") from None
    return create_range(match["name"].strip(), numbers["low"], numbers["high"], numbers.get("step"), location)


def create_range(
    name: str, low: float, high: float, step: float | None, location: str, *, may_be_fixed: bool = False
) -> Parameter:
    """Create a parameter with a range; raises `InputError` if the range is invalid.

    If `may_be_fixed` is set, the bounds may be equal: the parameter then has a single value.
    """
    if not (np.isfinite(low) and np.isfinite(high)):
        raise InputError(f"{location}: the bounds of {name} must be finite.")
    if max(abs(low), abs(high)) > _MAX_BOUND:
        raise InputError(
            f"{location}: the bounds of {name} are {low:g} and {high:g}; bounds beyond ±{_MAX_BOUND:g} are refused."
        )
    if may_be_fixed and low == high:
        return Parameter(name, low, high, step or 1.0)
    if low >= high:
        fix = f"; in Python, vary({name!r}, {low:g}, {high:g}) fixes it" if low == high else ""
        raise InputError(
            f"{location}: the range of {name} is {low:g} to {high:g}; the lower bound must be below the upper{fix}."
        )
    if step is not None and not 0 < step <= high - low:
        raise InputError(f"{location}: the step of {name} must be above 0 and at most {high - low:g}.")
    if step is not None and (high - low) / step > _MAX_STEPS:
        raise InputError(
            f"{location}: the range of {name} has {(high - low) / step:.3g} steps; use at most {_MAX_STEPS:g}, or no"
            " step."
        )
    return Parameter(name, low, high, step)


def require_unique_names(names: Sequence[str], location: str) -> None:
    """Raise `InputError` if a name is empty or occurs more than once."""
    for name in names:
        if not name:
            raise InputError(f"{location}: a varied parameter has no name.")
        if names.count(name) > 1:
            raise InputError(f"{location}: the parameter {name} is varied twice; keep one of them.")
