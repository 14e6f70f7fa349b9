"""Command `explore`: search a logical scenario for critical concrete scenarios."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from cornercase.cli import options as opt
from cornercase.cli.command_options import SectionedCommand, with_options
from cornercase.cli.config_file import Config
from cornercase.cli.options import app
from cornercase.cli.profiling import Profile
from cornercase.exploration._explore_options import OPTIONS


@app.command(cls=SectionedCommand)
@with_options(*OPTIONS)
def explore(
    scenario: Annotated[
        Path | None,
        typer.Argument(metavar="[SCENARIO.xosc]", help="OpenSCENARIO file; may be omitted if --space names it."),
    ] = None,
    *,
    output: opt.StudyOutput,
<<<<<<< HEAD
=======
    space: opt.SpaceFile = None,
    ranges: Annotated[
        list[str] | None, Option("--range", metavar="NAME=LOW:HIGH[:STEP]", help="Add or replace a parameter.")
    ] = None,
    vary: opt.Vary = None,
    continuous: Annotated[bool, Option("--continuous", help="Search ranges with steps as continuous intervals.")] = (
        False
    ),
    optimizer: Annotated[
        str,
        Option(
            metavar="NAME",
            help="bayes, level-set, committee, evolutionary, optuna, sobol, grid or random; options after a colon, as"
            " in bayes:filling=0.",
        ),
    ] = "bayes",
    critical: opt.Critical = None,
    critical_if: Annotated[
        str | None,
        Option(
            "--critical-if",
            metavar="CONDITION",
            help="Search a condition instead: 'collision and not reference:cc-human' is what this driver"
            " would have prevented; bounds on scores ('ttc < 1'), temporal operators, and, or, not:"
            " see the page Expressions.",
        ),
    ] = None,
    weight: Annotated[
        list[str] | None,
        Option("--weight", metavar="METRIC=W", help="Search the weighted sum of these metrics."),
    ] = None,
    pareto: Annotated[bool, Option("--pareto", help="Search the Pareto front of all metrics.")] = False,
    stop_when: Annotated[
        list[str] | None,
        Option(
            "--stop-when",
            metavar="WHAT<X",
            help="Stop when enough is known about the critical set: missed<0.01, interval<0.05,"
            " overlooked(0.01)<0.05, unvisited(0.01)<0.05, audited-missed<0.1; with several, when all hold.",
        ),
    ] = None,
    budget: Annotated[int, Option(metavar="N", help="Number of concrete scenarios to run in all.", min=1)] = 200,
    batch: Annotated[int, Option(metavar="N", help="Number of concrete scenarios in a round.", min=1)] = 10,
    asynchronous: Annotated[
        bool, Option("--asynchronous", help="Work without rounds: propose the next scenario as soon as one has ended.")
    ] = False,
    patience: Annotated[
        int | None,
        Option(
            metavar="N", help="Stop after N rounds without anything new (asynchronous: after as many scenarios).", min=1
        ),
    ] = None,
    max_seconds: Annotated[float | None, Option(metavar="S", help="Stop after this time in s.")] = None,
    seed: opt.Seed = 0,
    simulator: opt.SimulatorName = "builtin",
    workers: opt.Workers = 1,
    cluster: opt.Cluster = None,
    timeout: opt.Timeout = None,
    retries: opt.Retries = 1,
    max_failures: opt.MaxFailures = 5,
    repeats: Annotated[int, Option(metavar="N", help="Run each scenario N times; its score is the median.", min=1)] = 1,
    max_repeats: Annotated[
        int | None,
        Option(
            "--max-repeats",
            metavar="M",
            help="Run a scenario N times more, up to M times in all, while it is open whether it is critical: while"
            " the 90 % interval of the probability that a run is critical contains 0.5.",
            min=1,
        ),
    ] = None,
    audit: Annotated[
        float,
        Option(
            metavar="SHARE",
            help="Share of scenarios drawn at random and hidden from the search, to judge what it found.",
        ),
    ] = 0.0,
    time_step: opt.TimeStep = 0.05,
    duration: opt.Duration = 60.0,
    on_collision: opt.OnCollision = "continue",
    driver: opt.Drivers = None,
    check_proposals: Annotated[
        bool,
        Option("--check-proposals", help="Simulate nothing; test whether the stored results give the same proposals."),
    ] = False,
    warm_start: Annotated[
        Path | None,
        Option(
            "--warm-start",
            metavar="OTHER.db",
            help="Begin from the scores of a study of the same parameters: another driver, simulator or time step.",
        ),
    ] = None,
    retry_failed: Annotated[
        bool, Option("--retry-failed", help="First run the failed scenarios of the study once more.")
    ] = False,
>>>>>>> e_expr
    config: Config = None,
    profile: Profile = None,
    maps: opt.Maps = None,
    **options: Any,
) -> None:
    """Search a logical scenario for its critical concrete scenarios.

    Run the same command again to resume. With --check-proposals, exit code 1 means that a proposal differs.

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

    opt.print_ending(exploration.explore(scenario, output, **options, progress=True))
