"""The command that tells what changed between two versions."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cornercase._common.texts import json_text
from cornercase.cli.options import app, err, out

if TYPE_CHECKING:
    from cornercase.suite import Section


@app.command()
def compare(
    old: Annotated[Path, typer.Argument(metavar="OLD.db", help="Study of the old version.")],
    new: Annotated[Path, typer.Argument(metavar="NEW.db", help="Study of the new version, of the same scenario.")],
    *,
    metric: Annotated[
        list[str] | None, typer.Option("--metric", metavar="NAME", help="Metric to compare by; default: all.")
    ] = None,
    critical: Annotated[
        float | None,
        typer.Option(metavar="X", help="Use this threshold for both studies, which keep their own."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, for programs.")] = False,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE.html", help="Page to write, with replays.")
    ] = None,
    scenario: Annotated[
        Path | None,
        typer.Option(metavar="FILE.xosc", help="Scenario that was explored, for the page; default: beside the study."),
    ] = None,
) -> None:
    """Compare two versions of a system, by a study of each.

    It compares scenarios with the same parameters one by one. To get such pairs, explore both versions with the same
    seed.
    Exit code 0: no change; 1: something changed; 2: bad input.

    \b
    Example:
      cornercase compare old.db new.db
      cornercase compare old.db new.db --metric wttc --json
      cornercase compare old.db new.db -o compare.html
    """
    from cornercase import suite

    found = suite.compare(old, new, metrics=metric, critical=critical)
    if output is not None:
        from cornercase.report import write_comparison

        written = write_comparison(found, old, new, output, scenario=scenario)
        err.print(f"The page is {written.resolve()}")
    if as_json:
        sys.stdout.write(json_text(found.to_json()) + "\n")
    else:
        for section in suite.tell_comparison(found):
            _show(section)
    if found.changed:
        raise typer.Exit(1)


def _show(section: Section) -> None:
    out.print(section.title)
    for sentence in section.sentences:
        out.print(f"  {sentence}")
    lines = [section.header, *section.rows] if section.rows else []
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        out.print("    " + "  ".join(map(str.ljust, line, widths)).rstrip())
