"""Settings of an exploration: from the options of `explore`, or from a stored study."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final, cast

from cornercase._common.configurable import require_storable_options
from cornercase._common.errors import InputError
from cornercase._common.plugin_errors import is_built_in
from cornercase._common.text.sanitize import remove_folders
from cornercase._common.validation import check_mapping
from cornercase.drivers._resolve import DriverLike, check_drivers, may_be_named_in_file
from cornercase.drivers._serialization import (
    driver_command_option,
    format_driver,
    iter_driver_changes,
    require_storable_drivers,
)
from cornercase.exploration._explore_options import (
    CONFIG_OPTIONS,
    SEARCH_SETTINGS,
    ExplorationOptions,
    read_stored_options,
)
from cornercase.metrics import METRICS, CriticalIf, Expression, Metric, Stl
from cornercase.metrics._other_entities import ALL_OTHERS, resolve_others
from cornercase.metrics._own_metrics import StoredMetric, as_metric_tuple, name_or_own_metric, resolve_metrics
from cornercase.optimizers import OPTIMIZERS, Optimizer
from cornercase.optimizers._stored_optimizer import known_optimizer
from cornercase.scenario import ConcreteScenario, LogicalScenario, Value
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators import SIMULATORS, Simulator
from cornercase.simulators._base import COMMON_OPTIONS
from cornercase.simulators._common_options import select_declared_options, split_common_options
from cornercase.stop._stop_rules import StopCriterion, resolve_stop_rules
from cornercase.study import StudyFile, StudyMeta
from cornercase.study._critical_run_rates import MIN_DECISIVE_RUNS
from cornercase.study._import_recordings import IMPORTED_SIMULATOR
from cornercase.study._meta import MAX_AUDIT_FRACTION, metric_fields
from cornercase.study._objective import Objective
from cornercase.study._scenario_file import find_explored_scenario
from cornercase.study._stored_paths import format_stored_path

_NUMERIC_OPTION: Final = re.compile(r"\w+=(true|false|[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?)")
_NUMBER_WITH_UNIT: Final = re.compile(r"\s*[-+]?[\d.]+\s*[^\W\d]")
_SIMULATOR_HINT: Final = "give it again with `simulator`"


@dataclass(frozen=True)
class ExplorationConfig(ExplorationOptions):
    """Validated settings of an exploration; the fields are the options of `explore`.

    Some fields are normalized. `other` becomes a tuple if it has several names, and ``"*"`` becomes the names of all
    other entities. `max_repeats` becomes None if it equals `repeats`. `patience` counts rounds without an improvement.
    An improvement is a score at least as critical as the best so far; but the least critical value of the metric (cap)
    is an improvement only once. In a search without rounds, `batch` scenarios count as a round. Raises `InputError` for
    a wrong type, a value out of range or an invalid criterion.
    """

    logical: LogicalScenario

    def __post_init__(self) -> None:
        if not self.logical.space.parameters:
            raise InputError(
                f"{self.logical.path}: nothing is varied; give a `space` file, or `ranges` such as NAME=LOW:HIGH."
            )
        given = dict(vars(self))
        given["simulator"], common = split_common_options(self.simulator, given)
        given |= common
        if self.optimizer is not None:
            given["optimizer"] = _check_optimizer(self.optimizer)
        given["metrics"] = tuple(map(name_or_own_metric, as_metric_tuple(self.metrics)))
        criteria, max_seconds, patience = resolve_stop_rules(self.stop_when)
        given["stop_when"] = tuple(criteria)
        for name, limit in {"max_seconds": max_seconds, "patience": patience}.items():
            if limit is not None:
                given[name] = limit if given[name] is None else min(given[name], limit)
        if isinstance(self.critical, str) and _NUMBER_WITH_UNIT.match(self.critical) and self.metrics:
            raise self._make_threshold_unit_error()
        for name, option in CONFIG_OPTIONS.items():
            object.__setattr__(self, name, option.check(given[name]))
        all_entities = self.logical.scenario_file.entities if ALL_OTHERS in self.other else ()
        others = resolve_others(self.other, self.ego, all_entities)
        object.__setattr__(self, "other", others[0] if len(others) == 1 else others)
        if self.critical_if is not None:
            self._refuse_conflicts_with_condition()
        if self.audit > MAX_AUDIT_FRACTION:
            raise InputError(f"`audit` {self.audit:g}: give a fraction of the scenarios up to {MAX_AUDIT_FRACTION:g}.")
        object.__setattr__(self, "drivers", check_drivers(self.drivers))
        require_storable_drivers(self.drivers)
        object.__setattr__(self, "max_repeats", self._check_max_repeats())

    def _make_threshold_unit_error(self) -> InputError:
        metric = resolve_metrics(self.metrics)[0]
        example = f"{metric.name} {'<' if metric.lower_is_critical else '>'} {self.critical}"
        unit = "without a unit" if metric.unit == "1" else f"in {metric.unit}"
        return InputError(
            f"`critical` {self.critical!r}: give only a number, {unit} like {metric.name}; units are allowed only in a"
            f' condition, as in `critical_if` "{example}".'
        )

    @property
    def others(self) -> tuple[str, ...]:
        """Names of all entities that the ego is measured against."""
        return (self.other,) if isinstance(self.other, str) else tuple(self.other)

    def _refuse_conflicts_with_condition(self) -> None:
        """Raise `InputError` for arguments that contradict `critical_if`."""
        conflicts = {"critical": self.critical is not None, "weights": self.weights, "pareto": self.pareto}
        for name in filter(conflicts.get, conflicts):
            raise InputError(f"`critical_if` defines what is critical and what is searched for; leave `{name}` out.")
        for name, value in {"repeats": self.repeats, "max_repeats": self.max_repeats}.items():
            if value not in (None, 1):
                raise InputError(f"`critical_if` is evaluated on one run of each scenario; leave `{name}` out.")

    def _check_max_repeats(self) -> int | None:
        """Check `max_repeats`, the upper limit of runs per scenario, and return it; None if it equals `repeats`."""
        limit = self.max_repeats
        if limit in (None, self.repeats):
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
                f"`max_repeats` {limit}: fewer than {MIN_DECISIVE_RUNS} runs never show if a scenario is critical; give"
                f" {MIN_DECISIVE_RUNS} or more, or leave it out and set `repeats` to {limit}."
            )
        return limit

    def concrete_scenario(self, values: Mapping[str, Value], seed: int = 0) -> ConcreteScenario:
        """Return the concrete scenario with these values of the space, which are not checked again."""
        return ConcreteScenario(self.logical.path, dict(values), self.logical.file, seed)

    def require_entities(self) -> None:
        """Raise `InputError` if a setting names an entity that the scenario does not have.

        The error is also raised if the condition `critical_if` names the ego, since it can only name other entities.
        """
        self.logical.scenario_file.require_entity(self.ego, "ego")
        for other in self.others:
            self.logical.scenario_file.require_entity(other, "other")
        for entity in self.drivers:
            self.logical.scenario_file.require_entity(entity, "driven entity")
        if self.critical_if is not None:
            for entity in Expression.parse(self.critical_if, "condition").entities:
                if entity == self.ego:
                    raise InputError(f"`critical_if` {self.critical_if}: names the ego itself; name another entity.")
                self.logical.scenario_file.require_entity(entity, "one that collides in `critical_if`")
        for metric in resolve_metrics(self.metrics):
            for entity in metric.formula.entities if isinstance(metric, Stl) else ():
                self.logical.scenario_file.require_entity(entity, f"one that collides in the metric {metric.name}")

    def make_objective(self, metrics: Sequence[Metric] | None = None, *, needs_threshold: bool = False) -> Objective:
        """Create the objective of the search from metrics, weights, Pareto option and threshold.

        `metrics` replaces the metrics of the settings. Raises `InputError` if a metric is unknown or cannot be used, or
        if options contradict each other. A missing threshold is an error, too, if the optimizer, a stop criterion,
        `max_repeats` or the caller (`needs_threshold`) needs a threshold.
        """
        if metrics is None:
            metrics = resolve_metrics(self.metrics)
            for metric in metrics:
                metric.check_installed()
            condition = self.make_condition()
            metrics = metrics if condition is None else [condition, *metrics]
        needs_threshold |= bool(self.stop_when) or self.max_repeats is not None
        needs_threshold |= isinstance(self.optimizer, Optimizer) and "threshold" in self.optimizer.requires
        objective = Objective(metrics, self.weights, self.pareto)
        return objective.with_threshold(self.critical, is_required=needs_threshold)

    def make_condition(self) -> CriticalIf | None:
        """Create the metric for the condition `critical_if`; None without a condition."""
        if self.critical_if is None:
            return None
        condition = CriticalIf.from_text(self.critical_if)
        condition.condition.check_installed()
        return condition

    def require_metric_code(self) -> None:
        """Raise `InputError` if a metric is only described by a study, and its class is not known here."""
        for metric in as_metric_tuple(self.metrics):
            if isinstance(metric, StoredMetric):
                raise metric.make_missing_class_error()

    @property
    def stop_criteria(self) -> tuple[StopCriterion, ...]:
        """The criteria in `stop_when`, as objects."""
        return cast(tuple[StopCriterion, ...], self.stop_when)

    @cached_property
    def search(self) -> Optimizer:
        """The given optimizer; by default `auto` if there is a threshold or a condition, otherwise `bayes`."""
        if self.optimizer is not None:
            return cast(Optimizer, self.optimizer)
        return OPTIMIZERS.create("bayes" if self.make_objective().criterion is None else "auto")

    def with_stored_optimizer(self, study: Path) -> ExplorationConfig:
        """Return the configuration with the optimizer of `study`, if none was given and this study exists."""
        stored, metrics = "none", tuple[str, ...]()
        if self.optimizer is None and study.exists():
            # Other faults of the file are reported when it is opened for writing.
            with suppress(InputError), StudyFile.open(study) as opened:
                stored, metrics = opened.meta.optimizer, opened.meta.metrics
        # Imported recordings and runs of suites were not searched.
        if stored == "none":
            return self
        config = replace(self, optimizer=known_optimizer(stored))
        if "threshold" in config.search.requires:
            # Other metrics may have no threshold. Then the error, reported later, is that the metrics do not fit.
            with suppress(InputError):
                if metric_fields(self.make_objective().metrics)["metrics"] != metrics:
                    return self
        return config

    def start_optimizer(self, objective: Objective) -> Optimizer:
        """Return a fresh optimizer that searches the space."""
        threshold = None if objective.criterion is None else objective.criterion.oriented
        return self.search.start(self.logical.space, self.seed, threshold=threshold, budget=self.budget)

    def optimizer_text(self, stored: str) -> str:
        """Return the optimizer as text; return `stored`, the text in a study, if it means the same optimizer."""
        text, name = str(self.search), stored.partition(":")[0]
        # A study may only create an optimizer that the user has named.
        if text != stored and text.partition(":")[0] == name and name in OPTIMIZERS:
            with suppress(InputError):
                return stored if OPTIMIZERS.create(stored) == self.search else text
        return text

    def make_study_meta(
        self,
        objective: Objective,
        settings: Mapping[str, object],
        warm_start_info: Mapping[str, object] | None = None,
        *,
        study: Path = Path("study.db"),
    ) -> StudyMeta:
        """Create the metadata of a new study of this exploration.

        The stored path of the scenario file is relative to `study`, the path of the study.
        """
        fields_of_study: dict[str, Any] = {
            str(option.stored): getattr(self, name)
            for name, option in CONFIG_OPTIONS.items()
            if option.is_field_of_study
        }
        fields_of_study["optimizer"] = str(self.search)
        return StudyMeta(
            scenario=format_stored_path(self.logical.path, study),
            fingerprint=self.logical.fingerprint,
            space=self.logical.space,
            other=self.others[0] if len(self.others) == 1 else self.others,
            # The options may contain paths of this machine.
            simulator=remove_folders(str(self.simulator)),
            settings={**self._stored_settings(), **settings},
            critical=objective.threshold,
            elsewhere=warm_start_info or {},
            **metric_fields(objective.metrics),
            **fields_of_study,
        )

    def _stored_settings(self) -> dict[str, object]:
        """Return the settings that the study stores besides those of the simulator; defaults are left out."""
        return {
            name: getattr(self, name)
            for name, option in CONFIG_OPTIONS.items()
            if option.stored == "settings" and getattr(self, name) != option.default
        }


def _check_optimizer(optimizer: str | Optimizer) -> Optimizer:
    """Return the optimizer as an object; `InputError` if a study cannot store the optimizer's name or options."""
    resolved = OPTIMIZERS.resolve(optimizer, "optimizer")
    OPTIMIZERS.check_name_not_taken(resolved)
    if not is_built_in(resolved):
        require_storable_options(resolved)
    return resolved


