"""Runs of scenarios with rounded parameters, and the choice of a rounding that keeps the outcome."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from cornercase._common.errors import InputError, PluginError
from cornercase.drivers._resolve import may_be_named_in_file, resolve_driver
from cornercase.metrics._measure import evaluate_metrics
from cornercase.recordings import Recording
from cornercase.report.cards._meeting import Meeting, find_meeting
from cornercase.report.cards._rounding import Rounding
from cornercase.scenario import ConcreteScenario, Value
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators._base import Simulator
from cornercase.simulators._create import create_simulator
from cornercase.simulators._results import run_scenarios
from cornercase.study import StudyFile, StudyMeta
from cornercase.study._import_recordings import IMPORTED_SIMULATOR
from cornercase.study._objective import Objective

# Simulators that are not servers or programs with a licence of their own.
_SIMULATORS: Final = ("builtin", "esmini")


@dataclass(frozen=True)
class CardRun:
    """Run of a scenario: its parameter values, recording and scores, and how it ends.

    `is_critical` is None if the study has no threshold, or if a score is unknown.
    """

    values: Mapping[str, Value]
    recording: Recording
    meeting: Meeting
    scores: Mapping[str, float]
    is_critical: bool | None

    def ends_like(self, other: CardRun) -> bool:
        """Return whether both runs end in the same way.

        The ego must touch the same entities, and the same entity first among those that the study measures. Both runs
        must be critical, or neither.
        """
        same_contact = self.meeting.collides == other.meeting.collides and (
            not self.meeting.collides or self.meeting.other == other.meeting.other
        )
        same_entities = self.meeting.entities_hit == other.meeting.entities_hit
        return same_contact and same_entities and self.is_critical == other.is_critical


@dataclass(frozen=True)
class RoundedRun:
    """Rounded parameter values that a test card shows, and the run of the scenario with these values.

    If the scenario was not run with these values, `run` and `keeps_outcome` are None. `reason` says why the nearest
    rounding was not run. Each parameter can be rounded up or down, which gives `n_possible` roundings. The `n_tried`
    roundings nearest to the original values were tried, and `n_failed` of the tried ones could not be run.
    """

    values: Mapping[str, Value]
    run: CardRun | None
    keeps_outcome: bool | None
    n_tried: int
    n_possible: int
    n_failed: int = 0
    reason: str = ""
    is_nearest: bool = True


def read_stored_run(study: StudyFile, scenario: int, values: Mapping[str, Value]) -> CardRun:
    """Return the run of a scenario as it is stored in the study."""
    recording, scores = study.recording(scenario), study.scenario_scores(scenario)
    return _create_card_run(study.meta, study.objective, values, recording, scores)


def reason_not_to_run(meta: StudyMeta) -> str:
    """Return the reason why a study's scenarios cannot be run with rounded values; empty if they can be run."""
    if meta.simulator == IMPORTED_SIMULATOR:
        return "its recording was imported, and what made it is not known"
    if meta.suite:
        return "scenarios of a suite are files of their own; make cards of the study that it was selected from"
    if meta.simulator.partition(":")[0] not in _SIMULATORS:
        return f"{meta.simulator} is not started for test cards"
    # A study may come from anyone, and opening it must run no code that it names.
    if not all(isinstance(driver, str) and may_be_named_in_file(driver) for driver in meta.drivers.values()):
        return "a driver of the study is a program of its own, which is not started for test cards"
    if "reference:" in meta.condition:
        return "the condition of the study needs runs of a reference driver"
    if meta.own_metrics:
        return "a metric of the study is a class of its own"
    return ""


class RoundedRunner:
    """Runner of rounded scenarios, with the simulator, drivers and metrics of the study.

    Use this class as a context manager.
    """

    def __init__(self, study: StudyFile, scenario: ScenarioFile) -> None:
        meta = study.meta
        self._meta, self._scenario, self._objective = meta, scenario, study.objective
        self._metrics = meta.create_metrics()
        drivers = {entity: resolve_driver(driver) for entity, driver in meta.drivers.items()}
        self._simulator: Simulator = create_simulator(
            meta.simulator, {**meta.settings, "drivers": drivers}, ego=meta.ego
        )

    def __enter__(self) -> RoundedRunner:
        self._simulator.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        self._simulator.__exit__(*exception)

    def choose_rounding(self, original: CardRun, roundings: Sequence[Rounding], n_possible: int) -> RoundedRun:
        """Choose the nearest rounding whose run ends like the original run.

        The nearest rounding is run first. The others are run only if the run of the nearest rounding fails or ends in
        another way. If no rounding ends like the original run, the nearest rounding is returned. `roundings` are the
        nearest of all `n_possible` roundings, the nearest first.
        """
        nearest, *others = roundings
        (first,) = self._run([nearest])
        if isinstance(first, CardRun) and first.ends_like(original):
            return RoundedRun(nearest.values, first, True, 1, n_possible)
        tried = [first, *(self._run(others) if others else ())]
        n_failed = sum(isinstance(run, str) for run in tried)
        reason = first if isinstance(first, str) else ""
        for rounding, run in zip(roundings, tried, strict=True):
            if isinstance(run, CardRun) and run.ends_like(original):
                return RoundedRun(
                    rounding.values, run, True, len(tried), n_possible, n_failed, reason, is_nearest=False
                )
        if isinstance(first, str):
            return RoundedRun(nearest.values, None, None, len(tried), n_possible, n_failed, reason)
        return RoundedRun(nearest.values, first, False, len(tried), n_possible, n_failed)

    def _run(self, roundings: Sequence[Rounding]) -> list[CardRun | str]:
        """Run the scenario with each rounding; for a run that fails, the result contains the reason as text."""
        concretes = [
            ConcreteScenario(self._scenario.path, rounding.values, self._scenario, self._meta.seed)
            for rounding in roundings
        ]
        runs: list[CardRun | str] = []
        try:
            for rounding, outcome in zip(roundings, run_scenarios(self._simulator, concretes), strict=True):
                runs.append(self._measure(rounding, outcome) if isinstance(outcome, Recording) else str(outcome))
        except InputError as error:
            runs += [str(error)] * (len(roundings) - len(runs))
        return runs

    def _measure(self, rounding: Rounding, recording: Recording) -> CardRun | str:
        meta = self._meta
        try:
            results = evaluate_metrics(self._metrics, recording, meta.ego, meta.other)
        except PluginError as error:
            return str(error)
        scores = {name: float(result.score) for name, result in results.items()}
        return _create_card_run(meta, self._objective, rounding.values, recording, scores)


def _create_card_run(
    meta: StudyMeta,
    objective: Objective,
    values: Mapping[str, Value],
    recording: Recording,
    scores: Mapping[str, float],
) -> CardRun:
    is_critical = None
    if objective.criterion is not None and all(metric.name in scores for metric in objective.metrics):
        is_critical = objective.is_critical(scores)
    return CardRun(values, recording, find_meeting(recording, meta.ego, meta.others), scores, is_critical)
