"""Run, measure and store scenarios of a study."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from cornercase._common.errors import InputError, PluginError, SimulationError
from cornercase._common.typing import FloatArray
from cornercase.exploration._config import ExplorationConfig
from cornercase.exploration._reference_driver_runs import PendingCondition, ReferenceRuns
from cornercase.exploration._repeat_policy import RepeatedScenario, RepeatPolicy
from cornercase.exploration._repeatability import check_repeatability
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario
from cornercase.scenario._seeds import seed_of_run
from cornercase.simulators import Simulator
from cornercase.simulators._random_sensors import find_entities_with_random_sensors
from cornercase.simulators._results import run_scenarios
from cornercase.simulators._run_notices import RunNotices
from cornercase.study import ScenarioRecord, StudyFile
from cornercase.study._objective import Objective


class StageTimer:
    """Timer for the stages of an exploration, which adds the measured times to the times in the study."""

    def __init__(self, study: StudyFile) -> None:
        self._study = study
        self._seconds_by_stage: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Measure the time of the `with` block, and add it to the time of the stage."""
        start = time.monotonic()
        try:
            yield
        finally:
            self._seconds_by_stage[stage] = self._seconds_by_stage.get(stage, 0.0) + time.monotonic() - start

    def save_times(self) -> None:
        """Store the measured times in the study, and reset them."""
        if self._seconds_by_stage:
            self._study.writer.add_elapsed_times(self._seconds_by_stage)
        self._seconds_by_stage.clear()


