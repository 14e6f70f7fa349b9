"""Command `verify`: check that a study is undamaged, and repair it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from cornercase._common.memory import DEFAULT_MEMORY
from cornercase.cli import options as opt
from cornercase.cli.command_options import add_api_options
from cornercase.cli.options import Option, app, out


@app.command()
@add_api_options("drivers", "workers", simulator="that of the study")
def verify(
    study: opt.StudyFile,
    *,
    repair: Annotated[
        bool,
        Option(
            "--repair",
            help="Restore the study and run lost scenarios again; the damaged file stays as STUDY.db.damaged.",
        ),
    ] = False,
    scenario: opt.NamedScenario = None,
    memory: opt.Memory = DEFAULT_MEMORY,
    as_json: opt.Json = False,
    maps: opt.Maps = None,
    **options: Any,
) -> None:
    """Check whether a study is undamaged.

    Exit code 1: the study is damaged, or was repaired only in part.

    \b
    Example:
      cornercase verify study.db
      cornercase verify study.db --repair
    """
    from cornercase.study import verify as verify_study

    result = verify_study(study)
    again: tuple[int, ...] = ()
    lost: tuple[str, ...] = ()
    damaged: Path | None = None
    if repair and not result.is_sound:
        from cornercase.exploration import repair as repair_study

        repaired = repair_study(study, scenario=scenario, memory=memory, **options)
        again, lost, damaged = repaired.rerun_ids, repaired.lost_content, repaired.damaged_file
    if as_json:
        values = {"sound": result.is_sound, "checked": result.checked, "problems": list(result.problems)}
        if repair:
            values |= {"damaged": None if damaged is None else str(damaged), "again": list(again), "lost": list(lost)}
        opt.print_json(values)
    else:
        for problem in result.problems:
            out.print(f"{study}: {problem}")
        if result.is_sound and result.checked:
            out.print(f"{study}: undamaged; all checksums match.")
        elif result.is_sound:
            out.print(f"{study}: readable; studies of its earlier version have no checksums.")
        if damaged is not None:
            how = "Repaired in part" if lost else "Repaired"
            out.print(f"{how}; {len(again)} scenarios were run again, and the damaged file is {damaged}.")
            for sentence in lost:
                out.print(f"Lost: {sentence}.")
    if lost or (not result.is_sound and not repair):
        raise typer.Exit(1)
