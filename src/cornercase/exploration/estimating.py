"""From a study to the probability of its critical scenarios."""

from __future__ import annotations

import hashlib
import re
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from cornercase._common.arguments import flag, number, path, whole_number
from cornercase._common.errors import InputError
from cornercase._common.files import require_other_file
from cornercase._common.typing import FloatArray
from cornercase.drivers import Driver
from cornercase.evidence import ImportanceSampling, guessed_proposal
from cornercase.exploration.again import configuration_of, require_same_runs
from cornercase.exploration.configuration import Configuration
from cornercase.exploration.drawing import ProbabilityEstimator
from cornercase.exploration.estimation import Estimation
from cornercase.exploration.exploring import configured_simulator
from cornercase.scenario import Scenario
from cornercase.simulators import MOST_FAILURES
from cornercase.study import Study, begun_study

if TYPE_CHECKING:
    from distributed import Client

_LEARN_SHARE: Final = 0.4
_FEWEST: Final = 100
_EVENTS: Final = 2
# What the search of an estimate is called in its study.
_NAME = re.compile(r"importance-sampling:learn=(?P<learn>\d+),known=(?P<known>\d+)-(?P<digest>[0-9a-f]+)")


# Its parameters are the options of the command.
def estimate(
    study: Path | str,
    output: Path | str,
    *,
    budget: int = 2000,
    critical: float | None = None,
    encounter: float = 10.0,
    seed: int = 0,
    scenario: Path | str | Scenario | None = None,
    simulator: str | None = None,
    drivers: Mapping[str, str | Driver] | None = None,
    workers: int = 1,
    cluster: str | Client | None = None,
    timeout: float | None = None,
    retries: int = 1,
    max_failures: int = MOST_FAILURES,
    progress: bool = False,
) -> Estimation:
    """Estimate how probable critical scenarios and collisions are under the distributions of a study's space.

    New scenarios are run, by the simulator and with the settings of the study, and stored in a study of their own.
    Where to draw them is learned first, from what the study holds and in rounds; what is drawn then is independent, and
    gives an estimate without bias. The same call again goes on where it stopped; with a larger budget it goes on from
    there.

    Parameters
    ----------
    study : path
        What was explored; it is only read.
    output : path
        Study to write or continue.
    budget : int, default 2000
        Scenarios in all; 40 % of the first budget, at most, are for learning where to draw.
    critical : float, optional
        Threshold: score from which a scenario is critical; by default that of the study.
    encounter : float, default 10.0
        The ego and the other have an encounter where the gap between their boxes is at most so many m at some instant.
    seed : int, default 0
        The same seed gives the same result.
    scenario : path or Scenario, optional
        File that was explored. By default it is looked for where the study names it, beside the study and in the
        current folder, and known by its fingerprint.
    simulator : str, optional
        By default that of the study, without options.
    drivers : mapping of str to str or Driver, optional
        Drivers of your own, by entity, where the study has some; presets are those of the study.
    workers : int, default 1
        Simulators side by side.
    cluster : str or distributed.Client, optional
        Dask cluster to run on: ``"local"`` for `workers` processes here, the address of a scheduler, the file that a
        scheduler wrote, or a connection, which stays open.
    timeout : float, optional
        Time in s after which a scenario is given up.
    retries : int, default 1
        How often a scenario is run again after the simulator died or hung.
    max_failures : int, default 5
        Scenarios in a row in which the simulator dies or hangs, after which nothing more is run; 0 for no limit. An
        exception of a driver, the simulator or a metric is a failure of its scenario alone, however many there are. But
        if there are as many, and no scenario has given a result yet, nothing more is run either.
    progress : bool, default False
        Show how far it is on standard error.

    Returns
    -------
    Estimation

    Raises
    ------
    InputError
        Something cannot be used, the study has no threshold or is of something else, or the output is.

    See Also
    --------
    cornercase.explore : Makes the study.
    """
    file, made = path("study", study), path("output", output)
    require_other_file(made, file)
    budget, seed = whole_number("budget", budget, least=_FEWEST), whole_number("seed", seed)
    encounter = number("encounter", encounter, least=0.0)
    flag("progress", progress)
    with Study.open(file, readonly=True) as source:
        if _NAME.fullmatch(source.meta.optimizer):
            raise InputError(f"{file}: is an estimate itself; name the study that it was made from.")
        about = _configuration(source, scenario, budget, critical, seed, simulator, drivers or {})
        about = replace(about, workers=workers, cluster=cluster, timeout=timeout)
        about = replace(about, retries=retries, max_failures=max_failures)
        learn, known = _agreed(made, round(_LEARN_SHARE * budget))
        objective = about.objective()
        threshold = objective.threshold(about.critical)
        points, scores = source.points(), objective.oriented_of(source)
    known = len(points) if known is None else min(known, len(points))
    points, scores = points[:known], scores[:known]
    begun = time.monotonic()
    with configured_simulator(about) as running:
        meta = about.meta(objective, running.settings, study=made)
        name = f"importance-sampling:learn={learn},known={known}-{_digest(points, scores)}"
        meta = replace(meta, critical=objective.flip(threshold), optimizer=name)
        require_same_runs(file, source.meta, running)
        guess = guessed_proposal(about.logical.space, points, scores, threshold, seed)
        sampling = ImportanceSampling(about.logical.space, _EVENTS, learn, seed, guess)
        with begun_study(made, meta) as opened:
            opened.writer.continue_with(meta)
            opened.writer.add_elapsed("files", time.monotonic() - begun)
            found = ProbabilityEstimator(about, running, sampling, opened, encounter).run(progress)
    return found


def _configuration(
    study: Study,
    scenario: Path | str | Scenario | None,
    budget: int,
    critical: float | None,
    seed: int,
    simulator: str | None,
    drivers: Mapping[str, str | Driver],
) -> Configuration:
    """What the study was explored with, with another budget and seed."""
    if study.meta.pareto:
        raise InputError(f"{study.path}: was searched for a Pareto front, so nothing says what is critical.")
    about = configuration_of(study, study.path, scenario, simulator, drivers)
    # What else the search was, new draws are not.
    return replace(
        about,
        optimizer="random",
        critical=study.meta.critical if critical is None else critical,
        budget=budget,
        seed=seed,
        batch=Configuration.batch,
        asynchronous=False,
        repeats=1,
        most_repeats=None,
        audit=0.0,
    )


def _agreed(output: Path, learn: int) -> tuple[int, int | None]:
    """How many scenarios are for learning, and how many of the study count: as when the output was begun."""
    if output.exists():
        with suppress(InputError), Study.open(output, readonly=True) as begun:
            if (match := _NAME.fullmatch(begun.meta.optimizer)) is not None:
                return int(match["learn"]), int(match["known"])
    return learn, None


def _digest(points: FloatArray, scores: FloatArray) -> str:
    content = points.astype("<f8").tobytes() + np.asarray(scores, dtype="<f8").tobytes()
    return hashlib.sha256(content).hexdigest()[:12]
