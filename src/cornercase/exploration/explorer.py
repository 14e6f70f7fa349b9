"""The loop of the paper's figure "scenario exploration workflow"."""

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

# Scenarios of a space up to which those within its constraints are counted.
_MOST_COUNTED: Final = 1 << 18


@dataclass(frozen=True)
class ExplorationResult:
    """How an exploration ended.

    Attributes
    ----------
    study : Path
    done, failed : int
        Scenarios in the study that were run, and that could not be.
    reason : str
        Why it ended, as a part of a sentence.
    interrupted : bool
    alike : tuple of str
        A sentence for each metric that is searched and by which all scenarios are the same.
    notes : tuple of str
        The same of metrics that are not searched, where it was not said before of this study.
    same : bool or None
        Whether the results in the study gave the same proposals again; None where that was not asked.
    reasons : mapping of str to int
        How many scenarios failed for which reason, the most frequent first.
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
        """Count the scenarios of an open study.

        Parameters
        ----------
        study : Study
        reason : str
        interrupted : bool, default False
        before : int, optional
            How many scenarios the study held when this search began or went on; by default nothing new is said.

        Returns
        -------
        ExplorationResult
        """
        alike = tell_alike(study)
        searched = [alike.pop(name) for name in study.meta.searched if name in alike]
        # It has been said when there were enough of them.
        notes = tuple(alike.values()) if before is not None and before < ENOUGH_ALIKE else ()
        failed = study.failed()
        reasons = {why: len(rows) for why, rows in group_reasons(row.error or "" for row in failed).items()}
        return cls(
            study.path, len(study.done()), len(failed), reason, interrupted, tuple(searched), notes, reasons=reasons
        )

    @property
    def ended(self) -> int:
        """Number of scenarios that were run or could not be."""
        return self.done + self.failed

    def __repr__(self) -> str:
        failed = f", {self.failed} failed" if self.failed else ""
        return f"<ExplorationResult: {self.done} scenarios done{failed} in {self.study}; {self.reason}>"


class ScenarioExplorer:
    """Looks for the critical concrete scenarios of a logical one.

    Steps (1) to (6) of the paper's activity diagram: the optimizer chooses parameters, the simulator runs them, the
    metrics evaluate them, until a termination criterion is fulfilled. Each scenario is stored the moment it has
    ended; an explorer that is given a study goes on where that one stopped.

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
        if (known := study.elsewhere()) is not None:
            optimizer.begin_from(*known)

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
        """Run rounds until a criterion says why to end."""
        begun = time.monotonic()
        done, number = self._go_on(bar)
        while True:
            self._runner.try_repeatability()
            check_interrupt()
            if bar is not None:
                bar.update(done, self._best.text)
            if (reason := self._reason(done, time.monotonic() - begun)) is not None:
                return reason
            number += 1
            rows = self._next(number, done, min(self._configuration.batch, self._configuration.budget - done))
            if not rows:
                return self._used_up(done)
            self._tell(rows, self._simulate(rows, bar))
            done += len(rows)
            self._clock.note()

    def _next(self, number: int, done: int, wanted: int) -> list[Row]:
        """Propose a round, and store it; none when there are no more."""
        with self._clock("optimize"):
            points = self._proposer.propose(done, wanted)
        if len(points) == 0:
            return []
        with self._clock("store"):
            return self._study.writer.propose(number, points, self._space.values(points))

    def _reason(self, done: int, seconds: float) -> str | None:
        """Say which criterion ends the search; None for none."""
        limits = self._configuration
        if done >= limits.budget:
            return f"the budget of {limits.budget} scenarios is used up"
        if self._patience is not None and self._stale >= self._patience:
            return f"{self._patience} {self._things} brought nothing new"
        if limits.max_seconds is not None and seconds >= limits.max_seconds:
            return f"{limits.max_seconds:g} s have passed"
        return self._enough()

    def _used_up(self, done: int) -> str:
        """Say why a search ends that proposes nothing more: it may be a grid, or find nothing within constraints."""
        size = self._space.size
        # Audits may be scenarios that the search runs, too.
        points = np.array([row.point for row in self._study.rows()]).reshape(-1, self._space.dimension)
        ran = len(set(row_keys(self._space.snap(points))))
        if size is not None and ran < size <= _MOST_COUNTED:
            size = int(self._space.admits(self._space.lattice()).sum())
        if size is not None and ran >= size:
            return f"all {size} scenarios of the space were run"
        return f"the search proposes no more than these {done} scenarios"

    def _enough(self) -> str | None:
        """Say why enough is known of the critical set; None while it is not."""
        if not self._stopping.ready:
            return None
        with self._clock("judge"):
            return self._stopping.reason()

    def _go_on(self, bar: ProgressBar | None) -> tuple[int, int]:
        """Finish what a killed explorer left pending, tell the optimizer everything, and count scenarios and rounds."""
        rows = self._study.rows()
        known = self._objective.oriented_of(self._study)
        scores = dict(zip((row.id for row in rows if row.state == "done"), known, strict=True))
        for _, members in groupby(rows, key=lambda row: row.round):
            again = list(members)
            scores |= self._simulate([row for row in again if row.state == "pending"], bar)
            self._tell(again, scores)
        return len(rows), rows[-1].round if rows else 0

    def _simulate(self, rows: list[Row], bar: ProgressBar | None) -> dict[int, Any]:
        """Run scenarios; the oriented scores of those that did not fail, by id."""
        scores: dict[int, Any] = {}
        best, farthest = copy(self._best), 0
        for number, score in self._runner.run(rows):
            scores[number] = score
            best.add(score[None])
            # One that needed more runs ends after later ones.
            farthest = max(farthest, number)
            if bar is not None:
                bar.update(farthest, best.text)
        return scores

    def _tell(self, rows: list[Row], by_scenario: Mapping[int, Any]) -> None:
        """Give the scores of one round to all who learn from them; those of audits only to who judges."""
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
        # Some take the features of the recordings too.
        features = (self._features(searched, by_scenario),) if self._wants_features else ()
        with self._clock("judge"):
            self._stopping.tell(points, scores, *features)
        with self._clock("optimize"):
            self._search.tell(points, scores, *features)
        self._look_for_news(scores)

    def _look_for_news(self, scores: FloatArray) -> None:
        """Count how long there was nothing new, by the scores of one round."""
        self._stale = 0 if self._best.add(scores) else self._stale + 1

    def _features(self, rows: list[Row], by_scenario: Mapping[int, Any]) -> FloatArray:
        """What happened in the scenarios of one round, of the recordings that are stored, shape (m, f)."""
        with self._clock("measure"):
            recordings = [self._study.recording(row.id) if row.id in by_scenario else None for row in rows]
            return features_of(recordings, self._configuration.ego, self._configuration.others)
