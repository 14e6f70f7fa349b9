"""Description of an entity's driver as text: its parts, their options, and the options that can be searched."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from inspect import Parameter
from typing import Any

from cornercase._common.configurable import declared_options, format_option_value, given_options
from cornercase.drivers._compiled import CompiledDriver
from cornercase.drivers._driving_function import DrivingFunction
from cornercase.drivers._parameters import fixed_options, parts_by_name, searchable_options
from cornercase.drivers._resolve import DriverLike, driver_by_name, resolve_driver
from cornercase.drivers._system_under_test import PerScenarioDriver


def describe_driver(entity: str, driver: DriverLike) -> Iterator[str]:
    """Yield text lines about an entity's driver, sensors and vehicle model: options, and which can be searched."""
    resolved = resolve_driver(driver)
    made = driver_by_name(resolved) if isinstance(resolved, str) else resolved
    yield f"{entity}: driven by {driver if isinstance(driver, str) else made}"
    parts = parts_by_name(made)
    for name, part in parts.items():
        texts = [f"{option}={format_option_value(value)}" for option, value in _options_of(part).items()]
        yield f"  {name}: {', '.join(texts) or 'no options'}"
        if isinstance(part, DrivingFunction):
            yield from (f"  {line}" for line in part.describe())
    if names := list(_searchable_names(parts)):
        yield f"  can be searched, as in --range {entity}.{names[0]}=LOW:HIGH: {', '.join(names)}"


def _options_of(part: Any) -> Mapping[str, bool | int | float | str]:
    """Return the options of a driver, sensor or vehicle model with their values."""
    if isinstance(part, CompiledDriver):
        options: dict[str, Any] = {name: value for name, value in part.settings.items() if name != "driver"}
    elif isinstance(part, DrivingFunction) and not isinstance(part, PerScenarioDriver):
        options = {**part.options_in_force()}
    else:
        made = part.prototype if isinstance(part, PerScenarioDriver) else part
        given = given_options(made)
        options = {
            name: given.get(name, parameter.default)
            for name, parameter in declared_options(type(made)).items()
            if name != "name" and (name in given or parameter.default is not Parameter.empty)
        }
    return {name: value for name, value in options.items() if isinstance(value, bool | int | float | str)}


def _searchable_names(parts: Mapping[str, Any]) -> Iterator[str]:
    """Yield the names under which numeric options can be searched, except for options that have been given.

    If several parts (driver, sensors, vehicle model) have the same option, the name starts with the part, as in
    ``radar.range``.
    """
    numbers = {part: searchable_options(made) for part, made in parts.items()}
    counts = Counter(option for options in numbers.values() for option in options)
    for part, options in numbers.items():
        fixed = fixed_options(parts[part])
        for option in options:
            if option not in fixed:
                yield option if counts[option] == 1 else f"{part}.{option}"
