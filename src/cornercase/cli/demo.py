"""Command `demo`: run an example from exploration to report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from cornercase._common.errors import InputError
from cornercase.cli import options as opt
from cornercase.cli.messages import in_words_of_the_command_line
from cornercase.cli.options import Option, app, err, out
from cornercase.cli.profiling import Profile

if TYPE_CHECKING:
    from cornercase.scenario import Scenario
    from cornercase.study import Study

# Size of the suite of an example.
_SUITE: Final = 20


@app.command()
def demo(
    name: Annotated[str, typer.Argument(metavar="x-intersection|t-intersection", help="Name of the example.")],
    *,
    budget: Annotated[
        int | None, Option(metavar="N", help="Concrete scenarios to run; default: as in the paper.", min=1)
    ] = None,
    seed: opt.Seed = 0,
    driver: Annotated[str | None, Option(metavar="NAME", help="Driver of the ego.")] = None,
    simulator: opt.SimulatorName = "builtin",
    workers: opt.Workers = 1,
    output: Annotated[Path | None, Option("--output", "-o", metavar="DIR", help="Folder to write.")] = None,
    profile: Profile = None,
) -> None:
    """Explore, cluster, reduce and report an example; the t-intersection also gets a suite of tests.

    \b
    Example:
      cornercase demo x-intersection --budget 100 -o demo
      cornercase demo t-intersection -o t
    """
    from cornercase import clustering, reduction
    from cornercase.cli.warming import two_compile
    from cornercase.exploration import demonstration, explore_configuration, mutants_of_demonstration
    from cornercase.report import write_report
    from cornercase.study import Study

    folder = output or Path("demo") / name
    configuration = demonstration(
        name, budget=budget, seed=seed, driver=driver, simulator=simulator, workers=workers, folder=folder / "scenario"
    )
    scenario, study = configuration.logical.scenario, folder / "study.db"
    with two_compile():
        opt.tell_ending(explore_configuration(configuration, study, progress=True))
        with Study.open(study, readonly=False) as opened:
            clustering.analyze(opened, progress=True)
            # First, as the study stores only the last reduced set.
            if (mutants := mutants_of_demonstration(name)) is not None:
                _write_suite(opened, folder / "suite", mutants, scenario)
            reduction.reduce(opened, folder / "reduced", scenario=scenario, progress=True)
            write_report(opened, folder / "report.html", scenario=scenario, progress=True)
    out.print(f"The report is {(folder / 'report.html').resolve()}")


def _write_suite(study: Study, folder: Path, mutants: int, scenario: Scenario) -> None:
    """Write a suite that kills mutants of the ego's driver, and print how to run it."""
    from cornercase import reduction
    from cornercase.suite import find_exposure

    try:
        exposure = find_exposure(study, mutants, scenario=scenario, progress=True)
    except InputError as error:
        err.print(f"No suite of tests was made. {in_words_of_the_command_line(str(error))}")
        return
    suite = reduction.reduce(study, folder, size=_SUITE, exposure=exposure, scenario=scenario)
    out.print(f"{len(suite.kept)} scenarios that expose worse drivers are in {folder}; run them with another one:")
    out.print(f'  cornercase test {folder} --driver Ego=aggressive --require "no collision"', soft_wrap=True)
