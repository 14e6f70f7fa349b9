"""What a simulator is."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from cornercase._common.errors import InputError, SimulationError
from cornercase.drivers import Driver
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario


class Simulator(Protocol):
    """Runs concrete scenarios.

    One that cannot run every scenario that the builtin one can may have a method ``require_means(scenario)``, which
    raises an `InputError` for what it cannot; it is asked before anything is run.

    Attributes
    ----------
    name : str
        As on the command line: ``"builtin"``.
    settings : dict
        Everything besides the scenario that the recordings depend on, as plain JSON values. It is stored with a
        study, and a study goes on only with the same settings.
    """

    name: str
    settings: dict[str, object]

    def run(self, concretes: Sequence[ConcreteScenario]) -> Iterator[Recording | SimulationError]:
        """Give one recording or one error per concrete scenario, in order.

        Raises
        ------
        InputError
            The scenario file itself cannot be used, so none of them can run.
        """
        ...


@dataclass(frozen=True)
class Availability:
    """Whether a simulator can run here; what a simulator's class method `availability` gives, where it has one.

    Attributes
    ----------
    version : str
        Empty where that is not known.
    missing : str
        What is missing and how to get it, as a sentence; empty where nothing is.
    abilities : tuple of str
        What it can do, in a few words each.
    """

    version: str
    missing: str
    abilities: tuple[str, ...]


def checked_seed(seed: int, whose: str) -> int:
    """Return a seed that a simulator takes.

    Raises
    ------
    InputError
        It is not a whole number from 0 to 2147483647.
    """
    if not (isinstance(seed, int) and 0 <= seed < 2**31):
        raise InputError(f"The seed of {whose} is {seed}; give a whole number from 0 to 2147483647.")
    return seed


def checked_settings(
    time_step: float, duration: float, on_collision: str, drivers: Mapping[str, str | Driver] | None
) -> dict[str, object]:
    """Settings that all simulators with a storyboard have, as plain values.

    Raises
    ------
    InputError
        One is out of range.
    """
    if not 0.001 <= time_step <= 1.0:
        raise InputError(f"The time step is {time_step} s; choose one from 0.001 s to 1 s.")
    if not time_step <= duration <= 3600.0:
        raise InputError(f"The duration is {duration} s; choose one from one time step to 3600 s.")
    if on_collision not in ("continue", "stop"):
        raise InputError(f"on_collision is '{on_collision}'; it is continue or stop.")
    return {
        "time_step": time_step,
        "duration": duration,
        "on_collision": on_collision,
        "drivers": {
            entity: driver if isinstance(driver, str) else driver.settings
            for entity, driver in sorted((drivers or {}).items())
        },
    }
