"""Estimate the probability of critical scenarios of a study."""

from __future__ import annotations

import hashlib
import re
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from inspect import signature
from pathlib import Path
from typing import Final, Unpack

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.io.files import check_output_differs_from_source
from cornercase._common.option import check_options, document_options
from cornercase._common.typing import FloatArray
from cornercase._common.unknown_names import refuse_unknown_arguments
from cornercase._common.validation import check_bool, check_float, check_int, check_path
from cornercase.drivers._resolve import DriverLike
from cornercase.evidence._rare_events import ImportanceSampling, fit_initial_proposal
from cornercase.exploration._config import ExplorationConfig, config_from_study, require_same_settings
from cornercase.exploration._estimation import Estimation
from cornercase.exploration._explore import simulator_from_config
from cornercase.exploration._probability_estimator import ProbabilityEstimator
from cornercase.metrics import Metric
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators import Simulator
from cornercase.simulators._run_options import RUN_OPTIONS, RunKeywords
from cornercase.study import StudyFile
from cornercase.study._study_file import open_or_create_study

_LEARNING_FRACTION: Final = 0.4
_MIN_BUDGET: Final = 100
_N_EVENTS: Final = 2
# Stored name of the optimizer of an estimate.
_ESTIMATE_OPTIMIZER_NAME = re.compile(
    r"importance-sampling:learn=(?P<learn>\d+),known=(?P<known>\d+)-(?P<digest>[0-9a-f]+)"
)


@document_options(RUN_OPTIONS)
def estimate(
    study: Path | str,
    output: Path | str,
    *,
    budget: int = 2000,
    critical: float | None = None,
    encounter: float = 10.0,
    seed: int = 0,
    scenario: Path | str | ScenarioFile | None = None,
    simulator: str | Simulator | None = None,
    drivers: Mapping[str, DriverLike] | None = None,
    metrics: Sequence[Metric | str] = (),
    progress: bool = False,
    **options: Unpack[RunKeywords],
) -> Estimation:
    """Estimate the probability of critical scenarios and collisions under the distributions of a study's space.

    New scenarios are run with the study's simulator and settings, and stored in a separate study. First, a sampling
    distribution is learned in several rounds, starting from the results of the explored study. Then scenarios are drawn
    independently from this distribution, or from those of the space if it leads to no more events; they give an
    unbiased estimate. If you call `estimate` again with the same
    arguments, the estimate is resumed; with a larger `budget` it continues.

    Parameters
    ----------
    study : path
        The explored study; it is only read.
    output : path
        Study file to create or resume.
    budget : int, default 2000
        Number of scenarios in total; at most 40 % of them are used for learning. A larger budget in a later call
        adds no scenarios for learning.
    critical : float, optional
        Threshold: score from which a scenario is critical. Default: that of the study.
    encounter : float, default 10.0
        Gap in m: two entities have an encounter if the gap between their boxes is at least once not larger than this.
    seed : int, default 0
        The same seed gives the same result.
    scenario : path or ScenarioFile, optional
        The explored file. By default it is searched for at its stored path, next to the study and in the current
        folder, and recognized by its fingerprint.
    simulator : str or Simulator, optional
        By default the simulator of the study. The study's options of the simulator are only used if each is a number,
        true or false.
    drivers : mapping of str to str, SystemUnderTest or Driver, optional
        Your own drivers by name of the entity, if the study was explored with your own drivers; presets are taken from
        the study.
    metrics : sequence of Metric or str, optional
        All metrics of the study, if one is of your own class; by default they are taken from the study.
    progress : bool, default False
        Show progress on standard error.
    **options
        How the scenarios are run: any of the parameters below.

    Returns
    -------
    Estimation

    Other Parameters
    ----------------
    OPTIONS

    Raises
    ------
    InputError
        An argument cannot be used, the study has no threshold or was explored with other settings, or the output
        belongs to another estimate or exploration.

    See Also
    --------
    cornercase.explore : Creates the study.

    Examples
    --------
    The study has to be explored before::

        probability = cornercase.estimate("study.db", "estimate.db", budget=5000).critical
    """
    study_file, output_file = check_path("study", study), check_path("output", output)
    check_output_differs_from_source(output_file, study_file)
    budget, seed = check_int("budget", budget, minimum=_MIN_BUDGET), check_int("seed", seed)
    encounter = check_float("encounter", encounter, minimum=0.0)
    check_bool("progress", progress)
    refuse_unknown_arguments("estimate", [*signature(estimate).parameters, *RUN_OPTIONS], options)
    run_options = check_options("estimate", RUN_OPTIONS, options)
    with StudyFile.open(study_file, readonly=True) as source:
        if _ESTIMATE_OPTIMIZER_NAME.fullmatch(source.meta.optimizer):
            raise InputError(f"{study_file}: is the result of an estimate; give the explored study instead.")
        config = _estimate_config(source, scenario, budget, critical, seed, simulator, drivers or {}, metrics)
        config = replace(config, **run_options)
        learn, n_known = _stored_sample_sizes(output_file, round(_LEARNING_FRACTION * budget))
        objective = config.make_objective(needs_threshold=True)
        points, scores = source.points(), objective.minimized_scores(source)
    n_known = len(points) if n_known is None else min(n_known, len(points))
    points, scores = points[:n_known], scores[:n_known]
    start = time.monotonic()
    with simulator_from_config(config) as running:
        meta = config.make_study_meta(objective, running.settings, study=output_file)
        name = f"importance-sampling:learn={learn},known={n_known}-{_hash_scores(points, scores)}"
        meta = replace(meta, optimizer=name, driver_in_file=source.meta.driver_in_file)
        require_same_settings(study_file, source.meta, running)
        assert objective.criterion is not None
        start_proposal = fit_initial_proposal(config.logical.space, points, scores, objective.criterion, seed)
        sampling = ImportanceSampling(config.logical.space, _N_EVENTS, learn, seed, start_proposal)
        with open_or_create_study(output_file, meta) as opened:
            opened.writer.check_and_update_meta(meta)
            opened.writer.add_elapsed_time("files", time.monotonic() - start)
            result = ProbabilityEstimator(config, running, sampling, opened, encounter).run(progress)
    return result


