"""Contract checks of simulators."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from cornercase._common.configurable import declared_options
from cornercase._common.errors import InputError, SimulationError
from cornercase._common.geometry.boxes import wrap_angle
from cornercase._common.plugin_errors import convert_plugin_errors
from cornercase._common.validation import repr_short
from cornercase.recordings import Recording
from cornercase.recordings._compare import are_bitwise_equal, max_position_difference
from cornercase.simulators import SIMULATORS, Simulator
from cornercase.simulators._base import require_settings
from cornercase.simulators._registry import simulator_availability
from cornercase.testing._cases import Cases, default_cases, write_cases_without_drivers, write_cases_without_events
from cornercase.testing._contract_check import ContractCheck, NotTriedError
from cornercase.testing._crash import SimulatorCrashResult, crash_during_runs
from cornercase.testing._deviations import SmallRun, run_small_scenario, run_with_agent
from cornercase.testing._example_driver import CarFollowing
from cornercase.testing._small_scenarios import AGENT_DURATIONS, SMALL_SCENARIOS, write_small_scenarios

# m by which positions in two runs may differ, and a distance from the integral of the speed.
_TOLERANCE: Final = 0.5
# m/s; faster entities must point where they go.
_MOVING: Final = 2.0
# rad; the slip of a vehicle is smaller.
_MAX_SLIP: Final = 0.35
_AVAILABLE: Final = "can run on this machine"
_RUNS: Final = "gives one recording per scenario"
_OWN_FUNCTION: Final = "a function of one's own"
# Temporary folders of scenarios that checks will run.
_FOLDERS: Final = list[TemporaryDirectory[str]]()
# Check that a check needs; all other checks need recordings.
_NEEDS: Final = {_AVAILABLE: "", _RUNS: _AVAILABLE}


def simulator_checks(
    simulator: str | Simulator,
    cases: Sequence[Cases] | None = None,
    on_run: Callable[[SmallRun], None] | None = None,
    on_crash: Callable[[SimulatorCrashResult], None] | None = None,
) -> list[ContractCheck]:
    """Return the contract checks of a simulator.

    Parameters
    ----------
    simulator : str or Simulator
        Simulator, or its name with options after a colon, such as ``"esmini:seed=3"``.
    cases : sequence of Cases, optional
        Scenarios to run; by default some examples of cornercase.
    on_run : callable, optional
        Function that is called with the result of each small scenario, for example to write a report.
    on_crash : callable, optional
        Function that is called with the result of the check that kills the simulator on purpose.

    Returns
    -------
    list of ContractCheck

    Raises
    ------
    InputError
        The name is unknown, or a class is given instead of an object.

    Examples
    --------
    >>> from cornercase.testing import run_checks, simulator_checks
    >>> checks = simulator_checks("builtin")
    >>> checks[0].name
    'can run on this machine'
    >>> [result.problem for result in run_checks(checks) if result.problem]  # doctest: +SKIP
    []
    """
    if isinstance(simulator, type):
        name = simulator.__qualname__
        raise InputError(f"`simulator` {name}: is a class; give the simulator's name, or an object, as in {name}().")
    declared = SIMULATORS.get_class(simulator)
    given = cases if cases is not None else _default_cases(declared)
    checks = {
        _AVAILABLE: _check_availability,
        _RUNS: _check_recordings,
        "gives them in order": _check_scenario_order,
        "records m, rad, m/s, m/s² in right-handed axes": _check_recorded_units,
        "runs on after a scenario that cannot be run": _check_run_after_failure,
    }
    if declared.deterministic:
        checks["repeats itself, as it declares"] = _check_determinism
    if declared.batched:
        checks["gives the same alone and among other scenarios"] = _check_batch_independence
    if not declared.in_process:
        checks["goes on after a crash on purpose"] = partial(_check_crash_recovery, on_crash=on_crash)
    # Without drivers, since each simulator has drivers of its own.
    for name in SMALL_SCENARIOS:
        checks[f"agrees with the builtin simulator: {name}"] = partial(_check_agreement, name=name, on_run=on_run)
    for name in AGENT_DURATIONS:
        checks[f"agrees with the builtin simulator, driven by {_OWN_FUNCTION}: {name}"] = partial(
            _check_agreement_when_driven, name=name, on_run=on_run
        )
    with convert_plugin_errors(f"The simulator '{declared.name}'", declared, "in own_agents"):
        agents = declared.own_agents()
    for agent, options in agents.items():
        for name in AGENT_DURATIONS:
            checks[f"is driven by {agent}: {name}"] = partial(
                _check_agent_run, name=name, agent=agent, options=options, on_run=on_run
            )
    return [
        ContractCheck(name, partial(function, simulator, given), _NEEDS.get(name, _RUNS))
        for name, function in checks.items()
    ]


def _default_cases(declared: type[Simulator]) -> list[Cases]:
    if declared.runs_storyboard and declared.deterministic:
        return default_cases()
    folder = TemporaryDirectory()
    # Removed when the process ends, at the latest.
    _FOLDERS.append(folder)
    write = write_cases_without_drivers if declared.runs_storyboard else write_cases_without_events
    return write(Path(folder.name))


def _check_availability(simulator: Any, _: Sequence[Cases]) -> None:
    # Options may name a server on another machine, or start one.
    if not (isinstance(simulator, str) and ":" in simulator):
        problem = simulator_availability(simulator).problem
        assert not problem, problem
    created = SIMULATORS.create(simulator) if isinstance(simulator, str) else simulator
    require_settings(created)
    stored = json.loads(json.dumps(dict(created.settings)))
    for name, value in created.settings.items():
        assert stored.get(name) == value, (
            f"Its setting '{name}' is {repr_short(value)}, but {repr_short(stored.get(name))} after it was stored, so"
            " that a study could not be resumed; give plain JSON values."
        )


def _check_recordings(simulator: Any, all_cases: Sequence[Cases]) -> None:
    for cases in all_cases:
        for recording in cases.run(simulator):
            assert recording.time[0] == 0.0, f"A recording begins at {recording.time[0]:g} s instead of 0."
            assert (np.diff(recording.time) > 0.0).all(), "The instants of a recording do not increase."
            objects = cases.concretes[0].load_file().root.iter("ScenarioObject")
            missing = sorted({element.get("name", "") for element in objects} - set(recording.names))
            assert not missing, f"A recording lacks the entities {', '.join(missing)}."


def _check_scenario_order(simulator: Any, all_cases: Sequence[Cases]) -> None:
    for cases in all_cases:
        rows = range(len(cases.concretes))
        for first, second in zip(cases.run(simulator), cases.run(simulator, rows[::-1])[::-1], strict=True):
            distance = max_position_difference(first, second)
            assert distance is not None, (
                "In another order of the scenarios, a recording has other entities or instants."
            )
            assert distance < _TOLERANCE, f"In another order of the scenarios, an entity is {distance:.2f} m elsewhere."


def _check_recorded_units(simulator: Any, all_cases: Sequence[Cases]) -> None:
    for cases in all_cases:
        for recording in cases.run(simulator):
            _check_units_of_recording(recording)


def _check_units_of_recording(recording: Recording) -> None:
    step = np.diff(recording.time)
    for e, name in enumerate(recording.names):
        moved_x, moved_y = np.diff(recording.x[e]), np.diff(recording.y[e])
        speed = 0.5 * (recording.speed[e, 1:] + recording.speed[e, :-1])
        distance, expected = np.nansum(np.hypot(moved_x, moved_y)), np.nansum(np.abs(speed) * step)
        assert abs(distance - expected) < _TOLERANCE + 0.05 * expected, (
            f"{name} moves {distance:.1f} m, but its speeds add up to {expected:.1f} m; are they in m/s?"
        )
        is_moving = (np.hypot(moved_x, moved_y) > _MOVING * step) & (speed > _MOVING)
        slip = wrap_angle(np.arctan2(moved_y, moved_x) - recording.heading[e, 1:])[is_moving]
        if slip.size:
            middle = float(np.median(np.abs(slip)))
            assert middle < _MAX_SLIP, (
                f"{name} points {middle:.2f} rad away from where it goes; headings are in rad, counter-clockwise from"
                " +x."
            )


def _check_agreement(
    simulator: Any, _: Sequence[Cases], name: str, on_run: Callable[[SmallRun], None] | None = None
) -> None:
    with TemporaryDirectory() as folder:
        run = run_small_scenario(simulator, name, write_small_scenarios(Path(folder), name)[name])
    _require_no_problem(run, on_run)


def _check_run_after_failure(simulator: Any, all_cases: Sequence[Cases]) -> None:
    cases = all_cases[0]
    concrete = cases.concretes[0]
    number = concrete.load_file().root.find("ParameterDeclarations/ParameterDeclaration[@parameterType='double']")
    if number is None:
        return
    broken = replace(concrete, values={**concrete.values, number.get("name", ""): "nonsense"})
    try:
        first, second = Cases((broken, concrete), cases.entity).outcomes(simulator)
    except InputError as error:
        raise AssertionError(
            "If a number in one scenario is 'nonsense', the simulator raises InputError, and the whole search ends;"
            f" yield a SimulationError for this scenario instead ({str(error).removesuffix('.')})."
        ) from error
    assert isinstance(first, SimulationError), "It runs a scenario in which a number is 'nonsense'."
    assert isinstance(second, Recording), f"The scenario after a failed one fails, too: {second}."


def _check_determinism(simulator: Any, all_cases: Sequence[Cases]) -> None:
    for cases in all_cases:
        for first, second in zip(cases.run(simulator), cases.run(simulator), strict=True):
            assert are_bitwise_equal(first, second), (
                "A second run of a scenario differs, but it declares `deterministic`."
            )


def _check_batch_independence(simulator: Any, all_cases: Sequence[Cases]) -> None:
    for cases in all_cases:
        together, alone = cases.run(simulator), cases.run(simulator, [0])
        assert are_bitwise_equal(together[0], alone[0]), "Alone, a scenario differs from the one in a batch."


def _check_crash_recovery(
    simulator: Any, all_cases: Sequence[Cases], on_crash: Callable[[SimulatorCrashResult], None] | None = None
) -> None:
    if not isinstance(simulator, str):
        raise NotTriedError(
            "A simulator object runs in this process, which cannot be killed; give the simulator's name instead."
        )
    run = crash_during_runs(simulator, all_cases[0].concretes[0], all_cases[0].entity)
    if on_crash is not None:
        on_crash(run)
    for recording in run.outcomes:
        assert isinstance(recording, Recording), f"After a crash, a scenario failed: {recording}."
    assert run.spread is not None, "After a crash, a recording has other entities or instants."
    assert run.spread < _TOLERANCE, f"After a crash, an entity is {run.spread:.2f} m elsewhere."


def _check_agreement_when_driven(
    simulator: Any, _: Sequence[Cases], name: str, on_run: Callable[[SmallRun], None] | None = None
) -> None:
    declared = SIMULATORS.get_class(simulator)
    if not declared.runs_storyboard or "drivers" not in declared_options(declared):
        raise NotTriedError("The simulator cannot run both the storyboard and driving functions of cornercase.")
    with TemporaryDirectory() as folder:
        concrete = write_small_scenarios(Path(folder), name)[name]
        run = run_small_scenario(simulator, name, concrete, agent=_OWN_FUNCTION, drivers={"Ego": CarFollowing()})
    _require_no_problem(run, on_run)


def _check_agent_run(
    simulator: Any,
    _: Sequence[Cases],
    name: str,
    agent: str,
    options: Mapping[str, object],
    on_run: Callable[[SmallRun], None] | None = None,
) -> None:
    with TemporaryDirectory() as folder:
        concrete = write_small_scenarios(Path(folder), name)[name]
        run = run_with_agent(simulator, name, concrete, agent, options)
    _require_no_problem(run, on_run)


def _require_no_problem(run: SmallRun, on_run: Callable[[SmallRun], None] | None) -> None:
    if on_run is not None:
        on_run(run)
    assert not run.problem, run.problem
