"""Search without rounds: the optimizer is asked for the next scenario as soon as one has ended."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from functools import partial
from typing import Any

import numpy as np

from cornercase._common.progress import ProgressBar
from cornercase._common.typing import FloatArray
from cornercase.exploration.configuration import Configuration
from cornercase.exploration.deciding import Undecided
from cornercase.exploration.explorer import ScenarioExplorer
from cornercase.exploration.objective import Objective
from cornercase.exploration.proposing import turns_of
from cornercase.exploration.repeated import RepeatedScenario
from cornercase.optimizers import Optimizer
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Simulator, SimulatorStream
from cornercase.study import Row, Study


def pending_at_once(places: int) -> int:
    """Number of scenarios in progress for `places` parallel simulators.

    One simulator: one, so that each proposal knows all results. Otherwise half as many again, so that none has to wait.
    """
    return places if places == 1 else places + -(-places // 2)


class AsynchronousExplorer(ScenarioExplorer):
    """Searches a logical scenario without rounds.

    As soon as a scenario has ended, the optimizer is told its result, and all that arrived meanwhile, and asked for
    another. The study holds the order of the results, so a search that was killed is resumed identically: the optimizer
    is told in that order, and pending scenarios run first. Parameters as for `ScenarioExplorer`.
    """

    def __init__(
        self,
        configuration: Configuration,
        simulator: Simulator,
        optimizer: Optimizer,
        study: Study,
        objective: Objective | None = None,
        references: Mapping[str, Simulator] | None = None,
    ) -> None:
        super().__init__(configuration, simulator, optimizer, study, objective, references)
        self._simulators = {"": simulator, **(references or {})}
        if configuration.patience is not None:
            self._patience, self._things = configuration.patience * configuration.batch, "scenarios"
        # By scenario id: rows in progress, their repeats, those that need a reference run; new results.
        self._pending: dict[int, Row] = {}
        self._begun: dict[int, RepeatedScenario] = {}
        self._undecided: dict[int, Undecided] = {}
        self._came: list[Row] = []
        self._scores: dict[int, Any] = {}
        self._results = self._judged = 0

    def _run(self, bar: ProgressBar | None, check_interrupt: Callable[[], None]) -> str:
        """Run scenarios in parallel; once nothing else runs, check if runs are deterministic."""
        reason = self._run_beside(bar, check_interrupt)
        self._runner.try_repeatability()
        return reason

    def _run_beside(self, bar: ProgressBar | None, check_interrupt: Callable[[], None]) -> str:
        """Keep scenarios in progress until a criterion holds and all have ended; return the criterion."""
        start, reason = time.monotonic(), None
        with closing(SimulatorStream(self._simulators)) as stream:
            proposed, number = self._go_on_beside(stream)
            while True:
                if bar is not None:
                    bar.update(proposed - len(self._pending), self._best.text)
                n_free = pending_at_once(stream.places()) - len(self._pending)
                if reason is None and n_free > 0:
                    self._tell_all()
                    reason = self._reason(proposed, time.monotonic() - start)
                if reason is None and n_free > 0:
                    rows = self._ask(number + 1, proposed, min(n_free, self._configuration.budget - proposed))
                    if rows:
                        self._give(stream, rows)
                        proposed, number = proposed + len(rows), number + 1
                    else:
                        reason = self._used_up(proposed)
                if not self._pending:
                    self._tell_all()
                    assert reason is not None
                    return reason
                self._take(stream, check_interrupt)
                # Collect results that arrived meanwhile.
                while self._pending and stream.ready:
                    self._take(stream, check_interrupt)
                self._clock.note()

    def _go_on_beside(self, stream: SimulatorStream) -> tuple[int, int]:
        """Tell the optimizer the stored results in their order, and submit pending scenarios."""
        rows = self._study.rows()
        minimized = self._objective.oriented_of(self._study)
        scores = dict(zip((row.id for row in rows if row.state == "done"), minimized, strict=True))
        for turn in turns_of(self._study):
            if not turn.proposed:
                # The next round will be told further results as well.
                self._came, self._scores = list(turn.ended), scores
                break
            if turn.ended:
                self._tell(list(turn.ended), scores)
            if self._optimizer.remembers_asking and (searched := self._searched(turn.proposed)):
                self._search.pending = self._points(turn.pending)
                self._search.ask(len(searched))
        pending = [row for row in rows if row.state == "pending"]
        # A killed search has evaluated its stop criteria on these results; one that had ended evaluates them again.
        self._judged = self._results // self._configuration.batch if pending else -1
        self._give(stream, pending)
        return len(rows), rows[-1].round if rows else 0

    def _ask(self, number: int, proposed: int, wanted: int) -> list[Row]:
        self._search.pending = self._points(list(self._pending.values()))
        return self._next(number, proposed, wanted)

    def _searched(self, rows: Sequence[Row]) -> list[Row]:
        return [row for row in rows if not self._study.meta.is_audit(row.id)]

    def _give(self, stream: SimulatorStream, rows: Sequence[Row]) -> None:
        for row in rows:
            self._pending[row.id] = row
            self._run_on(stream, self._runner.begun(row))

    def _run_on(self, stream: SimulatorStream, one: RepeatedScenario) -> None:
        self._begun[one.row.id] = one
        stream.give(one.row.id, partial(self._outcomes, self._runner.concretes(one)))

    def _outcomes(self, concretes: Sequence[ConcreteScenario], simulator: Simulator) -> list[Any]:
        """Run in a worker thread; must not touch other state of the search."""
        return list(self._runner.outcomes(simulator, concretes))

    def _take(self, stream: SimulatorStream, check_interrupt: Callable[[], None]) -> None:
        """Wait for the next result, and store it or submit another run of the scenario."""
        with self._clock("simulate"):
            key, outcomes = stream.take(check_interrupt)
        row = self._pending[key]
        if row.id in self._undecided:
            result: Any = self._undecided.pop(row.id)
            self._runner.again(result, outcomes[0])
        else:
            result = self._runner.settled(self._begun.pop(row.id), outcomes)
        if isinstance(result, RepeatedScenario):
            self._run_on(stream, result)
            return
        if isinstance(result, Undecided) and result.wanted is not None:
            self._undecided[row.id] = result
            stream.give(row.id, partial(self._outcomes, self._runner.concretes(self._runner.begun(row))), result.wanted)
            return
        score = self._runner.stored(result) if isinstance(result, Undecided) else result
        if score is not None:
            self._scores[row.id] = score
        self._came.append(self._pending.pop(row.id))
        self._runner.require_results()

    def _tell_all(self) -> None:
        """Tell the optimizer the new results in the order of their arrival."""
        if self._came:
            self._tell(self._came, self._scores)
        self._came, self._scores = [], {}

    def _look_for_news(self, scores: FloatArray) -> None:
        self._results += len(scores)
        for score in scores:
            self._stale = 0 if self._best.add(score[None]) else self._stale + 1

    def _enough(self) -> str | None:
        """Check stop criteria no more often than a search in rounds does."""
        rounds = self._results // self._configuration.batch
        if rounds == self._judged:
            return None
        self._judged = rounds
        return super()._enough()

    def _points(self, rows: Sequence[Row]) -> FloatArray:
        """Points of the rows that are not audits, shape (p, d)."""
        return np.array([row.point for row in self._searched(rows)]).reshape(-1, self._space.dimension)