class ScenarioRunner:
    """Runner that simulates and measures scenarios, and stores each scenario as soon as it has ended.

    If a scenario is run several times, the run with the median score is stored (of two middle runs, the more critical
    one), together with the scores of all runs. Failed runs are ignored unless all failed. Extra repeats begin when
    all scenarios of the round have had their first repeats. Scenarios of a round that must be run with reference
    drivers before the condition is decided are stored when all these runs have ended. `references` are simulators in
    which a reference driver drives the ego, by name of the driver.
    """

    def __init__(
        self,
        config: ExplorationConfig,
        simulator: Simulator,
        objective: Objective,
        study: StudyFile,
        clock: StageTimer,
        references: Mapping[str, Simulator] | None = None,
    ) -> None:
        self._config, self._simulator, self._objective = config, simulator, objective
        self._study, self._clock = study, clock
        self._repeat_policy = RepeatPolicy(config, objective)
        self.notices = RunNotices(simulator)
        # Number of scenarios that failed by an exception of a driver, the simulator or a metric, and the last error.
        self._n_exceptions, self._last_error = 0, SimulationError()
        condition = config.make_condition()
        self._reference_runs, self._repeatability_checked = None, False
        if condition is not None:
            self._reference_runs = ReferenceRuns(config, condition, references or {}, self.simulate)
            if missing := [name for name in condition.reference_drivers if name not in (references or {})]:
                raise InputError(
                    f"`references`: `critical_if` needs the reference driver {missing[0]}; add a simulator in which"
                    f" {missing[0]} drives the ego."
                )

    def run_and_score(self, rows: Sequence[ScenarioRecord]) -> Iterator[tuple[int, Any]]:
        """Run scenarios; yield the id and the score of each successful scenario.

        Lower scores are more critical. The score is a float, or for a Pareto front an array of one score per metric.
        Raises `InputError` if the first `max_failures` scenarios all failed by exceptions, or if the simulator
        itself failed.
        """
        if not rows:
            return
        waiting, remaining = list[PendingCondition](), deque(self.request_first_runs(row) for row in rows)
        while remaining:
            unfinished = deque[RepeatedScenario]()
            for scenario, outcomes in self._run_batch(remaining):
                result = self.record_outcomes(scenario, outcomes)
                if isinstance(result, RepeatedScenario):
                    unfinished.append(result)
                elif isinstance(result, PendingCondition):
                    waiting.append(result)
                elif result is not None:
                    yield scenario.row.id, result
            remaining = unfinished
        if self._reference_runs is not None and waiting:
            with self._clock("simulate"):
                decided = list(self._reference_runs.decide_conditions(waiting))
            for pending in sorted(decided, key=lambda item: item.row.id):
                score = self.store_decided(pending)
                if score is not None:
                    yield pending.row.id, score
        self.require_any_result()

    def check_repeatability(self) -> None:
        """Run the first finished scenario of the study a second time, to check if runs are deterministic."""
        if self._repeatability_checked:
            return
        advice = (
            "a driver or the simulator draws random numbers or keeps state between runs: fix it, or run each scenario"
            " several times with `repeats`"
        )
        with self._clock("simulate"):
            self._repeatability_checked = check_repeatability(
                self._study, self._run_again, advice if self._config.repeats == 1 else "", self._has_random_sensors
            )

    def _has_random_sensors(self) -> bool:
        logical = self._config.logical
        files = [] if logical.file is None else [logical.file]
        return bool(find_entities_with_random_sensors(self._simulator, files, logical.space.names))

    def _run_again(self, row: ScenarioRecord) -> Iterator[Recording | SimulationError]:
        """Repeat the runs of a scenario one after another."""
        for run in range(self._config.max_repeats or self._config.repeats):
            yield from self.simulate(self._simulator, [self._make_concrete(row, run)])

    def _run_batch(
        self, scenarios: deque[RepeatedScenario]
    ) -> Iterator[tuple[RepeatedScenario, list[Recording | SimulationError]]]:
        """Do all requested runs of the scenarios in one batch; yield each scenario with the outcomes of its runs.

        The scenarios are removed from the deque.
        """
        results = self.simulate(
            self._simulator,
            [concrete for scenario in scenarios for concrete in self.requested_concrete_scenarios(scenario)],
        )
        while scenarios:
            scenario = scenarios.popleft()
            with self._clock("simulate"):
                outcomes = [next(results) for _ in range(scenario.n_requested)]
            yield scenario, outcomes
        # Exhaust the iterator, so that the simulator cleans up before the next batch.
        for _ in results:
            pass

    def request_first_runs(self, row: ScenarioRecord) -> RepeatedScenario:
        """Create the record of a scenario that has not been run; its first runs are requested."""
        return self._repeat_policy.request_first_runs(row)

    def requested_concrete_scenarios(self, repeated_run: RepeatedScenario) -> list[ConcreteScenario]:
        """Return one concrete scenario for each requested run; they differ in their seeds only."""
        runs = range(repeated_run.n_done, repeated_run.n_done + repeated_run.n_requested)
        return [self._make_concrete(repeated_run.row, run) for run in runs]

    def _make_concrete(self, row: ScenarioRecord, run: int) -> ConcreteScenario:
        return self._config.concrete_scenario(row.values, seed_of_run(self._config.seed, run))

    def record_outcomes(self, repeated_run: RepeatedScenario, outcomes: Sequence[Recording | SimulationError]) -> Any:
        """Measure finished runs, and store the scenario if it needs no further run.

        Returns the score (an array for a Pareto front; lower is more critical), or None if the scenario failed. Returns
        a `RepeatedScenario` if further runs are needed, or a `PendingCondition` if reference drivers have to run.
        """
        row = repeated_run.row
        with self._clock("measure"):
            self._repeat_policy.record_outcomes(repeated_run, outcomes)
        if repeated_run.n_requested:
            return repeated_run
        if not repeated_run.runs:
            assert repeated_run.error is not None
            self._record_failure(row, repeated_run.error)
            return None
        scores = self._repeat_policy.minimized_scores(repeated_run)
        middle = _median_index(scores)
        recording, courses = repeated_run.runs[middle]
        self.notices.add_run(recording, lambda: self._config.logical.scenario_file, f"scenario {row.id}")
        repeats = None
        if self._config.repeats > 1:
            repeats = {name: [run[name].score for _, run in repeated_run.runs] for name in courses}
        if self._reference_runs is None:
            with self._clock("store"):
                self._study.writer.record_result(row.id, recording, courses, repeats)
            return scores[middle]
        with self._clock("measure"):
            pending = self._reference_runs.evaluate_condition(row, recording, courses)
        return self.store_decided(pending) if pending.next_reference is None else pending

    def record_reference_run(self, pending_condition: PendingCondition, outcome: Recording | SimulationError) -> None:
        """Record the run with the reference driver that a scenario was waiting for."""
        if self._reference_runs is not None and pending_condition.next_reference is not None:
            self._reference_runs.record_reference_run(pending_condition, pending_condition.next_reference, outcome)

    def store_decided(self, pending_condition: PendingCondition) -> Any:
        """Store a scenario whose condition is decided; return its minimized score, or None if a run failed."""
        if pending_condition.error is not None:
            self._record_failure(pending_condition.row, pending_condition.error)
            return None
        courses = pending_condition.decided_results()
        with self._clock("store"):
            self._study.writer.record_result(
                pending_condition.row.id,
                pending_condition.recording,
                courses,
                references=pending_condition.reference_outcomes,
            )
        return self._objective.compute_scores_to_minimize(np.array([[result.score for result in courses.values()]]))[0]

    def _record_failure(self, row: ScenarioRecord, error: SimulationError) -> None:
        self._study.writer.record_failure(row.id, error)
        if isinstance(error, PluginError):
            self._n_exceptions, self._last_error = self._n_exceptions + 1, error

    def require_any_result(self) -> None:
        """Raise `InputError` if the first `max_failures` scenarios all failed by exceptions."""
        if 0 < self._config.max_failures <= self._n_exceptions and not self._study.finished_rows():
            raise InputError(
                f"The first {self._n_exceptions} scenarios all failed, so no more are run; in the last scenario"
                f" {self._last_error}. Fix the cause, and run the same command again; `max_failures` is the limit,"
                " and with 0 the search goes on however many scenarios fail."
            )

    def simulate(
        self, simulator: Simulator, concretes: Sequence[ConcreteScenario]
    ) -> Iterator[Recording | SimulationError]:
        """Run scenarios; yield a recording or an error for each. Raises `InputError` if the simulator itself fails."""
        try:
            yield from run_scenarios(simulator, concretes)
        except InputError:
            raise
        except Exception as error:
            text = " ".join(f"{type(error).__name__}: {error}".split())
            raise InputError(
                f"The simulator '{self._config.simulator}' failed ({text}); fix it, and run the same command"
                " again to resume."
            ) from error


def _median_index(scores: FloatArray) -> int:
    """Return the index of the median score; for scores of k metrics, shape (n, k), the first metric counts."""
    first = scores.reshape(len(scores), -1)[:, 0].tolist()
    order = sorted(range(len(first)), key=first.__getitem__)
    return order[(len(order) - 1) // 2]
