"""The command that says how probable critical scenarios are."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cornercase._common.json_keys import with_identifiers
from cornercase._common.texts import json_text
from cornercase.cli import parsing
from cornercase.cli.interrupting import exit_code
from cornercase.cli.options import (
    Cluster,
    Drivers,
    Maps,
    MaxFailures,
    Retries,
    Seed,
    StudyFile,
    Timeout,
    Workers,
    app,
    err,
    out,
)

if TYPE_CHECKING:
    from cornercase.evidence import Probability
    from cornercase.exploration import Estimation


@app.command()
def estimate(
    study: StudyFile,
    *,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="ESTIMATE.db", help="Study to write or continue.")],
    budget: Annotated[
        int, typer.Option(metavar="N", help="Number of concrete scenarios to run in all.", min=100)
    ] = 2000,
    critical: Annotated[
        float | None,
        typer.Option(metavar="X", help="Score from which a scenario is critical; default: as in the study."),
    ] = None,
    encounter: Annotated[
        float, typer.Option(metavar="M", help="The two meet if their gap is at most this many m.", min=0)
    ] = 10.0,
    seed: Seed = 0,
    scenario: Annotated[
        Path | None,
        typer.Option(
            metavar="SCENARIO.xosc",
            help="Scenario explored; default: as the study names it, beside it or here.",
        ),
    ] = None,
    simulator: Annotated[
        str | None,
        typer.Option(
            "--simulator", metavar="NAME", help="Simulator that runs the scenarios; default: that of the study."
        ),
    ] = None,
    workers: Workers = 1,
    cluster: Cluster = None,
    timeout: Timeout = None,
    retries: Retries = 1,
    max_failures: MaxFailures = 5,
    driver: Drivers = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, for programs.")] = False,
    maps: Maps = None,
) -> None:
    """Estimate how probable critical scenarios and collisions are.

    It draws new scenarios where critical ones are frequent, runs them, and weights them by the distributions of the
    space. The same command again goes on where it stopped.

    \b
    Example:
      cornercase estimate study.db --budget 2000 -o estimate.db
    """
    from cornercase import exploration

    found = exploration.estimate(
        study,
        output,
        budget=budget,
        critical=critical,
        encounter=encounter,
        seed=seed,
        scenario=scenario,
        simulator=simulator,
        drivers=parsing.pairs(driver or (), "--driver"),
        workers=workers,
        cluster=cluster,
        timeout=timeout,
        retries=retries,
        max_failures=max_failures,
        progress=True,
    )
    if as_json:
        sys.stdout.write(json_text(with_identifiers(found.to_json(), {})) + "\n")
    else:
        _tell(found)
    if found.interrupted:
        err.print(f"Interrupted; the same command goes on where it stopped: {found.study} holds what has ended.")
        raise typer.Exit(exit_code())


def _tell(found: Estimation) -> None:
    """Print probabilities as lines."""
    each = {
        f"critical ({found.criterion})": found.critical,
        "collision": found.collision,
        f"encounter (gap <= {found.within:g} m)": found.encounter,
        "critical given an encounter": found.critical_given_encounter,
        "collision given an encounter": found.collision_given_encounter,
    }
    for name, one in each.items():
        out.print(f"{name}: {'not known' if one is None else _words(one)}")
    learned = f", {found.learned} of them to learn where to draw" if found.learned else ""
    out.print(f"{found.scenarios} scenarios in {found.study}{learned}")
    for warning in found.warnings:
        err.print(warning)


def _words(one: Probability) -> str:
    """Say a probability, how sure it is, and what plain Monte Carlo would need for the same."""
    if one.error is None and one.met:
        return f"between {one.low:.3g} and {one.high:.3g} ({one.method})"
    if one.error is None:
        return f"not met; 0 to {one.high:.3g} (95 %, {one.method})"
    text = f"{one.value:.3g}, {one.low:.3g} to {one.high:.3g} (95 %), {one.low_90:.3g} to {one.high_90:.3g} (90 %)"
    if one.error == 0.0:
        return f"{one.value:.3g} ({one.method})"
    text += f", standard error {one.error:.1%}; {one.method}, met in {one.met} of {one.scenarios}"
    text += f", effectively {one.effective:.0f}"
    needed = one.plain_scenarios
    if needed is not None and needed > one.scenarios:
        text += f"; plain Monte Carlo would need {needed:.2g}"
    return text
