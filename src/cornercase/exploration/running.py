"""Scenarios of a study run, measured and stored."""

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
    """Adds up how long the stages of an exploration take, and notes it in the study.

    Parameters
    ----------
    study : Study
    """

    def __init__(self, study: Study) -> None:
        self._study = study
        self._spent: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Take the time of a stage."""
        begun = time.monotonic()
        try:
            yield
        finally:
            self._spent[stage] = self._spent.get(stage, 0.0) + time.monotonic() - begun

    def note(self) -> None:
        """Write down what was taken since the last time."""
        if self._spent:
            self._study.writer.add_all_elapsed(self._spent)
        self._spent.clear()


class ScenarioRunner:
    """Runs scenarios, measures them, and stores each the moment it has ended.

    Parameters
    ----------
    configuration : Configuration
        If each scenario is run several times, the run whose score is the median is stored (with an even number of
        runs, the more critical of the two in the middle), and the scores of all runs. Failed runs are left out, unless
        all failed. Scenarios that need more runs get them once each scenario of the round has had its first ones.
    simulator : Simulator
    objective : Objective
        Its metrics are measured.
    study : Study
        Open for writing.
    clock : StageClock
    references : mapping of str to Simulator, optional
        With the references of the configuration's condition at the wheel of the ego, by name. What depends on them is
        stored when all scenarios have ended, and those that depend on them have been run again.
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
        # Scenarios in which a driver, the simulator or a metric raised an exception.
        self._raised, self._last = 0, SimulationError()
        condition = configuration.condition()
        self._second, self._tried = None, False
        if condition is not None:
            self._second = SecondRuns(configuration, condition, references or {}, self.outcomes)
            if missing := [name for name in condition.references if name not in (references or {})]:
                raise InputError(f"`references`: there is no simulator with {missing[0]} at the wheel.")

    def run(self, rows: Sequence[Row]) -> Iterator[tuple[int, Any]]:
        """Run scenarios of the study.

        Parameters
        ----------
        rows : sequence of Row

        Yields
        ------
        tuple of int and float, or ndarray of float64, shape (metrics,)
            Id and oriented score of each that did not fail, once it is stored; several scores for a Pareto front.

        Raises
        ------
        InputError
            None of them can be run, or the simulator itself failed.
        """
        if not rows:
            return
        waiting, left = list[Undecided](), deque(self.begun(row) for row in rows)
        while left:
            needy = deque[RepeatedScenario]()
            for one, outcomes in self._batch(left):
                found = self.settled(one, outcomes)
                if isinstance(found, RepeatedScenario):
                    needy.append(found)
                elif isinstance(found, Undecided):
                    waiting.append(found)
                elif found is not None:
                    yield one.row.id, found
            left = needy
        if self._second is not None and waiting:
            with self._clock("simulate"):
                decided = list(self._second.decide(waiting))
            for ready in sorted(decided, key=lambda one: one.row.id):
                score = self.stored(ready)
                if score is not None:
                    yield ready.row.id, score
        self.require_results()

    def try_repeatability(self) -> None:
        """Run the first scenario of the study a second time, once it has ended, to see whether runs repeat themselves.

        Raises
        ------
        InputError
            The simulator itself failed.
        """
        if self._tried:
            return
        advice = (
            "a driver or the simulator draws random numbers, or keeps something from one run to the next: mend it, or"
            " run each scenario several times with `repeats`"
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
        """Run each scenario as often as is wanted, all in one batch; those that came are taken out."""
        results = self.outcomes(self._simulator, [each for one in scenarios for each in self.concretes(one)])
        while scenarios:
            one = scenarios.popleft()
            with self._clock("simulate"):
                outcomes = [next(results) for _ in range(one.wanted)]
            yield one, outcomes
        # All are taken, so that the simulator clears up before the next batch.
        for _ in results:
            pass

    def begun(self, row: Row) -> RepeatedScenario:
        """Begin with a scenario that has to be run.

        Parameters
        ----------
        row : Row

        Returns
        -------
        RepeatedScenario
        """
        return self._repetition.begin(row)

    def concretes(self, one: RepeatedScenario) -> list[ConcreteScenario]:
        """Make the concrete scenarios that have to be run next of one: the same as often as is wanted.

        Parameters
        ----------
        one : RepeatedScenario

        Returns
        -------
        list of ConcreteScenario
        """
        return [self._configuration.logical.concrete(one.row.values) for _ in range(one.wanted)]

    def settled(self, one: RepeatedScenario, outcomes: Sequence[Recording | SimulationError]) -> Any:
        """Measure runs of a scenario, and store what came of it unless it needs more, or depends on a reference.

        Parameters
        ----------
        one : RepeatedScenario
        outcomes : sequence of Recording or SimulationError
            Of the runs that were wanted.

        Returns
        -------
        float, ndarray of float64, shape (metrics,), RepeatedScenario, Undecided or None
            Its oriented score or scores; what has to be run again; None where it failed.
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
            looked = self._second.look(row, recording, courses)
        return self.stored(looked) if looked.wanted is None else looked

    def again(self, one: Undecided, outcome: Recording | SimulationError) -> None:
        """Take the run of a scenario with the reference that it depends on.

        Parameters
        ----------
        one : Undecided
        outcome : Recording or SimulationError
        """
        if self._second is not None and one.wanted is not None:
            self._second.take(one, one.wanted, outcome)

    def stored(self, one: Undecided) -> Any:
        """Store a scenario of which the condition is decided.

        Parameters
        ----------
        one : Undecided

        Returns
        -------
        float, or ndarray of float64, shape (metrics,), or None
            Its oriented score; None where it failed.
        """
        if one.error is not None:
            self._fail(one.row, one.error)
            return None
        courses = one.decided()
        with self._clock("store"):
            self._study.writer.finish(one.row.id, one.recording, courses, references=one.outcomes)
        return self._objective.oriented(np.array([[each.score for each in courses.values()]]))[0]

    def _fail(self, row: Row, error: SimulationError) -> None:
        self._study.writer.fail(row.id, error)
        if isinstance(error, PartError):
            self._raised, self._last = self._raised + 1, error

    def require_results(self) -> None:
        """End the search if a driver, the simulator or a metric fails in all scenarios from the first one on.

        Raises
        ------
        InputError
            As many have failed so as the configuration says, and none has given a result.
        """
        if 0 < self._configuration.max_failures <= self._raised and not self._study.done():
            raise InputError(
                f"None of {self._raised} scenarios gave a result (`max_failures`); in the last one {self._last}. Fix"
                " it, and run the same command again."
            )

    def outcomes(
        self, simulator: Simulator, concretes: Sequence[ConcreteScenario]
    ) -> Iterator[Recording | SimulationError]:
        """Run scenarios by a simulator, whose own failure is an error in a sentence.

        Parameters
        ----------
        simulator : Simulator
        concretes : sequence of ConcreteScenario

        Yields
        ------
        Recording or SimulationError
            One for each.

        Raises
        ------
        InputError
            None of them can be run, or the simulator itself failed.
        """
        try:
            yield from outcomes_of(simulator, concretes)
        except InputError:
            raise
        except Exception as error:
            words = " ".join(f"{type(error).__name__}: {error}".split())
            raise InputError(
                f"The simulator '{self._configuration.simulator}' failed ({words}); fix it, and run the same command"
                " again to go on."
            ) from error


def _middle(scores: FloatArray) -> int:
    """Place of the median of scores, shape (n,) or (n, k); of several scores the first counts."""
    first = scores.reshape(len(scores), -1)[:, 0].tolist()
    order = sorted(range(len(first)), key=first.__getitem__)
    return order[(len(order) - 1) // 2]
