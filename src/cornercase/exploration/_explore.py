"""Explore a logical scenario into a study."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cornercase._common.errors import InputError
from cornercase._common.io.files import check_output_differs_from_source
from cornercase._common.io.support_table import Notice, warn_notices
from cornercase._common.process.dask import open_connection
from cornercase._common.validation import check_bool, check_path, check_str_sequence
from cornercase.drivers import Driver
from cornercase.drivers._resolve import resolve_driver
from cornercase.exploration._asynchronous import AsynchronousExplorer
from cornercase.exploration._config import ExplorationConfig
from cornercase.exploration._explorer import ExplorationResult, ScenarioExplorer
from cornercase.exploration._varied_file import open_logical_scenario
from cornercase.exploration._verify_proposals import verify_proposals
from cornercase.exploration._warm_start import WarmStart, read_warm_start
from cornercase.exploration.stop._stop_rules import StopRule
from cornercase.optimizers import OPTIMIZERS, Optimizer
from cornercase.scenario import LogicalScenario
from cornercase.simulators import Simulator
from cornercase.simulators._create import create_simulator
from cornercase.simulators._results import check_simulator_accepts, list_ignored_content
from cornercase.simulators._run_notices import warn_if_ego_has_no_driver
from cornercase.simulators.pool._simulator import DEFAULT_MAX_FAILURES
from cornercase.study import StudyFile
from cornercase.study._criterion import Criterion
from cornercase.study._objective import Objective
from cornercase.study._study_file import open_or_create_study

if TYPE_CHECKING:
    from distributed import Client


# The parameters are the options of the command.
def explore(
    scenario: LogicalScenario | Path | str | None,
    study: Path | str,
    *,
    ego: str,
    other: str | Sequence[str],
    metrics: Sequence[str],
    space: Path | str | None = None,
    ranges: Sequence[str] = (),
    vary: Sequence[str] = (),
    continuous: bool = False,
    optimizer: str | Optimizer = "bayes",
    critical: float | None = None,
    critical_if: str | None = None,
    weights: Mapping[str, float] | None = None,
    pareto: bool = False,
    stop_when: StopRule | Sequence[StopRule | str] = (),
    budget: int = 200,
    batch: int = 10,
    asynchronous: bool = False,
    patience: int | None = None,
    max_seconds: float | None = None,
    seed: int = 0,
    simulator: str | Simulator = "builtin",
    workers: int = 1,
    cluster: str | Client | None = None,
    timeout: float | None = None,
    retries: int = 1,
    max_failures: int = DEFAULT_MAX_FAILURES,
    repeats: int = 1,
    max_repeats: int | None = None,
    audit: float = 0.0,
    time_step: float = 0.05,
    duration: float = 60.0,
    on_collision: str = "continue",
    drivers: Mapping[str, str | Driver] | None = None,
    check_proposals: bool = False,
    warm_start: Path | str | None = None,
    retry_failed: bool = False,
    progress: bool = False,
) -> ExplorationResult:
    """Search a logical scenario for its critical concrete scenarios.

    Each scenario is stored as soon as it has ended. If you call it again with the same arguments, it resumes where it
    stopped; with a larger `budget` it continues from there.

    Parameters
    ----------
    scenario : path or LogicalScenario or None
        OpenSCENARIO file. None: the file that `space` names.
    study : path
        Study file to create or resume.
    ego : str
        Name of the entity under test.
    other : str or sequence of str
        Entities that the ego is measured against; the most critical one counts. ``"*"`` means all others.
    metrics : sequence of str
        Criticality metrics. All are stored; the first is searched unless `weights` are given.
    space : path, optional
        ParameterValueDistribution file. Like `ranges`, `vary` and `continuous`, only if `scenario` is a path.
    ranges : sequence of str
        ``NAME=LOW:HIGH[:STEP]``; they add parameters to the space or replace them.
    vary : sequence of str
        ``NAME=LOW:HIGH[:STEP]`` or ``NAME`` for numbers in the file, under the names that
        `cornercase.scenario.list_variables` gives them. A copy of the scenario with parameters in their place is
        written next to the study as ``STUDY.varied.xosc`` and explored.
    continuous : bool, default False
        Search ranges with steps as continuous intervals.
    optimizer : str or Optimizer, default "bayes"
        Such as ``cornercase.optimizers.LevelSet(filling=0.1)``; in text, options follow a colon: ``"bayes:filling=0"``.
    critical : float, optional
        Threshold: score from which a scenario is critical. Default: the metric's own.
    critical_if : str, optional
        Condition that replaces metric and threshold, and is searched: ``"collision and not reference:cc-human"``. It
        consists of ``collision`` (of the ego with anybody), ``reference:NAME`` (the ego would also collide if this
        driver drove it), bounds on scores such as ``ttc < 1``, ``and``, ``or``, ``not`` and brackets. If the result
        depends on a reference, the scenario is run a second time.
    weights : mapping of str to float, optional
        By metric: search the weighted sum of the scores. Metrics that are critical when high count with a minus sign.
    pareto : bool, default False
        Search the Pareto front of all metrics.
    stop_when : StopRule or sequence of StopRule or str
        Stop when the critical set is known this well, such as ``cornercase.stop.missed(0.01)`` or ``"missed<0.01"``;
        all criteria must hold. `cornercase.stop.seconds` and `cornercase.stop.no_improvement` end it by themselves.
    budget, batch : int
        Number of scenarios in total and per round.
    asynchronous : bool, default False
        Search without rounds: ask for the next scenario as soon as one has ended. With one simulator, the same seed
        gives the same result. With several, the result depends on the order in which scenarios end, which is stored.
    patience : int, optional
        Stop after this many rounds without an improvement; without rounds, after as many scenarios.
    max_seconds : float, optional
        Time in s after which no new round starts.
    seed : int, default 0
        The same seed gives the same result.
    simulator : str or Simulator, default "builtin"
        Such as ``cornercase.simulators.Esmini(seed=3)``, or ``"esmini:seed=3"``. An object is not run itself: one like
        it is made in each process.
    workers : int, default 1
        Number of simulators that run in parallel.
    cluster : str or distributed.Client, optional
        Dask cluster to run on: ``"local"`` for `workers` local processes, the address of a scheduler, a scheduler file,
        or a client, which stays open.
    timeout : float, optional
        Time in s after which a scenario is cancelled.
    retries : int, default 1
        How often a scenario is run again after the simulator died or hung.
    max_failures : int, default 5
        Stop after this many consecutive scenarios in which the simulator died or hung; 0 for no limit. An exception of
        a driver, the simulator or a metric fails its scenario only, unless that many scenarios have failed before any
        gave a result.
    repeats : int, default 1
        How often each scenario is run; the median score counts.
    max_repeats : int, optional
        Upper limit of runs per scenario. A scenario gets `repeats` further runs as long as it is undecided on which
        side of the threshold it is: while the 90 % interval of the probability that a run is critical
        (`cornercase.study.StudyFile.critical_run_rates`) contains 0.5. Default: each scenario is run `repeats` times.
    audit : float, default 0.0
        Fraction of the scenarios, up to 0.5, that are drawn at random and hidden from the search, to assess its result.
    time_step, duration : float
        In s.
    on_collision : {"continue", "stop"}
        Whether a run goes on after a collision.
    drivers : mapping of str to str or Driver, optional
        By entity: a preset or ``package.module:Class``, both with options after a colon, or a driver object.
    check_proposals : bool, default False
        Simulate nothing; check that the stored results lead to the same proposals.
    warm_start : path, optional
        Study with the same parameters but another driver, simulator or time step, whose scores warm-start the search.
        They are copied; a search that is resumed does not need that study.
    retry_failed : bool, default False
        First run the failed scenarios of the study again, for example after an external failure. Later proposals stay.
    progress : bool, default False
        Show progress on standard error.

    Returns
    -------
    ExplorationResult

    Raises
    ------
    InputError
        An argument cannot be used, or the study belongs to another exploration; it is left unchanged.

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
    file = check_path("study", study)
    with open_logical_scenario(scenario, file, space, ranges, vary, continuous) as logical_scenario:
        config = ExplorationConfig(
            logical=logical_scenario,
            ego=ego,
            other=other,
            metrics=check_str_sequence("metrics", metrics),
            optimizer=optimizer,
            critical=critical,
            critical_if=critical_if,
            weights={} if weights is None else weights,
            pareto=pareto,
            stop_when=stop_when,
            budget=budget,
            batch=batch,
            asynchronous=asynchronous,
            patience=patience,
            max_seconds=max_seconds,
            seed=seed,
            simulator=simulator,
            workers=workers,
            cluster=cluster,
            timeout=timeout,
            retries=retries,
            max_failures=max_failures,
            repeats=repeats,
            max_repeats=max_repeats,
            audit=audit,
            time_step=time_step,
            duration=duration,
            on_collision=on_collision,
            drivers={} if drivers is None else drivers,
            warm_start=warm_start,
        )
        if check_bool("check_proposals", check_proposals):
            return _verify_proposals_of_study(config, file)
        return explore_config(config, file, progress, retry_failed=retry_failed)


