"""Mutants of a driver, for mutation testing: the same driver, but worse in one respect."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Protocol, runtime_checkable

import numpy as np

from cornercase._common.configurable import list_whole_number_option_names
from cornercase._common.errors import InputError, suggest_name
from cornercase._common.validation import check_int, check_str
from cornercase.drivers._base import Driver
from cornercase.drivers._equipment import EquippedDriver
from cornercase.drivers._mutation import Mutation
from cornercase.drivers._preset_name import nearest_preset_name, preset_parameters
from cornercase.drivers._registry import SEPARATOR, is_registered_driver, split_spec
from cornercase.drivers._resolve import driver_by_name, may_be_named_in_file, runs_program_or_file
from cornercase.drivers._serialization import user_driver_spec
from cornercase.drivers._system_under_test import PerScenarioDriver

MAX_MUTANTS: Final = 1000
"""Maximum number of mutants of a driver."""

_GOLDEN_RATIO: Final = (math.sqrt(5.0) - 1.0) / 2.0


MUTATIONS: Final = (
    Mutation("reacts later", "reaction_time", 0.1, 1.5, is_offset=True),
    Mutation("foresees less", "horizon", 0.8, 0.1),
    Mutation("narrower view", "field_of_view", 0.8, 0.1),
    Mutation("shorter sight", "sight_range", 0.7, 0.1),
    Mutation("forgets sooner", "memory", 0.7, 0.05),
    Mutation("weaker brakes", "max_deceleration", 0.8, 0.25),
    Mutation("brakes later", "comfortable_deceleration", 1.2, 3.0),
    Mutation("less patience", "safety_time", 0.8, 0.05),
    Mutation("stops closer", "braking_distance", 0.7, 0.05),
    Mutation("narrower margin", "lateral_margin", 0.7, 0.05),
    Mutation("follows closer in time", "time_headway", 0.7, 0.1),
    Mutation("follows closer at rest", "min_gap", 0.7, 0.1),
    Mutation("faster than asked for", "target_share", 1.05, 1.4),
    Mutation("faster in curves", "lateral_acceleration", 1.2, 3.0),
    Mutation("accelerates more", "acceleration", 1.2, 3.0),
)
"""Changes that make a preset worse; each preset uses the mutations of the parameters that it has."""


@dataclass(frozen=True)
class Mutant:
    """Mutant of a driver, which is worse in one respect, for mutation testing.

    Attributes
    ----------
    driver : str
        Name that creates the mutant, such as ``"normal:reaction_time=0.8"``.
    mutation : str
        What was changed, in words.

    Examples
    --------
    >>> from cornercase.drivers import generate_mutants
    >>> (mutant,) = generate_mutants("normal", 1)
    >>> mutant.driver, mutant.mutation
    ('normal:field_of_view=2.86', 'narrower view')
    """

    driver: str
    mutation: str


def generate_mutants(driver: str, count: int, seed: int = 0) -> tuple[Mutant, ...]:
    """Draw mutants of a driver, each worse in one parameter.

    The mutations take turns in random order. The severity of a mutant is a point between mild and severe on a
    logarithmic scale. The severities of the same mutation start at a random point and then advance by the golden ratio
    (additive recurrence), so that they cover the scale evenly.

    Parameters
    ----------
    driver : str
        A preset, possibly with options: ``"normal:horizon=4"``; or a class of your own that declares `mutations`:
        ``"my_aeb:Aeb:reaction=0.3"``; or an FMU or a program with a file of mutations:
        ``"fmu:aeb.fmu:mutations=mutations.toml"``. The mutants keep the sensors and the vehicle model of this driver.
    count : int
        Number of mutants. A larger number returns the same mutants as a smaller number, and then further ones. There
        are fewer if all parameters that are changed are whole numbers with few values.
    seed : int, default 0
        The same seed gives the same mutants.

    Returns
    -------
    tuple of Mutant
        All different from each other and from the driver.

    Raises
    ------
    InputError
        If there is no such driver, or no mutations of the driver are known, or none of them changes a parameter.

    References
    ----------
    R. A. DeMillo, R. J. Lipton, F. G. Sayward, "Hints on Test Data Selection: Help for the Practicing Programmer",
    Computer 11(4), 1978. Y. Jia, M. Harman, "An Analysis and Survey of the Development of Mutation Testing", IEEE
    Transactions on Software Engineering 37(5), 2011.

    Examples
    --------
    >>> from cornercase.drivers import generate_mutants
    >>> [mutant.driver for mutant in generate_mutants("normal:horizon=4", 2)]
    ['normal:horizon=4,field_of_view=2.86', 'normal:horizon=4,min_gap=0.338']
    """
    count = check_int("count", count, 1, MAX_MUTANTS)
    rng = np.random.default_rng(check_int("seed", seed, 0))
    declared, parameters = _mutations_and_parameters(check_str("driver", driver))
    mutations = [
        mutation
        for mutation in declared
        if parameters.get(mutation.parameter, 0.0) or (mutation.is_offset and mutation.parameter in parameters)
    ]
    mutations = [mutations[i] for i in rng.permutation(len(mutations))]
    starts = rng.random(len(mutations))
    unchanged = {
        mutation.parameter: _set_driver_option(driver, mutation.parameter, parameters[mutation.parameter])
        for mutation in mutations
    }
    mutants: dict[str, Mutant] = {}
    # Values are rounded to three digits, so some coincide; there are enough others.
    for round_number in range(2 * count):
        for mutation, start in zip(mutations, starts.tolist(), strict=True):
            severity = math.fmod(start + round_number * _GOLDEN_RATIO, 1.0)
            value = _mutate_value(mutation, parameters[mutation.parameter], severity)
            name = _set_driver_option(driver, mutation.parameter, value)
            if name != unchanged[mutation.parameter] and name not in mutants:
                mutants[name] = Mutant(name, mutation.description)
            if len(mutants) == count:
                return tuple(mutants.values())
    if not mutants:
        raise InputError(
            f"The driver '{driver}' has no mutants, as no mutation changes a parameter; a parameter of 0 needs an"
            " increase, not a factor, and a whole number needs one that does not vanish by rounding."
        )
    return tuple(mutants.values())


def _mutate_value(mutation: Mutation, value: float, severity: float) -> float:
    amount: float = mutation.mild * (mutation.severe / mutation.mild) ** severity
    mutated = float(f"{value + amount if mutation.is_offset else value * amount:.3g}")
    return round(mutated) if isinstance(value, int) else mutated


def _set_driver_option(driver: str, parameter: str, value: float) -> str:
    driver, equipment = split_spec(driver)
    if runs_program_or_file(driver):
        return SEPARATOR.join([_create_with_file_mutations(driver).spec_with({parameter: value}), *equipment])
    # The name of a class has a colon of its own.
    n_parts = 1 if is_registered_driver(driver) else 2
    base, options = ":".join(driver.split(":")[:n_parts]), ":".join(driver.split(":")[n_parts:])
    other_options = [
        option for option in options.split(",") if option and option.partition("=")[0].strip() != parameter
    ]
    return SEPARATOR.join([f"{base}:{','.join([*other_options, f'{parameter}={value:g}'])}", *equipment])


def mutable_driver_name(driver: str | Driver | Mapping[str, object]) -> str:
    """Return the name of a driver that can have mutants: a user's class, FMU or program, or else the nearest preset.

    `driver` is a name, a driver, or a driver's settings as stored in a study. Names and stored settings may come from a
    file, so only registered code of users is loaded for them. Raises `InputError` for a driver that cannot have
    mutants.
    """
    if (
        not isinstance(driver, Mapping)
        and (isinstance(driver, Driver) or may_be_named_in_file(driver))
        and (own := user_driver_spec(driver)) is not None
    ):
        _mutations_and_parameters(own)
        return own
    inner, equipment = _split_equipment(driver)
    if isinstance(inner, HasFileMutations):
        name = SEPARATOR.join([inner.spec_with({}), *equipment])
        _mutations_and_parameters(name)
        return name
    if isinstance(driver, Mapping) and "sha256" in driver:
        raise InputError(
            f"The study stores only the name of the driver {driver.get('driver')}, but mutants need its code; give the"
            " driver with `drivers`."
        )
    name = SEPARATOR.join([nearest_preset_name(inner), *equipment])
    if not isinstance(driver, Driver) and not may_be_named_in_file(name):
        raise InputError(
            f"The driver '{name}' has no mutants, as a file may only name registered sensors and vehicle models with"
            " numbers as options; give the driver with `drivers`."
        )
    return name


def _split_equipment(
    driver: str | Driver | Mapping[str, object],
) -> tuple[str | Driver | Mapping[str, object], tuple[str, ...]]:
    """Split a driver, or its settings as stored in a study, into the driver itself and the names of its equipment."""
    if isinstance(driver, str):
        return split_spec(driver)
    if isinstance(driver, EquippedDriver):
        return driver.driver, tuple(map(str, driver.equipment))
    if isinstance(driver, Mapping) and isinstance(equipment := driver.get("equipment"), list | tuple):
        inner = {key: value for key, value in driver.items() if key != "equipment"}
        return str(inner["driver"]) if [*inner] == ["driver"] else inner, tuple(map(str, equipment))
    return driver, ()


def is_user_class_name(name: str) -> bool:
    """Return whether the name of a driver stands for a class of the user, not for a registered driver."""
    return not is_registered_driver(name)


def _mutations_and_parameters(driver: str) -> tuple[Sequence[Mutation], dict[str, float]]:
    """Return the mutations that are possible in a driver, and the values of its numeric parameters."""
    name, _ = split_spec(driver)
    if runs_program_or_file(name):
        attached = _create_with_file_mutations(name)
        return attached.file_mutations, _mutable_parameters(name, attached)
    if is_registered_driver(name) and user_driver_spec(name) is None:
        return MUTATIONS, preset_parameters(name)
    created = driver_by_name(name)
    if not isinstance(created, Driver) or not created.mutations:
        raise InputError(
            f"The driver '{name}' has no mutants, as its class declares none; list what can be wrong in its attribute"
            " `mutations`."
        )
    made = created.prototype if isinstance(created, PerScenarioDriver) else created
    whole = list_whole_number_option_names(type(made))
    parameters = {
        name: int(value) if name in whole and value.is_integer() else value
        for name, value in created.numeric_parameters().items()
    }
    for mutation in created.mutations:
        if mutation.parameter not in parameters:
            raise InputError(
                f"The driver '{name}' declares a mutation of '{mutation.parameter}', but its constructor has no option"
                " of this name with a number as default."
            )
    return created.mutations, parameters


@runtime_checkable
class HasFileMutations(Protocol):
    """FMU or program as a driver: its name contains the parameter values, and a file lists its mutations."""

    file_mutations: tuple[Mutation, ...]

    def spec_with(self, changes: Mapping[str, float]) -> str: ...

    def numeric_parameters(self) -> dict[str, float]: ...


def _create_with_file_mutations(name: str) -> HasFileMutations:
    created = driver_by_name(name)
    if not isinstance(created, HasFileMutations) or not created.file_mutations:
        raise InputError(
            f"The driver '{name}' has no mutants, as no file says how far its parameters may be off; give such a"
            " file with the option mutations=mutations.toml."
        )
    return created


def _mutable_parameters(name: str, attached: HasFileMutations) -> dict[str, float]:
    numbers = attached.numeric_parameters()
    for mutation in attached.file_mutations:
        if mutation.parameter not in numbers:
            hint = suggest_name(mutation.parameter, numbers)
            raise InputError(f"The driver '{name}' has no numeric parameter '{mutation.parameter}'; {hint}")
    return numbers
