"""Commands `check-sut` and `check-simulator`, which check a user's driving system or simulator by its contract."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from cornercase._common.errors import InputError
from cornercase._common.text.sanitize import shorten
from cornercase.cli import options as opt
from cornercase.cli.command_options import add_api_options
from cornercase.cli.option_names import MAX_LINE_LENGTH, use_option_names
from cornercase.cli.options import Option, app, out

_Scenario = Annotated[
    Path | None,
    Option("--scenario", metavar="FILE.xosc", help="Scenario to run; default: some that come with cornercase."),
]

_Ego = Annotated[str, Option("--ego", metavar="NAME", help="Entity that the system under test drives.")]


@app.command(name="check-sut")
@add_api_options("space")
def check_sut(
    system: Annotated[
        str, typer.Argument(metavar="SPEC", help="System under test, as for --driver, without the entity.")
    ],
    *,
    scenario: _Scenario = None,
    space: Path | None = None,
    ego: _Ego = "Ego",
    as_json: opt.Json = False,
) -> None:
    """Check that a system under test is repeatable, requests no impossible motion, and depends on its scenario only.

    The exit code is 1 if a check fails.

    \b
    Example:
      cornercase check-sut normal
      cornercase check-sut my_aeb:Aeb:reaction=0.3 --scenario cut_in.xosc --ego Ego
    """
    from cornercase.drivers._resolve import driver_by_name
    from cornercase.testing import sut_checks

    driver_by_name(system)
    _exit_if_check_failed(
        _run_and_print_checks(
            "system under test", system, sut_checks(system, _read_check_scenarios(scenario, space, ego)), as_json
        )
    )


@app.command(name="check-simulator")
@add_api_options("space")
def check_simulator(
    simulator: Annotated[str, typer.Argument(metavar="NAME", help="Simulator, with options after a colon.")],
    *,
    scenario: _Scenario = None,
    space: Path | None = None,
    ego: _Ego = "Ego",
    output: Annotated[
        Path | None,
        Option("--output", "-o", metavar="FILE.zip", help="Also write what was found, to attach to an issue."),
    ] = None,
    as_json: opt.Json = False,
) -> None:
    """Check that a simulator is as repeatable as it declares, has the right units, and agrees with the builtin one.

    Twelve small scenarios are compared: braking, a lane change, a crossing walker, collisions and others. In two more
    scenarios, a driving function drives the ego, and then each driver that the simulator itself offers. If the
    simulator runs in a process of its own, this process is also killed on purpose. The exit code is 1 if a check fails.

    \b
    Example:
      cornercase check-simulator builtin
      cornercase check-simulator esmini:seed=3 -o proof.zip
    """
    from cornercase._common.io.files import check_writable_file
    from cornercase.simulators import SIMULATORS
    from cornercase.simulators._registry import simulator_availability
    from cornercase.testing import simulator_checks
    from cornercase.testing._check_archive import write_check_archive
    from cornercase.testing._crash import SimulatorCrashResult
    from cornercase.testing._deviations import SmallRun

    problem = simulator_availability(simulator).problem
    # Options may name a server on another machine, or start one; what is missing then is said by the checks.
    if problem and ":" not in simulator:
        raise InputError(problem)
    # A wrong option is no fault of the simulator.
    SIMULATORS.create(simulator)
    if output is not None:
        if output.is_dir():
            raise InputError(f"--output {output}: is a folder; give a file, such as {output / 'proof.zip'}.")
        check_writable_file("output", output)
    runs, crashes = list[SmallRun](), list[SimulatorCrashResult]()
    checks = simulator_checks(simulator, _read_check_scenarios(scenario, space, ego), runs.append, crashes.append)
    results = _run_and_print_checks("simulator", simulator, checks, as_json)
    if output is not None:
        write_check_archive(output, simulator, results, runs, crashes)
        if not as_json:
            out.print(f"wrote {output}")
    _exit_if_check_failed(results)


def _read_check_scenarios(scenario: Path | None, space: Path | None, ego: str) -> Any:
    from cornercase.scenario import LogicalScenario
    from cornercase.testing import Cases

    if scenario is None:
        if space is not None:
            raise InputError("--space: gives the ranges of a scenario; give the scenario, too, with --scenario.")
        return None
    return [Cases.from_logical(LogicalScenario.read(scenario, space), ego)]


def _run_and_print_checks(kind: str, name: str, checks: Sequence[Any], as_json: bool) -> list[Any]:
    """Run the checks of the system or simulator `name`, print each result, and return all results."""
    from cornercase.testing import run_checks

    results, rows, blocked = [], [], Counter[str]()
    for result in run_checks(checks):
        results.append(result)
        # Whether a check that was not run holds, is not known.
        rows.append(
            {
                "check": result.name,
                "holds": None if result.blocked_by or result.not_tried else not result.problem,
                "problem": result.problem or result.not_tried,
            }
        )
        if result.blocked_by:
            blocked[result.blocked_by] += 1
        elif not as_json:
            outcome = "FAILED" if result.problem else "-" if result.not_tried else "ok"
            out.print(f"{outcome:6} {result.name}")
            if result.problem or result.not_tried:
                sentence = result.problem or f"Not tried: {result.not_tried}"
                out.print(shorten(f"       {use_option_names(sentence)}", MAX_LINE_LENGTH))
    n_good = sum(row["holds"] is True for row in rows)
    if as_json:
        opt.print_json({kind: name, "checks": rows})
    else:
        for cause, count in blocked.items():
            out.print(f"not run: {count} checks that need this one: {cause}")
        out.print(f"{n_good} of {len(rows)} checks hold for the {kind} {name}")
    return results


def _exit_if_check_failed(results: Sequence[Any]) -> None:
    if any(result.problem for result in results):
        raise typer.Exit(1)
