"""Command `test`: run a suite of concrete scenarios."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from rich.table import Column, Table

from cornercase.cli import options as opt
from cornercase.cli.command_options import SectionedCommand, add_api_options
from cornercase.cli.options import Option, app, err, out
from cornercase.simulators._run_options import RUN_OPTIONS

if TYPE_CHECKING:
    from cornercase.reduction import KillMatrix
    from cornercase.suite import SuiteResult

# Largest number of printed scenarios, those that kill the most mutants.
_MAX_NAMED_SCENARIOS: Final = 3
# Length of file names that leaves room for the reasons on 80 columns.
_MAX_FILE_NAME_LENGTH: Final = 30
# Options whose defaults are in the manifest of a suite.
_OF_MANIFEST: Final = ("ego", "other", "metrics", "simulator", "time_step", "duration", "on_collision")


@app.command(name="test", cls=SectionedCommand)
@add_api_options("drivers", *RUN_OPTIONS, **dict.fromkeys(_OF_MANIFEST, "as in the manifest"))
def test_suite(
    suite: Annotated[
        Path,
        typer.Argument(
            metavar="DIR|manifest.json|FILE.xosc",
            help="Folder or manifest that reduce wrote, a folder of scenarios, or one scenario.",
        ),
    ],
    *,
    output: Annotated[Path, Option("--output", "-o", metavar="RUN.db", help="Study to write or continue.")],
    require: Annotated[
        list[str] | None,
        Option(
            "--require",
            metavar="EXPRESSION",
            help="Requirement on each scenario: 'no collision', 'no collision with NAME', 'no collision at fault',"
            " 'no collision unless cc-human collides' with this driver at the wheel, 'reach X,Y[,R] within T',"
            " 'drive D', bounds such as 'ttc > 1.5', temporal operators, and, or, not: see the page Expressions.",
        ),
    ] = None,
    requirements: Annotated[
        Path | None,
        Option(
            metavar="FILE.toml|yaml", help="File with more requirements: a list require, and lists by file or cluster."
        ),
    ] = None,
    require_from_file: Annotated[
        bool,
        Option(
            "--require-from-file",
            help="Also use criteria for ScenarioRunner in the files as requirements, if a recording can decide them.",
        ),
    ] = False,
    strict: Annotated[bool, Option("--strict", help="Count inconclusive scenarios as not passed.")] = False,
    junit: Annotated[
        Path | None, Option(metavar="FILE.xml", help="JUnit file to write, for Jenkins, GitLab or GitHub.")
    ] = None,
    summary: Annotated[
        Path | None, Option(metavar="FILE.md", help="Markdown file to write: a table for GitHub's job summary.")
    ] = None,
    as_json: opt.Json = False,
    against: Annotated[
        Path | None,
        Option(
            metavar="STUDY.db",
            help="Study with earlier recordings; default: the study that was reduced, if it is beside the manifest.",
        ),
    ] = None,
    mutants: Annotated[
        int | None, Option(metavar="N", help="Count how many of N mutants of the ego's driver the suite kills.", min=1)
    ] = None,
    seed: opt.MutantSeed = 0,
    maps: opt.Maps = None,
    **options: Any,
) -> None:
    """Run a reduced set, or any concrete scenarios, and judge the runs.

    Exit code 0: all passed, or were inconclusive without --strict; 1: some failed or could not be run, or were
    inconclusive with --strict; 2: nothing could be run. Run the same command again to resume.

    \b
    Example:
      cornercase test reduced --driver Ego=aggressive --require "no collision" \\
          --require "ttc > 0.5" --junit out.xml -o run.db
    """
    from cornercase.suite import run_suite

    result = run_suite(
        suite,
        output,
        require=require or (),
        requirements=requirements,
        require_from_file=require_from_file,
        against=against,
        junit=junit,
        summary=summary,
        mutants=mutants,
        seed=seed,
        **options,
        progress=True,
    )
    if as_json:
        opt.print_json(result.to_json())
    else:
        _print_result(result)
        for written in (junit, summary):
            if written is not None:
                err.print(f"Written to {written}")
    if not result.has_passed(strict=strict):
        raise typer.Exit(1)


def _print_result(result: SuiteResult) -> None:
    # With another driver all recordings differ, and the summary says so.
    compared = [f"against {result.against.name}"] if result.against and result.has_comparable_recordings else []
    table = Table(
        Column(
            "scenario",
            overflow="fold",
            no_wrap=max(len(scenario.file) for scenario in result.scenarios) <= _MAX_FILE_NAME_LENGTH,
        ),
        Column("verdict", no_wrap=True),
        Column("why", overflow="fold"),
        *compared,
        box=None,
    )
    for scenario in result.scenarios:
        state = "not run" if scenario.state == "error" else scenario.state
        difference = "–" if scenario.difference is None else scenario.difference.text
        table.add_row(scenario.file, state, scenario.reason, *([difference] if compared else []))
    out.print(table)
    out.print(f"{result.summary}, in {result.study}.")
    if not result.requirements:
        out.print("No requirement was given, so all that ran have passed; --require 'no collision' forbids collisions.")
    out.print(f"{result.comparison_summary}.")
    if result.n_ran_before:
        out.print(
            f"{result.n_ran_before} of them were already in {result.study} and were not run again; to test a new"
            " version, name another study with -o."
        )
    if result.kill_matrix is not None:
        _print_kills(result, result.kill_matrix)


def _print_kills(result: SuiteResult, exposure: KillMatrix) -> None:
    table = Table(Column("mutation", no_wrap=True), "exposed", "of", box=None)
    for kind, (exposed, count) in exposure.counts_by_mutation.items():
        table.add_row(kind, str(exposed), str(count))
    out.print(table)
    out.print(f"{exposure.summary_text}.")
    files = {scenario.id: scenario.file for scenario in result.scenarios}
    counts = dict(zip(exposure.scenarios, exposure.kills.sum(axis=1).tolist(), strict=True))
    order = sorted((scenario for scenario, count in counts.items() if count), key=lambda scenario: -counts[scenario])
    if order:
        names = ", ".join(f"{files[scenario]} ({counts[scenario]})" for scenario in order[:_MAX_NAMED_SCENARIOS])
        out.print(f"Most are exposed by {names}; {len(order)} of {len(files)} scenarios expose any.")
    if exposure.survivors:
        out.print(f"Exposed by none: {' '.join(exposure.survivors)}.")
    rule = " and ".join(f"'{requirement}'" for requirement in exposure.requirements)
    if not result.requirements:
        out.print(f"Without a requirement, mutants are judged by {rule}.")
    if n_failed := int(exposure.failed.sum()):
        where = "all scenarios" if exposure.failed.all() else f"{n_failed} of {len(exposure.failed)} scenarios"
        out.print(f"{exposure.driver} itself violates {rule} or fails in {where}, which therefore expose no mutant.")
