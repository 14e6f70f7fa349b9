"""From a logical scenario to a study."""

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


# Its parameters are the options of the command.
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

    Each scenario is stored the moment it has ended. The same call again goes on where it stopped; with a larger
    budget it goes on from there.

    Parameters
    ----------
    scenario : path or LogicalScenario or None
        OpenSCENARIO file; None for the one that `space` names.
    study : path
        Study to write or continue.
    ego : str
        Name of the entity under test.
    other : str or sequence of str
        Whom it is measured against; of several the one counts to whom it is most critical. ``"*"`` stands for all
        others.
    metrics : sequence of str
        Criticality metrics; all are stored, the first is searched where there are no weights.
    space : path, optional
        ParameterValueDistribution file. Like `ranges`, `vary` and `continuous` only for the path of a scenario.
    ranges : sequence of str
        ``NAME=LOW:HIGH[:STEP]``; they add parameters to the space or replace them.
    vary : sequence of str
        ``NAME=LOW:HIGH[:STEP]``, or ``NAME``, of numbers that stand in the file, by the names that
        `cornercase.scenario.variables` gives them. The scenario with parameters in their place is written beside the
        study, as ``STUDY.varied.xosc``, and that one is explored.
    continuous : bool, default False
        Search ranges with steps as continuous intervals.
    optimizer : str, default "bayes"
        Options stand after a colon, as in ``"bayes:filling=0"``.
    critical : float, optional
        Threshold: score from which a scenario is critical; by default the metric's own.
    critical_if : str, optional
        Condition that says instead what is critical, and is searched: ``"collision and not reference:cc-human"``. It is
        made of ``collision`` (of the ego, with anybody), ``reference:NAME`` (the ego would collide with this driver at
        the wheel), bounds on scores such as ``ttc < 1``, ``and``, ``or``, ``not`` and brackets. Where it depends on a
        reference, the scenario is run a second time.
    weights : mapping of str to float, optional
        By metric: search their weighted sum, in which what is critical when high counts with the opposite sign.
    pareto : bool, default False
        Search the Pareto front of all metrics.
    stop_when : sequence of str
        Stop when so much is known of the critical set, as ``"missed<0.01"``; of several all.
    budget, batch : int
        Scenarios in all and per round.
    asynchronous : bool, default False
        Have no rounds: ask the search for the next scenario as soon as one has ended. With one simulator the same seed
        gives the same result; with several the result depends on the order in which scenarios end, which is stored.
    patience : int, optional
        Rounds without anything new after which to stop; without rounds as many scenarios.
    max_seconds : float, optional
        Time in s after which no round is begun.
    seed : int, default 0
        The same seed gives the same result.
    simulator : str, default "builtin"
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
    repeats : int, default 1
        How often each scenario is run; its score is the median.
    most_repeats : int, optional
        How often a scenario is run at most: it is run `repeats` times more, again and again, while it is open on which
        side of the threshold it is, that is while the 90 % interval of the probability that a run is critical
        (`cornercase.study.Study.critical_runs`) holds 0.5. By default each is run `repeats` times.
    audit : float, default 0.0
        Share of the scenarios, up to 0.5, that are drawn at random and kept from the search, to judge what it found.
    time_step, duration : float
        s.
    on_collision : {"continue", "stop"}
        What a collision does to the run.
    drivers : mapping of str to str or Driver, optional
        Who drives, by entity: a preset or ``package.module:Class``, either with options after a colon, or a driver.
    replay : bool, default False
        Simulate nothing; look whether the results in the study give the same proposals again.
    from_study : path, optional
        Study of the same parameters, of another driver, simulator or time step, whose scores the search begins from.
        They are copied; a search that goes on needs them no more.
    retry_failed : bool, default False
        Run scenarios of the study that failed once more before it goes on, as after a failure from outside. What was
        proposed since then stays.
    progress : bool, default False
        Show how far it is on standard error.

    Returns
    -------
    ExplorationResult

    Raises
    ------
    InputError
        Something cannot be used, or the study is of another exploration; it is left as it is.

    Warns
    -----
    NoticeWarning
        Something in the scenario's files has no effect in the simulator.
    """
    file = path("study", study)
    with explored_file(scenario, file, space, ranges, vary, continuous) as logical:
        configuration = Configuration(
            logical=logical,
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
            return _replay(configuration, file)
        return explore_configuration(configuration, file, progress, retry_failed=retry_failed)


def _replay(one: Configuration, study: Path) -> ExplorationResult:
    one.require_entities()
    objective, optimizer = _searched_by(one)
    known = _known(one, study, objective, optimizer)
    with Study.open(study, readonly=True) as opened:
        elsewhere = opened.meta.elsewhere if known is None else known.about
        meta = one.meta(objective, opened.meta.settings, elsewhere, study=study)
    return replay_proposals(study, meta, objective, optimizer)


def _searched_by(one: Configuration) -> tuple[Objective, Optimizer]:
    """What is searched, and a fresh optimizer for it."""
    objective = one.objective()
    threshold = one.threshold(objective)
    optimizer = create_optimizer(one.optimizer, one.logical.space, one.seed, threshold=threshold, budget=one.budget)
    if one.pareto and not optimizer.takes_several:
        raise InputError(f"`pareto`: {one.optimizer} takes one score; use evolutionary, or optuna:sampler=nsga2.")
    return objective, optimizer


def _known(one: Configuration, study: Path, objective: Objective, optimizer: Optimizer) -> Beginning | None:
    """What the search begins from, if it is given another study."""
    if one.from_study is None:
        return None
    require_other_file(study, one.from_study, "study")
    if not optimizer.begins_from_studies:
        raise InputError(f"`from_study`: {one.optimizer} learns nothing from a study; use level-set or committee.")
    return read_beginning(Path(one.from_study), one.logical.space, objective, one.ego, one.others)


def explore_configuration(
    configuration: Configuration, study: Path | str, progress: bool = False, *, retry_failed: bool = False
) -> ExplorationResult:
    """Explore into a study, or go on with the one that is there; as `explore`.

    Parameters
    ----------
    configuration : Configuration
    study : path
    progress : bool, default False
    retry_failed : bool, default False
        Whether scenarios that failed are run once more.

    Returns
    -------
    ExplorationResult

    Raises
    ------
    InputError
        Something cannot be used, or the study is of another exploration; it is left as it is.
    """
    file = path("study", study)
    flag("progress", progress)
    flag("retry_failed", retry_failed)
    try:
        return _explore(configuration, file, progress, retry_failed)
    except KeyboardInterrupt:
        # Interrupted at the very beginning or end, when the explorer does not handle it itself.
        with suppress(InputError), Study.open(file, readonly=True) as opened:
            return ExplorationResult.of(opened, "it was interrupted", interrupted=True)
        raise


def _explore(one: Configuration, path: Path, progress: bool, retry_failed: bool) -> ExplorationResult:
    begun = time.monotonic()
    one.require_entities()
    objective, optimizer = _searched_by(one)
    known = _known(one, path, objective, optimizer)
    with (
        _on_one_cluster(one) as there,
        configured_simulator(there) as simulator,
        started_references(there) as references,
    ):
        # Asked before a study is made, since without these means no scenario can be run.
        some = one.logical.space.values(one.logical.space.samples())
        require_usable(simulator, [one.logical.scenario], [one.logical.concrete(values) for values in some])
        warn_of(_notices(one))
        warn_if_nobody_drives(simulator, [one.logical.scenario], one.ego)
        meta = one.meta(objective, simulator.settings, None if known is None else known.about, study=path)
        with begun_study(path, meta) as study:
            if known is None:
                # What it began from is in the study.
                meta = replace(meta, elsewhere=study.meta.elsewhere)
            study.writer.continue_with(meta, same_budget="budget" in optimizer_needs(one.optimizer))
            if known is not None:
                study.writer.keep_elsewhere(known.points, known.scores)
            had_ended = any(row.state != "pending" for row in study.rows())
            if retry_failed:
                study.writer.retry_failed()
            study.writer.add_elapsed("files", time.monotonic() - begun)
            kind = AsynchronousExplorer if one.asynchronous else ScenarioExplorer
            try:
                return kind(one, simulator, optimizer, study, objective, references).run(progress)
            except InputError:
                # What nothing could be run with must not keep out the corrected command. What had failed before stays.
                if not had_ended and not study.done():
                    study.writer.clear()
                raise


def _notices(one: Configuration) -> tuple[Notice, ...]:
    """What of the scenario has no effect, as it is read in the middle of the space."""
    middle = one.logical.space.values(one.logical.space.middle())
    return notices_of(one.simulator, one.logical.scenario, middle[0] if middle else None)


def configured_simulator(one: Configuration) -> Simulator:
    """Start the simulator of a configuration.

    Parameters
    ----------
    one : Configuration

    Returns
    -------
    Simulator
        To be closed.
    """
    return _started(one, one.drivers)


@contextmanager
def _on_one_cluster(one: Configuration) -> Iterator[Configuration]:
    """Connect with the cluster once, for the simulator and all references."""
    with connected(one.cluster, one.workers) as client:
        yield one if client is None else replace(one, cluster=client, workers=1)


@contextmanager
def started_references(one: Configuration) -> Iterator[dict[str, Simulator]]:
    """Start a simulator for each reference of the condition of a configuration, with it at the wheel of the ego.

    Parameters
    ----------
    one : Configuration

    Yields
    ------
    dict of str to Simulator
        By name of the reference; empty without a condition.

    Raises
    ------
    InputError
        There is no such driver, or the simulator takes none.
    """
    condition = one.condition()
    with ExitStack() as stack:
        found = {}
        for name in () if condition is None else condition.references:
            try:
                found[name] = stack.enter_context(_started(one, {**one.drivers, one.ego: name}))
            except InputError as error:
                raise InputError(f"`critical_if`, reference:{name}: {error}") from error
        yield found


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
