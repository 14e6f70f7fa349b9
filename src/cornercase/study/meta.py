"""What a study is about."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase._common.texts import plain_text, shorten
from cornercase._common.version import __version__
from cornercase.drivers import driver_changes
from cornercase.metrics import condition_of
from cornercase.scenario import Parameter, ParameterSpace

_DIFFERENT: Final = {
    "scenario": "another scenario",
    "fingerprint": "another version of the scenario file",
    "space": "other parameter ranges",
    "ego": "another ego",
    "other": "metrics against another entity",
    "metrics": "other metrics",
    "optimizer": "another optimizer",
    "weights": "other weights of the metrics",
    "pareto": "another objective",
    "seed": "another seed",
    "batch": "another batch size",
    "asynchronous": "another kind of search, in rounds or asynchronous",
    "settings": "other simulator settings",
    "repeats": "another number of repeats",
    "most_repeats": "another largest number of repeats",
    "audit": "another share of audits",
    "elsewhere": "a search that began from another study, from none, or from one that has changed since",
    "suite": "other files, or files that have changed since",
}


_TYPES: Final[dict[str, Any]] = (
    dict.fromkeys(("scenario", "fingerprint", "ego", "optimizer", "simulator", "suite", "origin", "version"), str)
    | dict.fromkeys(("seed", "budget", "batch", "repeats", "most_repeats"), int)
    | dict.fromkeys(("elsewhere", "repeatability", "settings", "weights"), dict)
    | dict.fromkeys(("metrics", "files", "kinds", "requirements"), list)
    | {"other": (str, list), "critical": (int, float), "audit": (int, float), "pareto": bool, "asynchronous": bool}
)
# Characters of a setting in a message.
_LONGEST_SETTING: Final = 60
_DRIVERS: Final = "drivers"
# What only later versions write.
_LATER: Final = (
    "asynchronous", "elsewhere", "kinds", "most_repeats", "origin", "repeatability", "requirements", "suite",
)  # fmt: skip
_YES_OR_NO: Final = ("asynchronous", "pareto")


MOST_AUDITS: Final = 0.5
"""Greatest share of the scenarios of a study that may be audits."""


def count_audits(share: float, scenarios: int) -> int:
    """Count the audits among the first scenarios of a study.

    Parameters
    ----------
    share : float
        Of audits among all.
    scenarios : int

    Returns
    -------
    int
    """
    return math.floor(share * scenarios + 1e-9)


@dataclass(frozen=True)
class StudyMeta:
    """What a study is about: everything that its content depends on.

    Attributes
    ----------
    scenario : str
        Path of the scenario file, or of the folder of imported recordings or of a suite, from the folder of the study
        on, as `stored_path` gives it. Earlier versions stored an absolute one, of which only the name counts.
    fingerprint : str
        SHA-256 of the scenario and the files that it uses, or of the imported files; of a suite that of its first one.
    space : ParameterSpace
        What is varied.
    ego : str
        Name of the entity under test.
    other : str or tuple of str
        Whom the metrics look at beside it; several names where there are several.
    metrics : tuple of str
        The first is the one that is searched.
    optimizer : str
        Name of the optimizer; ``"none"`` for imported recordings and suites.
    simulator : str
        Name of the simulator; ``"imported"`` for imported recordings.
    settings : mapping of str to object
        What the recordings depend on besides the scenario.
    critical : float or None
        Threshold: score from which a scenario is critical; None where nothing says it.
    weights : mapping of str to float
        Weight of each metric in the sum that is searched; empty where the first metric is searched.
    pareto : bool
        Whether the Pareto front of all metrics is searched.
    seed, budget, batch : int
        Seed of the search, number of scenarios in all, and in each round.
    repeats : int
        How often each scenario is run.
    most_repeats : int or None
        How often a scenario is run at most while it is open on which side of the threshold it is; None where each is
        run `repeats` times.
    audit : float
        Share of the scenarios that are drawn at random to judge the search, and that it is never told.
    asynchronous : bool
        Whether the search was asked for the next scenario as soon as one had ended.
    elsewhere : mapping of str to object
        What is known of the study that the search began from: the name of its file (``study``), its ``fingerprint``,
        ``simulator``, ``settings`` and number of ``scenarios``, and ``sha256`` of their points and scores; empty where
        it began from nothing.
    repeatability : mapping of str to object
        What came of running a scenario a second time: its id (``scenario``), whether both recordings are the ``same``
        bytes, and if not, by how many m entities are ``apart`` at most, None where that cannot be said; empty where it
        was not tried.
    files : tuple of str
        Imported recordings, or the scenario files of a suite, in the order of the scenarios' ids.
    kinds : tuple of str
        What kind each scenario of a suite is of, in words, in the same order; empty where none is known.
    requirements : tuple of str
        What the scenarios of a suite have to fulfil, each as `cornercase.suite.Requirement` reads it.
    suite : str
        SHA-256 of all files of a suite, and of those that they use; empty where one scenario file was explored.
    origin : str
        `fingerprint` of the study that a suite was reduced from; empty where there is none.
    version : str
        Version of cornercase that made the study.
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
    repeatability: Mapping[str, Any] = field(default_factory=dict)
    files: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()
    requirements: tuple[str, ...] = ()
    suite: str = ""
    origin: str = ""
    version: str = __version__

    @property
    def others(self) -> tuple[str, ...]:
        """Names of all entities that the ego is measured against."""
        return (self.other,) if isinstance(self.other, str) else self.other

    @property
    def searched(self) -> tuple[str, ...]:
        """Metrics whose scores are searched; none of imported recordings and suites."""
        if self.optimizer == "none":
            return ()
        if self.pareto:
            return self.metrics
        return tuple(name for name in self.metrics if name in self.weights) if self.weights else self.metrics[:1]

    @property
    def runs_of_each(self) -> str:
        """How often each scenario is run, in words."""
        return str(self.repeats) if self.most_repeats is None else f"{self.repeats} to {self.most_repeats}"

    @property
    def file_name(self) -> str:
        """Name of the scenario file, the or the first of a suite, or of the folder of recordings, without folders."""
        return _last_part(self.files[0] if self.suite and self.files else self.scenario)

    @property
    def runs_differ(self) -> str:
        """How two runs of the same scenario differ, in words; empty where none are known to."""
        if self.repeatability.get("same", True):
            return ""
        apart = self.repeatability.get("apart")
        how = f"in its recordings entities are up to {apart:.3g} m apart" if apart else "more than positions differs"
        return f"scenario {self.repeatability['scenario']} was run twice, and {how}"

    @property
    def drivers(self) -> dict[str, Any]:
        """Who drives, by entity, as `cornercase.drivers.describe_driver` says it; empty where the file alone does."""
        return dict(self.settings.get(_DRIVERS, {}))

    @property
    def title(self) -> str:
        """What the study is called: the name of its scenario file without ending, or that of its folder."""
        return Path(_last_part(self.scenario)).stem

    def to_json(self) -> dict[str, Any]:
        """Return plain values.

        Returns
        -------
        dict of str to object
            By the name of the field; None stands for an empty or a plain one.
        """
        # A study is written as before there were searches without rounds, or from other studies, or with more runs
        # where they are needed, or second runs, unless it is of one.
        later = {
            "asynchronous": self.asynchronous,
            "elsewhere": bool(self.elsewhere),
            "most_repeats": self.most_repeats is not None,
            "repeatability": bool(self.repeatability),
        }
        written = [one.name for one in fields(self) if later.get(one.name, True)]
        return {name: getattr(self, name) for name in written} | {
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
        """Tell whether a scenario is an audit: the last one with which their share of all is reached again.

        Parameters
        ----------
        scenario : int
            Its id.

        Returns
        -------
        bool
        """
        return count_audits(self.audit, scenario) > count_audits(self.audit, scenario - 1)

    @classmethod
    def from_json(cls, plain: Mapping[str, Any]) -> StudyMeta:
        """Make it of what `to_json` gave.

        Parameters
        ----------
        plain : mapping of str to object

        Returns
        -------
        StudyMeta

        Raises
        ------
        ValueError, LookupError, TypeError, AttributeError or OverflowError
            It is of something else.
        """
        # A field that is plain or empty stands there as None.
        known = [one.name for one in fields(cls) if one.name in plain or one.name not in _LATER]
        given = {name: plain[name] for name in known if plain[name] is not None}
        for name, value in given.items():
            if name in _TYPES and (
                not isinstance(value, _TYPES[name]) or isinstance(value, bool) != (name in _YES_OR_NO)
            ):
                raise ValueError(f"its {name} is {str(value)[:60]!r}")
        if isinstance(given["other"], list):
            given["other"] = _several(given["other"])
        for name in ("metrics", "files", "kinds", "requirements"):
            if not all(isinstance(one, str) for one in given.get(name, ())):
                raise ValueError(f"its {name} are no texts")
        if not given["metrics"] or not all(isinstance(one, int | float) for one in given.get("weights", {}).values()):
            raise ValueError("it has no metrics, or weights that are no numbers")
        numbers = (given.get("critical", 0.0), *given.get("weights", {}).values())
        if not all(math.isfinite(float(one)) for one in numbers):
            raise ValueError("its critical or its weights are not finite")
        known = given.get("elsewhere", {})
        if known and not all(isinstance(known.get(key), str) for key in ("sha256", "simulator", "study")):
            raise ValueError("it does not say what its search began from")
        if (tried := given.get("repeatability")) and not _is_try(tried):
            raise ValueError("it does not say what came of a second run")
        if given.get("most_repeats", math.inf) <= given.get("repeats", 1):
            raise ValueError("its most_repeats are no more than its repeats")
        if not 0.0 <= given.get("audit", 0.0) <= MOST_AUDITS:
            raise ValueError("its audit is no share")
        if not isinstance(given.get("settings", {}).get("drivers", {}), dict):
            raise ValueError("its drivers are no names by entity")
        given |= {name: tuple(given[name]) for name in ("metrics", "files", "kinds", "requirements") if name in given}
        return cls(**given | {"space": ParameterSpace.from_json(plain["space"])})

    def require_same(self, other: StudyMeta, path: Path, *, same_budget: bool = False) -> None:
        """Refuse to go on with a study of something else.

        The budget may grow, files may lie and the simulator may run elsewhere, and a threshold may be given where there
        is none.

        Parameters
        ----------
        other : StudyMeta
            What one wants to go on with.
        path : Path
            The study, for messages.
        same_budget : bool, default False
            Whether the budget may not grow, because the search depends on it.

        Raises
        ------
        InputError
            Something else differs.
        """
        if self.suite and other.suite and self.suite != other.suite:
            raise InputError(
                f"{path}: is of other scenarios than are there now: files were added, taken away or changed since; name"
                " another study with `study`."
            )
        for name, words in _DIFFERENT.items():
            mine, given = getattr(self, name), getattr(other, name)
            if name == "scenario" and self.fingerprint == other.fingerprint:
                continue
            if name == "space":
                # Its constraints follow from the file, and earlier versions did not write them.
                ours, theirs = mine.parameters, given.parameters
                mine, given = _with_units(ours, theirs), _with_units(theirs, ours)
            if name == "elsewhere":
                # Its file may lie elsewhere and be called otherwise; its scores may not be others.
                mine, given = mine.get("sha256"), given.get("sha256")
            if name == "metrics" and condition_of(mine) != condition_of(given):
                words = "another condition of what is critical"
            if mine != given:
                if name == "settings":
                    _require_same_files(mine, given, path)
                    words += f" ({_differences(mine, given)})"
                raise InputError(
                    f"{path}: belongs to {words}; name another study with `study`, or give the same options."
                )
        # Where it runs may change; what the recordings depend on is among the settings.
        if self.simulator.partition(":")[0] != other.simulator.partition(":")[0]:
            raise InputError(
                f"{path}: belongs to another simulator; name another study with `study`, or give the same."
            )
        if self.critical not in (None, other.critical):
            raise InputError(
                f"{path}: belongs to the threshold {self.critical:g}; name another study with"
                " `study`, or give the same `critical`."
            )
        if same_budget and self.budget != other.budget:
            raise InputError(
                f"{path}: its optimizer planned for a budget of {self.budget} scenarios; give the same `budget`."
            )


def _is_try(plain: Mapping[str, Any]) -> bool:
    """Whether it is what `StudyMeta.repeatability` holds."""
    apart, scenario = plain.get("apart"), plain.get("scenario")
    return (
        isinstance(plain.get("same"), bool)
        and isinstance(scenario, int)
        and (apart is None or (isinstance(apart, int | float) and math.isfinite(apart)))
    )


def _with_units(parameters: tuple[Parameter, ...], like: tuple[Parameter, ...]) -> tuple[Parameter, ...]:
    """Give parameters without a unit that of others: a range as an option has none, and no value depends on it."""
    units = {one.name: one.unit for one in like}
    return tuple(replace(one, unit=one.unit or units.get(one.name, "")) for one in parameters)


def _several(names: list[Any]) -> tuple[str, ...]:
    if len(names) < 2 or not all(isinstance(one, str) for one in names) or len(set(names)) < len(names):
        raise ValueError(f"its other is {str(names)[:60]}")
    return tuple(names)


def _last_part(path: str) -> str:
    # Written on Windows, it may be read elsewhere.
    return re.split(r"[\\/]", path.rstrip("\\/"))[-1]


def _require_same_files(mine: Mapping[str, Any], given: Mapping[str, Any], path: Path) -> None:
    """Refuse to go on with another version of a driver: a study holds runs of one."""
    if {**mine, _DRIVERS: None} != {**given, _DRIVERS: None}:
        return
    changes = list(driver_changes(mine.get(_DRIVERS), given.get(_DRIVERS)))
    for entity, there, here, only_the_file in changes:
        if only_the_file and all(one[-1] for one in changes):
            raise InputError(
                f"{path}: the file of the driver of {entity} has changed since ({plain_text(there)} there,"
                f" {plain_text(here)} here), and a study holds runs of one version; name another study with `study`, or"
                " restore the file."
            )


def _differences(mine: Mapping[str, Any], given: Mapping[str, Any]) -> str:
    """Which settings differ, with both values where these are short."""
    found = []
    for name in sorted({*mine, *given}):
        if name == _DRIVERS:
            found += [
                f"driver of {entity}: {plain_text(there)} there, {plain_text(here)} here"
                for entity, there, here, _ in driver_changes(mine.get(name), given.get(name))
            ]
        elif mine.get(name) != given.get(name):
            values = [shorten(plain_text(str(one.get(name, "none"))), _LONGEST_SETTING) for one in (mine, given)]
            found.append(f"{name}: {values[0]} there, {values[1]} here")
    return "; ".join(found)
