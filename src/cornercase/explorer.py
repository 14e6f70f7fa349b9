"""The loop of the paper's figure "scenario exploration workflow"."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from cornercase.errors import InputError, SimulationError
from cornercase.metrics.base import Metric
from cornercase.optimizers.base import Optimizer
from cornercase.scenario.logical import LogicalScenario
from cornercase.simulators.base import Simulator
from cornercase.study import Row, Study
from cornercase.typing import FloatArray


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
        All are stored; the first is searched.
    ego, other : str
    study : Study
        Open for writing.
    budget : int
        Scenarios in all.
    batch : int, default 10
        Scenarios per round.
    patience : int, optional
        Rounds without anything new after which to stop: none of them had a score that is more critical than all
        before.
    max_seconds : float, optional
        Time after which no round is begun.
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
    ) -> None:
        if not metrics:
            raise InputError("There is no metric to search; name one with --metric.")
        self._logical, self._simulator, self._optimizer = logical, simulator, optimizer
        self._metrics, self._ego, self._other, self._study = list(metrics), ego, other, study
        self._budget, self._batch = budget, batch
        self._patience, self._max_seconds = patience, max_seconds
        self._spent: dict[str, float] = {}

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
        bar = _Bar(self._budget, self._metrics[0].unit) if progress else None
        try:
            reason = self._run(bar)
        except KeyboardInterrupt:
            return ExplorationResult(self._ended(), "it was interrupted", interrupted=True)
        finally:
            if bar is not None:
                bar.stop()
        return ExplorationResult(self._ended(), reason)

    def _run(self, bar: _Bar | None) -> str:
        begun = time.monotonic()
        rows = self._study.rows()
        number = rows[-1].round if rows else 0
        for k in range(1, number + 1):
            self._simulate([row for row in rows if row.round == k and row.state == "pending"], bar)
        rows, scores = self._study.rows(), self._scores()
        for k in range(1, number + 1):
            self._tell([row for row in rows if row.round == k], scores)
        best_by_round = [_best(scores[row.id] for row in rows if row.round <= k) for k in range(1, number + 1)]
        while True:
            if bar is not None:
                bar.update(len(rows), self._flip(best_by_round[-1]) if best_by_round else None)
            if len(rows) >= self._budget:
                return f"the budget of {self._budget} scenarios is used up"
            if self._patience is not None and _stale(best_by_round) >= self._patience:
                return f"{self._patience} rounds brought nothing new"
            if self._max_seconds is not None and time.monotonic() - begun >= self._max_seconds:
                return f"{self._max_seconds:g} s have passed"
            with self._clock("optimize"):
                points = self._optimizer.ask(min(self._batch, self._budget - len(rows)))
            if len(points) == 0:
                return f"all {len(rows)} scenarios of the space were run"
            number += 1
            points = self._logical.space.snap(points)
            self._study.propose(number, points, self._logical.space.values(points))
            proposed = self._study.rows()[len(rows) :]
            self._simulate(proposed, bar)
            rows, scores = self._study.rows(), self._scores()
            self._tell([row for row in rows if row.round == number], scores)
            best_by_round.append(_best(scores.values()))
            self._note_time()

    def _simulate(self, rows: list[Row], bar: _Bar | None) -> None:
        if not rows:
            return
        results = self._simulator.run([self._logical.concrete(row.values) for row in rows])
        for row in rows:
            with self._clock("simulate"):
                result = next(results)
            if isinstance(result, SimulationError):
                self._study.fail(row.id, result)
                continue
            with self._clock("measure"):
                courses = {}
                for metric in self._metrics:
                    course = metric.course(result, self._ego, self._other)
                    courses[metric.name] = (course, metric.score(course))
            self._study.finish(row.id, result, courses)
            if bar is not None:
                bar.update(row.id, None)

    def _scores(self) -> dict[int, float]:
        """Scores of the searched metric by scenario, lower being more critical; NaN for failed ones."""
        rows = self._study.rows()
        scores = dict.fromkeys((row.id for row in rows), np.nan)
        found = self._study.scores(self._metrics[0].name)
        for row, score in zip([row for row in rows if row.state == "done"], found, strict=True):
            scores[row.id] = self._flip(float(score))
        return scores

    def _tell(self, rows: list[Row], scores: dict[int, float]) -> None:
        points: FloatArray = np.array([row.point for row in rows])
        self._optimizer.tell(points, np.array([scores[row.id] for row in rows]))

    def _flip(self, score: float) -> float:
        return score if self._metrics[0].lower_is_critical else -score

    @contextmanager
    def _clock(self, stage: str) -> Iterator[None]:
        begun = time.monotonic()
        yield
        self._spent[stage] = self._spent.get(stage, 0.0) + time.monotonic() - begun

    def _note_time(self) -> None:
        for stage, seconds in self._spent.items():
            self._study.add_elapsed(stage, seconds)
        self._spent.clear()

    def _ended(self) -> int:
        return sum(row.state != "pending" for row in self._study.rows())


def _best(scores: Iterable[float]) -> float:
    return min((score for score in scores if np.isfinite(score)), default=np.inf)


def _stale(best: list[float]) -> int:
    """Rounds since the best score last improved."""
    return 0 if not best else len(best) - 1 - best.index(best[-1])


class _Bar:
    """Progress with the best score, rate and time left: a bar on a terminal, now and then a line elsewhere."""

    def __init__(self, total: int, unit: str) -> None:
        self._total, self._unit = total, unit
        self._begun, self._first, self._said = time.monotonic(), -1, 0.0
        self._best = ""
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

    def update(self, done: int, best: float | None) -> None:
        if best is not None and np.isfinite(best):
            self._best = f"best {best:.3g} {self._unit}"
        if self._first < 0:
            self._first = done
        now = time.monotonic()
        rate = (done - self._first) / max(now - self._begun, 1e-9)
        if self._progress is not None:
            self._progress.update(self._task, completed=done, rate=f"{rate:.1f}/s", best=self._best)
        elif now - self._said > 5.0 or done >= self._total:
            self._said = now
            left = f"{(self._total - done) / rate:.0f} s left" if rate > 0 else "starting"
            print(
                f"{done} of {self._total} scenarios, {rate:.1f}/s, {left}, {self._best}",
                file=sys.stderr,
                flush=True,
            )

    def stop(self) -> None:
        if self._progress is not None:
            self._progress.stop()
