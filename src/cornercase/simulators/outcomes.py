"""One outcome for each scenario, whatever a simulator gives."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

from cornercase._common.errors import InputError, PartError, SimulationError
from cornercase._common.interrupts import requests_heard
from cornercase._common.ledger import Notice
from cornercase._common.parts import failure_of, guarded
from cornercase._common.places import without_file
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario, Scenario, Value
from cornercase.simulators.base import Simulator
from cornercase.simulators.elsewhere import SimulatorElsewhere
from cornercase.simulators.registry import SIMULATORS

Outcome = Recording | SimulationError

_END: Final[object] = object()


def outcomes_of(simulator: Simulator, concretes: Sequence[ConcreteScenario]) -> Iterator[Outcome]:
    """Run scenarios, with an outcome for each.

    If the simulator ends before it has given one for each, or raises an exception, the rest is run one by one, so that
    only the scenario at fault fails.

    Parameters
    ----------
    simulator : Simulator
    concretes : sequence of ConcreteScenario
        Their values are given to the simulator as it takes them.

    Yields
    ------
    Recording or SimulationError
        One for each scenario, in order; an error for one that got neither.

    Raises
    ------
    InputError
        None of them can be run; a value in a scenario file cannot be used, for one.
    """
    yield from outcomes_as_given(simulator, with_values(simulator, concretes))


def with_values(simulator: Simulator, concretes: Sequence[ConcreteScenario]) -> Sequence[ConcreteScenario]:
    """Give scenarios their values as a simulator takes them: by name, or by file.

    Parameters
    ----------
    simulator : Simulator
    concretes : sequence of ConcreteScenario

    Returns
    -------
    sequence of ConcreteScenario

    Raises
    ------
    InputError
        A value in a scenario file cannot be used.
    """
    return concretes if simulator.values_by == "file" else [one.by_name() for one in concretes]


def outcomes_as_given(simulator: Simulator, concretes: Sequence[ConcreteScenario]) -> Iterator[Outcome]:
    """Run scenarios whose values are as the simulator takes them, with an outcome for each, as `outcomes_of` does."""
    results: Iterator[object] | None = None
    last = len(concretes) - 1
    for k in range(len(concretes)):
        found, heard = _END, requests_heard()
        try:
            if results is None:
                results = iter(simulator.run(concretes))
            found = next(results, _END)
            if k == last:
                # Let it clear up before its last result counts: if that fails, the scenario is run again.
                next(results, None)
        except InputError:
            raise
        except BaseException as error:
            if isinstance(simulator, SimulatorElsewhere):
                # It is the machine or cornercase itself: simulators in other processes fail there.
                raise
            failure = failure_of("the simulator", error, heard)
            found = failure if last == 0 else _END
        if found is _END and last > 0:
            for one in concretes[k:]:
                yield from outcomes_as_given(simulator, [one])
            return
        yield _outcome(found)


def require_usable(
    simulator: Simulator, scenarios: Iterable[Scenario], concretes: Sequence[ConcreteScenario] = ()
) -> None:
    """Let a simulator refuse scenarios before anything is run.

    Parameters
    ----------
    simulator : Simulator
    scenarios : iterable of Scenario
        Each of which it has to have the means for.
    concretes : sequence of ConcreteScenario
        Some of those that may be run, of which it has to be able to run one at least.

    Raises
    ------
    InputError
        It refuses one, or fails.
    """
    with guarded(f"The simulator '{simulator.name}'", _declared(simulator), "in require_means or require_runnable"):
        for scenario in scenarios:
            simulator.require_means(scenario)
        if concretes:
            simulator.require_runnable(with_values(simulator, concretes))


def refusals_of(simulator: Simulator, concretes: Sequence[ConcreteScenario]) -> dict[int, str]:
    """Find which of several scenario files a simulator cannot run, before anything is run.

    Parameters
    ----------
    simulator : Simulator
    concretes : sequence of ConcreteScenario
        Each of a file of its own.

    Returns
    -------
    dict of int to str
        Why, as why a scenario failed, by number in the sequence.

    Raises
    ------
    InputError
        It refuses all, as it does the first, or fails.
    """
    if len(concretes) == 1:
        require_usable(simulator, [concretes[0].scenario()], concretes)
        return {}
    found: dict[int, InputError] = {}
    with guarded(f"The simulator '{simulator.name}'", _declared(simulator), "in require_means or require_runnable"):
        for k, concrete in enumerate(concretes):
            try:
                simulator.require_means(concrete.scenario())
                simulator.require_runnable(with_values(simulator, [concrete]))
            except InputError as error:
                found[k] = error
    if found and len(found) == len(concretes):
        raise found[0]
    return {k: failure_words(concretes[k].path, error) for k, error in found.items()}


def failure_words(path: Path, error: InputError) -> str:
    """Say why a scenario failed whose file cannot be used.

    Parameters
    ----------
    path : Path
        The file.
    error : InputError
        What is wrong with it.

    Returns
    -------
    str
        A part of a sentence, without the file and a full stop.
    """
    return without_file(str(path), str(error)).removesuffix(".")


def notices_of(name: str, scenario: Scenario, values: Mapping[str, Value] | None = None) -> tuple[Notice, ...]:
    """Let a simulator, which may be a class of anybody, name what of a scenario changes nothing in it.

    Parameters
    ----------
    name : str
        Registered simulator.
    scenario : Scenario
    values : mapping of str to float or str, optional

    Returns
    -------
    tuple of Notice

    Raises
    ------
    InputError
        It fails.
    """
    declared = SIMULATORS.class_of(name)
    with guarded(f"The simulator '{name}'", declared, "in notices"):
        return tuple(declared.notices(scenario, values))


def _declared(simulator: Simulator) -> type[Simulator]:
    """Class of a simulator, also if it runs in other processes."""
    return simulator.declared if isinstance(simulator, SimulatorElsewhere) else type(simulator)


def _outcome(found: object) -> Outcome:
    if isinstance(found, Recording | SimulationError):
        return found
    if found is _END:
        return PartError("the simulator ended without a result")
    what = "None" if found is None else f"a {type(found).__name__}"
    return PartError(f"the simulator gave {what} instead of a recording")
