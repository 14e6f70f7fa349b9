"""Settings of an exploration, also as a stored study was explored with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from cornercase._common.errors import InputError
from cornercase._common.process.dask import check_cluster
from cornercase._common.text.sanitize import remove_folders
from cornercase._common.validation import (
    check_bool,
    check_float,
    check_int,
    check_mapping,
    check_path,
    check_str,
    check_str_sequence,
    repr_short,
)
from cornercase.drivers import Driver
from cornercase.drivers._description import driver_command_option, format_driver, iter_driver_changes
from cornercase.drivers._resolve import create_driver_named_in_file, is_driver
from cornercase.exploration.stop._stop_rules import StopCriterion, StopRule, resolve_stop_rules
from cornercase.metrics import METRICS, CriticalIf
from cornercase.metrics._other_entities import ALL_OTHERS, resolve_others
from cornercase.metrics.formulas._critical_if import find_critical_if_condition
from cornercase.optimizers import OPTIMIZERS, Optimizer
from cornercase.scenario import LogicalScenario
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators import Simulator
from cornercase.simulators._common_options import split_common_options
from cornercase.simulators.pool._simulator import DEFAULT_MAX_FAILURES, MAX_WORKERS
from cornercase.study import StudyFile, StudyMeta
from cornercase.study._criterion import Criterion
from cornercase.study._meta import MAX_AUDIT_FRACTION
from cornercase.study._objective import Objective
from cornercase.study._run_rates import MIN_DECISIVE_RUNS
from cornercase.study._scenario_file import find_explored_scenario
from cornercase.study._stored_paths import stored_path

if TYPE_CHECKING:
    from distributed import Client

# Minimum of each integer setting.
_MINIMUM_OF_SETTING: Final = {
    "budget": 1,
    "batch": 1,
    "patience": 1,
    "seed": 0,
    "retries": 0,
    "max_failures": 0,
    "repeats": 1,
}


@dataclass(frozen=True)
class ExplorationConfig:
    """Validated settings of an exploration; the fields are the parameters of `explore`.

    `other` becomes a tuple if it has several names, and ``"*"`` becomes the names of all others. `max_repeats` becomes
    None if it equals `repeats`. Without rounds, `patience` and the stop criteria are evaluated after every `batch`
    results. `patience` counts rounds without a score at least as critical as the best so far; a score at the metric's
    cap is an improvement only once. Raises `InputError` for a wrong type, a value out of range or an invalid criterion.
    """

    logical: LogicalScenario
    ego: str
    other: str | Sequence[str]
    metrics: tuple[str, ...]
    optimizer: str | Optimizer = "bayes"
    critical: float | None = None
    critical_if: str | None = None
    weights: Mapping[str, float] = field(default_factory=dict)
    pareto: bool = False
    stop_when: StopRule | Sequence[StopRule | str] = ()
    budget: int = 200
    batch: int = 10
    asynchronous: bool = False
    patience: int | None = None
    max_seconds: float | None = None
    seed: int = 0
    simulator: str | Simulator = "builtin"
    workers: int = 1
    cluster: str | Client | None = None
    timeout: float | None = None
    retries: int = 1
    max_failures: int = DEFAULT_MAX_FAILURES
    repeats: int = 1
    max_repeats: int | None = None
    audit: float = 0.0
    time_step: float = 0.05
    duration: float = 60.0
    on_collision: str = "continue"
    drivers: Mapping[str, str | Driver] = field(default_factory=dict)
    warm_start: Path | str | None = None

    def __post_init__(self) -> None:
        arguments = dict(vars(self))
        simulator, options = split_common_options(self.simulator, arguments)
        arguments |= options
        checked: dict[str, object] = {"ego": check_str("ego", self.ego), "simulator": simulator}
        checked["optimizer"] = OPTIMIZERS.resolve(self.optimizer, "optimizer")
        all_entities = (
            self.logical.scenario_file.entities if ALL_OTHERS in check_str_sequence("other", self.other) else ()
        )
        others = resolve_others(self.other, check_str("ego", self.ego), all_entities)
        checked["other"] = others[0] if len(others) == 1 else others
        if self.critical_if is not None:
            checked["critical_if"] = check_str("critical_if", self.critical_if)
            self._refuse_conflicts_with_condition()
        checked["metrics"] = check_str_sequence("metrics", self.metrics)
        criteria, max_seconds, patience = resolve_stop_rules(self.stop_when)
        checked["stop_when"] = tuple(criteria)
        for name, limit in {"max_seconds": max_seconds, "patience": patience}.items():
            if limit is not None:
                arguments[name] = limit if arguments[name] is None else min(arguments[name], limit)
        checked |= {
            name: check_int(name, arguments[name], least)
            for name, least in _MINIMUM_OF_SETTING.items()
            if not (name == "patience" and arguments[name] is None)
        }
        checked["workers"] = check_int("workers", self.workers, 1, MAX_WORKERS)
        checked |= {name: check_bool(name, arguments[name]) for name in ("asynchronous", "pareto")}
        checked["on_collision"] = check_str("on_collision", self.on_collision, ("continue", "stop"))
        checked |= {name: check_float(name, arguments[name], above=0.0) for name in ("time_step", "duration")}
        checked["audit"] = check_float("audit", self.audit, minimum=0.0)
        if self.audit > MAX_AUDIT_FRACTION:
            raise InputError(f"`audit` {self.audit:g}: give a fraction of the scenarios up to {MAX_AUDIT_FRACTION:g}.")
        if self.critical is not None:
            checked["critical"] = check_float("critical", self.critical)
        if self.warm_start is not None:
            checked["warm_start"] = check_path("warm_start", self.warm_start)
        if self.cluster is not None:
            checked["cluster"] = check_cluster(self.cluster)
        if arguments["max_seconds"] is not None:
            checked["max_seconds"] = check_float("max_seconds", arguments["max_seconds"], minimum=0.0)
        if self.timeout is not None:
            checked["timeout"] = check_float("timeout", self.timeout, above=0.0)
        weights = check_mapping("weights", self.weights)
        checked["weights"] = {name: check_float("weights", weight) for name, weight in weights.items()}
        checked["drivers"] = {
            name: _check_driver(name, driver) for name, driver in check_mapping("drivers", arguments["drivers"]).items()
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        object.__setattr__(self, "max_repeats", self._checked_max_repeats())

    @property
    def others(self) -> tuple[str, ...]:
        """Names of all entities that the ego is measured against."""
        return (self.other,) if isinstance(self.other, str) else tuple(self.other)

    def _refuse_conflicts_with_condition(self) -> None:
        """Refuse arguments that contradict `critical_if`."""
        conflicts = {"critical": self.critical is not None, "weights": self.weights, "pareto": self.pareto}
        for name in filter(conflicts.get, conflicts):
            raise InputError(f"`critical_if` already defines what is critical and searched; leave `{name}` out.")
        for name, value in {"repeats": self.repeats, "max_repeats": self.max_repeats}.items():
            if value not in (None, 1):
                raise InputError(f"`critical_if` is evaluated on one run of each scenario; leave `{name}` out.")

    def _checked_max_repeats(self) -> int | None:
        """Return the checked upper limit of runs per scenario; None if it equals `repeats`."""
        if self.max_repeats is None:
            return None
        limit = check_int("max_repeats", self.max_repeats, 1)
        if limit == self.repeats:
            return None
        if self.pareto or self.weights:
            other = "pareto" if self.pareto else "weights"
            raise InputError(
                f"`max_repeats` {limit}: needs a single metric to decide if a run is critical; leave out `{other}`."
            )
        if self.repeats == 1:
            raise InputError(
                f"`max_repeats` {limit}: only applies if scenarios are repeated; set `repeats` to 2 or more."
            )
        if limit < self.repeats:
            raise InputError(f"`max_repeats` {limit}: is less than `repeats` {self.repeats}; give a larger number.")
        if limit < MIN_DECISIVE_RUNS:
            raise InputError(
                f"`max_repeats` {limit}: fewer than {MIN_DECISIVE_RUNS} runs never decide a scenario; give"
                f" {MIN_DECISIVE_RUNS} or more, or only `repeats` {limit}."
            )
        return limit

    def require_entities(self) -> None:
        """Raise `InputError` if the ego, another or a driven entity is not in the scenario."""
        self.logical.scenario_file.require_entity(self.ego, "ego")
        for other in self.others:
            self.logical.scenario_file.require_entity(other, "other")
        for entity in self.drivers:
            self.logical.scenario_file.require_entity(entity, "driven entity")

    def make_objective(self) -> Objective:
        """Create the objective; `InputError` if a metric is unknown or unavailable, or weights and front do not fit."""
        metrics = [METRICS.create(name) for name in dict.fromkeys(self.metrics)]
        for metric in metrics:
            metric.check_installed()
        condition = self.make_condition()
        return Objective(metrics if condition is None else [condition, *metrics], self.weights, self.pareto)

    def make_condition(self) -> CriticalIf | None:
        """Create the metric of `critical_if`; None without a condition."""
        if self.critical_if is None:
            return None
        condition = CriticalIf.from_text(self.critical_if)
        condition.check_parts_installed()
        return condition

    def parse_stop_criteria(self) -> list[StopCriterion]:
        """Parse the criteria of `stop_when`."""
        return resolve_stop_rules(self.stop_when)[0]

    def make_criterion(self, objective: Objective | None = None) -> Criterion:
        """Create the objective, unless it is given, and its threshold.

        Raises `InputError` if there is no threshold but the optimizer, a stop criterion or `max_repeats` needs it.
        """
        is_required = bool(self.stop_when) or self.max_repeats is not None
        is_required |= "threshold" in OPTIMIZERS.get_class(self.optimizer).requires
        return Criterion.from_given(objective or self.make_objective(), self.critical, is_required=is_required)

    def make_study_meta(
        self,
        criterion: Criterion,
        settings: Mapping[str, object],
        warm_start_info: Mapping[str, object] | None = None,
        *,
        study: Path = Path("study.db"),
    ) -> StudyMeta:
        """Create the metadata of a study of this exploration.

        `study` is the path of the study, from which the scenario file is named.
        """
        return StudyMeta(
            scenario=stored_path(self.logical.path, study),
            fingerprint=self.logical.fingerprint,
            space=self.logical.space,
            ego=self.ego,
            other=self.others[0] if len(self.others) == 1 else self.others,
            metrics=tuple(metric.name for metric in criterion.objective.metrics),
            optimizer=str(self.optimizer),
            # The options may contain paths of this machine.
            simulator=remove_folders(str(self.simulator)),
            settings=settings,
            critical=criterion.raw,
            weights=dict(self.weights),
            pareto=self.pareto,
            seed=self.seed,
            budget=self.budget,
            batch=self.batch,
            asynchronous=self.asynchronous,
            repeats=self.repeats,
            most_repeats=self.max_repeats,
            audit=self.audit,
            elsewhere=warm_start_info or {},
        )


def _check_driver(entity: str, driver: object) -> str | Driver:
    if isinstance(driver, str) and driver:
        return driver
    if not is_driver(driver):
        raise InputError(f"`drivers` {entity}={repr_short(driver)}: give the name of a driver, or an instance.")
    return driver


def config_from_study(
    study: StudyFile,
    file: Path,
    scenario: Path | str | ScenarioFile | None,
    simulator: str | Simulator | None,
    drivers: Mapping[str, str | Driver],
) -> ExplorationConfig:
    """Rebuild the configuration that a study was explored with.

    `file` is the study in messages, `scenario` the explored file (None: search for it), `simulator` None for the
    study's own without options, `drivers` the user's own drivers by entity. Raises `InputError` if a file or driver is
    missing.
    """
    meta, settings = study.meta, study.meta.settings
    source = find_explored_scenario(study, scenario, search_stored_path=True)
    if source is None:
        raise InputError(f"{file}: contains imported recordings, so no further scenario can be run.")
    resolved_drivers: dict[str, str | Driver] = dict(check_mapping("drivers", drivers))
    for entity, driver in settings.get("drivers", {}).items():
        # A study file must not make us import a module.
        if isinstance(driver, str) and _is_safe_driver_name(driver):
            resolved_drivers.setdefault(entity, driver)
        elif entity not in resolved_drivers:
            command = driver_command_option(driver)
            hint = "give it again" if command is None else f"give it again with `drivers` {entity}={command}"
            raise InputError(
                f"{file}: {format_driver(driver)} drove {entity}; code that a study names is not run, so {hint}."
            )
    run_settings: dict[str, Any] = {
        name: settings[name] for name in ("time_step", "duration", "on_collision") if name in settings
    }
    condition = find_critical_if_condition(meta.metrics)
    return ExplorationConfig(
        logical=LogicalScenario(source.path, meta.space, meta.fingerprint, source),
        ego=meta.ego,
        other=meta.other,
        metrics=tuple(name for name in meta.metrics if not find_critical_if_condition([name])),
        optimizer=meta.optimizer,
        critical=None if condition else meta.critical,
        critical_if=condition or None,
        weights=meta.weights,
        pareto=meta.pareto,
        budget=meta.budget,
        batch=meta.batch,
        asynchronous=meta.asynchronous,
        seed=meta.seed,
        repeats=meta.repeats,
        max_repeats=meta.most_repeats,
        audit=meta.audit,
        simulator=meta.simulator.partition(":")[0] if simulator is None else simulator,
        drivers=resolved_drivers,
        **run_settings,
    )


def _is_safe_driver_name(driver: str) -> bool:
    """Return whether a stored driver name may be resolved without running foreign code."""
    try:
        create_driver_named_in_file(driver)
    except InputError:
        return False
    return True


def require_same_settings(study: Path, meta: StudyMeta, simulator: Simulator) -> None:
    """Raise `InputError` if the settings of a simulator differ from those stored in the study."""
    own_settings: dict[str, Any] = dict(simulator.settings)
    different = [
        name for name in sorted({*own_settings, *meta.settings}) if own_settings.get(name) != meta.settings.get(name)
    ]
    if different:
        changes = iter_driver_changes(meta.settings.get("drivers"), own_settings.get("drivers"))
        drivers = "".join(f"; {stored} drove {entity}, not {current}" for entity, stored, current, _ in changes)
        raise InputError(
            f"{study}: was explored with another {', '.join(different)}{drivers}; give the same `simulator` and"
            " `drivers` as to `explore`."
        )
