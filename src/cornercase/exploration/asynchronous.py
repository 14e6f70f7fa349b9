"""A search that is asked for the next scenario as soon as one has ended."""

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
    """Count the scenarios that are on their way while a search without rounds goes on.

    Parameters
    ----------
    places : int
        Scenarios that are run at a time.

    Returns
    -------
    int
        One where one is run, so that each proposal knows of all results before it. Otherwise half as many again, so
        that no simulator waits for a proposal.
    """
    return places if places == 1 else places + -(-places // 2)


class AsynchronousExplorer(ScenarioExplorer):
    """Looks for the critical concrete scenarios of a logical one, without rounds.

    A number of scenarios are on their way. As soon as one has ended, the search is told, and asked for another one;
    what came while it was thinking it is told at once. The study holds the order in which results came, so that a
    search that was killed goes on as it was: it is told in that order, and what was on its way is run first.

    Parameters
    ----------
    configuration : Configuration
    simulator : Simulator
    optimizer : Optimizer
        A fresh one: it is told what the study holds.
    study : Study
        Open for writing.
    objective : Objective, optional
        What of which metrics is searched; by default that of the configuration.
    references : mapping of str to Simulator, optional
        With the references of the configuration's condition at the wheel of the ego, by name.

    Raises
    ------
    InputError
        Something of the configuration cannot be used.
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
        # On their way, their runs, those of them that depend on a reference, and what came since the search was told of
        # others.
        self._pending: dict[int, Row] = {}
        self._begun: dict[int, RepeatedScenario] = {}
        self._undecided: dict[int, Undecided] = {}
        self._came: list[Row] = []
        self._scores: dict[int, Any] = {}
        self._results = self._judged = 0

    def _run(self, bar: ProgressBar | None, check_interrupt: Callable[[], None]) -> str:
        """Run scenarios side by side; once nothing else runs, try whether runs repeat themselves."""
        reason = self._run_beside(bar, check_interrupt)
        self._runner.try_repeatability()
        return reason

    def _run_beside(self, bar: ProgressBar | None, check_interrupt: Callable[[], None]) -> str:
        """Keep scenarios on their way until a criterion says why to end, and all have ended."""
        begun, reason = time.monotonic(), None
        with closing(SimulatorStream(self._simulators)) as stream:
            proposed, number = self._go_on_beside(stream)
            while True:
                if bar is not None:
                    bar.update(proposed - len(self._pending), self._best.text)
                wanted = pending_at_once(stream.places()) - len(self._pending)
                if reason is None and wanted > 0:
                    self._tell_all()
                    reason = self._reason(proposed, time.monotonic() - begun)
                if reason is None and wanted > 0:
                    rows = self._ask(number + 1, proposed, min(wanted, self._configuration.budget - proposed))
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
                # What came meanwhile is told at once too.
                while self._pending and stream.ready:
                    self._take(stream, check_interrupt)
                self._clock.note()

    def _go_on_beside(self, stream: SimulatorStream) -> tuple[int, int]:
        """Tell the optimizer what a killed explorer knew, as it came, and give what was on its way."""
        rows = self._study.rows()
        known = self._objective.oriented_of(self._study)
        scores = dict(zip((row.id for row in rows if row.state == "done"), known, strict=True))
        for turn in turns_of(self._study):
            if not turn.proposed:
                # The next round is told of more, which comes now.
                self._came, self._scores = list(turn.ended), scores
                break
            if turn.ended:
                self._tell(list(turn.ended), scores)
            if self._optimizer.remembers_asking and (searched := self._searched(turn.proposed)):
                self._search.pending = self._points(turn.pending)
                self._search.ask(len(searched))
        pending = [row for row in rows if row.state == "pending"]
        # What was known when a search was killed was judged before; one that had ended is judged again.
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
        """Run in a thread of its own; nothing else of the search is touched there."""
        return list(self._runner.outcomes(simulator, concretes))

    def _take(self, stream: SimulatorStream, check_interrupt: Callable[[], None]) -> None:
        """Wait for what ends next, and store it; or have it run again, maybe with a reference."""
        with self._clock("simulate"):
            key, outcomes = stream.take(check_interrupt)
        row = self._pending[key]
        if row.id in self._undecided:
            found: Any = self._undecided.pop(row.id)
            self._runner.again(found, outcomes[0])
        else:
            found = self._runner.settled(self._begun.pop(row.id), outcomes)
        if isinstance(found, RepeatedScenario):
            self._run_on(stream, found)
            return
        if isinstance(found, Undecided) and found.wanted is not None:
            self._undecided[row.id] = found
            stream.give(row.id, partial(self._outcomes, self._runner.concretes(self._runner.begun(row))), found.wanted)
            return
        score = self._runner.stored(found) if isinstance(found, Undecided) else found
        if score is not None:
            self._scores[row.id] = score
        self._came.append(self._pending.pop(row.id))
        self._runner.require_results()

    def _tell_all(self) -> None:
        """Tell what came since the last time, in the order in which it came."""
        if self._came:
            self._tell(self._came, self._scores)
        self._came, self._scores = [], {}

    def _look_for_news(self, scores: FloatArray) -> None:
        self._results += len(scores)
        for score in scores:
            self._stale = 0 if self._best.add(score[None]) else self._stale + 1

    def _enough(self) -> str | None:
        """Judge no more often than a search in rounds does."""
        rounds = self._results // self._configuration.batch
        if rounds == self._judged:
            return None
        self._judged = rounds
        return super()._enough()

    def _points(self, rows: Sequence[Row]) -> FloatArray:
        """Points of those scenarios that the search is told of, shape (p, d)."""
        return np.array([row.point for row in self._searched(rows)]).reshape(-1, self._space.dimension)
