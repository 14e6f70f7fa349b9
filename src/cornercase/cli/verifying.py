"""The command that looks whether a study is as it was written, and brings back what is lost."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from cornercase._common.memory import DEFAULT_MEMORY
from cornercase._common.texts import json_text
from cornercase.cli import parsing
from cornercase.cli.options import Drivers, Maps, Memory, StudyFile, Workers, app, out


@app.command()
def verify(
    study: StudyFile,
    *,
    repair: Annotated[
        bool,
        typer.Option(
            "--repair",
            help="Restore the study, running lost scenarios again; the damaged file is kept as STUDY.db.damaged.",
        ),
    ] = False,
    scenario: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Scenario file; default: as the study names it, beside it or here."),
    ] = None,
    simulator: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Simulator that runs scenarios again; default: that of the study."),
    ] = None,
    driver: Drivers = None,
    workers: Workers = 1,
    memory: Memory = DEFAULT_MEMORY,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, for programs.")] = False,
    maps: Maps = None,
) -> None:
    """Test whether a study is undamaged; exit code 1 if it is not.

    \b
    Example:
      cornercase verify study.db
      cornercase verify study.db --repair
    """
    from cornercase.study import verify as verified

    found = verified(study)
    again: tuple[int, ...] = ()
    lost: tuple[str, ...] = ()
    damaged: Path | None = None
    if repair and not found.sound:
        from cornercase.exploration import repair as repaired

        drivers = parsing.pairs(driver or [], "--driver")
        mended = repaired(
            study, scenario=scenario, simulator=simulator, drivers=drivers, workers=workers, memory=memory
        )
        again, lost, damaged = mended.again, mended.lost, mended.damaged
    if as_json:
        words = {"sound": found.sound, "checked": found.checked, "problems": list(found.problems)}
        if repair:
            words |= {"damaged": None if damaged is None else str(damaged), "again": list(again), "lost": list(lost)}
        sys.stdout.write(json_text(words) + "\n")
    else:
        for one in found.problems:
            out.print(f"{study}: {one}")
        if found.sound and found.checked:
            out.print(f"{study}: everything is as it was written.")
        elif found.sound:
            out.print(f"{study}: can be read; it is of an earlier version, whose studies have no checksums.")
        if damaged is not None:
            how = "Repaired in part" if lost else "Repaired"
            out.print(f"{how}; {len(again)} scenarios were run again, and the damaged file is {damaged}.")
            for one in lost:
                out.print(f"Lost: {one}.")
    if lost or (not found.sound and not repair):
        raise typer.Exit(1)
