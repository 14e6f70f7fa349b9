"""Command `demo`: run an example from exploration to report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from cornercase._common.errors import InputError
from cornercase.cli import options as opt
from cornercase.cli.command_options import add_api_options
from cornercase.cli.option_names import use_option_names
from cornercase.cli.options import Option, app, err, out
from cornercase.cli.profiling import Profile

if TYPE_CHECKING:
    from cornercase.scenario._file import ScenarioFile
    from cornercase.study import StudyFile

# Size of the suite of an example.
_SUITE_SIZE: Final = 20


@app.command()
@add_api_options("seed", "simulator", "workers")
def demo(
    name: Annotated[str, typer.Argument(metavar="x-intersection|t-intersection", help="Name of the example.")],
    *,
    budget: Annotated[
        int | None, Option(metavar="N", help="Number of concrete scenarios to run; default: as in the paper.", min=1)
    ] = None,
    seed: int = 0,
    driver: Annotated[str | None, Option(metavar="NAME", help="Driver that drives the ego.")] = None,
    simulator: str = "builtin",
    workers: int = 1,
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
    from cornercase.cli.warm_up import compile_in_parallel
    from cornercase.exploration._explore import explore_config
    from cornercase.exploration._paper_examples import paper_experiment_config, paper_experiment_mutant_count
    from cornercase.report import write_report
    from cornercase.study import StudyFile

    folder = output or Path("demo") / name
    configuration = paper_experiment_config(
        name, budget=budget, seed=seed, driver=driver, simulator=simulator, workers=workers, folder=folder / "scenario"
    )
    scenario, study = configuration.logical.scenario_file, folder / "study.db"
    with compile_in_parallel():
        opt.finish_exploration_command(explore_config(configuration, study, progress=True))
        with StudyFile.open(study, readonly=False) as opened:
            clustering.analyze(opened, progress=True)
            # First, as the study stores only the last reduced set.
            if (mutants := paper_experiment_mutant_count(name)) is not None:
                _write_suite(opened, folder / "suite", mutants, scenario)
            # By interaction the scenarios of both examples form clusters; by the metric they do not.
            reduction.reduce(opened, folder / "reduced", by="interaction", scenario=scenario, progress=True)
            write_report(opened, folder / "report.html", scenario=scenario, progress=True)
    out.print(f"The report is {(folder / 'report.html').resolve()}")


def _write_suite(study: StudyFile, folder: Path, mutants: int, scenario: ScenarioFile) -> None:
    """Write a suite of scenarios that expose faulty variants of the ego's driver, and print how to run the suite."""
    from cornercase import reduction
    from cornercase.suite import analyze_mutants

    try:
        exposure = analyze_mutants(study, mutants, scenario=scenario, progress=True)
    except InputError as error:
        err.print(f"No suite of tests was made. {use_option_names(str(error))}")
        return
    suite = reduction.reduce(study, folder, size=_SUITE_SIZE, kill_matrix=exposure, scenario=scenario)
    out.print(f"{len(suite.scenarios)} scenarios that expose worse drivers are in {folder}; run them with another one:")
    out.print(f'  cornercase test {folder} --driver Ego=aggressive --require "no collision"', soft_wrap=True)
