"""Explore a logical scenario, and store the results in a study."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Unpack

from cornercase._common.errors import InputError
from cornercase._common.io.files import check_output_differs_from_source
from cornercase._common.io.support_table import Notice, warn_notices
from cornercase._common.option import check_options, document_options
from cornercase._common.process.dask import open_connection
from cornercase._common.unknown_names import refuse_unknown_arguments
from cornercase._common.validation import check_bool, check_path
from cornercase.drivers import Driver
from cornercase.drivers._resolve import DriverLike, refuse_program_driver, resolve_driver
from cornercase.exploration._asynchronous import AsynchronousExplorer
from cornercase.exploration._config import ExplorationConfig
from cornercase.exploration._constant_metrics import warn_about_threshold
from cornercase.exploration._explore_options import CALL_OPTIONS, CONFIG_OPTIONS, OPTIONS, SPACE_OPTIONS, ExploreOptions
from cornercase.exploration._explorer import ExplorationResult, ScenarioExplorer
from cornercase.exploration._varied_file import open_logical_scenario
from cornercase.exploration._verify_proposals import verify_proposals
from cornercase.exploration._warm_start import WarmStart, read_warm_start
from cornercase.metrics import Metric
from cornercase.optimizers import Optimizer
from cornercase.scenario import LogicalScenario
from cornercase.simulators import Simulator
from cornercase.simulators._create import create_simulator
from cornercase.simulators._driver_parameters import check_driver_parameters, list_probe_values
from cornercase.simulators._random_sensors import find_entities_with_random_sensors, warn_if_runs_are_random
from cornercase.simulators._results import check_simulator_accepts, list_ignored_content
from cornercase.simulators._run_notices import find_driver_in_files, warn_if_ego_has_no_driver
from cornercase.study import StudyFile
from cornercase.study._objective import Objective
from cornercase.study._remembered_paths import remember_scenario_path
from cornercase.study._study_file import open_or_create_study


@document_options(OPTIONS)
def explore(
    scenario: LogicalScenario | Path | str | None,
    study: Path | str,
    *,
    ego: str,
    other: str | Sequence[str],
    metrics: Metric | str | Sequence[Metric | str],
    progress: bool = False,
    **options: Unpack[ExploreOptions],
) -> ExplorationResult:
    """Search a logical scenario for critical concrete scenarios, and store the results in a study.

    Each scenario is stored as soon as it has ended. If you call `explore` again with the same arguments, a search that
    was stopped is resumed; with a larger `budget` it continues.

    Parameters
    ----------
    scenario : path or LogicalScenario or None
        OpenSCENARIO file. None: the file that `space` names.
    study : path
        Study file to create or resume.
    REQUIRED
    progress : bool, default False
        Show progress on standard error.
    **options
        Any of the parameters below.

    Returns
    -------
    ExplorationResult

    Other Parameters
    ----------------
    OPTIONS

    Raises
    ------
    InputError
        An argument cannot be used, or the study belongs to another exploration; the study is left unchanged.

    Warns
    -----
    NoticeWarning
        Something in the scenario's files has no effect in the simulator.

    Examples
    --------
    >>> import cornercase
    >>> files = "examples/x_intersection/x_intersection"
    >>> cornercase.explore(
    ...     f"{files}.xosc", "study.db", space=f"{files}.space.xosc", ego="Ego", other="Pedestrian", metrics=["wttc"],
    ...     optimizer="sobol", budget=4,
    ... )
    <ExplorationResult: 4 scenarios done in study.db; the budget of 4 scenarios is used up>
    """
    refuse_unknown_arguments("explore", OPTIONS, options)
    given: dict[str, Any] = {**options, "ego": ego, "other": other, "metrics": metrics}
    file = check_path("study", study)
    space, settings, call = (
        {name: value for name, value in given.items() if name in group}
        for group in (SPACE_OPTIONS, CONFIG_OPTIONS, CALL_OPTIONS)
    )
    with open_logical_scenario(scenario, file, **space) as logical_scenario:
        config = ExplorationConfig(logical_scenario, **settings)
        warn_about_threshold(config.make_objective(), "critical")
        call = check_options("explore", CALL_OPTIONS, call)
        if call.pop("check_proposals"):
            return _verify_proposals_of_study(config, file)
        return explore_config(config, file, progress, **call)


def _verify_proposals_of_study(config: ExplorationConfig, study: Path) -> ExplorationResult:
    config = config.with_stored_optimizer(study)
    config.require_entities()
    objective, optimizer = _make_objective_and_optimizer(config)
    warm_start = _load_warm_start(config, study, objective, optimizer)
    with StudyFile.open(study, readonly=True) as opened_study:
        warm_start_info = opened_study.meta.elsewhere if warm_start is None else warm_start.study_info
        meta = config.make_study_meta(objective, opened_study.meta.settings, warm_start_info, study=study)
        meta = replace(meta, optimizer=config.optimizer_text(opened_study.meta.optimizer))
    return verify_proposals(study, meta, objective, optimizer)


def _make_objective_and_optimizer(config: ExplorationConfig) -> tuple[Objective, Optimizer]:
    """Create the objective, and a fresh optimizer for it."""
    # Checked before the objective is created, whose error would only say that a Pareto front has no threshold.
    if config.pareto and not config.search.multi_objective:
        raise InputError(f"`pareto`: {config.search} searches one score; use evolutionary, or optuna:sampler=nsga2.")
    objective = config.make_objective()
    return objective, config.start_optimizer(objective)


def _load_warm_start(
    config: ExplorationConfig, study: Path, objective: Objective, optimizer: Optimizer
) -> WarmStart | None:
    """Load the scores of the study from which the search is warm-started; None without such a study."""
    if config.warm_start is None:
        return None
    check_output_differs_from_source(study, config.warm_start, "study")
    if not optimizer.supports_warm_start:
        if config.optimizer is None:
            raise InputError(
                f"`warm_start`: without a threshold or condition the optimizer is {config.search}, which learns nothing"
                " from another study; give a threshold with `critical`."
            )
        raise InputError(
            f"`warm_start`: {config.search} learns nothing from another study; use auto, level-set or committee."
        )
    return read_warm_start(Path(config.warm_start), config.logical.space, objective, config.ego, config.others)


def explore_config(
    config: ExplorationConfig,
    study: Path | str,
    progress: bool = False,
    *,
    retry_failed: bool = False,
) -> ExplorationResult:
    """Do the same as `explore`, but with the settings of a configuration; the study may exist already."""
    file = check_path("study", study)
    check_bool("progress", progress)
    check_bool("retry_failed", retry_failed)
    try:
        return _run_exploration(config.with_stored_optimizer(file), file, progress, retry_failed)
    except KeyboardInterrupt:
        # Interrupted before or after the part in which the explorer handles it itself.
        with suppress(InputError), StudyFile.open(file, readonly=True) as opened:
            return ExplorationResult.from_study(opened, "it was interrupted", interrupted=True)
        raise


def _run_exploration(
    config: ExplorationConfig, study_path: Path, progress: bool, retry_failed: bool
) -> ExplorationResult:
    start = time.monotonic()
    config.require_entities()
    objective, optimizer = _make_objective_and_optimizer(config)
    warm_start = _load_warm_start(config, study_path, objective, optimizer)
    with (
        _share_cluster_connection(config) as shared_config,
        simulator_from_config(shared_config) as simulator,
        reference_simulators(shared_config) as references,
    ):
        # Before the study is created: without these features no scenario can run.
        sample_values = config.logical.space.values(config.logical.space.representative_points())
        check_simulator_accepts(
            simulator,
            [config.logical.scenario_file],
            [config.concrete_scenario(values) for values in sample_values],
        )
        warn_notices(_notices_at_center(config, simulator))
        warn_if_ego_has_no_driver(simulator, [config.logical.scenario_file], config.ego)
        if config.repeats == 1:
            names = config.logical.space.names
            random = find_entities_with_random_sensors(simulator, [config.logical.scenario_file], names)
            warn_if_runs_are_random(random, "`repeats` runs each scenario several times, each with other numbers")
        meta = config.make_study_meta(
            objective, simulator.settings, None if warm_start is None else warm_start.study_info, study=study_path
        )
        meta = replace(meta, driver_in_file=find_driver_in_files(simulator, [config.logical.scenario_file], config.ego))
        with open_or_create_study(study_path, meta) as study:
            meta = replace(meta, optimizer=config.optimizer_text(study.meta.optimizer))
            if warm_start is None:
                # A resumed study holds its warm-start data itself.
                meta = replace(meta, elsewhere=study.meta.elsewhere)
            study.writer.check_and_update_meta(meta, same_budget="budget" in optimizer.requires)
            remember_scenario_path(config.logical.path, meta.fingerprint, study_path)
            if warm_start is not None:
                study.writer.save_warm_start(warm_start.points, warm_start.scores)
            had_ended = any(row.state != "pending" for row in study.rows())
            if retry_failed:
                study.writer.retry_failed()
            study.writer.add_elapsed_time("files", time.monotonic() - start)
            explorer_class = AsynchronousExplorer if config.asynchronous else ScenarioExplorer
            try:
                return explorer_class(config, simulator, optimizer, study, objective, references).run(progress)
            except InputError:
                # Remove a study in which nothing ran, so that the corrected command can start. Earlier failures stay.
                if not had_ended and not study.finished_rows():
                    study.writer.remove_scenarios()
                raise


def _notices_at_center(config: ExplorationConfig, simulator: Simulator) -> tuple[Notice, ...]:
    """List what the simulator ignores in the scenario file, with the parameter values at the centre of the space."""
    middle_values = config.logical.space.values(config.logical.space.center_point())
    return list_ignored_content(simulator, config.logical.scenario_file, middle_values[0] if middle_values else None)


def simulator_from_config(config: ExplorationConfig) -> Simulator:
    """Create the configured simulator; the caller has to close it. `InputError` if the code of a metric is missing."""
    config.require_metric_code()
    bounds = list_probe_values(config.logical.space)
    check_driver_parameters(config.simulator, config.logical.scenario_file, _resolve_drivers(config.drivers), bounds)
    return _create_simulator(config, config.drivers)


@contextmanager
def _share_cluster_connection(config: ExplorationConfig) -> Iterator[ExplorationConfig]:
    """Connect to the Dask cluster once, for the simulator and all reference simulators.

    Yields the configuration with this connection.
    """
    with open_connection(config.cluster, config.workers) as client:
        yield config if client is None else replace(config, cluster=client, workers=1)


@contextmanager
def reference_simulators(config: ExplorationConfig) -> Iterator[dict[str, Simulator]]:
    """Create a simulator for each reference driver in the condition; in it, this driver drives the ego.

    Yields the simulators by name of the reference driver.
    """
    condition = config.make_condition()
    with ExitStack() as stack:
        simulators = {}
        for name in () if condition is None else condition.reference_drivers:
            try:
                refuse_program_driver(name)
                simulators[name] = stack.enter_context(_create_simulator(config, {**config.drivers, config.ego: name}))
            except InputError as error:
                raise InputError(f"`critical_if`, reference:{name}: {error}") from error
        yield simulators


def _resolve_drivers(drivers: Mapping[str, DriverLike]) -> dict[str, str | Driver]:
    return {entity: resolve_driver(driver) for entity, driver in drivers.items()}


def _create_simulator(config: ExplorationConfig, drivers: Mapping[str, DriverLike]) -> Simulator:
    options: dict[str, Any] = {
        "time_step": config.time_step,
        "duration": config.duration,
        "on_collision": config.on_collision,
        "drivers": _resolve_drivers(drivers),
    }
    return create_simulator(
        config.simulator,
        options,
        ego=config.ego,
        workers=config.workers,
        timeout=config.timeout,
        retries=config.retries,
        cluster=config.cluster,
        max_failures=config.max_failures,
    )