def config_from_study(
    study: StudyFile,
    file: Path,
    scenario: Path | str | ScenarioFile | None,
    simulator: str | Simulator | None,
    drivers: Mapping[str, DriverLike],
    metrics: Sequence[Metric | str] = (),
) -> ExplorationConfig:
    """Rebuild the configuration with which a study was explored.

    `file` is the path of the study, for messages. `scenario` is the explored file; by default the file is searched for.
    `simulator` replaces the simulator of the study. `drivers` are the user's own drivers by entity. `metrics` are all
    metrics of the study; they are needed if a metric is of the user's own class. Raises `InputError` if a file, driver
    or simulator is missing.
    """
    meta = study.meta
    logical = read_logical_scenario(study, scenario)
    resolved_drivers = _collect_study_drivers(meta, file, drivers)
    values = read_stored_options(meta) | {
        "metrics": metrics or read_study_metrics(meta),
        "optimizer": known_optimizer(meta.optimizer),
        "simulator": _read_simulator_text(meta, file) if simulator is None else simulator,
        "drivers": resolved_drivers,
        # Its scores are copied into the study.
        "warm_start": None,
    }
    return ExplorationConfig(logical, **{name: value for name, value in values.items() if value is not None})


def simulator_from_study(meta: StudyMeta, file: Path) -> Simulator:
    """Create a simulator from the name, settings and drivers that a study stores.

    `file` is the path of the study, for messages. Raises `InputError` if the simulator or a driver is the user's own
    code, or if an option of the simulator is a text, since a text could name a program.
    """
    name = _read_simulator_text(meta, file)
    if name != meta.simulator:
        raise InputError(
            f"{file}: was explored with '{meta.simulator[:100]}', whose options are not taken from a study, since texts"
            f" could name programs; {_SIMULATOR_HINT}."
        )
    options = {key: meta.settings.get(key) for key in COMMON_OPTIONS} | {"drivers": _collect_study_drivers(meta, file)}
    given = {key: value for key, value in options.items() if value not in (None, CONFIG_OPTIONS[key].default, {})}
    return SIMULATORS.create(name, **select_declared_options(name, SIMULATORS.get_class(name), given))