def _verify_proposals_of_study(config: ExplorationConfig, study: Path) -> ExplorationResult:
    config.require_entities()
    criterion, optimizer = _make_criterion_and_optimizer(config)
    warm_start = _load_warm_start(config, study, criterion.objective, optimizer)
    with StudyFile.open(study, readonly=True) as opened_study:
        warm_start_info = opened_study.meta.elsewhere if warm_start is None else warm_start.study_info
        meta = config.make_study_meta(criterion, opened_study.meta.settings, warm_start_info, study=study)
    return verify_proposals(study, meta, criterion.objective, optimizer)


def _make_criterion_and_optimizer(config: ExplorationConfig) -> tuple[Criterion, Optimizer]:
    """Create the criterion and a fresh optimizer for it."""
    criterion = config.make_criterion()
    optimizer = OPTIMIZERS.resolve(config.optimizer, "optimizer").start(
        config.logical.space, config.seed, threshold=criterion.oriented, budget=config.budget
    )
    if config.pareto and not optimizer.multi_objective:
        raise InputError(f"`pareto`: {config.optimizer} takes one score; use evolutionary, or optuna:sampler=nsga2.")
    return criterion, optimizer


def _load_warm_start(
    config: ExplorationConfig, study: Path, objective: Objective, optimizer: Optimizer
) -> WarmStart | None:
    """Load the study that warm-starts the search; None without one."""
    if config.warm_start is None:
        return None
    check_output_differs_from_source(study, config.warm_start, "study")
    if not optimizer.supports_warm_start:
        raise InputError(f"`warm_start`: {config.optimizer} learns nothing from a study; use level-set or committee.")
    return read_warm_start(Path(config.warm_start), config.logical.space, objective, config.ego, config.others)


