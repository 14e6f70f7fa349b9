"""Get one result per scenario, whatever a simulator returns."""

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
    """Run scenarios and yield one recording or error each, in order.

    If the simulator raises an exception or stops early, the rest is run one by one, so that only the scenario at fault
    fails. Values are passed as the simulator takes them. Raises `InputError` if none can be run.
    """
    yield from outcomes_as_given(simulator, with_values(simulator, concretes))


def with_values(simulator: Simulator, concretes: Sequence[ConcreteScenario]) -> Sequence[ConcreteScenario]:
    """Return scenarios with values as a simulator takes them, by name or by file."""
    return concretes if simulator.values_by == "file" else [concrete.by_name() for concrete in concretes]


def outcomes_as_given(simulator: Simulator, concretes: Sequence[ConcreteScenario]) -> Iterator[Outcome]:
    """Like `run_scenarios`, for scenarios whose values are already as the simulator takes them."""
    results: Iterator[object] | None = None
    last = len(concretes) - 1
    for k in range(len(concretes)):
        result, requests_before = _END, requests_heard()
        try:
            if results is None:
                results = iter(simulator.run(concretes))
            result = next(results, _END)
            if k == last:
                # Let it clean up before its last result counts: if that fails, the scenario is run again.
                next(results, None)
        except InputError:
            raise
        except BaseException as error:
            if isinstance(simulator, SimulatorElsewhere):
                # A failure of the machine or cornercase: simulators fail in their own process.
                raise
            failure = failure_of("the simulator", error, requests_before)
            result = failure if last == 0 else _END
        if result is _END and last > 0:
            for concrete in concretes[k:]:
                yield from outcomes_as_given(simulator, [concrete])
            return
        yield _outcome(result)


def require_usable(
    simulator: Simulator, scenarios: Iterable[Scenario], concretes: Sequence[ConcreteScenario] = ()
) -> None:
    """Let a simulator check scenarios before anything is run; `InputError` if it refuses one or fails.

    Each of `scenarios` has to be supported, and at least one of the sample `concretes` has to be runnable.
    """
    with guarded(f"The simulator '{simulator.name}'", _declared(simulator), "in require_means or require_runnable"):
        for scenario in scenarios:
            simulator.require_means(scenario)
        if concretes:
            simulator.require_runnable(with_values(simulator, concretes))


def refusals_of(simulator: Simulator, concretes: Sequence[ConcreteScenario]) -> dict[int, str]:
    """Return which scenario files a simulator cannot run and why, by index, before anything is run.

    Each concrete scenario has a file of its own. Raises `InputError` if all are refused, or the simulator fails.
    """
    if len(concretes) == 1:
        require_usable(simulator, [concretes[0].scenario()], concretes)
        return {}
    refusals: dict[int, InputError] = {}
    with guarded(f"The simulator '{simulator.name}'", _declared(simulator), "in require_means or require_runnable"):
        for k, concrete in enumerate(concretes):
            try:
                simulator.require_means(concrete.scenario())
                simulator.require_runnable(with_values(simulator, [concrete]))
            except InputError as error:
                refusals[k] = error
    if refusals and len(refusals) == len(concretes):
        raise refusals[0]
    return {k: failure_words(concretes[k].path, error) for k, error in refusals.items()}


def failure_words(path: Path, error: InputError) -> str:
    """Describe why a scenario's file cannot be used, without the file's name and a full stop."""
    return without_file(str(path), str(error)).removesuffix(".")


def notices_of(name: str, scenario: Scenario, values: Mapping[str, Value] | None = None) -> tuple[Notice, ...]:
    """List scenario content without effect in a simulator; `InputError` if the simulator's class fails."""
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
    description = "None" if found is None else f"a {type(found).__name__}"
    return PartError(f"the simulator gave {description} instead of a recording")
