"""Everything that an exploration depends on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final

from cornercase._common.arguments import by_name, flag, number, path, shown, text, texts, whole_number
from cornercase._common.dask_client import cluster_argument
from cornercase._common.errors import InputError
from cornercase._common.texts import without_folders
from cornercase.drivers import Driver, is_driver
from cornercase.exploration.objective import Objective
from cornercase.exploration.stopping import Criterion
from cornercase.metrics import EVERYBODY, METRICS, CriticalIf, name_others
from cornercase.optimizers import optimizer_needs
from cornercase.scenario import LogicalScenario
from cornercase.simulators import MOST_FAILURES, MOST_WORKERS
from cornercase.study import FEWEST_CLEAR_RUNS, MOST_AUDITS, StudyMeta, stored_path

if TYPE_CHECKING:
    from distributed import Client

# Whole numbers, and the least that each may be.
_LEAST: Final = {"budget": 1, "batch": 1, "patience": 1, "seed": 0, "retries": 0, "max_failures": 0, "repeats": 1}


@dataclass(frozen=True)
class Configuration:
    """Everything that an exploration depends on.

    Attributes
    ----------
    logical : LogicalScenario
    ego : str
        Name of the entity under test.
    other : str or tuple of str
        Whom it is measured against. A sequence of several names becomes a tuple, and ``"*"`` the names of all others.
    metrics : tuple of str
        All are stored; the first is searched where there are no weights.
    optimizer : str
    critical : float or None
        Threshold: score from which a scenario is critical; None for the metric's own.
    critical_if : str or None
        Condition on collisions, scores and references that says instead what is critical; it is searched.
    weights : mapping of str to float
        By metric, for their weighted sum to be searched instead of the first.
    pareto : bool
        Whether to search the Pareto front of all metrics.
    stop_when : tuple of str
        What has to be known of the critical set to stop, as ``"missed<0.01"``; of several all.
    budget, batch : int
        Scenarios in all and per round.
    asynchronous : bool
        Whether the search is asked for the next scenario as soon as one has ended. As many results as a round has are
        the unit of `patience`, and of how often it is judged whether to stop.
    patience : int or None
        Rounds without anything new after which to stop: none of them had a score at least as critical as the best
        before. A score at the metric's cap is not critical and never new after the first.
    max_seconds : float or None
        Time in s after which no round is begun.
    seed : int
    simulator : str
    workers : int
        Simulators side by side.
    cluster : str, distributed.Client or None
        Dask cluster that they run on, as `cornercase.simulators.ClusterSimulator` takes it.
    timeout : float or None
        Time in s after which a scenario is given up.
    retries : int
        How often a scenario is run again after the simulator died or hung.
    max_failures : int
        Scenarios in a row in which the simulator dies or hangs, or scenarios that fail by exceptions before any gives
        a result, after which the exploration ends; 0 for no limit.
    repeats : int
        How often each scenario is run, for a simulator that does not give the same twice; the median counts.
    most_repeats : int or None
        How often a scenario is run at most: `repeats` times more while it is open on which side of the threshold it is.
        None where each is run `repeats` times, also where as many are given.
    audit : float
        Share of the scenarios that are drawn at random to judge the search, and that it is never told.
    time_step, duration : float
        s.
    on_collision : {"continue", "stop"}
    drivers : mapping of str to str or Driver
        Who drives, by entity.
    from_study : Path or None
        Study of the same parameters whose scores the search begins from.

    Raises
    ------
    InputError
        Something is of another type or out of range, or what `stop_when` says is no criterion.
    """

    logical: LogicalScenario
    ego: str
    other: str | Sequence[str]
    metrics: tuple[str, ...]
    optimizer: str = "bayes"
    critical: float | None = None
    critical_if: str | None = None
    weights: Mapping[str, float] = field(default_factory=dict)
    pareto: bool = False
    stop_when: tuple[str, ...] = ()
    budget: int = 200
    batch: int = 10
    asynchronous: bool = False
    patience: int | None = None
    max_seconds: float | None = None
    seed: int = 0
    simulator: str = "builtin"
    workers: int = 1
    cluster: str | Client | None = None
    timeout: float | None = None
    retries: int = 1
    max_failures: int = MOST_FAILURES
    repeats: int = 1
    most_repeats: int | None = None
    audit: float = 0.0
    time_step: float = 0.05
    duration: float = 60.0
    on_collision: str = "continue"
    drivers: Mapping[str, str | Driver] = field(default_factory=dict)
    from_study: Path | str | None = None

    def __post_init__(self) -> None:
        given = vars(self)
        taken: dict[str, object] = {name: text(name, given[name]) for name in ("ego", "optimizer", "simulator")}
        everybody = self.logical.scenario.entities if EVERYBODY in texts("other", self.other) else ()
        others = name_others(self.other, text("ego", self.ego), everybody)
        taken["other"] = others[0] if len(others) == 1 else others
        if self.critical_if is not None:
            taken["critical_if"] = text("critical_if", self.critical_if)
            self._require_condition_alone()
        taken |= {name: texts(name, given[name]) for name in ("metrics", "stop_when")}
        taken |= {
            name: whole_number(name, given[name], least)
            for name, least in _LEAST.items()
            if not (name == "patience" and self.patience is None)
        }
        taken["workers"] = whole_number("workers", self.workers, 1, MOST_WORKERS)
        taken |= {name: flag(name, given[name]) for name in ("asynchronous", "pareto")}
        taken["on_collision"] = text("on_collision", self.on_collision, ("continue", "stop"))
        taken |= {name: number(name, given[name], above=0.0) for name in ("time_step", "duration")}
        taken["audit"] = number("audit", self.audit, least=0.0)
        if self.audit > MOST_AUDITS:
            raise InputError(f"`audit` {self.audit:g}: give a share of the scenarios up to {MOST_AUDITS:g}.")
        if self.critical is not None:
            taken["critical"] = number("critical", self.critical)
        if self.from_study is not None:
            taken["from_study"] = path("from_study", self.from_study)
        if self.cluster is not None:
            taken["cluster"] = cluster_argument(self.cluster)
        if self.max_seconds is not None:
            taken["max_seconds"] = number("max_seconds", self.max_seconds, least=0.0)
        if self.timeout is not None:
            taken["timeout"] = number("timeout", self.timeout, above=0.0)
        weights = by_name("weights", self.weights)
        taken["weights"] = {name: number("weights", weight) for name, weight in weights.items()}
        taken["drivers"] = {name: _driver(name, driver) for name, driver in by_name("drivers", self.drivers).items()}
        for name, value in taken.items():
            object.__setattr__(self, name, value)
        object.__setattr__(self, "most_repeats", self._most_repeats())
        self.criteria()

    @property
    def others(self) -> tuple[str, ...]:
        """Names of all entities that the ego is measured against."""
        return (self.other,) if isinstance(self.other, str) else tuple(self.other)

    def _require_condition_alone(self) -> None:
        """Refuse what would say too what is critical, or is searched."""
        says_too = {"critical": self.critical is not None, "weights": self.weights, "pareto": self.pareto}
        for name in filter(says_too.get, says_too):
            raise InputError(f"`critical_if` says what is critical, and is searched; leave `{name}` out.")
        for name, given in {"repeats": self.repeats, "most_repeats": self.most_repeats}.items():
            if given not in (None, 1):
                raise InputError(f"`critical_if` is decided by one run of each scenario; leave `{name}` out.")

    def _most_repeats(self) -> int | None:
        """Take how often a scenario is run at most, where that is more than each is."""
        if self.most_repeats is None:
            return None
        most = whole_number("most_repeats", self.most_repeats, 1)
        if most == self.repeats:
            return None
        if self.pareto or self.weights:
            other = "pareto" if self.pareto else "weights"
            raise InputError(
                f"`most_repeats` {most}: whether a run is critical is told by one metric; leave it or `{other}` out."
            )
        if self.repeats == 1:
            raise InputError(
                f"`most_repeats` {most}: adds to scenarios that are run several times; give `repeats` of 2 or more."
            )
        if most < self.repeats:
            raise InputError(f"`most_repeats` {most}: is less than `repeats` {self.repeats}; give more.")
        if most < FEWEST_CLEAR_RUNS:
            raise InputError(
                f"`most_repeats` {most}: fewer than {FEWEST_CLEAR_RUNS} runs leave each scenario open; give"
                f" {FEWEST_CLEAR_RUNS} or more, or `repeats` {most} alone."
            )
        return most

    def require_entities(self) -> None:
        """Refuse an ego, other or driven entity that the scenario does not have.

        Raises
        ------
        InputError
        """
        self.logical.scenario.require_entity(self.ego, "ego")
        for other in self.others:
            self.logical.scenario.require_entity(other, "other")
        for entity in self.drivers:
            self.logical.scenario.require_entity(entity, "driven entity")

    def objective(self) -> Objective:
        """What is searched.

        Returns
        -------
        Objective

        Raises
        ------
        InputError
            There is no such metric, what it needs is not installed, or the weights or the front cannot be searched.
        """
        metrics = [METRICS.create(name) for name in dict.fromkeys(self.metrics)]
        for metric in metrics:
            metric.require()
        condition = self.condition()
        return Objective(metrics if condition is None else [condition, *metrics], self.weights, self.pareto)

    def condition(self) -> CriticalIf | None:
        """Metric of the condition that says what is critical.

        Returns
        -------
        CriticalIf or None
            None without a condition.

        Raises
        ------
        InputError
            It is none, or what it needs is not installed.
        """
        if self.critical_if is None:
            return None
        found = CriticalIf.of(self.critical_if)
        found.require_parts()
        return found

    def criteria(self) -> list[Criterion]:
        """What has to be known to stop.

        Returns
        -------
        list of Criterion

        Raises
        ------
        InputError
            A text is no criterion.
        """
        return [Criterion.parse(text) for text in self.stop_when]

    def threshold(self, objective: Objective) -> float | None:
        """Oriented score up to which a scenario is critical.

        Parameters
        ----------
        objective : Objective

        Returns
        -------
        float or None
            None where nothing says it and nothing needs it.

        Raises
        ------
        InputError
            Nothing says it, but the optimizer, a criterion to stop or `most_repeats` needs it.
        """
        if self.stop_when or self.most_repeats is not None or "threshold" in optimizer_needs(self.optimizer):
            return objective.threshold(self.critical)
        return objective.known_threshold(self.critical)

    def meta(
        self,
        objective: Objective,
        settings: Mapping[str, object],
        elsewhere: Mapping[str, object] | None = None,
        *,
        study: Path = Path("study.db"),
    ) -> StudyMeta:
        """What a study of this exploration is about.

        Parameters
        ----------
        objective : Objective
        settings : mapping of str to object
            Those of the simulator.
        elsewhere : mapping of str to object, optional
            As `StudyMeta` has it.
        study : Path, optional
            Where it is, or will be, as it names the scenario file from there; by default in the current folder.

        Returns
        -------
        StudyMeta
        """
        threshold = self.threshold(objective)
        return StudyMeta(
            scenario=stored_path(self.logical.path, study),
            fingerprint=self.logical.fingerprint,
            space=self.logical.space,
            ego=self.ego,
            other=self.others[0] if len(self.others) == 1 else self.others,
            metrics=tuple(metric.name for metric in objective.metrics),
            optimizer=self.optimizer,
            # Its options may name files and programs.
            simulator=without_folders(self.simulator),
            settings=settings,
            critical=None if threshold is None else objective.flip(threshold),
            weights=dict(self.weights),
            pareto=self.pareto,
            seed=self.seed,
            budget=self.budget,
            batch=self.batch,
            asynchronous=self.asynchronous,
            repeats=self.repeats,
            most_repeats=self.most_repeats,
            audit=self.audit,
            elsewhere=elsewhere or {},
        )


def _driver(entity: str, driver: object) -> str | Driver:
    if isinstance(driver, str) and driver:
        return driver
    if not is_driver(driver):
        raise InputError(f"`drivers` {entity}={shown(driver)}: give the name of a driver, or an instance.")
    return driver
