"""One outcome for each scenario, whatever a simulator gives."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from cornercase._common.errors import SimulationError
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario
from cornercase.simulators.base import Simulator

Outcome = Recording | SimulationError

_END: Final = object()


def outcomes_of(simulator: Simulator, concretes: Sequence[ConcreteScenario]) -> Iterator[Outcome]:
    """Run scenarios, with an outcome for each.

    If the simulator ends before it has given one for each, the rest is run one by one, so that only the scenario at
    fault fails.

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
        A value in a scenario file cannot be used, or what the simulator raises.
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
    results = iter(simulator.run(concretes))
    last = len(concretes) - 1
    for k in range(len(concretes)):
        found = next(results, _END)
        if found is _END and last > 0:
            for one in concretes[k:]:
                yield from outcomes_as_given(simulator, [one])
            return
        if k == last:
            # Let it clear up before its last result counts: if that fails, the scenario is run again.
            next(results, None)
        yield _outcome(found)


def _outcome(found: object) -> Outcome:
    if isinstance(found, Recording | SimulationError):
        return found
    if found is _END:
        return SimulationError("the simulator ended without a result")
    what = "None" if found is None else f"a {type(found).__name__}"
    return SimulationError(f"the simulator gave {what} instead of a recording")
