"""Command `explore`: search a logical scenario for critical concrete scenarios."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from cornercase.cli import options as opt
from cornercase.cli.command_options import SectionedCommand, add_api_options
from cornercase.cli.config_file import Config
from cornercase.cli.options import app
from cornercase.cli.profiling import Profile
from cornercase.exploration._explore_options import OPTIONS


@app.command(cls=SectionedCommand)
@add_api_options(*OPTIONS)
def explore(
    scenario: Annotated[
        Path | None,
        typer.Argument(metavar="[SCENARIO.xosc]", help="OpenSCENARIO file; may be omitted if --space names it."),
    ] = None,
    *,
    output: opt.StudyOutput,
    config: Config = None,
    profile: Profile = None,
    maps: opt.Maps = None,
    **options: Any,
) -> None:
    """Search a logical scenario for its critical concrete scenarios.

    Run the same command again to resume. With --check-proposals, exit code 1 means that the optimizer would propose
    other scenarios than the stored ones.

    \b
    Example:
      cornercase explore examples/x_intersection/x_intersection.xosc \\
          --space examples/x_intersection/x_intersection.space.xosc \\
          --ego Ego --other Pedestrian --metric wttc --budget 100 -o study.db
      cornercase explore examples/t_intersection/t_intersection.xosc \\
          --space examples/t_intersection/t_intersection.space.xosc \\
          --ego Ego --other C --metric wttc --driver Ego=normal --optimizer committee \\
          --critical-if "collision and not reference:cautious" -o preventable.db
      cornercase explore examples/r157/cut_in.xosc --vary Ego.initial.x=90:110 \\
          --ego Ego --other Other --metric wttc -o varied.db
      cornercase explore --config study.toml --budget 200 -o study.db
    """
    from cornercase import exploration

    opt.finish_exploration_command(exploration.explore(scenario, output, **options, progress=True))
