"""Command `simulate`: run concrete scenarios."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cornercase._common.errors import InputError
from cornercase._common.io.files import check_output_differs_from_source
from cornercase.cli import options as opt
from cornercase.cli import parsing
from cornercase.cli.command_options import SectionedCommand, add_api_options
from cornercase.cli.options import Option, app, out
from cornercase.simulators._run_options import SIMULATION_OPTIONS

if TYPE_CHECKING:
    from cornercase.simulators import SimulatedFolder


@app.command(cls=SectionedCommand)
@add_api_options(*SIMULATION_OPTIONS)
def simulate(
    scenarios: opt.ScenarioFiles,
    *,
    output: Annotated[
        Path,
        Option(
            "--output",
            "-o",
            metavar="FILE.csv|FILE.osi|DIR",
            help="Recording to write, as CSV or OSI; a folder for several scenarios.",
        ),
    ],
    table: Annotated[
        Path | None,
        Option(
            "--parameters",
            metavar="FILE.csv",
            help="Table with one concrete scenario per line: a column for each parameter, and 'file' for file names.",
        ),
    ] = None,
    values: opt.Values = None,
    ego: Annotated[str, Option(metavar="NAME", help="Entity under test, for a simulator that needs it.")] = "Ego",
    seed: Annotated[
        int, Option(metavar="N", help="Seed of random numbers of sensors and systems under test.", min=0)
    ] = 0,
    maps: opt.Maps = None,
    **options: Any,
) -> None:
    """Run concrete scenarios and write their recordings.

    Recordings of several scenarios, or of one with --parameters, go into a folder that import can read. Run the same
    command again to make missing recordings. Exit code 1: some scenarios could not be run.

    \b
    Example:
      cornercase simulate examples/x_intersection/x_intersection.xosc \\
          --set ego_start=40 -o recording.csv
      cornercase simulate reduced/*.xosc --workers 4 -o recordings
      cornercase simulate examples/x_intersection/x_intersection.xosc \\
          --parameters values.csv -o recordings
    """
    from cornercase import simulators
    from cornercase.recordings import write_osi

    parameters = parsing.parse_pairs(values or (), "--set")
    if table is not None or len(scenarios) > 1:
        result = simulators.simulate_many(
            scenarios, output, table=table, values=parameters, ego=ego, seed=seed, **options, progress=True
        )
        _print_folder_result(result)
        return
    if options["workers"] > 1 or options["cluster"] is not None:
        option = "--cluster" if options["cluster"] is not None else "--workers"
        raise InputError(f"{option}: is for several scenarios; give more files, or --parameters.")
    (scenario,) = scenarios
    check_output_differs_from_source(output, scenario)
    names = ("time_step", "duration", "on_collision", "drivers", "simulator", "timeout")
    recording = simulators.simulate(scenario, parameters, ego=ego, seed=seed, **{name: options[name] for name in names})
    if output.suffix.lower() == ".osi":
        write_osi(output, recording, ego if ego in recording.names else None)
    else:
        recording.to_csv(output)
    for collision in recording.collisions:
        out.print(f"{' and '.join(collision.entities)} collide at {collision.time:g} s")
    contacts = "" if recording.collisions else ", no collision"
    out.print(f"{len(recording.names)} entities, {recording.time[-1]:g} s{contacts}, written to {output}")


def _print_folder_result(result: SimulatedFolder) -> None:
    before = f", {result.n_existing} of which existed before" if result.n_existing else ""
    out.print(f"{result.done} recording{'s' if result.done > 1 else ''} in {result.folder}{before}.")
    if result.failed:
        count = f"{result.failed} scenarios" if result.failed > 1 else "1 scenario"
        out.print(f"{count} failed, {next(iter(result.failures))} first; the same command tries again.")
        opt.print_failure_reasons(result.failure_counts)
        raise typer.Exit(1)
