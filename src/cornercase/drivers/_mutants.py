"""Mutants of a driver, for mutation testing: the same driver, but worse in one respect."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.validation import check_int, check_str
from cornercase.drivers._base import Driver
from cornercase.drivers._compiled import CompiledDriver
from cornercase.drivers._registry import DRIVERS, is_registered_driver

MAX_MUTANTS: Final = 1000
"""Maximum number of mutants of a driver."""

_GOLDEN_RATIO: Final = (math.sqrt(5.0) - 1.0) / 2.0


@dataclass(frozen=True)
class Mutation:
    """A change that makes a driver worse: one parameter is multiplied by a factor, or increased if `is_offset`.

    `mild` and `severe` bound the factor, or the increase in the unit of the parameter. `description` is the text for
    tables.
    """

    description: str
    parameter: str
    mild: float
    severe: float
    is_offset: bool = False


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
"""All mutations; a driver gets those of its own parameters."""


@dataclass(frozen=True)
class Mutant:
    """A driver that is worse in one respect.

    Attributes
    ----------
    driver : str
        Name that creates it, such as ``"normal:reaction_time=0.8"``.
    mutation : str
        What was changed, in words.
    """

    driver: str
    mutation: str


def generate_mutants(driver: str, count: int, seed: int = 0) -> tuple[Mutant, ...]:
    """Draw mutants of a driver.

    The mutations take turns in random order. The severity of a mutant, from mild to severe on a logarithmic scale,
    follows the additive recurrence with the golden ratio from a random start for each mutation, which leaves no gaps.

    Parameters
    ----------
    driver : str
        A registered driver with parameters, possibly with options: ``"normal:horizon=4"``.
    count : int
        Number of mutants. A larger number only adds to the mutants of a smaller one.
    seed : int, default 0
        The same seed gives the same mutants.

    Returns
    -------
    tuple of Mutant
        All different from each other and from the driver.

    Raises
    ------
    InputError
        If there is no such driver, or it has no parameters to make worse.

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
    parameters = _numeric_parameters(check_str("driver", driver))
    mutations = [
        mutation
        for mutation in MUTATIONS
        if parameters.get(mutation.parameter, 0.0) or (mutation.is_offset and mutation.parameter in parameters)
    ]
    mutations = [mutations[i] for i in rng.permutation(len(mutations))]
    starts = rng.random(len(mutations))
    mutants: dict[str, Mutant] = {}
    # Values are rounded to three digits, so some coincide; there are enough others.
    for round_number in range(2 * count):
        for mutation, start in zip(mutations, starts.tolist(), strict=True):
            severity = math.fmod(start + round_number * _GOLDEN_RATIO, 1.0)
            value = float(f"{_mutate_value(mutation, parameters[mutation.parameter], severity):.3g}")
            name = _set_driver_option(driver, mutation.parameter, value)
            if value != parameters[mutation.parameter] and name not in mutants:
                mutants[name] = Mutant(name, mutation.description)
            if len(mutants) == count:
                return tuple(mutants.values())
    return tuple(mutants.values())


def _mutate_value(mutation: Mutation, value: float, severity: float) -> float:
    amount: float = mutation.mild * (mutation.severe / mutation.mild) ** severity
    return value + amount if mutation.is_offset else value * amount


def _set_driver_option(driver: str, parameter: str, value: float) -> str:
    base, _, options = driver.partition(":")
    other_options = [
        option for option in options.split(",") if option and option.partition("=")[0].strip() != parameter
    ]
    return f"{base}:{','.join([*other_options, f'{parameter}={value:g}'])}"


def nearest_preset_name(driver: str | Driver | Mapping[str, object]) -> str:
    """Name of a driver that can have mutants: the nearest preset, with options for what differs.

    Accepts a name, a driver, or its settings as stored in a study. Raises `InputError` for any other than cornercase's
    own drivers with parameters.
    """
    if isinstance(driver, str):
        _numeric_parameters(driver)
        return driver
    settings = dict(driver.settings if isinstance(driver, Driver) else driver)
    driver_kind = settings.get("driver")
    bases = {"behaviour": ("normal", "cautious", "aggressive"), "simple": ("simple",)}.get(str(driver_kind), ())
    candidates: list[tuple[int, str]] = []
    for base in bases:
        defaults = _numeric_parameters(base)
        # A user's class derived from a built-in driver may decide differently.
        if set(settings) != {"driver", *defaults} or not (isinstance(driver, Mapping) or _is_built_in(driver)):
            continue
        changed = {name: value for name, value in settings.items() if name in defaults and value != defaults[name]}
        options = ",".join(f"{name}={value!r}" for name, value in changed.items())
        candidates.append((len(changed), f"{base}:{options}" if options else base))
    if not candidates:
        raise InputError(f"The driver {driver_kind} has no mutants, as its parameters are unknown.")
    name = min(candidates, key=lambda candidate: candidate[0])[1]
    _numeric_parameters(name)
    return name


def _is_built_in(driver: Driver) -> bool:
    return type(driver).__module__.startswith("cornercase.drivers.")


def _numeric_parameters(driver: str) -> dict[str, float]:
    created = DRIVERS.create(driver) if is_registered_driver(driver) else None
    if not isinstance(created, CompiledDriver):
        raise InputError(
            f"The driver {driver} has no mutants, as its parameters are unknown; use cautious, normal, aggressive"
            " or simple."
        )
    return {name: float(value) for name, value in created.settings.items() if isinstance(value, int | float)}
