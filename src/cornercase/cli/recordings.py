"""Commands `measure` and `import`: work with existing recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from cornercase._common.io.files import check_output_differs_from_source
from cornercase.cli import options as opt
from cornercase.cli.command_options import add_api_options
from cornercase.cli.options import Option, app, out


@app.command()
@add_api_options("ego", "other", metrics="all that take no formula")
def measure(
    recording: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING",
            help="Recording to measure: CSV, also esmini's; SUMO FCD (.xml), CarMaker (.erg), CARLA (.log), ASAM OSI"
            " (.osi, .mcap), CommonRoad (.xml).",
        ),
    ],
    *,
    ego: str,
    other: list[str],
    output: Annotated[Path, Option("--output", "-o", metavar="FILE.csv", help="Courses to write.")],
    metrics: list[str] | None = None,
) -> None:
    """Measure a recording of any simulator by criticality metrics, and print the scores.

    \b
    Example:
      cornercase measure recording.csv --ego Ego --other Pedestrian --metric wttc -o courses.csv
    """
    from cornercase.metrics import measure as measure_recording
    from cornercase.recordings._csv import write_courses

    check_output_differs_from_source(output, recording)
    measurement = measure_recording(recording, ego, other, metrics)
    write_courses(output, measurement.time, measurement.courses)
    table = Table(*measurement.column_names(), box=None)
    for row in measurement.rows():
        table.add_row(*row)
    out.print(table)
    out.print(f"{measurement.time.size} instants written to {output}")


@app.command(name="import")
@add_api_options("ego", "other", "metrics", "critical")
def import_(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder with recordings and parameters.csv.")],
    *,
    ego: str,
    other: list[str],
    metrics: list[str],
    output: opt.StudyOutput,
    table: Annotated[
        Path | None,
        Option(
            "--parameters", metavar="FILE.csv", help="Table with the column 'file' and a column for each parameter."
        ),
    ] = None,
    critical: float | None = None,
) -> None:
    """Make a study from existing recordings, to cluster and reduce them.

    Formats: CSV of cornercase and of esmini, SUMO's floating car data, CarMaker's ERG, CARLA's recorder files, ASAM OSI
    traces, CommonRoad scenarios.

    \b
    Example:
      cornercase import runs --ego hero --other adversary --metric ttc -o study.db
    """
    from cornercase.study import import_recordings

    result = import_recordings(
        folder, output, ego=ego, other=other, metrics=metrics, table=table, critical=critical, progress=True
    )
    out.print(f"{result.done} scenarios in {output}")
    if result.failed:
        out.print(f"{result.failed} recordings could not be read or measured; the first: {result.reason}")
