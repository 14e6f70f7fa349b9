"""Table of the options of an exploration, for Python functions, the command line, study files and documentation.

A new option is one entry here, one line in `ExploreOptions` for type checkers, and the code that uses it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from cornercase._common.option import Option, collect_options, option
from cornercase.simulators._run_options import RunOptions, SimulationKeywords, SimulationOptions

if TYPE_CHECKING:
    from cornercase.metrics import Metric
    from cornercase.optimizers import Optimizer
    from cornercase.stop._stop_rules import StopRule
    from cornercase.study import StudyMeta

_PROBLEM: Final = "What is tested"
_SEARCH: Final = "Search"
# Settings of the search that a problem or a study object holds itself.
_PROBLEM_SETTINGS: Final = ("weights", "pareto", "seed")
_problem = partial(option, panel=_PROBLEM)
_search = partial(option, panel=_SEARCH)
_study = partial(option, panel="Study", in_file=False)


# fmt: off
@dataclass(frozen=True, kw_only=True)
class SpaceOptions:
    """Options that define which parameters vary, if the logical scenario is given as a file."""

    space: Path | str | None = _problem(
        None, "ParameterValueDistribution file.", metavar="FILE.xosc",
        docs="ParameterValueDistribution file. `space`, `ranges`, `vary` and `continuous` cannot be given with a"
        " `LogicalScenario`, which has a space already.")
    ranges: tuple[str, ...] = _problem(
        (), "Add or replace a parameter.", flag="--range", metavar="NAME=LOW:HIGH[:STEP]",
        docs="Each ``NAME=LOW:HIGH[:STEP]`` adds a parameter to the space, or replaces the parameter of this name.")
    vary: tuple[str, ...] = _problem(
        (), "Vary a number of the file, by its name in the list of 'cornercase vary FILE.xosc'; without a range, the"
        " range proposed there is used.", metavar="NAME[=LOW:HIGH[:STEP]]",
        docs="Numbers in the scenario file to vary, as ``NAME=LOW:HIGH[:STEP]``, or ``NAME`` with the proposed range;"
        " `cornercase.scenario.list_variables` lists the names. A copy of the scenario, with parameters for these"
        " numbers, is written next to the study as ``STUDY.varied.xosc`` and explored.")
    continuous: bool = _problem(False, "Search ranges with steps as continuous intervals.")


@dataclass(frozen=True, kw_only=True)
class ExplorationOptions(SimulationOptions, RunOptions):
    """Options that say what is tested, how it is searched, and how scenarios are run."""

    ego: str = field(metadata={"option": Option(
        "Entity under test.", panel=_PROBLEM, metavar="NAME", stored="ego")})
    other: str | Sequence[str] = field(metadata={"option": Option(
        "Other entity; repeat it for several, '*' for all others. The most critical one counts.",
        docs='Entities that the ego is measured against; the most critical one counts. ``"*"`` means all others.',
        panel=_PROBLEM, metavar="NAME|*", stored=lambda meta: meta.others)})
    metrics: Metric | str | Sequence[Metric | str] = field(metadata={"option": Option(
        "Criticality metric. Repeat it for several: all are stored, the first is searched.",
        docs="Criticality metrics, by name or as objects, also of your own class. All are stored; the first is searched"
        " unless `weights` are given.",
        panel=_PROBLEM, flag="--metric", metavar="NAME",
        stored=lambda meta: meta.metrics[1:] if meta.condition else meta.metrics)})
    critical_if: str | None = _problem(
        None, "Search for a condition, without threshold: 'collision and not reference:cc-human' holds for a collision"
        " that the driver cc-human would have prevented. Bounds on scores ('ttc < 1'), temporal operators, and, or, not"
        " are explained on the page Expressions.",
        metavar="CONDITION",
        docs="Condition that replaces metric and threshold, and is searched: ``\"collision and not"
        ' reference:cc-human"``. It consists of ``collision`` (of the ego with anybody), ``reference:NAME`` (the ego'
        " would also collide if this driver drove it), bounds on scores such as ``ttc < 1``, ``and``, ``or``, ``not``"
        " and brackets. If the result depends on a reference, the scenario is run a second time.",
        stored=lambda meta: meta.condition or None)
    critical: float | None = _problem(
        None, "Score from which a scenario is critical; default: the metric's own threshold.", metavar="X",
        stored=lambda meta: None if meta.condition else meta.critical)
    optimizer: str | Optimizer | None = _search(
        None, "auto, bayes, level-set, committee, evolutionary, optuna, sobol, grid or random; options after a colon,"
        " as in bayes:filling=0. Default: auto, or bayes if no threshold or condition says what is critical.",
        metavar="NAME", stored="optimizer",
        docs="Optimizer, such as ``cornercase.optimizers.LevelSet(filling=0.1)``; in text, options follow a colon:"
        ' ``"bayes:filling=0"``. By default ``auto``, or ``bayes`` if no threshold or condition says what is critical;'
        " a study that was searched before keeps its optimizer.")
    budget: int = _search(200, "Number of concrete scenarios to run in all.", metavar="N", minimum=1, stored="budget")
    seed: int = _search(0, "Same seed, same result.", metavar="N", minimum=0, stored="seed")
    batch: int = _search(10, "Number of concrete scenarios in a round.", metavar="N", minimum=1, stored="batch")
    weights: Mapping[str, float] = _search(
        dict, "Search the weighted sum of these metrics.", flag="--weight", metavar="METRIC=W", stored="weights",
        docs="Weight of each metric, above 0: the minimum of the weighted sum of the scores is searched. Scores that"
        " are critical when high are subtracted; give a positive weight for them, too.")
    pareto: bool = _search(False, "Search the Pareto front of all metrics.", stored="pareto")
    repeats: int = _search(
        1, "Run each scenario N times; its score is the median.", metavar="N", minimum=1, stored="repeats",
        docs="Number of runs of each scenario; the median score counts.")
    max_repeats: int | None = _search(
        None, "Run a scenario up to M times, as long as its runs do not show whether it is critical: while the"
        " 90 % interval of the probability that a run is critical contains 0.5.", metavar="M", minimum=1,
        stored="most_repeats",
        docs="Upper limit of runs per scenario. A scenario gets `repeats` further runs as long as its runs do not show"
        " whether it is critical: while the 90 % interval of the probability that a run is critical"
        " (`cornercase.study.StudyFile.critical_run_rates`) contains 0.5. By default each scenario is run `repeats`"
        " times.")
    audit: float = _search(
        0.0, "Share of scenarios, up to 0.5, drawn at random and hidden from the search, to judge its results.",
        metavar="SHARE", minimum=0.0, stored="audit")
    asynchronous: bool = _search(
        False, "Work without rounds: propose the next scenario as soon as one has ended.", stored="asynchronous",
        docs="Search without rounds: ask for the next scenario as soon as one has ended. With one simulator, the same"
        " seed gives the same result. With several, the result depends on the order in which scenarios end, which is"
        " stored.")
    warm_start: Path | str | None = _search(
        None, "Begin with the scores of another study: same parameters, but another driver, simulator or time step.",
        metavar="OTHER.db", stored=lambda meta: meta.elsewhere.get("study"),
        docs="Study with the same parameters but another driver, simulator or time step, whose scores warm-start the"
        " search. They are copied; a search that is resumed does not need that study.")
    stop_when: StopRule | Sequence[StopRule | str] = _search(
        (), "Stop when enough is known about the critical set: missed<0.01, missed(0.7)<0.01, interval<0.05,"
        " overlooked(0.01)<0.05,"
        " unvisited(0.01)<0.05, audited-missed<0.1; with several, when all hold.", metavar="WHAT<X",
        docs="Stop when the critical set is known well enough: criteria such as ``cornercase.stop.missed(0.01)`` or"
        ' ``"missed<0.01"``, which all must hold. `cornercase.stop.seconds` and `cornercase.stop.no_improvement` each'
        " end the search on their own.")
    patience: int | None = _search(
        None, "Stop after N rounds without an improvement (asynchronous: after N times --batch scenarios).",
        metavar="N", minimum=1,
        docs="Stop after this number of rounds without an improvement; without rounds, `batch` scenarios count as a"
        " round.")
    max_seconds: float | None = _search(None, "Start no new round after this time in s.", metavar="S", minimum=0.0)


@dataclass(frozen=True, kw_only=True)
class OneTimeOptions:
    """Options of a single call that do not change the search."""

    check_proposals: bool = _study(False, "Simulate nothing; test whether the stored results give the same proposals.")
    retry_failed: bool = _study(
        False, "First run the failed scenarios of the study once more; scenarios proposed after them stay.")
# fmt: on


class ExploreOptions(SimulationKeywords, total=False):
    """Types of the keyword arguments of `cornercase.explore`, except `ego`, `other` and `metrics`."""

    space: Path | str | None
    ranges: Sequence[str]
    vary: Sequence[str]
    continuous: bool
    critical_if: str | None
    critical: float | None
    optimizer: str | Optimizer | None
    budget: int
    seed: int
    batch: int
    weights: Mapping[str, float] | None
    pareto: bool
    repeats: int
    max_repeats: int | None
    audit: float
    asynchronous: bool
    warm_start: Path | str | None
    stop_when: StopRule | Sequence[StopRule | str]
    patience: int | None
    max_seconds: float | None
    check_proposals: bool
    retry_failed: bool


_PANELS: Final = (_PROBLEM, _SEARCH, "Simulation", "Runs", "Study")
OPTIONS: Final = {
    name: item
    for panel in _PANELS
    for name, item in collect_options(SpaceOptions, ExplorationOptions, OneTimeOptions).items()
    if item.panel == panel
}
"""All options by name, in the order of help, files and printed commands."""
SPACE_OPTIONS: Final = collect_options(SpaceOptions)
CONFIG_OPTIONS: Final = collect_options(ExplorationOptions)
CALL_OPTIONS: Final = collect_options(OneTimeOptions)
SEARCH_SETTINGS: Final = {name for name, item in OPTIONS.items() if item.stored == "settings"}
"""Keys of those settings in a study that do not belong to the simulator."""


def read_stored_options(meta: StudyMeta) -> dict[str, Any]:
    """Return the options with which a study was explored, if they are stored; None for an option without a value."""
    fields_of_study = meta.to_json()
    values = {}
    for name, item in OPTIONS.items():
        if callable(item.stored):
            values[name] = item.stored(meta)
        elif item.stored in ("settings", "simulator"):
            values[name] = meta.settings.get(name)
        elif item.stored is not None:
            # It holds no default values.
            values[name] = fields_of_study.get(item.stored)
    return values


def read_stored_search_options(meta: StudyMeta) -> dict[str, Any]:
    """Return the options of a study's search that `Problem` and `Study` do not hold, without default values."""
    return {
        name: value
        for name, value in read_stored_options(meta).items()
        if OPTIONS[name].panel == _SEARCH
        and OPTIONS[name].is_field_of_study
        and name not in _PROBLEM_SETTINGS
        and value is not None
    }