def explore_config(
    config: ExplorationConfig, study: Path | str, progress: bool = False, *, retry_failed: bool = False
) -> ExplorationResult:
    """Explore into a new or existing study, like `explore`."""
    file = check_path("study", study)
    check_bool("progress", progress)
    check_bool("retry_failed", retry_failed)
    try:
        return _run_exploration(config, file, progress, retry_failed)
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
    criterion, optimizer = _make_criterion_and_optimizer(config)
    warm_start = _load_warm_start(config, study_path, criterion.objective, optimizer)
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
            [config.logical.concrete_scenario(values) for values in sample_values],
        )
        warn_notices(_notices_at_center(config, simulator))
        warn_if_ego_has_no_driver(simulator, [config.logical.scenario_file], config.ego)
        meta = config.make_study_meta(
            criterion, simulator.settings, None if warm_start is None else warm_start.study_info, study=study_path
        )
        with open_or_create_study(study_path, meta) as study:
            if warm_start is None:
                # A resumed study holds its warm-start data itself.
                meta = replace(meta, elsewhere=study.meta.elsewhere)
            study.writer.resume(meta, same_budget="budget" in OPTIMIZERS.get_class(config.optimizer).requires)
            if warm_start is not None:
                study.writer.save_warm_start(warm_start.points, warm_start.scores)
            had_ended = any(row.state != "pending" for row in study.rows())
            if retry_failed:
                study.writer.retry_failed()
            study.writer.add_elapsed_time("files", time.monotonic() - start)
            explorer_class = AsynchronousExplorer if config.asynchronous else ScenarioExplorer
            try:
                return explorer_class(config, simulator, optimizer, study, criterion, references).run(progress)
            except InputError:
                # Remove a study in which nothing ran, so that the corrected command can start. Earlier failures stay.
                if not had_ended and not study.finished_rows():
                    study.writer.remove_scenarios()
                raise


def _notices_at_center(config: ExplorationConfig, simulator: Simulator) -> tuple[Notice, ...]:
    """List what has no effect in the simulator, for a scenario in the middle of the space."""
    middle_values = config.logical.space.values(config.logical.space.center_point())
    return list_ignored_content(simulator, config.logical.scenario_file, middle_values[0] if middle_values else None)


def simulator_from_config(config: ExplorationConfig) -> Simulator:
    """Create the configured simulator; the caller closes it."""
    return _create_simulator(config, config.drivers)


@contextmanager
def _share_cluster_connection(config: ExplorationConfig) -> Iterator[ExplorationConfig]:
    """Connect to the Dask cluster once, for the simulator and all reference simulators."""
    with open_connection(config.cluster, config.workers) as client:
        yield config if client is None else replace(config, cluster=client, workers=1)


@contextmanager
def reference_simulators(config: ExplorationConfig) -> Iterator[dict[str, Simulator]]:
    """Create one simulator per reference driver of the condition, with that driver in the ego; by reference name."""
    condition = config.make_condition()
    with ExitStack() as stack:
        simulators = {}
        for name in () if condition is None else condition.reference_drivers:
            try:
                simulators[name] = stack.enter_context(_create_simulator(config, {**config.drivers, config.ego: name}))
            except InputError as error:
                raise InputError(f"`critical_if`, reference:{name}: {error}") from error
        yield simulators


def _create_simulator(config: ExplorationConfig, drivers: Mapping[str, str | Driver]) -> Simulator:
    options: dict[str, Any] = {
        "time_step": config.time_step,
        "duration": config.duration,
        "on_collision": config.on_collision,
        "drivers": {entity: resolve_driver(driver) for entity, driver in drivers.items()},
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
