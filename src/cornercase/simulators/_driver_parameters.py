"""Checks of parameters of drivers, sensors and vehicles, such as ``Ego.reaction``, before anything is run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from cornercase._common.errors import InputError
from cornercase.drivers import Driver
from cornercase.drivers._parameters import check_parameters, read_parameters
from cornercase.drivers._resolve import check_drivers, create_driver_named_in_file, driver_by_name
from cornercase.scenario import ParameterSpace, Value
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators._base import Simulator
from cornercase.simulators._registry import SIMULATORS


def find_parameters_of_drivers(
    scenario: ScenarioFile, drivers: Mapping[str, object], names: Iterable[str]
) -> list[tuple[str, Driver, dict[str, str]]]:
    """Find the parameters of drivers, such as ``Ego.reaction``, among `names`.

    Returns one tuple per entity: the entity, its driver, and a dict from short to full names of the parameters, such as
    ``{"reaction": "Ego.reaction"}``. `drivers` take precedence over the drivers that the file names. Raises
    `InputError` for a parameter that the driver does not have.
    """
    by_entity: dict[str, dict[str, str]] = {}
    for full_name, (entity, name) in scenario.parse_driver_option_names(dict.fromkeys(names)).items():
        by_entity.setdefault(entity, {})[name] = full_name
    parameters = []
    for entity, own in by_entity.items():
        if entity in drivers:
            driver = check_drivers(drivers)[entity]
            made = driver_by_name(driver) if isinstance(driver, str) else driver
        elif entity in scenario.drivers:
            # A file must not name code that runs.
            try:
                made = create_driver_named_in_file(scenario.drivers[entity])
            except InputError as error:
                raise InputError(f"{scenario.path}: {error}") from None
        else:
            raise InputError(
                f"{scenario.path}: {next(iter(own.values()))} is a parameter of the driver of {entity}, but {entity}"
                f" has no driver; give `drivers`, as in {{{entity!r}: 'normal'}}."
            )
        check_parameters(entity, made, own)
        parameters.append((entity, made, own))
    return parameters


def check_driver_parameters(
    simulator: str | Simulator | type[Simulator],
    scenario: ScenarioFile,
    drivers: Mapping[str, object],
    samples: Sequence[Mapping[str, Value]],
) -> None:
    """Raise `InputError` if a simulator takes no parameters of drivers, or a driver refuses a value in `samples`."""
    names = list(dict.fromkeys(name for values in samples for name in values))
    if not (own := scenario.parse_driver_option_names(names)):
        return
    simulator_class = SIMULATORS.get_class(simulator)
    if not simulator_class.takes_driver_parameters:
        raise InputError(
            f"{scenario.path}: {next(iter(own))} is a parameter of a driver, which the simulator"
            f" '{simulator_class.name}' does not take; leave it out, or use the simulator 'builtin'."
        )
    for entity, driver, full_names in find_parameters_of_drivers(scenario, drivers, names):
        for name, full_name in full_names.items():
            values = [{name: sample[full_name]} for sample in samples if full_name in sample]
            _, problems = read_parameters(entity, driver, values, may_run_code=True)
            for problem in problems.values():
                raise InputError(f"{scenario.path}: {problem}.")


def list_probe_values(space: ParameterSpace) -> list[dict[str, Value]]:
    """Return the values with which to check each parameter of a space: both bounds and a value between, or all choices.

    Each dict of the list has a value of one parameter.
    """
    samples = list[dict[str, Value]]()
    for parameter in space.parameters:
        if parameter.choices:
            positions = parameter.level_midpoints(np.arange(len(parameter.choices)))
            samples += [parameter.assignment_at(position) for position in positions]
        else:
            samples += [{parameter.name: value} for value in (parameter.low, parameter.high)]
            samples.append(parameter.assignment_at(0.37))
    return samples
