"""The command that runs a suite."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer
from rich.table import Column, Table

from cornercase._common.texts import json_text
from cornercase.cli import parsing
from cornercase.cli.options import (
    Cluster,
    Drivers,
    Maps,
    MaxFailures,
    Retries,
    Timeout,
    Workers,
    app,
    err,
    out,
)

if TYPE_CHECKING:
    from cornercase.reduction import Exposure
    from cornercase.suite import SuiteResult

# So many of the scenarios that expose most are named.
_NAMED: Final = 3
# Characters of a file name that leave room for what is said of it on 80 columns.
_NAME: Final = 30


@app.command(name="test")
def test_(
    suite: Annotated[
        Path,
        typer.Argument(
            metavar="DIR|manifest.json|FILE.xosc", help="What reduce wrote, a folder of concrete scenarios, or one."
        ),
    ],
    *,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="RUN.db", help="Study to write or continue.")],
    require: Annotated[
        list[str] | None,
        typer.Option(
            "--require",
            metavar="EXPRESSION",
            help="Requirement on each scenario: 'no collision', 'no collision with NAME', 'no collision at fault',"
            " 'no collision unless cc-human collides' with this driver at the wheel, 'reach X,Y[,R] within T',"
            " 'drive D', or a formula such as 'ttc > 1.5' and 'ego.acceleration > -4'.",
        ),
    ] = None,
    requirements: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.toml|yaml", help="File with more requirements: lists called require, and by file or kind."
        ),
    ] = None,
    require_from_file: Annotated[
        bool,
        typer.Option(
            "--require-from-file",
            help="Take the criteria of ScenarioRunner that the scenarios ask for as requirements, where a recording can"
            " tell.",
        ),
    ] = False,
    strict: Annotated[bool, typer.Option("--strict", help="Inconclusive scenarios have not passed.")] = False,
    junit: Annotated[
        Path | None, typer.Option(metavar="FILE.xml", help="JUnit file to write, for Jenkins, GitLab or GitHub.")
    ] = None,
    summary: Annotated[
        Path | None, typer.Option(metavar="FILE.md", help="Table in Markdown to write, for GitHub's job summary.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, for programs.")] = False,
    against: Annotated[
        Path | None,
        typer.Option(
            metavar="STUDY.db",
            help="Study with earlier recordings; default: the one that was reduced, if it lies beside the manifest.",
        ),
    ] = None,
    simulator: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Simulator that runs the scenarios; default: that of the manifest."),
    ] = None,
    driver: Drivers = None,
    workers: Workers = 1,
    cluster: Cluster = None,
    timeout: Timeout = None,
    retries: Retries = 1,
    max_failures: MaxFailures = 5,
    ego: Annotated[
        str | None, typer.Option(metavar="NAME", help="Entity under test; default: as in the manifest.")
    ] = None,
    other: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME|*", help="Other entity, also several; default: as in the manifest."),
    ] = None,
    metric: Annotated[
        list[str] | None,
        typer.Option("--metric", metavar="NAME", help="Criticality metric to store; default: those of the manifest."),
    ] = None,
    time_step: Annotated[
        float | None, typer.Option(metavar="S", help="Time step in s; default: as in the manifest.")
    ] = None,
    duration: Annotated[
        float | None, typer.Option(metavar="S", help="Longest duration in s; default: as in the manifest.")
    ] = None,
    on_collision: Annotated[
        str | None, typer.Option(metavar="stop|continue", help="What a collision does; default: as in the manifest.")
    ] = None,
    mutants: Annotated[
        int | None,
        typer.Option(metavar="N", help="Test how many of N mutants of the ego's driver the suite exposes.", min=1),
    ] = None,
    seed: Annotated[int, typer.Option(metavar="N", help="Seed of the mutants: same seed, same mutants.", min=0)] = 0,
    maps: Maps = None,
) -> None:
    """Run a reduced set, or any concrete scenarios, and judge the runs.

    Exit code 0: all passed; 1: some failed or could not be run; 2: nothing could be run. The same command again goes on
    where it stopped.

    \b
    Example:
      cornercase test reduced --driver Ego=aggressive --require "no collision" \\
          --require "ttc > 0.5" --junit out.xml -o run.db
    """
    from cornercase import suite as room

    result = room.test(
        suite,
        output,
        require=require or (),
        requirements=requirements,
        require_from_file=require_from_file,
        ego=ego,
        other=other,
        metrics=metric or (),
        simulator=simulator,
        workers=workers,
        cluster=cluster,
        timeout=timeout,
        retries=retries,
        max_failures=max_failures,
        time_step=time_step,
        duration=duration,
        on_collision=on_collision,
        drivers=parsing.pairs(driver or (), "--driver"),
        against=against,
        junit=junit,
        summary=summary,
        mutants=mutants,
        seed=seed,
        progress=True,
    )
    if as_json:
        sys.stdout.write(json_text(result.to_json()) + "\n")
    else:
        _print(result)
        for written in (junit, summary):
            if written is not None:
                err.print(f"Written to {written}")
    if not result.has_passed(strict=strict):
        raise typer.Exit(1)


def _print(result: SuiteResult) -> None:
    compared = result.against is not None
    last = ["recording"] if compared else []
    table = Table(
        Column("scenario", overflow="fold", no_wrap=max(len(one.file) for one in result.scenarios) <= _NAME),
        Column("verdict", no_wrap=True),
        Column("why", overflow="fold"),
        *last,
        box=None,
    )
    for one in result.scenarios:
        words = ["–" if one.difference is None else one.difference.text] if compared else []
        state = "not run" if one.state == "error" else one.state
        table.add_row(one.file, state, one.reason, *words)
    out.print(table)
    out.print(f"{result.text}, in {result.study}.")
    out.print(f"{result.comparison}.")
    if result.ran_before:
        out.print(
            f"{result.ran_before} of them were in {result.study} before and were not run again; to run a new version of"
            " what drives, name another study with -o."
        )
    if result.exposure is not None:
        _print_exposure(result, result.exposure)


def _print_exposure(result: SuiteResult, exposure: Exposure) -> None:
    table = Table(Column("mutation", no_wrap=True), "exposed", "of", box=None)
    for kind, (exposed, count) in exposure.by_mutation.items():
        table.add_row(kind, str(exposed), str(count))
    out.print(table)
    out.print(f"{exposure.text}.")
    files = {one.id: one.file for one in result.scenarios}
    counts = dict(zip(exposure.scenarios, exposure.exposed.sum(axis=1).tolist(), strict=True))
    order = sorted((one for one, count in counts.items() if count), key=lambda one: -counts[one])
    if order:
        most = ", ".join(f"{files[one]} ({counts[one]})" for one in order[:_NAMED])
        out.print(f"Most are exposed by {most}; {len(order)} of {len(files)} scenarios expose any.")
    if exposure.unexposed:
        out.print(f"By none: {' '.join(exposure.unexposed)}.")
    if exposure.failed.all():
        out.print(f"{exposure.driver} itself fails in all scenarios, so that no mutant can be exposed.")
