"""Commands `check` and `convert`: read and convert scenario files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from cornercase._common.errors import InputError
from cornercase._common.optional_packages import describe_install
from cornercase._common.text.sanitize import shorten
from cornercase._common.version import __version__
from cornercase.cli import options as opt
from cornercase.cli import parsing
from cornercase.cli.command_options import add_api_options
from cornercase.cli.option_names import MAX_LINE_LENGTH, use_option_names
from cornercase.cli.options import Option, app, err, out


@app.command()
@add_api_options("space", "drivers")
def check(
    scenarios: opt.ScenarioFiles,
    *,
    space: Path | None = None,
    drivers: dict[str, str] | None = None,
    strict: Annotated[
        bool,
        Option(
            "--strict",
            help="Treat every violation of the standard as an error, even if its meaning is clear; name the rule.",
        ),
    ] = False,
    simulator: Annotated[
        str | None,
        Option("--simulator", metavar="NAME", help="Also say what this simulator does differently, or refuses."),
    ] = None,
    ego: Annotated[str, Option("--ego", metavar="NAME", help="Entity under test, for --simulator.")] = "Ego",
    maps: opt.Maps = None,
) -> None:
    """Check scenario files: what they contain, what cornercase ignores, and whether they are valid and can run.

    Violations of the standard that can be understood in only one way are accepted, and listed as "adapted". The exit
    code is 1 if a file is not valid or cannot run, or with --strict if something was adapted; it is 2 if the only file
    cannot be read. --sut also describes the driver, and lists the options of the driver that explore can vary.
    --simulator also lists the parts of the scenario that this simulator ignores or replaces, and the parameters without
    effect because a driver of the simulator decides instead.

    \b
    Example:
      cornercase check examples/x_intersection/x_intersection.xosc \\
          --space examples/x_intersection/x_intersection.space.xosc
      cornercase check examples/x_intersection/x_intersection.xosc \\
          --sut Ego=normal:horizon=4
      cornercase check examples/x_intersection/x_intersection.xosc \\
          --simulator carla --sut Ego=cautious
      cornercase check reduced/*.xosc --strict
    """
    from cornercase import simulators

    if space is not None and len(scenarios) > 1:
        raise InputError("--space: belongs to one scenario; check one scenario at a time.")
    if simulator is not None:
        # A misspelled option is no matter of a scenario.
        simulators.SIMULATORS.create(simulator)
    n_bad = 0
    printed: set[tuple[str, str]] = set()
    for scenario in scenarios:
        if len(scenarios) > 1:
            out.print(f"{scenario}:")
        try:
            report = simulators.check(scenario, space, strict=strict, drivers=drivers)
        except InputError as error:
            if len(scenarios) == 1:
                raise
            out.print(shorten(use_option_names(str(error)).replace("\n", "\\n"), MAX_LINE_LENGTH))
            n_bad += 1
            continue
        _print_check(report, drivers or {}, printed)
        is_refused = simulator is not None and not _print_simulator_effects(report, simulator, drivers, ego)
        n_bad += is_refused or not report.is_valid
    if len(scenarios) > 1:
        strictly = ", break no rule" if strict else ""
        out.print(f"{len(scenarios) - n_bad} of {len(scenarios)} are valid{strictly} and can be run")
    if n_bad:
        raise typer.Exit(1)


def _print_check(report: Any, drivers: Mapping[str, str], printed: set[tuple[str, str]]) -> None:
    """Print the report of a check, without notices on shared files that were `printed` for an earlier scenario."""
    from cornercase.drivers._driver_overview import describe_driver

    for key, count in report.contents.items():
        out.print(f"{key}: {count}")
    out.print(f"parameters: {', '.join(report.parameters) or 'none'}")
    if report.variables:
        out.print(f"variables: {', '.join(report.variables)}")
    for name, driver in report.drivers.items():
        if name in drivers:
            for line in describe_driver(name, drivers[name]):
                out.print(line)
        elif driver:
            out.print(f"{name}: driven by {driver}")
    if undriven := [name for name, driver in report.drivers.items() if not driver and name not in drivers]:
        follow = "follows the storyboard and does" if len(undriven) == 1 else "follow the storyboard and do"
        out.print(f"{', '.join(undriven)}: {follow} not react; --driver {undriven[0]}=normal drives {undriven[0]}")
    # With --strict, adaptations are printed below with their rules.
    notices = [n for n in report.notices if not (report.standard_violations and n.label == "adapted")]
    keys = [(str(notice.file), notice.sentence) for notice in notices]
    for key in keys:
        if key not in printed:
            out.print(shorten(key[1], MAX_LINE_LENGTH))
    if n_printed := sum(key in printed for key in keys):
        out.print(f"and {n_printed} notice{'' if n_printed == 1 else 's'} on files that it shares, as above")
    printed.update(keys)
    if report.schema is None:
        out.print(f"schema: not checked; {describe_install('validate')}")
    else:
        except_adapted = ", except for what is adapted" if any(x.label == "adapted" for x in report.notices) else ""
        out.print(f"schema {report.schema}: {f'valid{except_adapted}' if not report.schema_errors else 'not valid'}")
    for line in (
        *report.schema_errors,
        *(f"refused: {text}" for text in report.standard_violations),
        *report.run_errors,
    ):
        out.print(shorten(f"  {line}", MAX_LINE_LENGTH))
    if report.space is not None:
        for parameter in report.space.parameters:
            is_declared = set(parameter.assigned_names) <= {*report.parameters}
            out.print(f"varied: {_format_parameter(parameter)}{'' if is_declared else ' (of a driver, not checked)'}")
        out.print(f"concrete scenarios: {'infinitely many' if report.space.size is None else report.space.size}")
    out.print(f"{'can' if not report.run_errors else 'cannot'} be run, in builtin of cornercase {__version__}")


def _print_simulator_effects(report: Any, simulator: str, drivers: Mapping[str, str] | None, ego: str) -> bool:
    """Print what a simulator ignores or replaces in a scenario; return True if the simulator can run the scenario."""
    from cornercase.simulators._ignored_or_replaced import describe_ignored_or_replaced

    name = simulator.partition(":")[0]
    try:
        sentences = describe_ignored_or_replaced(simulator, report.path, drivers=drivers, ego=ego)
    except InputError as error:
        out.print(shorten(use_option_names(f"{name} cannot run it: {error}").replace("\n", "\\n"), MAX_LINE_LENGTH))
        return False
    printed = {notice.sentence for notice in report.notices}
    for sentence in (sentence for sentence in sentences if sentence not in printed):
        out.print(shorten(use_option_names(f"{name}: {sentence}"), MAX_LINE_LENGTH))
    return True


def _format_parameter(parameter: Any) -> str:
    if parameter.choices:
        count = len(parameter.choices)
        return f"{parameter.name}: {'1 choice' if count == 1 else f'{count} choices'}"
    step = "" if parameter.step is None else f" in steps of {parameter.step:g}"
    return f"{parameter.name}: {parameter.low:g} to {parameter.high:g}{step} {parameter.unit}".rstrip()


@app.command(name="convert")
@add_api_options("ego")
def convert_scenario(
    scenario: opt.ScenarioFile,
    *,
    ego: str,
    output: Annotated[Path, Option("--output", "-o", metavar="FILE.xosc", help="File to write.")],
    values: opt.Values = None,
    maps: opt.Maps = None,
) -> None:
    """Write a concrete scenario as OpenSCENARIO 1.0, as CARLA's ScenarioRunner reads it.

    Parts whose meaning changes slightly are reported. Parts that OpenSCENARIO 1.0 cannot express are refused.

    \b
    Example:
      cornercase convert examples/t_intersection/t_intersection.xosc \\
          --set c_start_time=1 --ego Ego -o t10.xosc
    """
    from cornercase.simulators import convert

    for note in convert(scenario, output, ego=ego, values=parsing.parse_pairs(values or (), "--set")).notes:
        err.print(note)
    out.print(f"Written to {output}")
