"""From a logical scenario to a report, as the command line does it."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cornercase._common.errors import InputError
from cornercase.exploration.explorer import ExplorationResult, ScenarioExplorer
from cornercase.exploration.objective import Objective
from cornercase.exploration.stopping import Criterion
from cornercase.metrics import METRICS
from cornercase.optimizers import create_optimizer, optimizer_needs
from cornercase.scenario import LogicalScenario
from cornercase.simulators import Simulator, start_simulator
from cornercase.study import Study, StudyMeta


@dataclass(frozen=True)
class Exploration:
    """Everything that an exploration depends on.

    Attributes
    ----------
    logical : LogicalScenario
    ego, other : str
    metrics : tuple of str
        The first is searched.
    optimizer : str
    critical : float or None
        Score from which a scenario is critical; None for the metric's own.
    weights : mapping of str to float
        For a weighted sum of the metrics, instead of the first.
    pareto : bool
        Whether to search the Pareto front of all metrics.
    stop_when : tuple of str
        What has to be known to stop, as ``"missed<0.01"``.
    budget, batch, seed : int
    patience : int or None
    max_seconds : float or None
    simulator : str
    workers : int
    timeout : float or None
        s after which a scenario is given up.
    retries : int
        How often a scenario is run again after the simulator died or hung.
    repeats : int
        How often each scenario is run, as of `ScenarioExplorer`.
    time_step, duration : float
        s.
    on_collision : {"continue", "stop"}
    drivers : mapping of str to str
        Driver by entity.
    """

    logical: LogicalScenario
    ego: str
    other: str
    metrics: tuple[str, ...]
    optimizer: str = "bayes"
    critical: float | None = None
    weights: Mapping[str, float] = field(default_factory=dict)
    pareto: bool = False
    stop_when: tuple[str, ...] = ()
    budget: int = 200
    batch: int = 10
    seed: int = 0
    patience: int | None = None
    max_seconds: float | None = None
    simulator: str = "builtin"
    workers: int = 1
    timeout: float | None = None
    retries: int = 1
    repeats: int = 1
    time_step: float = 0.05
    duration: float = 60.0
    on_collision: str = "continue"
    drivers: Mapping[str, str] = field(default_factory=dict)


def explore_scenario(exploration: Exploration, path: Path, progress: bool = False) -> ExplorationResult:
    """Explore into a study, or go on with the one that is there.

    Raises
    ------
    InputError
        Something about the exploration cannot be used, or the study is of another one; it is left as it is.
    """
    try:
        return _explore(exploration, path, progress)
    except KeyboardInterrupt:
        # While the explorer does not listen, at its very beginning or end.
        with suppress(InputError), Study.open(path, readonly=True) as study:
            return ExplorationResult(len(study.done()) + len(study.failed()), "it was interrupted", interrupted=True)
        raise


def _explore(one: Exploration, path: Path, progress: bool) -> ExplorationResult:
    file = one.logical.scenario
    file.require_entity(one.ego, "ego")
    file.require_entity(one.other, "other")
    if one.ego == one.other:
        raise InputError(f"--other {one.other}: is the ego itself; name the entity that it meets.")
    metrics = [METRICS.create(name) for name in dict.fromkeys(one.metrics)]
    objective = Objective(metrics, one.weights, one.pareto)
    criteria = [Criterion.parse(text) for text in one.stop_when]
    needs = optimizer_needs(one.optimizer)
    required = "threshold" in needs or bool(criteria)
    threshold = objective.threshold(one.critical) if required else objective.known_threshold(one.critical)
    optimizer = create_optimizer(one.optimizer, one.logical.space, one.seed, threshold=threshold, budget=one.budget)
    if one.pareto and not optimizer.takes_several:
        raise InputError(f"--pareto: {one.optimizer} takes one score; use evolutionary, or optuna:sampler=nsga2.")
    simulator = _simulator(one)
    # Before there is a study, as nothing of the scenario could be run.
    simulator.require_means(file)
    meta = StudyMeta(
        scenario=str(one.logical.path.resolve()),
        fingerprint=one.logical.fingerprint,
        space=one.logical.space,
        ego=one.ego,
        other=one.other,
        metrics=tuple(metric.name for metric in metrics),
        optimizer=one.optimizer,
        simulator=one.simulator,
        settings=simulator.settings,
        critical=None if threshold is None else objective.flip(threshold),
        weights=dict(one.weights),
        pareto=one.pareto,
        seed=one.seed,
        budget=one.budget,
        batch=one.batch,
        repeats=one.repeats,
    )
    with Study.open(path) if path.exists() else Study.create(path, meta) as study:
        study.continue_with(meta, same_budget="budget" in needs)
        explorer = ScenarioExplorer(
            one.logical, simulator, optimizer, metrics, one.ego, one.other, study,
            budget=one.budget, batch=one.batch, patience=one.patience, max_seconds=one.max_seconds,
            objective=objective, stop_when=criteria, critical=threshold, seed=one.seed, repeats=one.repeats,
        )  # fmt: skip
        try:
            return explorer.run(progress)
        finally:
            simulator.close()


def _simulator(one: Exploration) -> Simulator:
    from cornercase.drivers import named_driver

    options: dict[str, Any] = {
        "time_step": one.time_step,
        "duration": one.duration,
        "on_collision": one.on_collision,
        # A preset stays a name, so that it can be written into the reduced set's files.
        "drivers": {entity: named_driver(n) if ":" in n else n for entity, n in one.drivers.items()},
    }
    for name in one.drivers.values():
        named_driver(name)
    return start_simulator(
        one.simulator, options, ego=one.ego, workers=one.workers, timeout=one.timeout, retries=one.retries
    )
