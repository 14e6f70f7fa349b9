"""Exactly one result per scenario from any simulator, even if the simulator fails."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from cornercase._common.errors import InputError, PluginError, SimulationError
from cornercase._common.io.support_table import Notice
from cornercase._common.plugin_errors import convert_plugin_errors, make_scenario_failure
from cornercase._common.process.signals import count_termination_requests
from cornercase._common.text.element_locations import remove_file_prefix
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario, Value
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators._base import Simulator
from cornercase.simulators._remote import RemoteSimulator

Outcome = Recording | SimulationError

_NO_RESULT: Final[object] = object()


def run_scenarios(simulator: Simulator, concretes: Sequence[ConcreteScenario]) -> Iterator[Outcome]:
    """Run scenarios and yield one recording or error for each, in order.

    If the simulator raises an exception or stops early, the remaining scenarios are run one by one, so that only the
    scenario at fault fails. Parameter values are passed by name or by file, as the simulator requires. Raises
    `InputError` if no scenario can be run.
    """
    yield from run_scenarios_as_given(simulator, adapt_values_to_simulator(simulator, concretes))


def adapt_values_to_simulator(
    simulator: Simulator, concretes: Sequence[ConcreteScenario]
) -> Sequence[ConcreteScenario]:
    """Return scenarios with the parameter values that a simulator requires, according to its `parameter_passing`.

    These are the values of all parameters, or only the values that differ from the scenario file.
    """
    return (
        concretes if simulator.parameter_passing == "file" else [concrete.with_all_values() for concrete in concretes]
    )


def run_scenarios_as_given(simulator: Simulator, concretes: Sequence[ConcreteScenario]) -> Iterator[Outcome]:
    """Run scenarios like `run_scenarios`; parameter values must already be in the form that the simulator requires."""
    results: Iterator[object] | None = None
    last = len(concretes) - 1
    for k in range(len(concretes)):
        result, requests_before = _NO_RESULT, count_termination_requests()
        try:
            if results is None:
                results = iter(simulator.run(concretes))
            result = next(results, _NO_RESULT)
            if k == last:
                # Let it clean up before its last result counts: if that fails, the scenario is run again.
                next(results, None)
        except InputError:
            raise
        except BaseException as error:
            if isinstance(simulator, RemoteSimulator):
                # A failure of the machine or cornercase: simulators fail in their own process.
                raise
            failure = make_scenario_failure("the simulator", error, requests_before)
            result = failure if last == 0 else _NO_RESULT
        if result is _NO_RESULT and last > 0:
            for concrete in concretes[k:]:
                yield from run_scenarios_as_given(simulator, [concrete])
            return
        yield _with_road_file(_check_outcome(result), concretes[k])


def check_simulator_accepts(
    simulator: Simulator, scenarios: Iterable[ScenarioFile], concretes: Sequence[ConcreteScenario] = ()
) -> None:
    """Raise `InputError` if a simulator refuses one of the scenarios, or can run none of the sample `concretes`."""
    with convert_plugin_errors(
        f"The simulator '{simulator.name}'", get_simulator_class(simulator), "in check_supported or check_runnable"
    ):
        for scenario in scenarios:
            simulator.check_supported(scenario)
        if concretes:
            simulator.check_runnable(adapt_values_to_simulator(simulator, concretes))


def find_refusals(simulator: Simulator, concretes: Sequence[ConcreteScenario]) -> dict[int, str]:
    """Return the reasons why a simulator refuses scenarios, by index; `InputError` if all scenarios are refused."""
    if len(concretes) == 1:
        check_simulator_accepts(simulator, [concretes[0].load_file()], concretes)
        return {}
    refusals: dict[int, InputError] = {}
    with convert_plugin_errors(
        f"The simulator '{simulator.name}'", get_simulator_class(simulator), "in check_supported or check_runnable"
    ):
        for k, concrete in enumerate(concretes):
            try:
                simulator.check_supported(concrete.load_file())
                simulator.check_runnable(adapt_values_to_simulator(simulator, [concrete]))
            except InputError as error:
                refusals[k] = error
    if refusals and len(refusals) == len(concretes):
        raise refusals[0]
    return {k: describe_file_error(concretes[k].path, error) for k, error in refusals.items()}


def describe_file_error(path: Path, error: InputError) -> str:
    """Return why a scenario file cannot be used: an error's text without the file name and the full stop."""
    return remove_file_prefix(str(path), str(error)).removesuffix(".")


def list_ignored_content(
    simulator: Simulator, scenario: ScenarioFile, values: Mapping[str, Value] | None = None
) -> tuple[Notice, ...]:
    """List the content of a scenario that has no effect in a simulator."""
    declared = get_simulator_class(simulator)
    with convert_plugin_errors(f"The simulator '{simulator.name}'", declared, "in notices"):
        return tuple(declared.notices(scenario, values))


def get_simulator_class(simulator: Simulator) -> type[Simulator]:
    """Return the class of a simulator; for a `RemoteSimulator`, the class that runs in other processes."""
    return simulator.simulator_class if isinstance(simulator, RemoteSimulator) else type(simulator)


def _with_road_file(outcome: Outcome, concrete: ConcreteScenario) -> Outcome:
    """Return a recording with the road file of its scenario, for metrics."""
    if isinstance(outcome, SimulationError) or outcome.road_file is not None:
        return outcome
    try:
        return replace(outcome, road_file=concrete.load_file().road_path_for(concrete.values))
    except InputError:
        # A simulator may run files that cornercase does not read.
        return outcome


def _check_outcome(result: object) -> Outcome:
    if isinstance(result, Recording | SimulationError):
        return result
    if result is _NO_RESULT:
        return PluginError("the simulator ended without a result")
    description = "None" if result is None else f"a {type(result).__name__}"
    return PluginError(f"the simulator gave {description} instead of a recording")
