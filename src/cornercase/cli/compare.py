"""Command `compare`: say whether a new version of a system is better or worse, and what changed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cornercase.cli import options as opt
from cornercase.cli import parsing
from cornercase.cli.options import Option, app, err, out

if TYPE_CHECKING:
    from cornercase.suite.compare._describe_comparison import ComparisonSection


@app.command()
def compare(
    old: Annotated[Path, typer.Argument(metavar="OLD.db", help="Study of the old version.")],
    new: Annotated[Path, typer.Argument(metavar="NEW.db", help="Study of the new version, of the same scenario.")],
    *,
    metrics: Annotated[
        list[str] | None,
        Option("--metric", metavar="NAME", help="Metric to compare by; repeat it for several; default: all."),
    ] = None,
    critical: Annotated[
        float | None, Option(metavar="X", help="Threshold for this comparison only; default: each study's own.")
    ] = None,
    tolerances: Annotated[
        list[str] | None,
        Option(
            "--tolerance",
            metavar="METRIC=NUMBER",
            help="Largest change of this metric's score that does not count; repeat it for several. Default: 0.1 s, m,"
            " m/s, m/s² or s²; 0.01 for metrics without unit.",
        ),
    ] = None,
    as_json: opt.Json = False,
    output: Annotated[
        Path | None, Option("--output", "-o", metavar="FILE.html", help="Page to write, with replays.")
    ] = None,
    scenario: opt.ExploredScenario = None,
    maps: opt.Maps = None,
) -> None:
    """Say whether a new version of a system is better or worse, and what changed, from a study of each version.

    Scenarios with the same parameters are compared one by one. To get such pairs, explore both versions with the same
    seed. The new version is worse if there is a new collision, a requirement newly fails, a scenario can no longer be
    run or is newly critical, or a score is more critical by more than its tolerance.

    Exit code 0: nothing is worse; 1: something is worse, even if something else is better; 2: no verdict is possible,
    or bad input.

    \b
    Example:
      cornercase compare old.db new.db
      cornercase compare old.db new.db --metric wttc --json
      cornercase compare old.db new.db -o compare.html
    In a nightly job, which fails if something is worse:
      cornercase compare last-night.db tonight.db --tolerance ttc=0.2 -o compare.html
    """
    from cornercase import suite
    from cornercase.suite.compare._describe_comparison import describe_comparison

    comparison = suite.compare(
        old, new, metrics=metrics, critical=critical, tolerances=parsing.parse_numbers(tolerances or (), "--tolerance")
    )
    if output is not None:
        from cornercase.report import write_comparison

        page = write_comparison(comparison, old, new, output, scenario=scenario)
        err.print(f"The page is {page.resolve()}")
    if as_json:
        opt.print_json(comparison.to_json())
    else:
        for section in describe_comparison(comparison):
            _print_section(section)
    if comparison.verdict == "cannot say":
        reason = comparison.verdict_reason
        err.print(f"cornercase: {old} and {new}: cannot say whether anything is worse, as {reason}.")
        raise typer.Exit(2)
    if comparison.worse:
        raise typer.Exit(1)


def _print_section(section: ComparisonSection) -> None:
    out.print(section.title)
    for sentence in section.sentences:
        out.print(f"  {sentence}")
    lines = [section.header, *section.text_rows] if section.rows else []
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        out.print("    " + "  ".join(map(str.ljust, line, widths)).rstrip())
