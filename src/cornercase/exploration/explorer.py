"""The exploration loop: the paper's figure "scenario exploration workflow"."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import Any, Final

import numpy as np

from cornercase._common.interrupts import noted_interrupts
from cornercase._common.parts import group_reasons
from cornercase._common.progress import ProgressBar
from cornercase._common.rows import row_keys
from cornercase._common.typing import FloatArray
from cornercase.exploration.alike import ENOUGH_ALIKE, tell_alike
from cornercase.exploration.configuration import Configuration
from cornercase.exploration.judging import elsewhere_of
from cornercase.exploration.objective import Best, Objective
from cornercase.exploration.proposing import Proposer, Search
from cornercase.exploration.running import ScenarioRunner, StageClock
from cornercase.exploration.stopping import Stopping
from cornercase.metrics import features_of
from cornercase.optimizers import Optimizer
from cornercase.simulators import Simulator
from cornercase.study import Row, Study

# Largest space whose scenarios within the constraints are counted.
_MOST_COUNTED: Final = 1 << 18


@dataclass(frozen=True)
class ExplorationResult:
    """How an exploration ended.

    Attributes
    ----------
    study : Path
    done, failed : int
        Number of scenarios in the study that gave a result, and that failed.
    reason : str
        Why it ended, as a part of a sentence.
    interrupted : bool
    alike : tuple of str
        A sentence for each searched metric that has the same score in all scenarios.
    notes : tuple of str
        The same for metrics that are not searched, unless this was reported before for this study.
    same : bool or None
        Whether the stored results led to the same proposals again; None if this was not checked.
    reasons : mapping of str to int
        Number of failed scenarios by reason, the most frequent first.
    """

    study: Path
    done: int
    failed: int
    reason: str
    interrupted: bool = False
    alike: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    same: bool | None = None
    reasons: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def of(cls, study: Study, reason: str, interrupted: bool = False, before: int | None = None) -> ExplorationResult:
        """Create the result from an open study.

        Parameters
        ----------
        study : Study
        reason : str
        interrupted : bool, default False
        before : int, optional
            Number of scenarios that the study held when this search started or was resumed; by default no notes are
            made.

        Returns
        -------
        ExplorationResult
        """
        messages = tell_alike(study)
        searched = [messages.pop(name) for name in study.meta.searched if name in messages]
        # Reported once, when the study reaches the minimum number of scenarios.
        notes = tuple(messages.values()) if before is not None and before < ENOUGH_ALIKE else ()
        failed = study.failed()
        reasons = {
            reason_text: len(rows) for reason_text, rows in group_reasons(row.error or "" for row in failed).items()
        }
        return cls(
            study.path, len(study.done()), len(failed), reason, interrupted, tuple(searched), notes, reasons=reasons
        )

    @property
    def ended(self) -> int:
        """Number of scenarios that gave a result or failed."""
        return self.done + self.failed

    def __repr__(self) -> str:
        failed = f", {self.failed} failed" if self.failed else ""
        return f"<ExplorationResult: {self.done} scenarios done{failed} in {self.study}; {self.reason}>"


class ScenarioExplorer:
    """Searches a logical scenario in rounds, steps (1) to (6) of the paper's activity diagram.

    The optimizer chooses parameters, the simulator runs them, the metrics evaluate them, until a termination criterion
    holds. Each scenario is stored as soon as it has ended; an existing study is resumed. `optimizer` has to be a fresh
    one: it is told what the study contains. `references` are simulators with a reference driver in the ego, by name.
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
        self._configuration, self._optimizer, self._study = configuration, optimizer, study
        self._space = configuration.logical.space
        self._objective = configuration.objective() if objective is None else objective
        threshold = configuration.threshold(self._objective)
        self._stopping = Stopping(
            configuration.criteria(),
            self._space,
            threshold,
            configuration.seed,
            configuration.optimizer,
            audited=configuration.audit > 0.0,
            elsewhere=None if threshold is None or not configuration.stop_when else elsewhere_of(study, threshold),
        )
        self._clock = StageClock(study)
        self._runner = ScenarioRunner(configuration, simulator, self._objective, study, self._clock, references)
        self._best, self._stale = Best(self._objective), 0
        self._patience, self._things = configuration.patience, "rounds"
        self._wants_features = "features" in optimizer.needs
        if (warm_start := study.elsewhere()) is not None:
            optimizer.begin_from(*warm_start)

    def run(self, progress: bool = False) -> ExplorationResult:
        """Explore until a termination criterion holds; `progress` shows best score, rate and remaining time."""
        self._search = Search(self._optimizer, self._study.meta.asynchronous)
        self._proposer = Proposer(self._search, self._study)
        before = len(self._study.done())
        bar = ProgressBar(self._configuration.budget, "exploring", "scenarios") if progress else None
        try:
            with noted_interrupts() as check:
                reason = self._run(bar, check)
        except KeyboardInterrupt:
            return ExplorationResult.of(self._study, "it was interrupted", interrupted=True, before=before)
        finally:
            if bar is not None:
                bar.stop()
            self._clock.note()
            self._runner.notices.warn()
        return ExplorationResult.of(self._study, reason, before=before)

    def _run(self, bar: ProgressBar | None, check_interrupt: Callable[[], None]) -> str:
        """Run rounds and return why the search ended."""
        start = time.monotonic()
        done, number = self._go_on(bar)
        while True:
            self._runner.try_repeatability()
            check_interrupt()
            if bar is not None:
                bar.update(done, self._best.text)
            if (reason := self._reason(done, time.monotonic() - start)) is not None:
                return reason
            number += 1
            rows = self._next(number, done, min(self._configuration.batch, self._configuration.budget - done))
            if not rows:
                return self._used_up(done)
            self._tell(rows, self._simulate(rows, bar))
            done += len(rows)
            self._clock.note()

    def _next(self, number: int, done: int, wanted: int) -> list[Row]:
        """Propose and store one round; empty if the search has no more proposals."""
        with self._clock("optimize"):
            points = self._proposer.propose(done, wanted)
        if len(points) == 0:
            return []
        with self._clock("store"):
            return self._study.writer.propose(number, points, self._space.values(points))

    def _reason(self, done: int, seconds: float) -> str | None:
        """Return the termination criterion that holds; None if none does."""
        config = self._configuration
        if done >= config.budget:
            return f"the budget of {config.budget} scenarios is used up"
        if self._patience is not None and self._stale >= self._patience:
            return f"{self._patience} {self._things} brought no improvement"
        if config.max_seconds is not None and seconds >= config.max_seconds:
            return f"{config.max_seconds:g} s have passed"
        return self._enough()

    def _used_up(self, done: int) -> str:
        """Return why the search proposes nothing more: the space is exhausted, or the constraints leave nothing."""
        size = self._space.size
        # An audit may be the same scenario as a proposal of the search.
        points = np.array([row.point for row in self._study.rows()]).reshape(-1, self._space.dimension)
        n_run = len(set(row_keys(self._space.snap(points))))
        if size is not None and n_run < size <= _MOST_COUNTED:
            size = int(self._space.admits(self._space.lattice()).sum())
        if size is not None and n_run >= size:
            return f"all {size} scenarios of the space were run"
        return f"the search has no proposals after these {done} scenarios"

    def _enough(self) -> str | None:
        """Return which stop criteria on the critical set hold; None unless all do."""
        if not self._stopping.ready:
            return None
        with self._clock("judge"):
            return self._stopping.reason()

    def _go_on(self, bar: ProgressBar | None) -> tuple[int, int]:
        """Run pending scenarios and tell the optimizer all results; return the numbers of scenarios and rounds."""
        rows = self._study.rows()
        minimized = self._objective.oriented_of(self._study)
        scores = dict(zip((row.id for row in rows if row.state == "done"), minimized, strict=True))
        for _, members in groupby(rows, key=lambda row: row.round):
            round_rows = list(members)
            scores |= self._simulate([row for row in round_rows if row.state == "pending"], bar)
            self._tell(round_rows, scores)
        return len(rows), rows[-1].round if rows else 0

    def _simulate(self, rows: list[Row], bar: ProgressBar | None) -> dict[int, Any]:
        """Run scenarios; return the minimized scores of the successful ones by id."""
        scores: dict[int, Any] = {}
        best, farthest = copy(self._best), 0
        for number, score in self._runner.run(rows):
            scores[number] = score
            best.add(score[None])
            # A scenario with extra runs ends after later ones.
            farthest = max(farthest, number)
            if bar is not None:
                bar.update(farthest, best.text)
        return scores

    def _tell(self, rows: list[Row], by_scenario: Mapping[int, Any]) -> None:
        """Pass the scores of one round to the optimizer and the stop criteria; audits only to the latter."""
        failed = np.full_like(self._objective.uncritical, np.nan)
        missing = failed if self._objective.pareto else np.nan
        scores = np.array([by_scenario.get(row.id, missing) for row in rows])
        points = np.array([row.point for row in rows])
        audits = np.array([self._study.meta.is_audit(row.id) for row in rows], dtype=np.bool_)
        with self._clock("judge"):
            self._stopping.tell_audits(points[audits], scores[audits])
        searched = [row for row, audit in zip(rows, audits, strict=True) if not audit]
        if not searched:
            return
        points, scores = points[~audits], scores[~audits]

        features = (self._features(searched, by_scenario),) if self._wants_features else ()
        with self._clock("judge"):
            self._stopping.tell(points, scores, *features)
        with self._clock("optimize"):
            self._search.tell(points, scores, *features)
        self._look_for_news(scores)

    def _look_for_news(self, scores: FloatArray) -> None:
        """Count the rounds without an improvement."""
        self._stale = 0 if self._best.add(scores) else self._stale + 1

    def _features(self, rows: list[Row], by_scenario: Mapping[int, Any]) -> FloatArray:
        """Features of the stored recordings of one round, shape (m, f)."""
        with self._clock("measure"):
            recordings = [self._study.recording(row.id) if row.id in by_scenario else None for row in rows]
            return features_of(recordings, self._configuration.ego, self._configuration.others)
