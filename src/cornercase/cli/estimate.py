"""Command `estimate`: estimate the probability of critical scenarios."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cornercase.cli import options as opt
from cornercase.cli.command_options import SectionedCommand, add_api_options
from cornercase.cli.options import Option, app, err, out
from cornercase.cli.signals import interrupt_exit_code
from cornercase.simulators._run_options import RUN_OPTIONS

if TYPE_CHECKING:
    from cornercase.evidence import Probability
    from cornercase.exploration import Estimation


@app.command(cls=SectionedCommand)
@add_api_options("seed", "drivers", *RUN_OPTIONS, critical="as in the study", simulator="that of the study")
def estimate(
    study: opt.StudyFile,
    *,
    output: Annotated[Path, Option("--output", "-o", metavar="ESTIMATE.db", help="Study to write or continue.")],
    budget: Annotated[int, Option(metavar="N", help="Total number of concrete scenarios to run.", min=100)] = 2000,
    encounter: Annotated[
        float, Option(metavar="M", help="Largest gap in m between ego and other that counts as an encounter.", min=0)
    ] = 10.0,
    scenario: opt.NamedScenario = None,
    as_json: opt.Json = False,
    maps: opt.Maps = None,
    **options: Any,
) -> None:
    """Estimate how probable critical scenarios and collisions are.

    New scenarios are drawn mainly where critical scenarios are frequent, and weighted by the distributions of the
    parameters. If the scores do not lead there, they are drawn from these distributions. Run the same command again to
    resume.

    \b
    Example:
      cornercase estimate study.db --budget 2000 -o estimate.db
    """
    from cornercase import exploration

    estimation = exploration.estimate(
        study, output, budget=budget, encounter=encounter, scenario=scenario, **options, progress=True
    )
    if as_json:
        from cornercase.report.text._summary_dict import replace_words_by_keys

        opt.print_json(replace_words_by_keys(estimation.to_json()))
    else:
        _print_estimation(estimation)
    if estimation.interrupted:
        err.print(f"Interrupted. {estimation.study} holds what has ended; run the same command again to resume.")
        raise typer.Exit(interrupt_exit_code())


def _print_estimation(estimation: Estimation) -> None:
    probabilities = {
        f"critical ({estimation.criterion})": estimation.critical,
        "collision": estimation.collision,
        f"encounter (gap <= {estimation.encounter_gap:g} m)": estimation.encounter,
        "critical given an encounter": estimation.critical_given_encounter,
        "collision given an encounter": estimation.collision_given_encounter,
    }
    for event, probability in probabilities.items():
        out.print(f"{event}: {'not known' if probability is None else _format_probability(probability)}")
    learned = f", {estimation.n_learning} of them to learn where to draw" if estimation.n_learning else ""
    out.print(f"{estimation.scenarios} scenarios in {estimation.study}{learned}")
    for warning in estimation.warnings:
        err.print(warning)


def _format_probability(p: Probability) -> str:
    """Format a probability, its uncertainty, and the runs that plain Monte Carlo needs for the same uncertainty."""
    if p.error is None and p.met:
        return f"between {p.low:.3g} and {p.high:.3g} ({p.method})"
    if p.error is None:
        return f"not met; 0 to {p.high:.3g} (95 %, {p.method})"
    if p.error == 0.0:
        return f"{p.value:.3g} ({p.method})"
    text = f"{p.value:.3g}, {p.low:.3g} to {p.high:.3g} (95 %), {p.low_90:.3g} to {p.high_90:.3g} (90 %)"
    text += f", standard error {p.error:.1%}; {p.method}, met in {p.met} of {p.scenarios}"
    text += f", effectively {p.effective:.0f}"
    needed = p.equivalent_monte_carlo_scenarios
    if needed is not None and needed > p.scenarios:
        text += f"; plain Monte Carlo would need {needed:.2g}"
    return text