def _read_simulator_text(meta: StudyMeta, file: Path) -> str:
    """Return a study's simulator as text; with its options only if each is a number, true or false.

    Other texts could name a program.
    """
    name, _, options = meta.simulator.partition(":")
    if name == IMPORTED_SIMULATOR:
        raise InputError(f"{file}: contains imported recordings, so no further scenario can be run.")
    if name not in SIMULATORS:
        raise InputError(
            f"{file}: was explored with the simulator '{meta.simulator[:100]}', which is not installed here, or which"
            f" was defined in Python code; code that a study names is not run, so {_SIMULATOR_HINT}."
        )
    is_number = not SIMULATORS.takes_whole_text(name) and all(map(_NUMERIC_OPTION.fullmatch, options.split(",")))
    return meta.simulator if is_number else name


def _collect_study_drivers(
    meta: StudyMeta, file: Path, given: Mapping[str, DriverLike] | None = None
) -> dict[str, DriverLike]:
    """Return the drivers of a study by entity; take the user's own drivers from `given`: a study has only names."""
    drivers: dict[str, DriverLike] = dict(check_mapping("drivers", given or {}))
    for entity, driver in meta.drivers.items():
        # A study file must not make us import a module.
        if isinstance(driver, str) and may_be_named_in_file(driver):
            drivers.setdefault(entity, driver)
        elif entity not in drivers:
            command = driver_command_option(driver)
            # An object that no text describes is given as an object again.
            example = "" if command is None else f", as in {{{entity!r}: {command!r}}}"
            raise InputError(
                f"{file}: {format_driver(driver)} drove {entity}; code that a study names is not run, so give it again"
                f" with `drivers`{example}."
            )
    return drivers


