"""Options of drivers, sensors and vehicle models that differ between scenarios, such as ``Ego.radar.range``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

import numpy as np

from cornercase._common.configurable import (
    Configurable,
    copy_with_numeric_options,
    given_options,
    list_numeric_option_names,
)
from cornercase._common.errors import InputError, suggest_name
from cornercase._common.plugin_errors import is_built_in
from cornercase._common.text.sanitize import format_exception
from cornercase._common.typing import FloatArray
from cornercase.drivers._base import Driver
from cornercase.drivers._driving_function import DrivingFunction
from cornercase.drivers._equipment import EquippedDriver
from cornercase.drivers._registry import SEPARATOR
from cornercase.drivers._serialization import recorded_options
from cornercase.drivers._system_under_test import PerScenarioDriver
from cornercase.drivers._varied_driver import VariedDriver
from cornercase.drivers.sensors._sensor import Sensor
from cornercase.drivers.vehicles._vehicle_model import VehicleModel

DRIVER: Final = "driver"
VEHICLE: Final = "vehicle"
Part = Driver | Sensor | VehicleModel


def parts_by_name(driver: Driver) -> dict[str, Part]:
    """Return a driver, its sensors and its vehicle model by the name of the part, such as ``radar`` in ``radar.range``.

    The driver is called ``driver``, the vehicle model ``vehicle``, and a sensor has its own name. Sensors of the same
    name are numbered from 1 on.
    """
    if not isinstance(driver, EquippedDriver):
        return {DRIVER: driver}
    names = [sensor.name.partition(":")[0] or type(sensor).__qualname__ for sensor in driver.sensors]
    seen, total = Counter[str](), Counter(names)
    parts: dict[str, Part] = {DRIVER: driver.driver}
    for name, sensor in zip(names, driver.sensors, strict=True):
        seen[name] += 1
        parts[f"{name}{seen[name]}" if total[name] > 1 else name] = sensor
    return parts if driver.vehicle is None else parts | {VEHICLE: driver.vehicle}


def find_parameter(entity: str, driver: Driver, name: str) -> tuple[str, str]:
    """Return the part (driver, sensor or vehicle model) and the option that a parameter name of an entity means.

    `name` is without the entity: an option, or a part and its option as in ``radar.range``. Raises `InputError` if no
    part has this option, or if several parts have it.
    """
    options = {part: searchable_options(made) for part, made in parts_by_name(driver).items()}
    matches = [(part, option) for part in options for option in options[part] if name in (option, f"{part}.{option}")]
    if len(matches) > 1:
        owners = " and of ".join(part for part, _ in matches)
        full_names = " or ".join(f"{entity}.{part}.{option}" for part, option in matches)
        raise InputError(f"{entity}.{name}: is an option of {owners}; write {full_names}.")
    if not matches:
        counts = Counter(option for own in options.values() for option in own)
        candidates = [
            f"{part}.{option}" if counts[option] > 1 or name.startswith(f"{part}.") else option
            for part in options
            for option in options[part]
        ]
        hint = suggest_name(name, candidates)
        if "." in name and name.partition(".")[0] not in options:
            hint = "numbers of the scenario file are varied by `vary`."
        elif not candidates and isinstance(driver, DrivingFunction) and driver.options_may_vary:
            hint = f"only options that it is given can be searched, so add it as in '{driver}:{name}=1'."
        raise InputError(
            f"{entity}.{name}: the driver of {entity} ({driver}) has no option '{name}' that takes numbers; {hint}"
        )
    return matches[0]


def check_parameters(entity: str, driver: Driver, names: Iterable[str]) -> None:
    """Raise `InputError` if a searched parameter is unknown, ambiguous, given twice, or already set in the driver."""
    meant: dict[tuple[str, str], str] = {}
    for name in names:
        part, option = find_parameter(entity, driver, name)
        if (other := meant.setdefault((part, option), name)) != name:
            raise InputError(f"{entity}.{name}: is the same option as {entity}.{other}; keep one of them.")
        if option in fixed_options(parts_by_name(driver)[part]):
            raise InputError(
                f"{entity}.{name}: the driver of {entity} ({driver}) is given with a fixed '{option}'; leave '{option}'"
                " out of the driver."
            )


def fixed_options(part: Part) -> set[str]:
    """Return the options that a driver, sensor or vehicle model was created with; a search cannot vary these."""
    if isinstance(part, DrivingFunction) and part.options_may_vary:
        return set()
    made: object = part.prototype if isinstance(part, PerScenarioDriver) else part
    given_by_name = recorded_options(made)
    if not isinstance(made, Configurable):
        return {*given_by_name}
    # The name of a driver of a user need not be a text.
    text = str(made if isinstance(made, VariedDriver) else made.name)
    in_text = [option.partition("=")[0].strip() for option in text.partition(":")[2].split(",")]
    return {*given_by_name, *given_options(made), *in_text}


def must_be_same_in_batch(driver: Driver, part: str) -> bool:
    """Return whether a part must have the same options in all scenarios of a batch (scenarios simulated together).

    This is so for a user's `Driver` class, since one object drives in all scenarios of a batch.
    """
    made = parts_by_name(driver)[part]
    can_vary = isinstance(made, DrivingFunction) or (isinstance(made, VariedDriver) and is_built_in(type(made)))
    return isinstance(made, Driver) and not can_vary


def read_parameters(
    entity: str, driver: Driver, values: Sequence[Mapping[str, object]], *, may_run_code: bool = False
) -> tuple[dict[str, FloatArray], dict[int, str]]:
    """Return an entity's parameters in N scenarios as arrays (N,) by name, and problems with invalid values.

    `values` has the values of each scenario by name of the parameter, without the entity. Problems are texts by index
    of the scenario; a scenario with a problem has the values of another, valid scenario in the arrays, or 0 if no
    scenario is valid. If `may_run_code`, constructors of users' classes check the values, too.
    """
    names = list(values[0]) if values else []
    parts, problems, usable = parts_by_name(driver), dict[int, str](), dict[tuple[float, ...], str]()
    targets = {name: find_parameter(entity, driver, name) for name in names}
    table = np.zeros((len(values), len(names)))
    for n, scenario in enumerate(values):
        for k, name in enumerate(names):
            try:
                table[n, k] = float(str(scenario[name]))
            except ValueError:
                table[n, k] = np.nan
            if not np.isfinite(table[n, k]):
                problems[n] = f"the parameter {entity}.{name} is '{scenario[name]}', which is not a number"
        if n not in problems:
            row = tuple(table[n].tolist())
            if row not in usable:
                usable[row] = _find_problem(parts, dict(zip(targets.values(), row, strict=True)), may_run_code)
            if usable[row]:
                given = ", ".join(f"{entity}.{name}={value:g}" for name, value in zip(names, row, strict=True))
                problems[n] = f"{given}: {usable[row]}"
    if problems:
        valid = next((n for n in range(len(values)) if n not in problems), None)
        table[list(problems)] = 0.0 if valid is None else table[valid]
    return {name: table[:, k].copy() for k, name in enumerate(names)}, problems


def split_parameters(
    entity: str, driver: Driver, parameters: Mapping[str, FloatArray]
) -> dict[str, dict[str, FloatArray]]:
    """Return the parameters of an entity by part (driver, sensor or vehicle model), then by option."""
    own: dict[str, dict[str, FloatArray]] = {part: {} for part in parts_by_name(driver)}
    for name, array in parameters.items():
        part, option = find_parameter(entity, driver, name)
        own[part][option] = array
    return own


def options_by_scenario(parameters: Mapping[str, FloatArray], scenarios: int) -> list[dict[str, float]]:
    """Return the options of each scenario by name, from arrays over the scenarios."""
    return [{name: float(values[n]) for name, values in parameters.items()} for n in range(scenarios)]


def spec_with_values(entity: str, driver: Driver, values: Mapping[str, object]) -> str:
    """Return the text that creates a driver with the options `values` added, as in ``"normal:horizon=4"``.

    The names in `values` are without the entity: an option, or a part and its option.
    """
    options: dict[str, list[str]] = {}
    for name, value in values.items():
        part, option = find_parameter(entity, driver, name)
        options.setdefault(part, []).append(f"{option}={value}")
    texts = []
    for part, made in parts_by_name(driver).items():
        text, own = str(made), ",".join(options.get(part, ()))
        texts.append(f"{text}{',' if ':' in text else ':'}{own}" if own else text)
    return SEPARATOR.join(texts)


def searchable_options(part: Part) -> tuple[str, ...]:
    """Return the names of the numeric options of a driver, sensor or vehicle model, which a search can vary."""
    if isinstance(part, DrivingFunction) and not isinstance(part, PerScenarioDriver):
        # Options of the adapter itself, such as a time limit, are not options of the FMU or program.
        return tuple(part.numeric_parameters())
    made = part.prototype if isinstance(part, PerScenarioDriver) else part
    declared = list_numeric_option_names(type(made)) if isinstance(made, Configurable) else []
    return tuple(dict.fromkeys((*declared, *(part.numeric_parameters() if isinstance(part, Driver) else ()))))


def _find_problem(parts: Mapping[str, Part], values: Mapping[tuple[str, str], float], may_run_code: bool) -> str:
    """Return why a constructor of a part refuses its values; an empty text if no constructor does."""
    for name, part in parts.items():
        numbers = {option: value for (of_part, option), value in values.items() if of_part == name}
        is_adapter = isinstance(part, DrivingFunction) and not isinstance(part, PerScenarioDriver)
        if not numbers or is_adapter or (_is_code_of_user(part) and not may_run_code):
            continue
        try:
            copy_with_numeric_options(part, numbers)
        except (InputError, ValueError) as error:
            return str(error).removesuffix(".")
        except Exception as error:
            return format_exception(error)
    return ""


def _is_code_of_user(part: Part) -> bool:
    return not is_built_in(type(part.prototype if isinstance(part, PerScenarioDriver) else part))
