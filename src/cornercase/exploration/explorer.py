"""The loop of the paper's figure "scenario exploration workflow"."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from cornercase._common.errors import InputError, SimulationError
from cornercase._common.interrupts import noted_interrupts
from cornercase.evidence import CriticalSet
from cornercase.exploration.objective import Best, Objective
from cornercase.exploration.stopping import Criterion
from cornercase.metrics import Metric, measured
from cornercase.optimizers import Optimizer
from cornercase.scenario import LogicalScenario
from cornercase.simulators import Simulator
from cornercase.study import Row, Study

# With fewer scenarios nothing is said about a critical set.
_LEAST = 40


@dataclass(frozen=True)
class ExplorationResult:
    """How an exploration ended.

    Attributes
    ----------
    done : int
        Scenarios in the study that ended, failed ones included.
    reason : str
    interrupted : bool
    """

    done: int
    reason: str
    interrupted: bool = False


class ScenarioExplorer:
    """Looks for the critical concrete scenarios of a logical one.

    Steps (1) to (6) of the paper's activity diagram: the optimizer chooses parameters, the simulator runs them, the
    metrics evaluate them, until a termination criterion is fulfilled. Each scenario is stored the moment it has
    ended; an explorer that is given a study goes on where that one stopped.

    Parameters
    ----------
    logical : LogicalScenario
    simulator : Simulator
    optimizer : Optimizer
        A fresh one: it is told what the study holds.
    metrics : sequence of Metric
        All are stored; the first is searched where there is no objective.
    ego, other : str
    study : Study
        Open for writing.
    budget : int
        Scenarios in all.
    batch : int, default 10
        Scenarios per round.
    patience : int, optional
        Rounds without anything new after which to stop: none of them had a score at least as critical as the best
        before. A score at the metric's cap is not critical and never new after the first.
    max_seconds : float, optional
        Time after which no round is begun.
    objective : Objective, optional
        What of the metrics is searched.
    stop_when : sequence of Criterion
        Enough is known when all of them are fulfilled.
    critical : float, optional
        For them: score up to which, as a search is told of it, a scenario is critical.
    seed : int, default 0
        For them.
    repeats : int, default 1
        How often each scenario is run, by a simulator that does not give the same twice. What is stored is the run
        with the median of what is searched (of an even number the more critical of the two in the middle), and the
        scores of all. Runs that failed are left out, unless all did.
    """

    def __init__(
        self,
        logical: LogicalScenario,
        simulator: Simulator,
        optimizer: Optimizer,
        metrics: Sequence[Metric],
        ego: str,
        other: str,
        study: Study,
        *,
        budget: int,
        batch: int = 10,
        patience: int | None = None,
        max_seconds: float | None = None,
        objective: Objective | None = None,
        stop_when: Sequence[Criterion] = (),
        critical: float | None = None,
        seed: int = 0,
        repeats: int = 1,
    ) -> None:
        self._objective = Objective(metrics) if objective is None else objective
        if stop_when and critical is None:
            raise InputError("A criterion about the critical set needs to know what is critical.")
        self._logical, self._simulator, self._optimizer = logical, simulator, optimizer
        self._metrics, self._ego, self._other, self._study = list(metrics), ego, other, study
        self._budget, self._batch = budget, batch
        self._patience, self._max_seconds = patience, max_seconds
        self._spent: dict[str, float] = {}
        self._best, self._stale = Best(self._objective), 0
        self._stop_when, self._critical, self._seed = tuple(stop_when), critical, seed
        self._points, self._told = np.zeros((0, logical.space.dimension)), np.zeros(0)
        self._repeats = repeats

    def run(self, progress: bool = False) -> ExplorationResult:
        """Explore until a termination criterion is fulfilled.

        Parameters
        ----------
        progress : bool, default False
            Show a bar with the best score so far, rate and time left; lines instead where there is no terminal.

        Returns
        -------
        ExplorationResult
        """
        bar = _Bar(self._budget) if progress else None
        try:
            with noted_interrupts() as check:
                reason = self._run(bar, check)
        except KeyboardInterrupt:
            return ExplorationResult(self._ended(), "it was interrupted", interrupted=True)
        finally:
            if bar is not None:
                bar.stop()
            self._note_time()
        return ExplorationResult(self._ended(), reason)

    def _run(self, bar: _Bar | None, check_interrupt: Callable[[], None]) -> str:
        begun = time.monotonic()
        done, number = self._go_on(bar)
        while True:
            check_interrupt()
            if bar is not None:
                bar.update(done, self._best.text)
            if done >= self._budget:
                return f"the budget of {self._budget} scenarios is used up"
            if self._patience is not None and self._stale >= self._patience:
                return f"{self._patience} rounds brought nothing new"
            if self._max_seconds is not None and time.monotonic() - begun >= self._max_seconds:
                return f"{self._max_seconds:g} s have passed"
            if (enough := self._enough()) is not None:
                return enough
            with self._clock("optimize"):
                points = self._optimizer.ask(min(self._batch, self._budget - done))
            if len(points) == 0:
                return f"all {done} scenarios of the space were run"
            number += 1
            points = self._logical.space.snap(points)
            rows = self._study.propose(number, points, self._logical.space.values(points))
            self._tell(rows, self._simulate(rows, bar))
            done += len(rows)
            self._note_time()

    def _go_on(self, bar: _Bar | None) -> tuple[int, int]:
        """Finish what a killed explorer left pending, and tell the optimizer all; how many scenarios and rounds."""
        rows = self._study.rows()
        known = self._objective.oriented_of(self._study)
        scores = dict(zip((row.id for row in rows if row.state == "done"), known, strict=True))
        for _, members in groupby(rows, key=lambda row: row.round):
            again = list(members)
            scores |= self._simulate([row for row in again if row.state == "pending"], bar)
            self._tell(again, scores)
        return len(rows), rows[-1].round if rows else 0

    def _simulate(self, rows: list[Row], bar: _Bar | None) -> dict[int, Any]:
        """Run scenarios, and store each when it has ended; what is told of those that did not fail."""
        scores: dict[int, Any] = {}
        best = copy(self._best)
        concretes = [self._logical.concrete(row.values) for row in rows for _ in range(self._repeats)]
        results = self._simulator.run(concretes) if rows else iter(())
        nothing = SimulationError("the simulator ended without a result")
        for row in rows:
            with self._clock("simulate"):
                outcomes = [next(results, nothing) for _ in range(self._repeats)]
            with self._clock("measure"):
                runs = [
                    (one, measured(self._metrics, one, self._ego, self._other))
                    for one in outcomes
                    if not isinstance(one, SimulationError)
                ]
            if not runs:
                self._study.fail(row.id, next(one for one in outcomes if isinstance(one, SimulationError)))
                continue
            oriented = [
                self._objective.oriented(np.array([[score for _, score in one.values()]]))[0] for _, one in runs
            ]
            # Of several objectives the first says which run is in the middle.
            order = sorted(range(len(runs)), key=lambda k: float(np.atleast_1d(oriented[k])[0]))
            middle = order[(len(order) - 1) // 2]
            recording, courses = runs[middle]
            repeats = None
            if self._repeats > 1:
                repeats = {metric.name: [one[metric.name][1] for _, one in runs] for metric in self._metrics}
            self._study.finish(row.id, recording, courses, repeats)
            scores[row.id] = oriented[middle]
            best.add(scores[row.id][None])
            if bar is not None:
                bar.update(row.id, best.text)
        return scores

    def _tell(self, rows: list[Row], by_scenario: Mapping[int, Any]) -> None:
        failed = np.full_like(self._objective.uncritical, np.nan)
        missing = failed if self._objective.pareto else np.nan
        told = np.array([by_scenario.get(row.id, missing) for row in rows])
        points = np.array([row.point for row in rows])
        self._optimizer.tell(points, told)
        self._stale = 0 if self._best.add(told) else self._stale + 1
        if self._stop_when:
            self._points, self._told = np.concatenate([self._points, points]), np.concatenate([self._told, told])

    def _enough(self) -> str | None:
        """Why enough is known of the critical set; None while it is not."""
        if not self._stop_when or self._critical is None or len(self._told) < _LEAST:
            return None
        with self._clock("judge"):
            try:
                known = CriticalSet(self._logical.space, self._points, self._told, self._critical, self._seed)
            except ValueError:
                return None
            values = [criterion.value(known) for criterion in self._stop_when]
        if any(value >= one.below for one, value in zip(self._stop_when, values, strict=True)):
            return None
        return " and ".join(one.words(value) for one, value in zip(self._stop_when, values, strict=True))

    @contextmanager
    def _clock(self, stage: str) -> Iterator[None]:
        begun = time.monotonic()
        try:
            yield
        finally:
            self._spent[stage] = self._spent.get(stage, 0.0) + time.monotonic() - begun

    def _note_time(self) -> None:
        for stage, seconds in self._spent.items():
            self._study.add_elapsed(stage, seconds)
        self._spent.clear()

    def _ended(self) -> int:
        return sum(row.state != "pending" for row in self._study.rows())


class _Bar:
    """Progress with the best score, rate and time left: a bar on a terminal, now and then a line elsewhere."""

    def __init__(self, total: int) -> None:
        self._total = total
        self._begun, self._first, self._said, self._done = time.monotonic(), -1, 0.0, -1
        console = Console(stderr=True)
        self._progress: Progress | None = None
        self._task: Any = None
        if console.is_terminal:
            self._progress = Progress(
                TextColumn("exploring"),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.fields[rate]}"),
                TimeRemainingColumn(),
                TextColumn("{task.fields[best]}"),
                console=console,
            )
            self._progress.start()
            self._task = self._progress.add_task("", total=total, rate="", best="")

    def update(self, done: int, best: str) -> None:
        if self._first < 0:
            self._first = done
        now = time.monotonic()
        rate = (done - self._first) / max(now - self._begun, 1e-9)
        if self._progress is not None:
            self._progress.update(self._task, completed=done, rate=f"{rate:.1f}/s", best=best)
        elif now - self._said > 5.0 or (done >= self._total and done != self._done):
            self._said, self._done = now, done
            left = f"{(self._total - done) / rate:.0f} s left" if rate > 0 else "starting"
            said = [f"{done} of {self._total} scenarios", f"{rate:.1f}/s", left, best]
            print(", ".join(filter(None, said)), file=sys.stderr, flush=True)

    def stop(self) -> None:
        if self._progress is not None:
            self._progress.stop()
