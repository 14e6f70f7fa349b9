"""The description of a study: scenario, parameter space, optimizer, simulator and settings."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase._common.text.sanitize import escape_control_characters, shorten
from cornercase._common.typing import FloatArray
from cornercase._common.version import __version__
from cornercase.drivers._serialization import format_driver, iter_driver_changes
from cornercase.metrics import METRICS, Metric
from cornercase.metrics._critical_if import find_critical_if_condition
from cornercase.metrics._own_metrics import StoredMetric, describe_own_metric
from cornercase.scenario import Parameter, ParameterSpace

_DIFFERENCE_TEXTS: Final = {
    "scenario": "another scenario",
    "fingerprint": "another version of the scenario file",
    "space": "other parameter ranges",
    "ego": "another ego",
    "other": "metrics against another entity",
    "metrics": "other metrics",
    "own_metrics": "another definition of a metric (class, unit, direction or cap)",
    "optimizer": "another optimizer",
    "weights": "other weights of the metrics",
    "pareto": "another objective",
    "seed": "another seed",
    "batch": "another batch size",
    "asynchronous": "another mode of search (in rounds or asynchronous)",
    "settings": "other simulator settings",
    "repeats": "another number of repeats",
    "most_repeats": "another largest number of repeats",
    "audit": "another share of audits",
    "elsewhere": "another warm start (another study, none, or one that has changed since)",
    "suite": "other files, or files that have changed since",
}

# Fields with values that are short enough for a message.
_COMPARED_VALUES: Final = ("ego", "other", "metrics", "optimizer", "seed", "batch", "repeats", "most_repeats", "audit")

_FIELD_TYPES: Final[dict[str, Any]] = (
    dict.fromkeys(
        ("scenario", "fingerprint", "ego", "driver_in_file", "optimizer", "simulator", "suite", "origin", "version"),
        str,
    )
    | dict.fromkeys(("seed", "budget", "batch", "repeats", "most_repeats"), int)
    | dict.fromkeys(("elsewhere", "own_metrics", "repeatability", "settings", "weights"), dict)
    | dict.fromkeys(("metrics", "files", "kinds", "requirements"), list)
    | {"other": (str, list), "critical": (int, float), "audit": (int, float), "pareto": bool, "asynchronous": bool}
)
# Largest number of characters of a setting in a message.
_MAX_SETTING_LENGTH: Final = 60
_DRIVERS_KEY: Final = "drivers"
# Keys that are only written if they are used.
_OPTIONAL_FIELDS: Final = (
    "asynchronous", "driver_in_file", "elsewhere", "kinds", "most_repeats", "origin", "own_metrics", "repeatability",
    "requirements", "suite",
)  # fmt: skip
_BOOLEAN_FIELDS: Final = ("asynchronous", "pareto")


MAX_AUDIT_FRACTION: Final = 0.5
"""Largest fraction of the scenarios of a study that may be audits."""


def count_audits(audit_fraction: float, n_scenarios: int) -> int:
    """Return how many of the first `n_scenarios` of a study are audits (scenarios drawn at random as a check).

    `audit_fraction` is the fraction of audits among all scenarios.
    """
    return math.floor(audit_fraction * n_scenarios + 1e-9)


def metric_fields(metrics: Iterable[Metric]) -> dict[str, Any]:
    """Return the values of the fields ``metrics`` and ``own_metrics`` of a `StudyMeta` for these metrics, by field."""
    described = {metric.name: describe_own_metric(metric) for metric in metrics}
    own = {name: description for name, description in described.items() if description is not None}
    return {"metrics": tuple(described), "own_metrics": own}


def hash_points_and_scores(points: FloatArray, scores: FloatArray) -> str:
    """Return the SHA-256 of points, shape (n, d), and their scores, shape (n,)."""
    return hashlib.sha256(points.astype("<f8").tobytes() + scores.astype("<f8").tobytes()).hexdigest()


@dataclass(frozen=True)
class StudyMeta:
    """The description of a study: everything that its content depends on.

    Attributes
    ----------
    scenario : str
        Path of the scenario file; for imported recordings and suites, path of their folder. The path is relative to the
        folder of the study. Only the name is stored if the path would reveal folders of the machine.
    fingerprint : str
        SHA-256 of the scenario file and all files that it uses, or of the table and the recordings of an import. For a
        suite, SHA-256 of the first scenario file that can be run, and all files that it uses.
    space : ParameterSpace
        The parameter space.
    ego : str
        Name of the entity under test.
    other : str or tuple of str
        Name of the entity that the ego is measured against; a tuple of names if there are several.
    metrics : tuple of str
        Names of the metrics; the first one is the objective.
    own_metrics : mapping of str to mapping
        Description of each metric whose class does not come with cornercase, by name, so that scores can be read
        without the class: ``class``, ``unit``, ``lower_is_critical``, ``cap`` and, if the metric has them, ``bound``,
        ``default_threshold``, ``contact_score`` and ``severity``. Empty without metrics of this kind.
    optimizer : str
        Name of the optimizer; ``"none"`` for imported recordings and suites.
    simulator : str
        Name of the simulator; ``"imported"`` for imported recordings.
    settings : mapping of str to object
        All other settings that affect the recordings, by name.
    critical : float or None
        Threshold of the objective; None if there is none.
    weights : mapping of str to float
        Weight of each metric if the objective is a weighted sum; empty if the objective is the first metric.
    pareto : bool
        Whether the Pareto front of all metrics is searched.
    seed, budget, batch : int
        Seed of the optimizer, number of scenarios in total, and number of scenarios per round.
    repeats : int
        Number of runs of each scenario.
    most_repeats : int or None
        Largest number of runs of a scenario. More than `repeats` runs are made while it is undecided whether the
        scenario is critical. None if each scenario has `repeats` runs.
    audit : float
        Fraction of scenarios that are audits: drawn at random as a check, with results hidden from the search.
    asynchronous : bool
        Whether the optimizer proposes the next scenario as soon as one has ended, instead of in rounds.
    elsewhere : mapping of str to object
        The earlier study of a warm start: its file name (``study``), ``fingerprint``, ``simulator``, ``settings``,
        number of ``scenarios``, and the ``sha256`` of their points and scores. Empty without a warm start.
    repeatability : mapping of str to object
        Result of running one scenario twice: the id of the scenario (``scenario``), and whether both recordings have
        the ``same`` bytes. If the recordings differ, ``apart`` is the largest distance in m between the positions of an
        entity in both (None if unknown). ``random`` is True if sensors are random, so that runs with other seeds
        differ; otherwise there is no such key. Empty if no scenario was run twice.
    files : tuple of str
        Files of imported recordings, or scenario files of a suite, in the order of scenario ids.
    kinds : tuple of str
        Name of the cluster that each scenario of a suite represents, in the order of scenario ids; empty if unknown.
    requirements : tuple of str
        Requirements on the scenarios of a suite, as texts for `cornercase.suite.Requirement.parse`.
    suite : str
        SHA-256 of the scenario files of a suite and all files that they use; empty if the study is not of a suite.
    origin : str
        `fingerprint` of the study that a suite was selected from; empty if there is none.
    version : str
        Version of cornercase that created the study.
    driver_in_file : str or None
        Driver that the scenario file names for the ego. Empty if the file names no driver, so that the ego follows the
        storyboard unless a driver is given. None if unknown, as for all simulators but the builtin one.

    Examples
    --------
    >>> from cornercase.study import StudyFile
    >>> with StudyFile.open("study.db") as study:  # doctest: +SKIP
    ...     print(study.meta.ego, study.meta.metrics, study.meta.optimizer, study.meta.budget)
    Ego ('wttc',) sobol 200
    """

    scenario: str
    fingerprint: str
    space: ParameterSpace
    ego: str
    other: str | tuple[str, ...]
    metrics: tuple[str, ...]
    optimizer: str
    simulator: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    critical: float | None = None
    weights: Mapping[str, float] = field(default_factory=dict)
    pareto: bool = False
    seed: int = 0
    budget: int = 0
    batch: int = 0
    repeats: int = 1
    most_repeats: int | None = None
    audit: float = 0.0
    asynchronous: bool = False
    elsewhere: Mapping[str, Any] = field(default_factory=dict)
    own_metrics: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    repeatability: Mapping[str, Any] = field(default_factory=dict)
    files: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()
    requirements: tuple[str, ...] = ()
    suite: str = ""
    origin: str = ""
    version: str = __version__
    driver_in_file: str | None = None

    @property
    def others(self) -> tuple[str, ...]:
        """Names of all entities that the ego is measured against."""
        return (self.other,) if isinstance(self.other, str) else self.other

    def create_metric(self, name: str) -> Metric:
        """Return a metric of the study, for reading its stored scores and courses.

        Parameters
        ----------
        name : str
            One of `metrics`.

        Returns
        -------
        Metric
            If the class of the metric does not come with cornercase, a metric made from its description in the study,
            which cannot evaluate recordings.

        Raises
        ------
        InputError
            There is no such metric.
        """
        description = self.own_metrics.get(name)
        return METRICS.create(name) if description is None else StoredMetric(name, description)

    def create_metrics(self) -> tuple[Metric, ...]:
        """Return all metrics of the study, each as `create_metric` returns it.

        Returns
        -------
        tuple of Metric
        """
        return tuple(map(self.create_metric, self.metrics))

    @property
    def objective_metrics(self) -> tuple[str, ...]:
        """Metrics whose scores the optimizer gets; empty without optimizer (imported recordings and suites)."""
        if self.optimizer == "none":
            return ()
        if self.pareto:
            return self.metrics
        return tuple(name for name in self.metrics if name in self.weights) if self.weights else self.metrics[:1]

    @property
    def condition(self) -> str:
        """Condition under which a scenario is critical, such as ``"collision"``; empty if a threshold decides."""
        return find_critical_if_condition(self.metrics)

    @property
    def repeats_text(self) -> str:
        """Text that says how many times each scenario is run, such as ``"3"`` or ``"3 to 10"``."""
        return str(self.repeats) if self.most_repeats is None else f"{self.repeats} to {self.most_repeats}"

    @property
    def file_name(self) -> str:
        """Name of the scenario file (for a suite, of the first file) or of the folder of imported recordings."""
        return _base_name(self.files[0] if self.suite and self.files else self.scenario)

    @property
    def nondeterminism_text(self) -> str:
        """Text that says how two runs of the same scenario differ; empty if no difference is known."""
        if self.repeatability.get("same", True):
            return ""
        distance = self.repeatability.get("apart")
        difference = (
            f"in its recordings entities are up to {distance:.3g} m apart"
            if distance
            else "more than positions differs"
        )
        return f"scenario {self.repeatability['scenario']} was run twice, and {difference}"

    @property
    def may_draw_random_numbers(self) -> bool:
        """True if recordings may depend on the seed: sensors are random, or a driver is the user's own class."""
        given = (driver.get("driver") for driver in self.drivers.values() if isinstance(driver, Mapping))
        return bool(self.repeatability.get("random")) or any(":" in str(name) for name in given)

    @property
    def drivers(self) -> dict[str, Any]:
        """Drivers that the user gave, by entity, each as a text or as a dict of its settings."""
        return dict(self.settings.get(_DRIVERS_KEY, {}))

    @property
    def ego_driver(self) -> Any:
        """Driver of the ego, from the user or else from the scenario file; empty text if none, None if unknown."""
        return self.drivers.get(self.ego, self.driver_in_file)

    @property
    def roles_text(self) -> str:
        """Sentences that name the ego and its driver, the other entities, and the simulator."""
        who, others = self.ego, self.others
        if driver := self.ego_driver:
            who += f", driven by {format_driver(driver)}"
        elif driver == "":
            who += f", which follows the storyboard and does not react (--driver {self.ego}=normal drives it)"
        against = (
            f"{others[0]}."
            if len(others) == 1
            else f"{', '.join(others[:-1])} and {others[-1]}; the most critical counts."
        )
        sentences = [f"Under test: {who}, against {against}"]
        if self.simulator != "imported":
            sentences.append(f"Simulator: {self.simulator}, cornercase {self.version}.")
        return " ".join(sentences)

    @property
    def title(self) -> str:
        """Name of the scenario file or recordings folder without its ending; for a suite, the name of its folder."""
        name = _base_name(self.scenario)
        return name if self.suite else Path(name).stem

    def to_json(self) -> dict[str, Any]:
        """Return the description as values that JSON can store.

        Returns
        -------
        dict of str to object
            Value by field name; None stands for an empty or default value.
        """
        # These keys are only written if the study uses them.
        is_written = {
            "asynchronous": self.asynchronous,
            "driver_in_file": self.driver_in_file is not None,
            "elsewhere": bool(self.elsewhere),
            "most_repeats": self.most_repeats is not None,
            "own_metrics": bool(self.own_metrics),
            "repeatability": bool(self.repeatability),
        }
        names = [field_.name for field_ in fields(self) if is_written.get(field_.name, True)]
        return {name: getattr(self, name) for name in names} | {
            "space": self.space.to_json(),
            "other": self.other if isinstance(self.other, str) else list(self.other),
            "metrics": list(self.metrics),
            "settings": dict(self.settings),
            "weights": dict(self.weights) or None,
            "pareto": self.pareto or None,
            "repeats": self.repeats if self.repeats > 1 else None,
            "audit": self.audit or None,
            "files": list(self.files) or None,
            "kinds": list(self.kinds) or None,
            "requirements": list(self.requirements) or None,
            "suite": self.suite or None,
            "origin": self.origin or None,
        }

    def is_audit(self, scenario: int) -> bool:
        """Return whether a scenario is an audit, drawn at random as a check; audits are spread evenly over the ids.

        Parameters
        ----------
        scenario : int
            Id of the scenario.

        Returns
        -------
        bool
        """
        return count_audits(self.audit, scenario) > count_audits(self.audit, scenario - 1)

    @classmethod
    def from_json(cls, description: Mapping[str, Any]) -> StudyMeta:
        """Make a description from the result of `to_json`.

        Parameters
        ----------
        description : mapping of str to object

        Returns
        -------
        StudyMeta

        Raises
        ------
        ValueError, LookupError, TypeError, AttributeError or OverflowError
            The values do not describe a study.
        """
        # Empty and default values are stored as None.
        names = [item.name for item in fields(cls) if item.name in description or item.name not in _OPTIONAL_FIELDS]
        values = {name: description[name] for name in names if description[name] is not None}
        for name, value in values.items():
            if name in _FIELD_TYPES and (
                not isinstance(value, _FIELD_TYPES[name]) or isinstance(value, bool) != (name in _BOOLEAN_FIELDS)
            ):
                raise ValueError(f"its field {name} has the invalid value {str(value)[:60]!r}")
        if isinstance(values["other"], list):
            values["other"] = _require_distinct_names(values["other"])
        for name in ("metrics", "files", "kinds", "requirements"):
            if not all(isinstance(item, str) for item in values.get(name, ())):
                raise ValueError(f"its field {name} is not a list of texts")
        if not values["metrics"] or not all(
            isinstance(item, int | float) for item in values.get("weights", {}).values()
        ):
            raise ValueError("it has no metrics, or weights that are not numbers")
        numbers = (values.get("critical", 0.0), *values.get("weights", {}).values())
        if not all(math.isfinite(float(item)) for item in numbers):
            raise ValueError("its threshold or a weight of its metrics is not finite")
        names = values.get("elsewhere", {})
        if names and not all(isinstance(names.get(key), str) for key in ("sha256", "simulator", "study")):
            raise ValueError("its warm start is invalid")
        if (repeatability := values.get("repeatability")) and not _is_repeatability_valid(repeatability):
            raise ValueError("its repeatability is invalid")
        for name, own_metric in values.get("own_metrics", {}).items():
            StoredMetric(name, own_metric)
        if values.get("most_repeats", math.inf) <= values.get("repeats", 1):
            raise ValueError("its most_repeats is not greater than its repeats")
        if not 0.0 <= values.get("audit", 0.0) <= MAX_AUDIT_FRACTION:
            raise ValueError(f"its audit is not a fraction from 0 to {MAX_AUDIT_FRACTION:g}")
        if not isinstance(values.get("settings", {}).get("drivers", {}), dict):
            raise ValueError("its drivers are not a mapping")
        values |= {
            name: tuple(values[name]) for name in ("metrics", "files", "kinds", "requirements") if name in values
        }
        return cls(**values | {"space": ParameterSpace.from_json(description["space"])})

    def require_resumable(self, other: StudyMeta, path: Path, *, same_budget: bool = False) -> None:
        """Raise `InputError` unless a study with this description can be continued with the description `other`.

        The budget may change, unless `same_budget` is True. Files and simulator may be in another place. A threshold
        may be added if the study has none. Requirements, cluster names and origin of a suite may change.

        Parameters
        ----------
        other : StudyMeta
            Description to continue with.
        path : Path
            Path of the study, for messages.
        same_budget : bool, default False
            Whether the budget has to be the same, because the optimizer depends on the budget.

        Raises
        ------
        InputError
            The descriptions differ in any other way.
        """
        if self.suite and other.suite and self.suite != other.suite:
            raise InputError(
                f"{path}: holds other scenarios than the folder, because files were added, removed or changed; name"
                " another study with `study`."
            )
        for name, description in _DIFFERENCE_TEXTS.items():
            mine, theirs_value = getattr(self, name), getattr(other, name)
            if name == "scenario" and self.fingerprint == other.fingerprint:
                continue
            if name == "space":
                # Constraints of the space follow from the scenario file.
                ours, theirs = mine.parameters, theirs_value.parameters
                mine, theirs_value = _fill_missing_units(ours, theirs), _fill_missing_units(theirs, ours)
            if name == "elsewhere":
                # The file may have moved; its scores must be the same.
                mine, theirs_value = mine.get("sha256"), theirs_value.get("sha256")
            if name == "metrics" and self.condition != other.condition:
                description = "another condition of what is critical"
            if mine != theirs_value:
                if name == "settings":
                    _require_same_driver_files(mine, theirs_value, path)
                    description += f" ({_describe_setting_differences(mine, theirs_value)})"
                elif name in _COMPARED_VALUES:
                    description += f" ({_describe_difference(mine, theirs_value)})"
                raise InputError(
                    f"{path}: belongs to {description}; name another study with `study`, or give the same options."
                )
        # The address may change; the settings hold everything that recordings depend on.
        if self.simulator.partition(":")[0] != other.simulator.partition(":")[0]:
            raise InputError(
                f"{path}: belongs to another simulator; name another study with `study`, or give the same `simulator`."
            )
        if self.critical not in (None, other.critical):
            raise InputError(
                f"{path}: belongs to a search with the threshold {self.critical:g}; name another study with"
                " `study`, or give the same `critical`."
            )
        if same_budget and self.budget != other.budget:
            raise InputError(
                f"{path}: its optimizer planned for a budget of {self.budget} scenarios; give the same `budget`."
            )


