"""Command `paper`: draw the figures of the paper that the method comes from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Final

import typer

from cornercase._common.errors import InputError
from cornercase.cli import options as opt
from cornercase.cli.command_options import add_api_options
from cornercase.cli.options import Option, app, out
from cornercase.cli.profiling import Profile

# The example that reconstructs each scenario, and the paper's search: Thompson sampling without space-filling points.
_EXAMPLES: Final = {"scenario-1": "x-intersection", "scenario-2": "t-intersection"}
_OPTIMIZER: Final = "bayes:filling=0"


@app.command()
@add_api_options("seed")
def paper(
    name: Annotated[str, typer.Argument(metavar="scenario-1|scenario-2", help="Scenario of the paper.")],
    study: Annotated[
        Path | None,
        typer.Argument(metavar="STUDY.db", help="Study to draw; by default the example is explored as in the paper."),
    ] = None,
    *,
    output: Annotated[Path, Option("--output", "-o", metavar="DIR", help="Folder to write.")],
    budget: Annotated[
        int | None, Option(metavar="N", help="Number of concrete scenarios to run; default: as in the paper.", min=1)
    ] = None,
    seed: int = 0,
    driver: Annotated[str | None, Option(metavar="NAME", help="Driver that drives the ego.")] = None,
    profile: Profile = None,
) -> None:
    """Draw the figures of Schuett, Otten and Sax (2023) from a study.

    Figure 5 shows scenario 1, an X-intersection; figure 6 shows scenario 2, a T-intersection. Clusters that the study
    already has are drawn as they are: to change them, run analyze with other settings, and draw again.

    \b
    Example:
      cornercase paper scenario-1 -o paper
      cornercase analyze paper/study.db --by wttc --gamma 1 --eps 0.1 --min-samples 6
      cornercase paper scenario-1 paper/study.db -o paper
    """
    from cornercase import clustering
    from cornercase.exploration._explore import explore_config
    from cornercase.exploration._paper_examples import paper_experiment_config
    from cornercase.report import PAPER_SCENARIOS, write_paper_figures
    from cornercase.study._study_file import open_study

    if name not in PAPER_SCENARIOS:
        raise InputError(f"'{name}' is no scenario of the paper; choose {' or '.join(PAPER_SCENARIOS)}.")
    aspects = PAPER_SCENARIOS[name].aspects
    path = study or output / "study.db"
    if study is None:
        configuration = paper_experiment_config(
            _EXAMPLES[name], budget=budget, seed=seed, driver=driver, folder=output / "scenario"
        )
        opt.finish_exploration_command(
            explore_config(replace(configuration, optimizer=_OPTIMIZER), path, progress=True)
        )
    else:
        for option, is_given in (("--budget", budget is not None), ("--seed", seed != 0), ("--driver", bool(driver))):
            if is_given:
                raise InputError(
                    f"{option}: is only for a new exploration; leave {option} out, or leave out the study {study}."
                )
    with open_study(path, readonly=True) as opened:
        for aspect in aspects:
            if aspect not in clustering.ASPECTS and aspect not in opened.meta.metrics:
                raise InputError(
                    f"{path}: was not measured by {aspect}, which the figure of {name} shows; explore with --metric"
                    f" {aspect}, too, or draw the other scenario."
                )
        missing = [aspect for aspect in aspects if aspect not in opened.analyzed_aspects()]
    if missing:
        clustering.analyze(path, missing, progress=True)
    out.print(f"The figures are in {write_paper_figures(path, name, output).resolve()}")
