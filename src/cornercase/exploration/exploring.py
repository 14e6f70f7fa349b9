"""Explore a logical scenario into a study."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cornercase._common.arguments import flag, path, texts
from cornercase._common.dask_client import connected
from cornercase._common.errors import InputError
from cornercase._common.files import require_other_file
from cornercase._common.ledger import Notice, warn_of
from cornercase.drivers import Driver, told_driver
from cornercase.exploration.asynchronous import AsynchronousExplorer
from cornercase.exploration.beginning import Beginning, read_beginning
from cornercase.exploration.configuration import Configuration
from cornercase.exploration.explorer import ExplorationResult, ScenarioExplorer
from cornercase.exploration.objective import Objective
from cornercase.exploration.replaying import replay_proposals
from cornercase.exploration.varied_beside import explored_file
from cornercase.optimizers import Optimizer, create_optimizer, optimizer_needs
from cornercase.scenario import LogicalScenario
from cornercase.simulators import (
    MOST_FAILURES,
    Simulator,
    notices_of,
    require_usable,
    start_simulator,
    warn_if_nobody_drives,
)
from cornercase.study import Study, begun_study

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
    optimizer: str = "bayes",
    critical: float | None = None,
    critical_if: str | None = None,
    weights: Mapping[str, float] | None = None,
    pareto: bool = False,
    stop_when: Sequence[str] = (),
    budget: int = 200,
    batch: int = 10,
    asynchronous: bool = False,
    patience: int | None = None,
    max_seconds: float | None = None,
    seed: int = 0,
    simulator: str = "builtin",
    workers: int = 1,
    cluster: str | Client | None = None,
    timeout: float | None = None,
    retries: int = 1,
    max_failures: int = MOST_FAILURES,
    repeats: int = 1,
    most_repeats: int | None = None,
    audit: float = 0.0,
    time_step: float = 0.05,
    duration: float = 60.0,
    on_collision: str = "continue",
    drivers: Mapping[str, str | Driver] | None = None,
    replay: bool = False,
    from_study: Path | str | None = None,
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
        `cornercase.scenario.variables` gives them. A copy of the scenario with parameters in their place is written
        next to the study as ``STUDY.varied.xosc`` and explored.
    continuous : bool, default False
        Search ranges with steps as continuous intervals.
    optimizer : str, default "bayes"
        Options follow a colon: ``"bayes:filling=0"``.
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
    stop_when : sequence of str
        Stop when the critical set is known this well, such as ``"missed<0.01"``; all criteria must hold.
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
    simulator : str, default "builtin"
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
    most_repeats : int, optional
        Upper limit of runs per scenario. A scenario gets `repeats` further runs as long as it is undecided on which
        side of the threshold it is: while the 90 % interval of the probability that a run is critical
        (`cornercase.study.Study.critical_runs`) contains 0.5. Default: each scenario is run `repeats` times.
    audit : float, default 0.0
        Fraction of the scenarios, up to 0.5, that are drawn at random and hidden from the search, to assess its result.
    time_step, duration : float
        In s.
    on_collision : {"continue", "stop"}
        Whether a run goes on after a collision.
    drivers : mapping of str to str or Driver, optional
        By entity: a preset or ``package.module:Class``, both with options after a colon, or a driver object.
    replay : bool, default False
        Simulate nothing; check that the stored results lead to the same proposals.
    from_study : path, optional
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
    file = path("study", study)
    with explored_file(scenario, file, space, ranges, vary, continuous) as logical_scenario:
        config = Configuration(
            logical=logical_scenario,
            ego=ego,
            other=other,
            metrics=texts("metrics", metrics),
            optimizer=optimizer,
            critical=critical,
            critical_if=critical_if,
            weights={} if weights is None else weights,
            pareto=pareto,
            stop_when=texts("stop_when", stop_when),
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
            most_repeats=most_repeats,
            audit=audit,
            time_step=time_step,
            duration=duration,
            on_collision=on_collision,
            drivers={} if drivers is None else drivers,
            from_study=from_study,
        )
        if flag("replay", replay):
            return _replay(config, file)
        return explore_configuration(config, file, progress, retry_failed=retry_failed)


def _replay(one: Configuration, study: Path) -> ExplorationResult:
    one.require_entities()
    objective, optimizer = _searched_by(one)
    warm_start = _known(one, study, objective, optimizer)
    with Study.open(study, readonly=True) as opened_study:
        warm_start_info = opened_study.meta.elsewhere if warm_start is None else warm_start.about
        meta = one.meta(objective, opened_study.meta.settings, warm_start_info, study=study)
    return replay_proposals(study, meta, objective, optimizer)


def _searched_by(one: Configuration) -> tuple[Objective, Optimizer]:
    """Create the objective and a fresh optimizer for it."""
    objective = one.objective()
    threshold = one.threshold(objective)
    optimizer = create_optimizer(one.optimizer, one.logical.space, one.seed, threshold=threshold, budget=one.budget)
    if one.pareto and not optimizer.takes_several:
        raise InputError(f"`pareto`: {one.optimizer} takes one score; use evolutionary, or optuna:sampler=nsga2.")
    return objective, optimizer


def _known(one: Configuration, study: Path, objective: Objective, optimizer: Optimizer) -> Beginning | None:
    """Load the study that warm-starts the search; None without one."""
    if one.from_study is None:
        return None
    require_other_file(study, one.from_study, "study")
    if not optimizer.begins_from_studies:
        raise InputError(f"`from_study`: {one.optimizer} learns nothing from a study; use level-set or committee.")
    return read_beginning(Path(one.from_study), one.logical.space, objective, one.ego, one.others)


def explore_configuration(
    configuration: Configuration, study: Path | str, progress: bool = False, *, retry_failed: bool = False
) -> ExplorationResult:
    """Explore into a new or existing study, like `explore`."""
    file = path("study", study)
    flag("progress", progress)
    flag("retry_failed", retry_failed)
    try:
        return _explore(configuration, file, progress, retry_failed)
    except KeyboardInterrupt:
        # Interrupted before or after the part in which the explorer handles it itself.
        with suppress(InputError), Study.open(file, readonly=True) as opened:
            return ExplorationResult.of(opened, "it was interrupted", interrupted=True)
        raise


def _explore(one: Configuration, path: Path, progress: bool, retry_failed: bool) -> ExplorationResult:
    start = time.monotonic()
    one.require_entities()
    objective, optimizer = _searched_by(one)
    warm_start = _known(one, path, objective, optimizer)
    with (
        _on_one_cluster(one) as shared_config,
        configured_simulator(shared_config) as simulator,
        started_references(shared_config) as references,
    ):
        # Before the study is created: without these features no scenario can run.
        sample_values = one.logical.space.values(one.logical.space.samples())
        require_usable(simulator, [one.logical.scenario], [one.logical.concrete(values) for values in sample_values])
        warn_of(_notices(one))
        warn_if_nobody_drives(simulator, [one.logical.scenario], one.ego)
        meta = one.meta(objective, simulator.settings, None if warm_start is None else warm_start.about, study=path)
        with begun_study(path, meta) as study:
            if warm_start is None:
                # A resumed study holds its warm-start data itself.
                meta = replace(meta, elsewhere=study.meta.elsewhere)
            study.writer.continue_with(meta, same_budget="budget" in optimizer_needs(one.optimizer))
            if warm_start is not None:
                study.writer.keep_elsewhere(warm_start.points, warm_start.scores)
            had_ended = any(row.state != "pending" for row in study.rows())
            if retry_failed:
                study.writer.retry_failed()
            study.writer.add_elapsed("files", time.monotonic() - start)
            explorer_class = AsynchronousExplorer if one.asynchronous else ScenarioExplorer
            try:
                return explorer_class(one, simulator, optimizer, study, objective, references).run(progress)
            except InputError:
                # Remove a study in which nothing ran, so that the corrected command can start. Earlier failures stay.
                if not had_ended and not study.done():
                    study.writer.clear()
                raise


def _notices(one: Configuration) -> tuple[Notice, ...]:
    """List what has no effect in the simulator, for a scenario in the middle of the space."""
    middle_values = one.logical.space.values(one.logical.space.middle())
    return notices_of(one.simulator, one.logical.scenario, middle_values[0] if middle_values else None)


def configured_simulator(one: Configuration) -> Simulator:
    """Create the configured simulator; the caller closes it."""
    return _started(one, one.drivers)


@contextmanager
def _on_one_cluster(one: Configuration) -> Iterator[Configuration]:
    """Connect to the Dask cluster once, for the simulator and all reference simulators."""
    with connected(one.cluster, one.workers) as client:
        yield one if client is None else replace(one, cluster=client, workers=1)


@contextmanager
def started_references(one: Configuration) -> Iterator[dict[str, Simulator]]:
    """Create one simulator per reference driver of the condition, with that driver in the ego; by reference name."""
    condition = one.condition()
    with ExitStack() as stack:
        simulators = {}
        for name in () if condition is None else condition.references:
            try:
                simulators[name] = stack.enter_context(_started(one, {**one.drivers, one.ego: name}))
            except InputError as error:
                raise InputError(f"`critical_if`, reference:{name}: {error}") from error
        yield simulators


def _started(one: Configuration, drivers: Mapping[str, str | Driver]) -> Simulator:
    options: dict[str, Any] = {
        "time_step": one.time_step,
        "duration": one.duration,
        "on_collision": one.on_collision,
        "drivers": {entity: told_driver(driver) for entity, driver in drivers.items()},
    }
    return start_simulator(
        one.simulator,
        options,
        ego=one.ego,
        workers=one.workers,
        timeout=one.timeout,
        retries=one.retries,
        cluster=one.cluster,
        max_failures=one.max_failures,
    )