def _is_repeatability_valid(values: Mapping[str, Any]) -> bool:
    """Return whether a mapping has the entries and types of `StudyMeta.repeatability`."""
    distance, scenario = values.get("apart"), values.get("scenario")
    return (
        isinstance(values.get("same"), bool)
        and isinstance(scenario, int)
        and (distance is None or (isinstance(distance, int | float) and math.isfinite(distance)))
    )


def _fill_missing_units(parameters: tuple[Parameter, ...], reference: tuple[Parameter, ...]) -> tuple[Parameter, ...]:
    """Give each parameter without a unit the unit that the same parameter has in `reference`.

    Ranges that the user gives as options have no units, but are the same parameters, since units do not change values.
    """
    units = {parameter.name: parameter.unit for parameter in reference}
    return tuple(replace(parameter, unit=parameter.unit or units.get(parameter.name, "")) for parameter in parameters)


def _require_distinct_names(names: list[Any]) -> tuple[str, ...]:
    if len(names) < 2 or not all(isinstance(name, str) for name in names) or len(set(names)) < len(names):
        raise ValueError(f"its field other is {str(names)[:60]}, and not a list of at least two different names")
    return tuple(names)


def _base_name(path: str) -> str:
    # The path may have been written on Windows.
    return re.split(r"[\\/]", path.rstrip("\\/"))[-1]