def read_logical_scenario(study: StudyFile, scenario: Path | str | ScenarioFile | None) -> LogicalScenario:
    """Read the scenario that was explored; by default the file is searched for. `InputError` if it is not found."""
    if study.meta.suite:
        raise InputError(
            f"{study.path}: is the run of a suite, which has no search problem; give the study that was explored, or"
            " run the suite again with `Suite.run`."
        )
    source = find_explored_scenario(study, scenario, search_stored_path=True)
    if source is None:
        raise InputError(f"{study.path}: contains imported recordings, so no further scenario can be run.")
    return LogicalScenario(source.path, study.meta.space, study.meta.fingerprint, source)


def read_study_metrics(meta: StudyMeta) -> tuple[str | Metric, ...]:
    """Return the names of a study's metrics, without the metric of its condition.

    For a metric of unknown class, return an object with the stored description instead of the name.
    """
    names = meta.metrics[1:] if meta.condition else meta.metrics
    return tuple(name if name.partition(":")[0] in METRICS else meta.create_metric(name) for name in names)


def require_same_settings(study: Path, meta: StudyMeta, simulator: Simulator) -> None:
    """Raise `InputError` if simulator settings differ from those stored in the study."""
    own_settings: dict[str, Any] = dict(simulator.settings)
    different = [
        name
        for name in sorted({*own_settings, *meta.settings} - SEARCH_SETTINGS)
        if own_settings.get(name) != meta.settings.get(name)
    ]
    if different:
        changes = iter_driver_changes(meta.settings.get("drivers"), own_settings.get("drivers"))
        drivers = "".join(f"; {stored} drove {entity}, not {current}" for entity, stored, current, _ in changes)
        raise InputError(
            f"{study}: was explored with another {', '.join(different)}{drivers}; give the same `simulator`, with"
            " the same drivers, as to `explore`."
        )
