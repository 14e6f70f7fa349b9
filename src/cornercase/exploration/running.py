"""Run, measure and store scenarios of a study."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from cornercase._common.errors import InputError, PartError, SimulationError
from cornercase._common.typing import FloatArray
from cornercase.exploration.configuration import Configuration
from cornercase.exploration.deciding import SecondRuns, Undecided
from cornercase.exploration.objective import Objective
from cornercase.exploration.repeatability import try_repeatability
from cornercase.exploration.repeated import RepeatedScenario, Repetition
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import RunNotices, Simulator, outcomes_of
from cornercase.study import Row, Study


class StageClock:
    """Adds up how long the stages of an exploration take, and stores the sums in the study."""

    def __init__(self, study: Study) -> None:
        self._study = study
        self._spent: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Measure the time of a stage."""
        start = time.monotonic()
        try:
            yield
        finally:
            self._spent[stage] = self._spent.get(stage, 0.0) + time.monotonic() - start

    def note(self) -> None:
        """Store and reset the measured times."""
        if self._spent:
            self._study.writer.add_all_elapsed(self._spent)
        self._spent.clear()


class ScenarioRunner:
    """Runs and measures scenarios, and stores each as soon as it has ended.

    Of repeated runs, the run with the median score is stored (for an even number, the more critical of the middle two),
    and the scores of all runs. Failed runs are ignored unless all failed. Extra repeats are run after all scenarios of
    the round have had their first repeats. If the condition depends on references (simulators with a reference driver
    in the ego, by name), a scenario is stored after all have ended and the reference runs are done.
    """

    def __init__(
        self,
        configuration: Configuration,
        simulator: Simulator,
        objective: Objective,
        study: Study,
        clock: StageClock,
        references: Mapping[str, Simulator] | None = None,
    ) -> None:
        self._configuration, self._simulator, self._objective = configuration, simulator, objective
        self._study, self._clock = study, clock
        self._repetition = Repetition(configuration, objective)
        self.notices = RunNotices(simulator)
        # Number of scenarios that failed by an exception of a driver, the simulator or a metric, and the last error.
        self._raised, self._last = 0, SimulationError()
        condition = configuration.condition()
        self._second, self._tried = None, False
        if condition is not None:
            self._second = SecondRuns(configuration, condition, references or {}, self.outcomes)
            if missing := [name for name in condition.references if name not in (references or {})]:
                raise InputError(f"`references`: there is no simulator in which {missing[0]} drives the ego.")

    def run(self, rows: Sequence[Row]) -> Iterator[tuple[int, Any]]:
        """Run scenarios; yield id and minimized score (float, or shape (metrics,) for a front) of each successful one.

        Raises `InputError` if none of them can be run, or the simulator itself failed.
        """
        if not rows:
            return
        waiting, remaining = list[Undecided](), deque(self.begun(row) for row in rows)
        while remaining:
            unfinished = deque[RepeatedScenario]()
            for scenario, outcomes in self._batch(remaining):
                result = self.settled(scenario, outcomes)
                if isinstance(result, RepeatedScenario):
                    unfinished.append(result)
                elif isinstance(result, Undecided):
                    waiting.append(result)
                elif result is not None:
                    yield scenario.row.id, result
            remaining = unfinished
        if self._second is not None and waiting:
            with self._clock("simulate"):
                decided = list(self._second.decide(waiting))
            for pending in sorted(decided, key=lambda item: item.row.id):
                score = self.stored(pending)
                if score is not None:
                    yield pending.row.id, score
        self.require_results()

    def try_repeatability(self) -> None:
        """Run the first finished scenario of the study a second time, to check if runs are deterministic."""
        if self._tried:
            return
        advice = (
            "a driver or the simulator draws random numbers or keeps state between runs: fix it, or run each scenario"
            " several times with `repeats`"
        )
        with self._clock("simulate"):
            self._tried = try_repeatability(
                self._study, self._once_more, advice if self._configuration.repeats == 1 else ""
            )

    def _once_more(self, row: Row) -> Recording | SimulationError:
        (outcome,) = self.outcomes(self._simulator, [self._configuration.logical.concrete(row.values)])
        return outcome

    def _batch(
        self, scenarios: deque[RepeatedScenario]
    ) -> Iterator[tuple[RepeatedScenario, list[Recording | SimulationError]]]:
        """Run all requested runs in one batch; scenarios are removed from the deque as their results come."""
        results = self.outcomes(
            self._simulator, [concrete for scenario in scenarios for concrete in self.concretes(scenario)]
        )
        while scenarios:
            scenario = scenarios.popleft()
            with self._clock("simulate"):
                outcomes = [next(results) for _ in range(scenario.wanted)]
            yield scenario, outcomes
        # Exhaust the iterator, so that the simulator cleans up before the next batch.
        for _ in results:
            pass

    def begun(self, row: Row) -> RepeatedScenario:
        """Create the state of a scenario without runs."""
        return self._repetition.begin(row)

    def concretes(self, one: RepeatedScenario) -> list[ConcreteScenario]:
        """Create the concrete scenario once per requested run."""
        return [self._configuration.logical.concrete(one.row.values) for _ in range(one.wanted)]

    def settled(self, one: RepeatedScenario, outcomes: Sequence[Recording | SimulationError]) -> Any:
        """Measure finished runs, and store the scenario if it needs no further run.

        Returns its minimized score or scores, `RepeatedRun` or `PendingCondition` if more runs are needed, None if it
        failed.
        """
        row = one.row
        with self._clock("measure"):
            self._repetition.take(one, outcomes)
        if one.wanted:
            return one
        if not one.runs:
            assert one.error is not None
            self._fail(row, one.error)
            return None
        scores = self._repetition.scores(one)
        middle = _middle(scores)
        recording, courses = one.runs[middle]
        self.notices.look(recording, lambda: self._configuration.logical.scenario)
        repeats = None
        if self._configuration.repeats > 1:
            repeats = {name: [run[name].score for _, run in one.runs] for name in courses}
        if self._second is None:
            with self._clock("store"):
                self._study.writer.finish(row.id, recording, courses, repeats)
            return scores[middle]
        with self._clock("measure"):
            pending = self._second.look(row, recording, courses)
        return self.stored(pending) if pending.wanted is None else pending

    def again(self, one: Undecided, outcome: Recording | SimulationError) -> None:
        """Record the run with the reference driver that a scenario was waiting for."""
        if self._second is not None and one.wanted is not None:
            self._second.take(one, one.wanted, outcome)

    def stored(self, one: Undecided) -> Any:
        """Store a scenario whose condition is decided; return its minimized score, None if a run failed."""
        if one.error is not None:
            self._fail(one.row, one.error)
            return None
        courses = one.decided()
        with self._clock("store"):
            self._study.writer.finish(one.row.id, one.recording, courses, references=one.outcomes)
        return self._objective.oriented(np.array([[result.score for result in courses.values()]]))[0]

    def _fail(self, row: Row, error: SimulationError) -> None:
        self._study.writer.fail(row.id, error)
        if isinstance(error, PartError):
            self._raised, self._last = self._raised + 1, error

    def require_results(self) -> None:
        """Raise `InputError` if `max_failures` scenarios failed by exceptions before any gave a result."""
        if 0 < self._configuration.max_failures <= self._raised and not self._study.done():
            raise InputError(
                f"None of {self._raised} scenarios gave a result (`max_failures`); in the last one {self._last}. Fix"
                " it, and run the same command again."
            )

    def outcomes(
        self, simulator: Simulator, concretes: Sequence[ConcreteScenario]
    ) -> Iterator[Recording | SimulationError]:
        """Run scenarios; yield one recording or error each. A crash of the simulator itself raises `InputError`."""
        try:
            yield from outcomes_of(simulator, concretes)
        except InputError:
            raise
        except Exception as error:
            text = " ".join(f"{type(error).__name__}: {error}".split())
            raise InputError(
                f"The simulator '{self._configuration.simulator}' failed ({text}); fix it, and run the same command"
                " again to resume."
            ) from error


def _middle(scores: FloatArray) -> int:
    """Index of the median of scores, shape (n,) or (n, k); of several scores the first counts."""
    first = scores.reshape(len(scores), -1)[:, 0].tolist()
    order = sorted(range(len(first)), key=first.__getitem__)
    return order[(len(order) - 1) // 2]