def _require_same_driver_files(stored_settings: Mapping[str, Any], new_settings: Mapping[str, Any], path: Path) -> None:
    """Raise `InputError` if settings differ only in drivers' files: a study must hold runs of one version of a driver.

    If the settings differ in anything else, nothing is raised: the caller then describes all differences.
    """
    if {**stored_settings, _DRIVERS_KEY: None} != {**new_settings, _DRIVERS_KEY: None}:
        return
    changes = list(iter_driver_changes(stored_settings.get(_DRIVERS_KEY), new_settings.get(_DRIVERS_KEY)))
    for entity, stored, current, only_file in changes:
        if only_file and all(change[-1] for change in changes):
            raise InputError(
                f"{path}: the file of the driver of {entity} has changed since the study was made"
                f" ({escape_control_characters(stored)} in the study,"
                f" {escape_control_characters(current)} given), but a study holds runs of only one version of a driver;"
                " name another study with `study`, or restore the file."
            )


def _describe_setting_differences(stored_settings: Mapping[str, Any], new_settings: Mapping[str, Any]) -> str:
    """Describe the settings that differ, with the stored and the new value; long values are shortened."""
    texts = []
    for name in sorted({*stored_settings, *new_settings}):
        if name == _DRIVERS_KEY:
            texts += [
                f"driver of {entity}: {escape_control_characters(stored)} in the study,"
                f" {escape_control_characters(current)} given"
                for entity, stored, current, _ in iter_driver_changes(stored_settings.get(name), new_settings.get(name))
            ]
        elif stored_settings.get(name) != new_settings.get(name):
            texts.append(f"{name}: {_describe_difference(stored_settings.get(name), new_settings.get(name))}")
    return "; ".join(texts)


def _describe_difference(stored: object, given: object) -> str:
    texts = []
    for value in (stored, given):
        text = "none" if value is None else ", ".join(map(str, value)) if isinstance(value, tuple) else str(value)
        texts.append(shorten(escape_control_characters(text), _MAX_SETTING_LENGTH))
    return f"{texts[0]} in the study, {texts[1]} given"