def _estimate_config(
    study: StudyFile,
    scenario: Path | str | ScenarioFile | None,
    budget: int,
    critical: float | None,
    seed: int,
    simulator: str | Simulator | None,
    drivers: Mapping[str, DriverLike],
    metrics: Sequence[Metric | str],
) -> ExplorationConfig:
    """Return the configuration of an explored study, changed for an estimate with this budget and seed."""
    if study.meta.pareto:
        raise InputError(f"{study.path}: was searched for a Pareto front, so it has no threshold; give another study.")
    config = config_from_study(study, study.path, scenario, simulator, drivers, metrics)
    if (condition := config.make_condition()) is not None:
        if condition.reference_drivers:
            raise InputError(
                f"{study.path}: its condition, {config.critical_if}, depends on reference drivers, which an estimate"
                " does not run; give a study explored with a threshold, or with a condition without reference drivers."
            )
        if critical is not None:
            raise InputError(
                f"{study.path}: its condition, {config.critical_if}, says what is critical; leave `critical` out."
            )
    # Draws need none of the other search settings.
    return replace(
        config,
        optimizer="random",
        # The threshold of a condition is its own.
        critical=study.meta.critical if critical is None and condition is None else critical,
        budget=budget,
        seed=seed,
        batch=ExplorationConfig.batch,
        asynchronous=False,
        repeats=1,
        max_repeats=None,
        audit=0.0,
    )


def _stored_sample_sizes(output: Path, n_learn: int) -> tuple[int, int | None]:
    """Return how many new scenarios are used for learning, and how many scenarios of the explored study.

    If the estimate is resumed, both numbers are read from the file `output`. Otherwise they are `n_learn` and None,
    which stands for all scenarios of the explored study.
    """
    if output.exists():
        with suppress(InputError), StudyFile.open(output, readonly=True) as existing:
            if (match := _ESTIMATE_OPTIMIZER_NAME.fullmatch(existing.meta.optimizer)) is not None:
                return int(match["learn"]), int(match["known"])
    return n_learn, None


def _hash_scores(points: FloatArray, scores: FloatArray) -> str:
    content = points.astype("<f8").tobytes() + np.asarray(scores, dtype="<f8").tobytes()
    return hashlib.sha256(content).hexdigest()[:12]
